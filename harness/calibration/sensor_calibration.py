"""From corners to a sensor: an initial estimate, a robust adjustment, a plain one of inliers, and its covariance."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from harness.calibration.adjust import Adjusted, adjust
from harness.calibration.board_coverage import Coverage, coverage_of
from harness.calibration.circle import Circle
from harness.calibration.corners import Corners
from harness.calibration.covered_field import covered_field
from harness.calibration.halves import Halves, compare_halves
from harness.calibration.misaligned import is_misalignment, likelihood_ratio, misalignment_notes
from harness.calibration.parameters import Parameters, choose_keys, key_named, kind_of, with_values
from harness.calibration.poses import BoardPoses
from harness.calibration.start import Start, find_start, poses_for, template_of, visible
from harness.calibration.uncertainty import RayGrid, Uncertainty, ray_grid, ray_sigma, uncertainty_of
from harness.camera.intrinsics import FieldOfView
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor, model_from_sensor
from harness.display import OneLine
from harness.errors import InputError, with_article
from harness.geometry.angles import Array

Tell = Callable[[str], None]

_OUTLIER = 6.0
"""A residual of so many standard deviations marks an outlier: noise reaches 6 once in 66 million corners
(exp(-6²/2), the length of two normal coordinates)."""
_ROUGH_PX = 3.0
"""Scale of the robust loss, pixels, until the scatter of the residuals is known."""
_LEAST_SIGMA_PX = 1e-3
"""Lower bound on the scatter, pixels: residuals of noise-free corners are rounding errors, and no outliers."""
_LEAST_CORNERS = 6
"""A board with fewer inliers is dropped."""
_FEW_IMAGES = 5
_VAGUE_PX = 1.0


@dataclass(frozen=True, repr=False, eq=False)
class CentralFit(OneLine):
    """The best sensor with camera and mirror aligned, from the same corners: one that matchers can use."""

    sensor: Sensor
    """The sensor, with the field and the mount of the misaligned one."""
    rms_px: float
    """Root of the mean squared distance between predicted and measured corners, pixels."""


@dataclass(frozen=True, repr=False, eq=False)
class SensorCalibration(OneLine):
    """A calibrated sensor, the corners it was estimated from, and its uncertainty."""

    sensor: Sensor
    keys: tuple[str, ...]
    """Dotted keys of the `n` parameters that were estimated; all others were given."""
    uncertainty: Uncertainty
    corners: Corners
    """The `m` inliers."""
    left_out: Corners | None
    """The outliers, which were not used."""
    poses: BoardPoses
    """Poses of the boards of `corners`, in the sensor's frame."""
    residuals: Array
    """`[m, 2]`: residuals, predicted minus measured, pixels."""
    grid: RayGrid
    """Rays over the field, `k`, in the camera model's own frame."""
    ray_sigma_px: Array
    """`[k]`: standard deviation of their pixels, up to a rotation of the whole sensor, pixels."""
    ray_sigma_fixed_px: Array
    """`[k]`: the same, including that rotation."""
    coverage: Coverage
    halves: Halves | None
    """Two calibrations from half of the images each; None with fewer than four images."""
    circle: Circle | None
    """The image circle, if one was detected."""
    central: CentralFit | None
    """The best central sensor, if a misalignment was estimated."""
    rounds: int
    notes: tuple[str, ...]
    """Warnings to read before the sensor is used, one line each."""

    @property
    def rms_px(self) -> float:
        """RMS reprojection error: the root of the mean squared distance of predicted and measured corners, pixels."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=-1))))

    @property
    def rms_of_images_px(self) -> Array:
        """`[images]`: the RMS reprojection error of each image, pixels."""
        starts = self.corners.starts
        count = np.add.reduceat(np.ones(len(self.residuals)), starts)
        return np.sqrt(np.add.reduceat(np.sum(self.residuals**2, axis=-1), starts) / count)


def calibrate_sensor(
    corners: Corners,
    kind: str,
    *,
    lens: Sequence[str] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float | None] | None = None,
    start: Sensor | None = None,
    mount: Mount | None = None,
    field: FieldOfView | None = None,
    circle: Circle | None = None,
    tell: Tell = lambda _: None,
) -> SensorCalibration:
    """The sensor that best fits the corners, with its uncertainty.

    Parameters
    ----------
    kind
        The kind of camera model.
    lens
        Lens terms to estimate; the model's default ones when None.
    free, fix
        Keys to estimate in addition to the default ones, and keys not to estimate, with their value, or None for that
        of the initial sensor. With `misalignment` free, the best central sensor of a hyperboloid mirror comes first.
    start
        An initial sensor of that kind, instead of a search.
    mount
        How the camera is mounted, which boards do not determine; by default as `start` or as usual for the model.
    field
        The sensor's field of view; by default the part that the corners cover.
    tell
        Called with a line of text to report progress.

    Raises
    ------
    InputError
        When an option is invalid, no sensor fits the corners, or they determine nothing.
    """
    template, keys = _chosen(_template(corners, kind, start), lens, free, dict(fix or {}))
    plain = tuple(key for key in keys if not is_misalignment(key))
    begin = Start(template, poses_for(corners, template)) if start else find_start(corners, template, plain, circle)
    aligned = None
    if plain != keys:
        aligned = _central_start(corners, begin, plain, tell)
        begin = begin if not template.is_central else aligned
    adjusted, used, left_out = _without_outliers(corners, Parameters(begin.sensor, keys), begin, tell)
    uncertainty = _determined(uncertainty_of(adjusted), keys)
    calibrated = adjusted.parameters.sensor_at(adjusted.vector)
    calibrated = calibrated.model_copy(update={"mount": mount or (start.mount if start else Mount())})
    sensor = _with_field(calibrated, field or covered_field(calibrated, used, circle))
    central = None if aligned is None else _central_fit(used, aligned.sensor, plain, sensor)
    grid = ray_grid(sensor, distance_m=float(np.median(np.linalg.norm(adjusted.poses.apply(used)[1], axis=-1))))
    # The adjustment is in the model's own frame.
    grid = replace(grid, directions=np.ascontiguousarray(grid.directions @ model_from_sensor(sensor).T))
    turned, unturned = ray_sigma(adjusted, uncertainty.vector_covariance, grid)
    halves = compare_halves(adjusted, used, grid)
    ratio = None if central is None else likelihood_ratio(central.rms_px, adjusted.residuals, uncertainty)
    return SensorCalibration(
        sensor=sensor,
        keys=keys,
        uncertainty=uncertainty,
        corners=used,
        left_out=left_out,
        poses=adjusted.poses.in_frame(model_from_sensor(sensor).T),
        residuals=adjusted.residuals,
        grid=grid,
        ray_sigma_px=turned,
        ray_sigma_fixed_px=unturned,
        coverage=coverage_of(sensor, used, grid),
        halves=halves,
        circle=circle,
        central=central,
        rounds=adjusted.rounds,
        notes=(
            *_notes(adjusted, uncertainty, corners, used, turned),
            *misalignment_notes(keys, uncertainty, template, ratio),
        ),
    )


def check_choice(
    kind: str,
    *,
    lens: Sequence[str] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float | None] | None = None,
    start: Sensor | None = None,
) -> None:
    """Refuse what `calibrate_sensor` would refuse of these, as far as that takes no corners.

    Raises
    ------
    InputError
        As `calibrate_sensor`.
    """
    if start is not None:
        _check_kind_of(start, kind)
    template = start or template_of(kind, 640, 480)
    # Which values a camera may have follows from the size of the images.
    of_camera = {word for word in fix or {} if key_named(template, word, "fix").startswith("camera.")}
    _chosen(template, lens, free, {word: None if word in of_camera else value for word, value in (fix or {}).items()})


def _chosen(
    template: Sensor, lens: Sequence[str] | None, free: Sequence[str], fixed: Mapping[str, float | None]
) -> tuple[Sensor, tuple[str, ...]]:
    """The initial sensor with the values that are given, and the keys to estimate."""
    given = {key_named(template, word, "fix"): value for word, value in fixed.items() if value is not None}
    try:
        template = with_values(template, given)
    except ValueError as error:
        raise InputError(f"{', '.join(given)}: {_first_line(error)}", key="fix") from error
    keys = choose_keys(template, lens=lens, free=free, fix=list(fixed))
    if not keys:
        raise InputError("nothing is left to estimate", key="fix")
    return template, keys


def _central_start(corners: Corners, begin: Start, keys: tuple[str, ...], tell: Tell) -> Start:
    """The best central sensor, from which a misalignment is looked for."""
    sensor = begin.sensor.aligned
    if keys:
        central = Start(sensor, begin.poses if begin.sensor.is_central else poses_for(corners, sensor))
        adjusted, _, _ = _without_outliers(corners, Parameters(sensor, keys), central, tell)
        sensor = adjusted.parameters.sensor_at(adjusted.vector)
    return Start(sensor, poses_for(corners, sensor))


def _central_fit(used: Corners, sensor: Sensor, keys: tuple[str, ...], misaligned: Sensor) -> CentralFit | None:
    """The best central sensor of the corners that were used; None if it cannot be fitted."""
    parameters = Parameters(sensor, keys)
    central = adjust(parameters, used, parameters.vector(sensor), poses_for(used, sensor))
    if central is None:
        return None
    best = parameters.sensor_at(central.vector)
    best = best.model_copy(update={"mount": misaligned.mount})
    rms = float(np.sqrt(np.mean(np.sum(central.residuals**2, axis=-1))))
    try:
        return CentralFit(_with_field(best, misaligned.field), rms)
    except InputError:
        return CentralFit(_with_field(best, covered_field(best, used, None)), rms)


def _template(corners: Corners, kind: str, start: Sensor | None) -> Sensor:
    if start is None:
        return template_of(kind, corners.width_px, corners.height_px)
    _check_kind_of(start, kind)
    if (start.camera.width_px, start.camera.height_px) != (corners.width_px, corners.height_px):
        raise InputError(
            f"is of {start.camera.width_px} x {start.camera.height_px} pixels; the images have {corners.width_px} x "
            f"{corners.height_px}",
            key="start",
        )
    return start.model_copy(update={"mount": Mount()})


def _check_kind_of(start: Sensor, kind: str) -> None:
    if kind_of(start.model) != kind:
        raise InputError(f"is {with_article(start.model.title)}, not of kind '{kind}'", key="start")


def _without_outliers(
    corners: Corners, parameters: Parameters, begin: Start, tell: Tell
) -> tuple[Adjusted, Corners, Corners | None]:
    """The plain adjustment of all corners that are inliers of the robust one."""
    vector, poses, scale = parameters.vector(begin.sensor), begin.poses, _ROUGH_PX
    in_view = visible(corners, begin.sensor, poses)
    used, poses = corners.of(in_view), poses.of(in_view)
    sigma = 0.0
    length = np.zeros(0)
    for _ in range(2):
        robust = adjust(parameters, used, vector, poses, robust_px=scale) if in_view else None
        if robust is None:
            raise InputError("the initial sensor cannot project all corners; give a better one", key="start")
        vector, poses = robust.vector, robust.poses
        length = np.linalg.norm(robust.residuals, axis=-1)
        # The median of the length of two normal coordinates is 1.1774 standard deviations.
        sigma = max(float(np.median(length)) / 1.1774, _LEAST_SIGMA_PX)
        scale = 3 * sigma
    agrees = length <= _OUTLIER * sigma
    left = np.bincount(used.image[agrees], minlength=len(in_view))
    agrees &= (left >= _LEAST_CORNERS)[used.image]
    if not agrees.any():
        raise InputError("no board agrees with the others: are the corners in the board's order?")
    tell(f"{np.count_nonzero(agrees)} of {len(corners.image)} corners agree, about {sigma:.2g} px each way")
    keep = np.zeros(len(corners.image), dtype=bool)
    keep[np.flatnonzero(np.isin(corners.image, in_view))[agrees]] = True
    final = adjust(parameters, corners.where(keep), vector, poses.of(np.unique(used.image[agrees]).tolist()))
    assert final is not None  # it begins where the robust one has ended
    return final, corners.where(keep), None if keep.all() else corners.where(~keep)


def _determined(uncertainty: Uncertainty, keys: Sequence[str]) -> Uncertainty:
    """The uncertainty, unless nothing at all is determined."""
    if set(uncertainty.undetermined) == set(keys):
        raise InputError(
            f"the corners determine none of {', '.join(keys)}: take more boards, at more angles, or fix what is known"
        )
    return uncertainty


def _first_line(error: ValueError) -> str:
    """The first line of a validation error: our own message, or pydantic's without its list of locations."""
    if not isinstance(error, ValidationError):
        return str(error).splitlines()[0].strip()
    first = error.errors()[0]
    text = first["msg"].removeprefix("Value error, ")
    if not text.startswith("Input should be "):
        return text
    return f"must be {text.removeprefix('Input should be ')}; found {first['input']:g}"


