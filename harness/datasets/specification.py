"""The specification of a data set: the distributions of its scenes, rigs and motions, as in a TOML file.

Pairs of numbers are the lowest and the highest value; what lies between them is equally likely unless a key says
otherwise.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec

Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0, le=1000)]
Count = Annotated[int, Field(ge=0, le=50)]
Grey = Annotated[float, Field(ge=0, le=255)]
Lengths = tuple[Positive, Positive]
Counts = tuple[Count, Count]
Angles = tuple[Annotated[float, Field(ge=-90, le=90)], Annotated[float, Field(ge=-90, le=90)]]
Camera = Literal["mirror", "fisheye", "equirectangular", "ocam", "perspective"]
Per = Literal["pair", "scene", "set"]
LayoutName = Literal["omnirange", "helvipad", "omnimvs", "colmap"]


class _Ranges(Spec):
    """A table in which every pair of numbers is a lowest and a highest value."""

    @model_validator(mode="after")
    def _ordered(self) -> "_Ranges":
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) == 2 and not isinstance(value[0], str) and value[0] > value[1]:
                raise ValueError(f"{name}: the lowest value must come first; found [{value[0]:g}, {value[1]:g}]")
        return self


class Split(Spec):
    """Shares of the scenes. A scene is in one part with all its pairs, so that no part has seen another's scenes."""

    train: Share = 0.8
    """Share of the scenes for training."""
    val: Share = 0.1
    """Share of the scenes for validation."""
    test: Share = 0.1
    """Share of the scenes for testing."""

    @model_validator(mode="after")
    def _whole(self) -> "Split":
        if abs(self.train + self.val + self.test - 1) > 1e-6:
            raise ValueError(f"train, val and test must add up to 1; found {self.train + self.val + self.test:g}")
        return self


class Room(_Ranges):
    """The room that a scene is."""

    length_m: Lengths = (4.0, 12.0)
    """Extent along x, metres."""
    width_m: Lengths = (3.5, 9.0)
    """Extent along y, metres."""
    height_m: Lengths = (2.4, 4.0)
    """Height, metres."""
    windows: Counts = (0, 3)
    """Walls with a window through which the sky is seen, at most 4."""
    open_air: Share = 0.1
    """Share of the rooms without a ceiling."""
    sky_grey: tuple[Grey, Grey] = (190.0, 255.0)
    """Grey level of the sky, which is the same everywhere."""


class Furniture(_Ranges):
    """The furniture of a room. Pieces that find no free place are left out."""

    boxes: Counts = (2, 7)
    """Crates and cabinets, turned about the vertical."""
    box_m: Lengths = (0.2, 1.2)
    """Length and width of a box, metres; its height is up to twice as large."""
    tables: Counts = (0, 2)
    """Tables with four legs."""
    curved: Counts = (0, 3)
    """Vases and balls: bodies of revolution, as meshes."""
    curved_m: Lengths = (0.3, 1.3)
    """Height of a curved body, metres."""
    poles: Counts = (0, 3)
    """Poles from floor to ceiling."""
    pole_m: Lengths = (0.005, 0.08)
    """Side of a pole, metres; equal ratios are equally likely."""
    boards: Counts = (0, 3)
    """Boards on the walls, half of them without any texture."""


class Surfaces(_Ranges):
    """The frequencies of kinds of texture, as weights, and the textures' range."""

    noise: Weight = 5.0
    """Weight of band-limited noise."""
    photograph: Weight = 3.0
    """Weight of gravel, grass and brick (photographs in the public domain, CC0)."""
    repetitive: Weight = 1.0
    """Weight of stripes, checks and small bricks, which repeat themselves."""
    textureless: Weight = 1.0
    """Weight of a uniform grey."""
    shortest_m: Lengths = (0.02, 0.1)
    """Shortest wavelength of noise, metres."""
    contrast: tuple[Annotated[float, Field(gt=0, le=128)], Annotated[float, Field(gt=0, le=128)]] = (15.0, 50.0)
    """Standard deviation of noise, grey levels."""
    period_m: Lengths = (0.08, 0.5)
    """Period of what repeats itself, metres."""

    @model_validator(mode="after")
    def _any(self) -> "Surfaces":
        if not self.noise + self.photograph + self.repetitive + self.textureless > 0:
            raise ValueError("one of noise, photograph, repetitive and textureless must be above 0")
        return self


class Rig(_Ranges):
    """The two sensors, the motion between them, and where the first one stands."""

    cameras: Annotated[tuple[Camera, ...], Field(min_length=1, max_length=8)] = ("mirror",)
    """Kinds of camera, of which one is drawn for both views: a hyperboloid `mirror`, an equidistant `fisheye` of 220
    degrees that looks up, `equirectangular`, `ocam` (OCamCalib's model of such a fisheye), and `perspective`, a camera
    of 90 degrees that looks ahead."""
    width_px: Annotated[int, Field(ge=32, le=4096)] = 640
    """Width of the images, pixels."""
    height_px: Annotated[int, Field(ge=24, le=4096)] = 480
    """Height of the images, pixels."""
    calibration_per: Literal["scene", "set"] = "scene"
    """Frequency of drawing both calibrations: for each scene, or once."""
    focal_percent: Annotated[float, Field(ge=0, le=20)] = 2.0
    """Standard deviation of the true focal length, percent; the calibration that is written has it."""
    centre_px: Annotated[float, Field(ge=0, le=100)] = 3.0
    """Standard deviation of the true principal point along u and v, pixels."""
    motion_per: Per = "pair"
    """Frequency of drawing the motion from view 1 to view 2: for each pair or scene, or once."""
    baseline_m: Lengths = (0.08, 0.8)
    """Distance of the viewpoints, metres; equal ratios are equally likely."""
    elevation_deg: Angles = (-10.0, 10.0)
    """Angle of the baseline above the horizontal of view 1, degrees; 90 is straight up. Its azimuth is any."""
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 20.0
    """Largest turn of view 2 against view 1 about the vertical, degrees either way."""
    tilt_deg: Annotated[float, Field(ge=0, le=45)] = 2.0
    """Standard deviation of pitch and roll of view 2 against view 1, degrees."""
    sway_deg: Annotated[float, Field(ge=0, le=45)] = 2.0
    """Standard deviation of pitch and roll of view 1 in the world, degrees; its yaw is any."""
    viewpoint_height_m: Lengths = (0.6, 1.7)
    """Height of view 1 above the floor, metres."""
    clearance_m: Positive = 0.25
    """Distance of both viewpoints from whatever stands there, metres."""


