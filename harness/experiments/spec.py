"""What an experiment is: a trial's settings, and the axes along which they vary."""

import hashlib
import itertools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from harness import shipped
from harness.camera.pose import Motion, Pose, relative_motion, translated
from harness.camera.sensor import Sensor, load_sensor
from harness.errors import InputError
from harness.simulation.fingerprint import fingerprint
from harness.simulation.noise import generator
from harness.simulation.scene import Scene, load_scene
from harness.spec import Finite, Positive, Spec, parse, read_toml
from harness.stereo.matching.window import WindowMatcher
from harness.stereo.panorama import Grid, Interpolation


class SecondView(Spec):
    """The second view: a baseline from the first one, in a direction of the world, and a rotation of its own.

    Half a metre along x, unrotated, as in the paper. The rotation is in the world's frame, as the first view's.
    """

    baseline_m: Positive = 0.5
    azimuth_deg: Finite = 0.0
    elevation_deg: Finite = 0.0
    yaw_deg: Finite = 0.0
    pitch_deg: Finite = 0.0
    roll_deg: Finite = 0.0

    def pose(self, view_1: Pose) -> Pose:
        """Where the second view stands, given the first."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        moved = translated(
            view_1,
            (
                self.baseline_m * math.cos(elevation) * math.cos(azimuth),
                self.baseline_m * math.cos(elevation) * math.sin(azimuth),
                self.baseline_m * math.sin(elevation),
            ),
        )
        return moved.model_copy(
            update={"yaw_deg": self.yaw_deg, "pitch_deg": self.pitch_deg, "roll_deg": self.roll_deg}
        )


class Rendering(Spec):
    """How a pixel is made: the mean of `samples` rays on a square grid inside it."""

    samples: Annotated[int, Field(ge=1, le=1024)] = 16

    @model_validator(mode="after")
    def _square(self) -> "Rendering":
        if math.isqrt(self.samples) ** 2 != self.samples:
            raise ValueError(f"samples must be a square number (1, 4, 9, 16, ...); found {self.samples}")
        return self


class Noise(Spec):
    """White Gaussian noise on the mirror images, in grey levels of 0 .. 255."""

    sigma_grey: Annotated[float, Field(ge=0, le=255)] = 0.0


class Placement(Spec):
    """What the seed draws of where the rig stands, so that a trial is not about one lucky place.

    `offset_m`: both views are moved alike by up to this much along x, y and z, evenly. `random_yaw`: both views are
    turned alike by any angle; the baseline keeps its direction in the world, and so takes any in the panorama.
    """

    offset_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    random_yaw: bool = False


class Unwrapping(Spec):
    """How the mirror image becomes a panorama."""

    interpolation: Interpolation = "bilinear"


class Filter(Spec):
    """The Laplacian of Gaussian; 0 for none.

    At 1 px the noise of the unwrapping's interpolation makes the sub-pixel error on walls a fifth larger than at 1.5.
    """

    log_sigma_px: Annotated[float, Field(ge=0, le=50)] = 1.5


class Trial(Spec):
    """One run of the pipeline, from a scene to an error."""

    scene: Scene
    sensor: Sensor = Sensor()
    view_1: Pose = Pose(position_m=(0.0, 0.0, 1.0))
    view_2: SecondView = SecondView()
    placement: Placement = Placement()
    render: Rendering = Rendering()
    noise: Noise = Noise()
    panorama: Grid = Grid()
    unwrap: Unwrapping = Unwrapping()
    filter: Filter = Filter()
    matching: WindowMatcher = WindowMatcher()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of all that is random: placement and noise."""

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that name these settings, on any machine: a scene counts by its contents."""
        settings = self.model_dump(mode="json") | {"scene": fingerprint(self.scene)}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def poses(self) -> tuple[Pose, Pose]:
        """Where both views stand, with what the seed draws."""
        view_2 = self.view_2.pose(self.view_1)
        place = self.placement
        if place.offset_m == 0 and not place.random_yaw:
            return self.view_1, view_2
        draws = generator(self.seed, "placement", fingerprint(self.scene))
        x, y, z = (place.offset_m * draws.uniform(-1, 1, 3)).tolist()
        yaw_deg = float(draws.uniform(0, 360)) if place.random_yaw else 0.0
        first, second = (
            translated(view, (x, y, z)).model_copy(update={"yaw_deg": view.yaw_deg + yaw_deg})
            for view in (self.view_1, view_2)
        )
        return first, second

    @property
    def motion(self) -> Motion:
        """From view 1 to view 2."""
        return relative_motion(*self.poses)


class Experiment(Spec):
    """A named set of trials: the full product of the axes over the base trial's settings."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,79}$")]
    """Letters, digits, `_`, `.` and `-`: it also names the output folder."""
    description: str = ""
    trial: Trial
    axes: dict[str, Annotated[list[str | int | float | bool], Field(min_length=1)]] = {}
    """Dotted keys of the trial, such as `matching.subpixel`, and the values that each takes."""

    def trials(self, *, file: Path | None = None) -> list[tuple[dict[str, Any], Trial]]:
        """Every trial with its place on the axes, in the order of the product, the last axis fastest.

        Raises
        ------
        InputError
            When an axis is no key of a trial, or a value is not valid there; names `file`.
        """
        base = self.trial.model_dump(mode="json")
        expanded = []
        for values in itertools.product(*self.axes.values()):
            place = dict(zip(self.axes, values, strict=True))
            table = base
            for key, value in place.items():
                table = _with(table, key.split("."), value)
            expanded.append((place, parse(Trial, _resolve(table, file, "axes"), file=file, key="axes")))
        return expanded


def load_experiment(name_or_path: str) -> Experiment:
    """Read an experiment by shipped name or path.

    `trial.scene` may be a table, a shipped name or a path; `trial.sensor` a table or a path. Paths are relative to the
    experiment's file.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    path = shipped.find("experiments", name_or_path)
    table = read_toml(path)
    if isinstance(table.get("trial"), dict):
        table = table | {"trial": _resolve(table["trial"], path, "trial")}
    experiment = parse(Experiment, table, file=path)
    experiment.trials(file=path)
    return experiment


def _resolve(trial: Mapping[str, Any], file: Path | None, key: str) -> dict[str, Any]:
    """The table of a trial with the scene and sensor files that it names read in."""
    resolved = dict(trial)
    folder = file.parent if file is not None else None
    if isinstance(resolved.get("scene"), str):
        try:
            resolved["scene"] = load_scene(str(shipped.find("scenes", resolved["scene"], relative_to=folder)))
        except InputError as error:
            if error.file != trial["scene"]:
                raise
            raise InputError(f"'{error.file}': {error.problem}", file=file, key=f"{key}.scene") from error
    if isinstance(resolved.get("sensor"), str):
        resolved["sensor"] = load_sensor((folder or Path()) / resolved["sensor"])
    return resolved


def _with(table: Mapping[str, Any], keys: list[str], value: Any) -> dict[str, Any]:
    """A copy of a nested table with one place changed."""
    first, *rest = keys
    if not rest:
        return {**table, first: value}
    below = table.get(first)
    return {**table, first: _with(below if isinstance(below, Mapping) else {}, rest, value)}
