"""Range from two photographs: any matcher on real images, without a scene and without truth."""

import io
import json
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from harness.camera.sensor import Sensor, forget_directions, project
from harness.camera.visible_rows import with_rows
from harness.display import OneLine
from harness.errors import InputError
from harness.files import OwnFiles, check_no_others, make_folder, read_regular, write
from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_1
from harness.geometry.motion_error import MotionError, range_sigma
from harness.geometry.panorama import Grid, directions, row_bands
from harness.geometry.pose import Motion
from harness.geometry.triangulation import sigma_of_range
from harness.images import LIMIT_BYTES, decode
from harness.matching.interface import MatcherSettings, Matches, Reason
from harness.matching.pair import Bands, Pair, Share, sharing
from harness.matching.ranges import ranges_of
from harness.matching.semi_global.match import forget_large
from harness.matching.uncertainty import sigma_alpha_2
from harness.pipeline.geometry_check import GeometryCheck, check_geometry, geometry_share
from harness.pipeline.match_check import moved, without, without_unlike
from harness.pipeline.repeated_texture import repeated
from harness.pipeline.sharpness import Sharpness, compare_sharpness, equalised, filled, half_size, has_few_matches
from harness.pipeline.sight import check_sensor

WRITTEN = (
    "range.npy",
    "range_mm.png",
    "sigma_m.npy",
    "sigma_matching_m.npy",
    "sigma_geometry_m.npy",
    "sigma_motion_m.npy",
    "alpha_2.npy",
    "reason.npy",
    "points.ply",
    "range.json",
    "across.csv",
)
OF_A_RANGE = OwnFiles(
    "range of two images",
    dict.fromkeys(("range.html", *WRITTEN))
    | {"range.json": b'{\n  "density": ', "across.csv": b"azimuth_deg,elevation_deg,u_px,v_px,"},
    {"range.html": b"<title>Range from two "},
)
"""The files of a folder with the ranges of two images."""


_WORTH_SAYING = 0.005
"""Share of the panorama whose texture repeats, at least, to be said so."""
_BEYOND_LIMITS = 1.5
"""By what factor ranges of texture that repeats are looked for beyond estimated limits: it has few keypoints, whose
matches the motion rejects."""


@dataclass(frozen=True, repr=False)
class Photograph(OneLine):
    """A mirror image from a file."""

    file: Path
    grey: NDArray[np.float32]
    """`[height, width]`, 0 .. 255."""
    colour: NDArray[np.uint8]
    """`[height, width, 3]`."""
    scale: str
    """The conversion from the file's levels to grey, in words."""