class Noise(_Ranges):
    """Noise and exposure of the rendered images."""

    sigma_grey: tuple[Annotated[float, Field(ge=0, le=100)], Annotated[float, Field(ge=0, le=100)]] = (0.0, 3.0)
    """Standard deviation of white noise, grey levels; drawn for each pair."""
    gain_percent: Annotated[float, Field(ge=0, le=50)] = 2.0
    """Standard deviation of the exposure of view 2 against that of view 1, percent."""


class DatasetSpec(Spec):
    """A data set: how many pairs of what, and how they are laid out in files."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    """The set's name."""
    description: str = ""
    """A description for the reader."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of everything that is drawn."""
    scenes: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    """Number of scenes."""
    pairs_per_scene: Annotated[int, Field(ge=1, le=100)] = 10
    """Pairs of views in each scene."""
    layout: LayoutName = "omnirange"
    """The files' layout: `omnirange` (a folder for each pair), `helvipad` (two upright panoramas above each other,
    disparity in degrees), `omnimvs` (OCamCalib cameras and inverse depths on a panorama), or `colmap` (text models)."""
    colour: bool = False
    """Whether images are red, green and blue."""
    samples: Literal[1, 4, 9, 16, 25, 36, 64] = 4
    """Least number of rays in a pixel; up to 16 times as many where they are too wide for a texture or an outline."""
    split: Split = Split()
    """Training, validation and test."""
    room: Room = Room()
    """The room."""
    furniture: Furniture = Furniture()
    """The furniture of the room."""
    surfaces: Surfaces = Surfaces()
    """The textures of room and furniture."""
    rig: Rig = Rig()
    """The sensors and how they are placed."""
    noise: Noise = Noise()
    """Noise and exposure of the images."""

    @property
    def pairs(self) -> int:
        """Number of pairs in all."""
        return self.scenes * self.pairs_per_scene

    @model_validator(mode="after")
    def _fits(self) -> "DatasetSpec":
        rig, room = self.rig, self.room
        narrowest = min(room.length_m[0], room.width_m[0])
        if rig.baseline_m[1] + 2 * rig.clearance_m > 0.7 * narrowest:
            raise ValueError(
                f"rig.baseline_m = {rig.baseline_m[1]:g} with clearance_m = {rig.clearance_m:g} on both sides needs "
                f"more than 70 % of the narrowest room, {narrowest:g} m; use a smaller one, or larger rooms"
            )
        # Upright rigs need the height; all need a viewpoint between floor and ceiling.
        rise = rig.baseline_m[1] * max(abs(each) for each in rig.elevation_deg) / 90
        if rig.viewpoint_height_m[0] + rise + rig.clearance_m > room.height_m[0]:
            raise ValueError(
                f"rig.viewpoint_height_m = {rig.viewpoint_height_m[0]:g} and the baseline above it do not fit under a "
                f"ceiling of room.height_m = {room.height_m[0]:g}"
            )
        if room.windows[1] > 4:
            raise ValueError("room.windows: a room has 4 walls")
        if "equirectangular" in rig.cameras and rig.width_px != 2 * rig.height_px:
            raise ValueError(
                f"rig: a panorama of the whole sphere is twice as wide as high; found {rig.width_px} x {rig.height_px}"
            )
        _check_layout(self)
        return self


_CAMERAS: dict[LayoutName, tuple[Camera, ...]] = {
    "helvipad": ("equirectangular",),
    "omnimvs": ("ocam",),
    "colmap": ("fisheye", "perspective"),
}
"""Kinds of camera that a layout can describe; any for those that are not named."""


def _check_layout(spec: DatasetSpec) -> None:
    """Refuse settings that the files of a layout cannot express."""
    allowed = _CAMERAS.get(spec.layout)
    for each in spec.rig.cameras:
        if allowed and each not in allowed:
            raise ValueError(
                f"rig.cameras: the layout {spec.layout} cannot describe '{each}'; valid: {', '.join(allowed)}"
            )
    rig = spec.rig
    if spec.layout == "helvipad":
        fixed = rig.motion_per == "set" and rig.elevation_deg == (90.0, 90.0) and not (rig.turn_deg or rig.tilt_deg)
        if not fixed:
            raise ValueError(
                "rig: the layout helvipad has one baseline for the whole set, straight up: give motion_per = "
                '"set", elevation_deg = [90, 90], turn_deg = 0 and tilt_deg = 0'
            )
    if spec.layout == "omnimvs" and rig.motion_per == "pair":
        raise ValueError('rig.motion_per: the layout omnimvs has one rig for a scene; use "scene" or "set"')


def number_between(low_high: tuple[float, float], share: float) -> float:
    """The value at a share of the way from the lowest to the highest."""
    low, high = low_high
    return low + (high - low) * share


__all__ = ["Camera", "DatasetSpec", "Finite", "LayoutName", "Per", "Rig", "Room", "Split", "number_between"]
