"""Two images and their ranges, warped to the view from another viewpoint."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from harness.api.loading import load_sensor
from harness.api.ranging import RangeEstimate
from harness.camera.sensor import Sensor, pixel_directions, require_central
from harness.display import OneLine, html_figure
from harness.errors import InputError
from harness.files import PICTURE_MARK, OwnFiles, check_no_others, make_folder, write
from harness.geometry.angles import Array, normalise
from harness.geometry.panorama import directions
from harness.geometry.pose import AT_REST, Pose
from harness.images import png_note
from harness.spec import parse
from harness.warping.surface import RangeSurface
from harness.warping.warp import Image, PixelState, Source, warp

Projection = Literal["panorama", "mirror", "perspective"]


_README = "view.png: the view; black where nothing is known\n"
OF_A_VIEW = OwnFiles(
    "warped view",
    dict.fromkeys(("view.png", "range.npy", "sigma_m.npy", "state.npy")) | {"README.txt": _README.encode()},
    {"view.png": PICTURE_MARK},
)
"""The files of a folder with a warped view."""


@dataclass(frozen=True, eq=False, repr=False)
class NewView(OneLine):
    """A view from another viewpoint; arrays `[height, width]`, unmirrored."""

    image: NDArray[np.uint8]
    """`[height, width]`, or `[height, width, 3]` of colour photographs; black where nothing is known."""
    range_m: Array
    """Range from the new viewpoint, in the unit of the estimate; NaN where it is unknown."""
    sigma_m: Array
    """Standard deviation of `range_m`."""
    state: NDArray[np.uint8]
    """The `harness.warping.warp.PixelState` of each pixel: seen, or the reason why not."""

    def shares(self) -> dict[str, float]:
        """Share of the pixels in each state."""
        return {state.name.lower(): float((self.state == state).mean()) for state in PixelState}

    def write(self, folder: str | Path) -> None:
        """Write `view.png` and the arrays into a folder, which is created if it does not exist.

        Raises
        ------
        InputError
            When the folder cannot be written to.
        """
        folder = Path(folder)
        check_no_others(folder, OF_A_VIEW)
        make_folder(folder)
        states = ", ".join(f"{state.value} {state.name.lower()}" for state in PixelState)
        # First, so that a folder that was left half-written is known as ours.
        write(
            folder / "README.txt",
            f"{_README}range.npy: distance from the new viewpoint, metres (baselines where the scale is not known), or "
            f"NaN\nsigma_m.npy: its standard deviation\nstate.npy: {states}\n",
        )
        for name, array in (("state.npy", self.state), ("range.npy", self.range_m), ("sigma_m.npy", self.sigma_m)):
            stream = io.BytesIO()
            np.save(stream, array, allow_pickle=False)
            write(folder / name, stream.getvalue())
        write(folder / "view.png", self._png())

    def _png(self) -> bytes:
        stream = io.BytesIO()
        Pillow.fromarray(self.image).save(stream, format="PNG", pnginfo=png_note())
        return stream.getvalue()

    def _repr_html_(self) -> str:
        """The picture."""
        return html_figure({"new view": self._png()}, f"{self.shares()['seen']:.1%} of the pixels are seen by a source")


def warp_view(
    estimate: RangeEstimate,
    position_m: Sequence[float],
    *,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    projection: Projection = "panorama",
    sensor: str | Path | Mapping[str, Any] | Sensor | None = None,
    field_deg: float = 90.0,
    width_px: int = 640,
    height_px: int = 480,
    fill: bool = False,
) -> NewView:
    """Warp two photographs with their ranges to the view from another viewpoint.

    Parameters
    ----------
    estimate
        The result of `estimate_range`.
    position_m
        The new viewpoint (x, y, z) in view 1's frame, metres, or baselines where the scale is not known.
    yaw_deg, pitch_deg, roll_deg
        The rotation of the new view against view 1's frame, about z, then y, then x, degrees.
    projection
        `panorama`: on the estimate's grid. `mirror`: as a sensor sees it. `perspective`: a pinhole camera that looks
        along x of its frame, z up.
    sensor
        The sensor of a `mirror` image; that of view 1 when None.
    field_deg, width_px, height_px
        Horizontal field of view and size of a `perspective` view.
    fill
        Whether holes are filled from their surroundings.

    Returns
    -------
    NewView
        `image`, `range_m`, `sigma_m` and `state` of every pixel; `write(folder)`.

    Raises
    ------
    InputError
        When an argument is invalid, or the estimate has no range at all.

    Examples
    --------
    >>> import harness
    >>> left, right = (harness.render("room", position_m=(x, 0, 1), samples=1) for x in (0, 0.5))
    >>> estimate = harness.estimate_range(left.image, right.image, left.sensor, (0.5, 0, 0), matcher="column")
    >>> view = harness.warp_view(estimate, (0.2, 0.3, 0.0), projection="perspective", yaw_deg=90)
    >>> view.image.shape
    (480, 640)
    """
    pose = viewpoint(position_m, yaw_deg, pitch_deg, roll_deg)
    check_perspective(field_deg, width_px, height_px)
    if not estimate.valid.any():
        raise InputError("has no range to warp with", key="estimate")
    rays = _rays(estimate, projection, sensor, field_deg, (height_px, width_px)) @ pose.R_world_from_view.T
    pair = estimate.pair
    surface = RangeSurface(pair.grid, estimate.range_m, estimate.sigma_m)
    motions = AT_REST, pair.motion
    channels = _channels(estimate)
    warped = [
        warp(
            [Source(surface, AT_REST)],
            [Image(grey, each, motion) for grey, each, motion in zip(pictures, pair.sensors, motions, strict=True)],
            np.asarray(pose.position_m),
            rays,
            fill=fill,
        )
        for pictures in channels
    ]
    image = np.stack([np.nan_to_num(np.clip(np.rint(each.grey), 0, 255)) for each in warped], axis=-1).astype(np.uint8)
    first = warped[0]
    return NewView(image if len(channels) > 1 else image[..., 0], first.range_m, first.sigma_m, first.state)


def viewpoint(position_m: Sequence[float], yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """The pose of a new view in view 1's frame.

    Raises
    ------
    InputError
        When a number is not finite.
    """
    angles = {"yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    return parse(Pose, {"position_m": list(position_m), **angles})


def check_perspective(field_deg: float, width_px: int, height_px: int) -> None:
    """Refuse an impossible pinhole camera.

    Raises
    ------
    InputError
        When its field of view or its size is out of range.
    """
    if not 1 <= field_deg <= 179:
        raise InputError(f"must be 1 to 179 degrees; found {field_deg:g}", key="field_deg")
    for name, side in (("width_px", width_px), ("height_px", height_px)):
        if not 8 <= side <= 16384:
            raise InputError(f"must be 8 to 16384; found {side}", key=name)


def _channels(estimate: RangeEstimate) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Both images of each channel: the photographs' colours where there are any, or their grey levels."""
    first, second = estimate.photographs
    colours = first.colour, second.colour
    sizes = [(each.camera.height_px, each.camera.width_px) for each in estimate.pair.sensors]
    as_matched = all(colour.shape[:2] == size for colour, size in zip(colours, sizes, strict=True))
    if not as_matched or all((colour[..., :1] == colour).all() for colour in colours):
        return [estimate.pair.images]
    return [(colours[0][..., i].astype(np.float32), colours[1][..., i].astype(np.float32)) for i in range(3)]


def _rays(
    estimate: RangeEstimate,
    projection: Projection,
    sensor: str | Path | Mapping[str, Any] | Sensor | None,
    field_deg: float,
    size: tuple[int, int],
) -> Array:
    """Unit rays of the new view's pixels in its own frame, `[height, width, 3]`; NaN for a pixel without a ray."""
    if projection == "panorama":
        return directions(estimate.pair.grid)[:, ::-1]  # as seen from inside: azimuth descends to the right
    if projection == "mirror":
        seen_by = estimate.pair.sensors[0] if sensor is None else load_sensor(sensor)
        require_central(seen_by)
        rays, valid = pixel_directions(seen_by)
        return np.where(valid[..., None], rays, np.nan)
    if projection != "perspective":
        raise InputError(f"must be panorama, mirror or perspective; found {projection!r}", key="projection")
    height, width = size
    focal = width / 2 / math.tan(math.radians(field_deg) / 2)
    u, v = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    return normalise(np.stack([np.full(u.shape, focal), -u, -v], axis=-1))