@dataclass(frozen=True, repr=False)
class Estimate(OneLine):
    """Range from a pair of photographs; arrays on view 1's panorama."""

    photographs: tuple[Photograph, Photograph]
    pair: Pair
    matcher: MatcherSettings
    matches: Matches
    range_m: Array
    """Range from view 1; NaN where `reason` is not `Reason.MATCHED`."""
    sigma_m: Array
    """Predicted standard deviation of the range, to first order; NaN where nothing is predicted. The root of the sum of
    the squares of the next three."""
    sigma_matching_m: Array
    """The part of the matching: of the images' noise and texture."""
    sigma_geometry_m: Array
    """The part of motion and calibration, as far as the images show that these are wrong; 0 where they do not."""
    sigma_motion_m: Array
    """The part of a motion that was estimated, by its covariance; 0 where the motion was given."""
    has_metres: bool
    """Whether the length of the motion is known; all ranges are in units of it where it is not."""
    geometry: GeometryCheck
    """Whether motion and calibration agree with the images."""
    sharpness: Sharpness
    """The sharpness of the images as read; `pair.images` are equally sharp."""
    reason: NDArray[np.uint8]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with a range."""
        return np.isfinite(self.range_m)

    @property
    def points_m(self) -> Array:
        """`[pixels with a range, 3]`, in view 1's frame, z up."""
        return directions(self.pair.grid)[self.valid] * self.range_m[self.valid][:, None]

    def lines(self) -> list[str]:
        """What to say of sharpness, of the geometry, and of texture that repeats, as a list of sentences."""
        repeated = float(np.mean(self.reason == Reason.REPEATED))
        left_out = f"{repeated:.1%} of the panorama is left out: its texture repeats, and another range fits as well"
        return [
            *self.sharpness.lines(),
            *self.geometry.lines(),
            *([left_out] if repeated > _WORTH_SAYING else []),
        ]

    def summary(self) -> dict[str, Any]:
        """The overall figures as plain values; None for a figure without a value."""

        def median(values: Array) -> float | None:
            known = values[np.isfinite(values)]
            return float(np.median(known)) if known.size else None

        return {
            "density": float(self.valid.mean()),
            "range_median_m": median(self.range_m),
            "sigma_median_m": median(self.sigma_m),
            "sigma_matching_median_m": median(self.sigma_matching_m),
            "sigma_geometry_median_m": median(self.sigma_geometry_m),
            "sigma_motion_median_m": median(self.sigma_motion_m),
            "baseline_m": self.pair.motion.baseline_m,
            "unit": "metre" if self.has_metres else "baseline",
            "panorama": self.pair.grid.model_dump(),
            "d_min_m": self.matcher.d_min_m,
            "d_max_m": self.matcher.d_max_m,
            "sharpness": self.sharpness.summary(),
            "geometry": self.geometry.summary(),
        }

    @property
    def colours(self) -> NDArray[np.uint8]:
        """`[pixels with a range, 3]`: red, green and blue of view 1's photograph."""
        valid = self.valid
        return np.concatenate([self._colours(rows, valid[rows]) for rows in row_bands(self.pair.grid)])

    def _colours(self, rows: slice, valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """The colours of the valid pixels of some of the panorama's rows."""
        pixels, _ = project(self.pair.sensors[0], directions(self.pair.grid)[rows][valid])
        coordinates = pixels[:, ::-1].T
        bands = np.moveaxis(self.photographs[0].colour, -1, 0)
        sampled = [
            ndimage.map_coordinates(each, coordinates, order=1, mode="nearest", output=np.float32) for each in bands
        ]
        return np.clip(np.rint(np.stack(sampled, axis=-1)), 0, 255).astype(np.uint8)


def read_photograph(file: Path, sensor: Sensor, bits: int | None = None, *, option: str = "--sensor") -> Photograph:
    """Read a mirror image of any common format, see `harness.images`; colour is matched by its luma.

    Parameters
    ----------
    bits
        White is 2^bits - 1; the file's type decides when None.
    option
        The option or argument that gives the sensor, for messages.

    Raises
    ------
    InputError
        When the file is missing or no image, does not have the sensor's size, or has levels outside 0 .. white.
    """
    camera = sensor.camera
    picture = decode(
        read_regular(file, LIMIT_BYTES, "image"),
        file,
        white=None if bits is None else 2.0**bits - 1,
        key="--bits",
        size=(camera.width_px, camera.height_px),
        size_hint=f"the sensor {camera.width_px}x{camera.height_px}; give the sensor that took it with {option}",
    )
    grey = picture.grey()
    grey.flags.writeable = False
    return Photograph(file, grey, picture.colour(), picture.scale)


def estimate(
    first: Photograph,
    second: Photograph,
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    matcher: MatcherSettings,
    grid: Grid | None = None,
    motion_error: MotionError | None = None,
    *,
    has_metres: bool = True,
    limits_known: bool = True,
) -> Estimate:
    """Match two photographs and triangulate.

    Parameters
    ----------
    motion_error
        How uncertain the motion is; None where it is taken for exact.
    has_metres
        Whether the motion's length is in metres; 1 stands for it otherwise.
    limits_known
        Whether nothing is nearer or farther than what the matcher searches. Limits that were estimated may be wrong:
        texture that repeats is looked for beyond them.

    Raises
    ------
    InputError
        When a sensor sees nothing of the panorama, the matcher cannot be found, or what it returns is invalid.
    """
    grid = _grid(grid or Grid(), sensors, motion)
    check_sensor(sensors[0], grid)
    check_sensor(sensors[1], grid, key="sensor_2", R_sensor_from_panorama=motion.R_v2_from_v1)
    sharpness = compare_sharpness((first.grey, second.grey), sensors, motion, grid)
    images = equalised((first.grey, second.grey), sensors, sharpness)
    bands = _bands_of((first, second), sensors, sharpness)
    pair = Pair(images, sensors, motion, grid, share=_sharing_panoramas(), bands=bands)
    matches = without_unlike(pair, matcher, _matched(pair, matcher, sharpness))
    beyond = 1.0 if limits_known else _BEYOND_LIMITS
    limits_m = matcher.d_min_m / beyond, matcher.d_max_m * beyond
    matches = without(
        matches, repeated(pair, limits_m, ranges_of(matches, pair.alpha_1, motion.baseline_m)[0]), Reason.REPEATED
    )
    geometry = check_geometry(pair, *_ranges(pair, matcher, matches)[::2])
    matches = without(matches, moved(pair, geometry), Reason.OFF_CURVE)
    range_m, reason, matching_m = _ranges(pair, matcher, matches)
    forget_large(pair.grid)
    forget_directions(sensors[0])
    geometry_m = geometry_share(geometry, pair, range_m) * range_m
    motion_m = np.where(np.isfinite(range_m), 0.0, np.nan)
    if motion_error is not None:
        for rows in row_bands(grid):
            motion_m[rows] = range_sigma(directions(grid)[rows], range_m[rows], motion.t_v1, motion_error)
    return Estimate(
        photographs=(first, second),
        pair=pair,
        matcher=matcher,
        matches=matches,
        range_m=range_m,
        sigma_m=np.sqrt(matching_m**2 + geometry_m**2 + motion_m**2),
        sigma_matching_m=matching_m,
        sigma_geometry_m=geometry_m,
        sigma_motion_m=motion_m,
        has_metres=has_metres,
        geometry=geometry,
        sharpness=sharpness,
        reason=reason,
    )


def _bands_of(
    photographs: tuple[Photograph, Photograph], sensors: tuple[Sensor, Sensor], sharpness: Sharpness
) -> Callable[[int], Bands] | None:
    """The photographs' colours, equally sharp as the grey images; None for grey photographs."""
    colours = tuple(each.colour for each in photographs)
    alike = all(each.colour.shape[:2] == each.grey.shape for each in photographs)
    if not alike or all((each[..., :1] == each).all() for each in colours):
        return None

    def bands(view: int) -> Bands:
        made = []
        for i in range(3):
            both = tuple(np.ascontiguousarray(each[..., i], dtype=np.float32) for each in colours)
            made.append(equalised((both[0], both[1]), sensors, sharpness)[view])
        return made[0], made[1], made[2]

    return bands


def _sharing_panoramas() -> Share:
    """Share panoramas alone: a single matcher runs once, and costs of the size of a volume are not worth keeping."""
    keep = sharing()

    def share(stage: str, key: Hashable, make: Callable[[], Any]) -> Any:
        return keep(stage, key, make) if stage in {"unwrap", "filter", "project"} else make()

    return share


def _ranges(pair: Pair, matcher: MatcherSettings, matches: Matches) -> tuple[Array, NDArray[np.uint8], Array]:
    """Range, `Reason` and the matching's standard deviation of the range, each `[height, width]`."""
    a_1, baseline_m = alpha_1(pair.grid, pair.t_v1), pair.motion.baseline_m
    range_m, reason = ranges_of(matches, a_1, baseline_m)
    sigma_m = sigma_of_range(a_1, matches.alpha_2, sigma_alpha_2(pair, matcher, matches), baseline_m)
    return range_m, reason, np.where(np.isfinite(range_m), sigma_m, np.nan)


def _matched(pair: Pair, matcher: MatcherSettings, sharpness: Sharpness) -> Matches:
    """The matches; where soft images have few, those of images of half the size as well."""
    matches = matcher.match(pair)
    support = matcher.support(0.0)
    by_pixels = support is not None and support.frame == "mirror"
    density = float(np.mean(matches.reasons == Reason.MATCHED))
    if by_pixels and has_few_matches(sharpness, density, pair.images):
        return filled(matches, matcher.match(half_size(pair)))
    return matches


def _grid(grid: Grid, sensors: tuple[Sensor, Sensor], motion: Motion) -> Grid:
    try:
        return with_rows(grid, sensors, motion.R_v2_from_v1)
    except ValueError as error:
        raise InputError(str(error), key="panorama") from error


def write_estimate(result: Estimate, folder: Path) -> None:
    """Write the files of `WRITTEN`.

    `range_mm.png` has 16 bits: millimetres, 0 where there is no range, 65535 from 65.535 m on. `points.ply` holds the
    points in view 1's frame with the photograph's colours. `range.json` holds the medians and the verdict on the
    geometry, `across.csv` how far each window of `harness.motion.across` lies off its epipolar curve.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    check_no_others(folder, OF_A_RANGE)
    make_folder(folder)
    # First, so that a folder that was left half-written is known as ours.
    write(folder / "range.json", json.dumps(result.summary(), indent=2, allow_nan=False) + "\n")
    for name, array in (
        ("range.npy", result.range_m),
        ("sigma_m.npy", result.sigma_m),
        ("sigma_matching_m.npy", result.sigma_matching_m),
        ("sigma_geometry_m.npy", result.sigma_geometry_m),
        ("sigma_motion_m.npy", result.sigma_motion_m),
        ("alpha_2.npy", result.matches.alpha_2),
        ("reason.npy", result.reason),
    ):
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        write(folder / name, stream.getvalue())
    millimetres = np.clip(np.rint(1000 * np.where(result.valid, result.range_m, 0.0)), 0, 65535).astype(np.uint16)
    stream = io.BytesIO()
    Image.fromarray(millimetres).save(stream, format="PNG")
    write(folder / "range_mm.png", stream.getvalue())
    cloud = trimesh.PointCloud(result.points_m, colors=result.colours)  # type: ignore[no-untyped-call]
    write(folder / "points.ply", cloud.export(file_type="ply"))  # type: ignore[no-untyped-call]
    write(folder / "across.csv", result.geometry.table().to_csv(index=False, float_format="%.6g", lineterminator="\n"))