def _with_field(sensor: Sensor, field: FieldOfView) -> Sensor:
    try:
        return Sensor.model_validate(dict(sensor.model_copy(update={"field": field})))
    except ValueError as error:
        raise InputError(f"the calibrated sensor cannot have this field: {_first_line(error)}", key="field") from error


def _notes(
    adjusted: Adjusted, uncertainty: Uncertainty, corners: Corners, used: Corners, sigma_px: Array
) -> Iterator[str]:
    """Warnings to read before the sensor is used."""
    if not adjusted.converged:
        yield f"The adjustment did not converge in {adjusted.rounds} iterations: the sensor is not the best fit."
    if uncertainty.undetermined:
        yield (
            f"The corners do not determine {', '.join(uncertainty.undetermined)}: take more boards, closer to the rim "
            "and at more angles, or fix what is known."
        )
    count = len(corners.image) - len(used.image)
    gone = [name for name in corners.images if name not in used.images]
    if gone:
        yield f"No corner of {', '.join(gone)} was used: hardly any of them agree with the others."
    if count > 0.05 * len(corners.image):
        yield (
            f"{count / len(corners.image):.0%} of the corners are outliers, too many for mistakes alone. "
            "Another model, or more lens terms, may fit."
        )
    if np.median(sigma_px) > _VAGUE_PX:
        yield f"The standard deviation of rays is {np.median(sigma_px):.2g} px (median): more boards would reduce it."
    if len(used.images) < _FEW_IMAGES:
        number = "1 image is few" if len(used.images) == 1 else f"{len(used.images)} images are few"
        yield f"{number}: {_FEW_IMAGES} with boards in all parts of the image are better."
    model: Any = adjusted.parameters.sensor_at(adjusted.vector).model
    if kind_of(model) == "hyperboloid" and model.b_m < 0.1 * model.a_m:
        yield "The estimated mirror is a paraboloid, the limit of hyperboloids; the unified model extends beyond it."
    yield from _trade_offs(adjusted.parameters.keys, uncertainty)


def _trade_offs(keys: Sequence[str], uncertainty: Uncertainty) -> Iterator[str]:
    correlation = uncertainty.correlation
    shape = [i for i, key in enumerate(keys) if key in {"model.xi", "model.b_m"}]
    for i in shape:
        for j in (j for j, key in enumerate(keys) if key == "lens.k1"):
            if abs(correlation[i, j]) > 0.95:
                yield (
                    f"{keys[i]} and {keys[j]} trade off (correlation {correlation[i, j]:.4f}): compare rays with those "
                    "of another calibration, not these numbers."
                )
