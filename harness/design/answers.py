"""The expected errors of a rig at some ranges, and the search for rigs that meet a requirement."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from harness.camera.models.hyperboloid import Mirror
from harness.camera.models.ocam import OCam
from harness.camera.sensor import Sensor
from harness.design.budget import CAUSES, Budget, budget, directions_of
from harness.design.rig import RigDesign
from harness.display import OneLine
from harness.evaluation.statistics import central_68


@dataclass(frozen=True, repr=False)
class Answer(OneLine):
    """The expected error of a rig at one range, over the directions around it."""

    range_m: float
    error_m: float
    """The error that 68.3 % of the estimates stay within; infinite if fewer can be seen by both views."""
    by_cause_m: dict[str, float]
    """The same error from each cause alone."""
    leading: str
    """The cause with the largest share of the variance."""


def answers(rig: RigDesign, ranges_m: Sequence[float]) -> tuple[Answer, ...]:
    """The expected errors of a rig at ranges in metres, of surfaces that face view 1, 30 degrees or more off t."""
    together = budget(rig, np.asarray(ranges_m)[:, None, None] * directions_of(rig))
    result = []
    for i, range_m in enumerate(ranges_m):
        parts = Budget(together.points_m[i], {name: each[i] for name, each in together.sigma_m.items()})
        by_cause = {name: central_68(parts.sigma_m[name]) for name in CAUSES}
        result.append(Answer(range_m, central_68(parts.total_m), by_cause, parts.leading))
    return tuple(result)


# --- The search ---------------------------------------------------------------------------------------------------

WIDTHS_PX = (640, 800, 1024, 1280, 1600, 1920, 2560, 3200)
BASELINES_M = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)
MIRROR_SCALES = (0.5, 0.75, 1.0, 1.5, 2.0)
"""Sizes of the mirror as multiples of the given one's."""


@dataclass(frozen=True)
class Cost:
    """The price list of the search, no unit: linear in pixels, in the mirror's area and in the baseline."""

    per_megapixel: float = 1.0
    """The cost of a million pixels."""
    per_mirror_60_mm: float = 1.0
    """The cost of a mirror of 60 mm across; it grows with the area."""
    per_metre: float = 1.0
    """The cost of a metre of baseline."""

    def of(self, rig: RigDesign) -> float:
        """The cost of a rig."""
        camera = rig.sensor.camera
        mirror = (mirror_diameter_m(rig.sensor) / 0.06) ** 2
        pixels = camera.width_px * camera.height_px / 1e6
        return self.per_megapixel * pixels + self.per_mirror_60_mm * mirror + self.per_metre * rig.baseline_m


@dataclass(frozen=True, repr=False)
class Candidate(OneLine):
    """A rig that meets the requirement."""

    rig: RigDesign
    cost: float
    answer: Answer
    accuracy_m: float

    @property
    def margin(self) -> float:
        """The required error over the expected one."""
        return self.accuracy_m / self.answer.error_m


def candidates(
    base: RigDesign,
    accuracy_m: float,
    range_m: float,
    *,
    baseline_max_m: float = np.inf,
    height_max_m: float = np.inf,
    width_px: int | None = None,
    cost: Cost | None = None,
    most: int = 10,
) -> list[Candidate]:
    """The cheapest rigs that reach an accuracy at a range: images, mirrors and baselines of other sizes.

    Noise, texture and what is uncertain are the given rig's, in the same units: pixels, degrees, millimetres, shares.

    Parameters
    ----------
    baseline_max_m
        The longest baseline allowed.
    height_max_m
        The largest distance allowed between the camera's centre and the rim of its mirror.
    width_px
        The image's width, where it is given.
    most
        Most rigs that are returned.
    """
    price = cost or Cost()
    priced = sorted(
        ((price.of(rig), rig) for rig in _variants(base, baseline_max_m, height_max_m, width_px)), key=lambda p: p[0]
    )
    reached: list[Candidate] = []
    for price_of_rig, rig in priced:
        parts = budget(rig, range_m * directions_of(rig))
        if central_68(parts.total_m) <= accuracy_m:
            (answer,) = answers(rig, [range_m])
            reached.append(Candidate(rig, price_of_rig, answer, accuracy_m))
        if len(reached) == most:
            break
    return reached


def _variants(base: RigDesign, baseline_max_m: float, height_max_m: float, width_px: int | None) -> Iterator[RigDesign]:
    scales = MIRROR_SCALES if base.has_mirror else (1.0,)
    baselines = [each for each in BASELINES_M if each <= baseline_max_m] or [baseline_max_m]
    for width, scale in product(WIDTHS_PX if width_px is None else (width_px,), scales):
        sensor = resized(base.sensor, width, scale)
        if height_m(sensor) <= height_max_m:
            for baseline_m in baselines:
                yield base.model_copy(update={"name": "", "sensor": sensor, "baseline_m": baseline_m})


def resized(sensor: Sensor, width_px: int, mirror_scale: float = 1.0) -> Sensor:
    """The same sensor with an image, and a mirror, of another size: it sees the same directions."""
    camera = sensor.camera
    scale = width_px / camera.width_px
    placed = camera.model_copy(
        update={
            "width_px": width_px,
            "height_px": round(camera.height_px * scale),
            "focal_px": camera.focal_px * scale,
            "cx_px": (camera.cx_px + 0.5) * scale - 0.5,
            "cy_px": (camera.cy_px + 0.5) * scale - 0.5,
        }
    )
    model = sensor.model
    if isinstance(model, Mirror):
        model = model.model_copy(update={"a_m": model.a_m * mirror_scale, "b_m": model.b_m * mirror_scale})
    elif isinstance(model, OCam):
        scaled = tuple(each * scale ** (1 - i) for i, each in enumerate(model.coefficients))
        model = model.model_copy(update={"coefficients": scaled})
    return sensor.model_copy(update={"camera": placed, "model": model, "mask": None})


def rim_m(sensor: Sensor) -> tuple[float, float]:
    """Radius of the mirror's rim, and its height above the inner focus, metres; zero without a mirror."""
    if not isinstance(sensor.model, Mirror):
        return 0.0, 0.0
    elevation = np.radians(sensor.field.elevation_max_deg)
    a, b, e = sensor.model.a_m, sensor.model.b_m, sensor.model.e_m
    distance = b**2 / (a - e * np.sin(elevation))
    return float(distance * np.cos(elevation)), float(distance * np.sin(elevation))


def mirror_diameter_m(sensor: Sensor) -> float:
    """Diameter of the mirror's rim, which the highest elevation in the field of view sets; 0 without a mirror."""
    return 2 * rim_m(sensor)[0]


def height_m(sensor: Sensor) -> float:
    """The height from the camera's centre to the farther of the mirror's rim and apex, metres; 0 without a mirror."""
    if not isinstance(sensor.model, Mirror):
        return 0.0
    return 2 * sensor.model.e_m + max(rim_m(sensor)[1], -(sensor.model.e_m - sensor.model.a_m))
