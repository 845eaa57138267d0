"""An initial sensor, close enough for the adjustment: many guesses in the unified model without a lens, ranked by their
residuals, and then a conversion to the requested model.

With xi and a focal length alone, the unified model approximates a pinhole (xi = 0), a fisheye or any mirror.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from harness.calibration.adjust import Adjusted, adjust
from harness.calibration.circle import Circle
from harness.calibration.corners import Corners
from harness.calibration.parameters import Parameters, axial_slope, kind_of, semi_axis, value_of, with_values
from harness.calibration.poses import BoardPoses, poses_from_bearings, refine_poses, residuals_of, turned_over
from harness.calibration.uncertainty import angles_off_axis
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import MODELS
from harness.camera.reflection import camera_of_points, ray_directions
from harness.camera.sensor import Sensor, parameters_of, unproject
from harness.errors import InputError, nearest, with_article
from harness.geometry.angles import Array

_ANGLES_DEG = (25.0, 45.0, 65.0, 85.0, 105.0, 125.0)
"""Assumed angles off the axis of the outermost corner."""
_XIS = (0.0, 0.6, 1.0, 1.6)
_TRIED = 5
"""Number of guesses that are adjusted."""
_ROUGH_PX = 3.0
"""Scale of the robust loss, pixels, while the sensor is unknown."""


@dataclass(frozen=True)
class Start:
    """The initial state of the adjustment."""

    sensor: Sensor
    poses: BoardPoses


def check_kind(kind: str) -> None:
    """Check that a kind of model can be calibrated.

    Raises
    ------
    InputError
        When there is no such kind.
    """
    if kind not in MODELS:
        raise InputError(f"there is no camera model '{kind}'; {nearest(kind, list(_PLAIN))}", key="model")
    if kind not in _PLAIN:
        raise InputError(f"a model of kind '{kind}' cannot be calibrated; {nearest(kind, list(_PLAIN))}", key="model")


def template_of(kind: str, width_px: int, height_px: int) -> Sensor:
    """A sensor of a kind of model, undistorted, with its principal point at the centre; its field is not checked.

    Raises
    ------
    InputError
        When there is no such kind.
    """
    check_kind(kind)
    camera = Camera(width_px=width_px, height_px=height_px, cx_px=(width_px - 1) / 2, cy_px=(height_px - 1) / 2)
    model = MODELS[kind].model_validate(_PLAIN[kind])
    return Sensor.model_construct(model=model, camera=camera, lens=Lens(), field=FieldOfView())


_PLAIN: dict[str, dict[str, Any]] = {
    "hyperboloid": {},
    "unified": {"xi": 1.0},
    "eucm": {"alpha": 0.5, "beta": 1.0},
    "double_sphere": {"xi": 0.0, "alpha": 0.5},
    "kannala_brandt": {"k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0},
    "ocam": {"coefficients": (-100.0, 0.0, 0.0, 0.0, 0.0)},
}
"""Initial values of each model's own keys."""


def find_start(corners: Corners, template: Sensor, keys: tuple[str, ...], circle: Circle | None) -> Start:
    """An initial sensor of the template's kind, and the poses of the boards.

    Parameters
    ----------
    template
        Gives the values of all keys that are not in `keys`.
    circle
        The image circle, whose centre is a guess of the principal point.

    Raises
    ------
    InputError
        When no guess fits the corners, or this kind of model has no initial guess.
    """
    kind = kind_of(template.model)
    if kind not in _OWN_KEYS:
        raise InputError(
            f"there is no initial guess for {with_article(template.model.title)}; give a sensor to start from",
            key="start",
        )
    # In another model xi and the focal length take the role of its own keys.
    own = [key for key in ("model.xi", "camera.focal_px") if key in keys or kind != "unified"]
    free = (*own, *(key for key in ("camera.cx_px", "camera.cy_px") if key in keys))
    guesses = sorted(_guesses(corners, template, free, circle), key=lambda each: each[0])
    if not guesses:
        raise InputError(
            "no guess of the camera can project whole boards: are the corners in the board's order, and is the board's "
            "size right?"
        )
    best: Adjusted | None = None
    for _, guess in guesses[:_TRIED]:
        tried = _adjusted_unified(corners, guess, free)
        if tried is not None and (best is None or tried.cost < 0.999 * best.cost):
            best = tried
    if best is None:
        raise InputError("no guess of the camera converged on the corners")
    sensor = best.parameters.sensor_at(best.vector)
    starts = [Start(each, poses_for(corners, each)) for each in _converted(template, keys, corners, sensor)]
    return starts[0] if len(starts) == 1 else min(starts, key=lambda each: _cost(corners, each, keys))


def _cost(corners: Corners, start: Start, keys: tuple[str, ...]) -> float:
    """The cost after an adjustment; infinite if the adjustment fails."""
    in_view = visible(corners, start.sensor, start.poses)
    if not in_view:
        return math.inf
    parameters = Parameters(start.sensor, keys)
    some, poses = corners.of(in_view), start.poses.of(in_view)
    adjusted = adjust(parameters, some, parameters.vector(start.sensor), poses, robust_px=_ROUGH_PX)
    return math.inf if adjusted is None else adjusted.cost / len(in_view)


def poses_for(corners: Corners, sensor: Sensor) -> BoardPoses:
    """The boards' poses for a known sensor, the better one of the two solutions for a small board.

    NaN for a board with too few corners in the model's domain.
    """
    camera = camera_of_points(sensor)
    first = poses_from_bearings(corners, ray_directions(sensor, corners.pixels)[0])
    poses, cost = refine_poses(camera, corners, first)
    other, other_cost = refine_poses(camera, corners, turned_over(poses, corners))
    better = other_cost < cost
    return BoardPoses(np.where(better[:, None, None], other.R, poses.R), np.where(better[:, None], other.t, poses.t))


def _guesses(
    corners: Corners, template: Sensor, free: tuple[str, ...], circle: Circle | None
) -> Iterator[tuple[float, Start]]:
    """Sensors of the unified model and the boards' poses, with the median residual of the corners, pixels."""
    middles = {((corners.width_px - 1) / 2, (corners.height_px - 1) / 2)}
    if circle is not None:
        middles.add((circle.u, circle.v))
    size = corners.width_px, corners.height_px
    given = {name: getattr(template.camera, name) for name in ("cx_px", "cy_px") if f"camera.{name}" not in free}
    xis = _XIS if "model.xi" in free else (value_of(template, "model.xi"),)
    for u, v in middles:
        cx, cy = given.get("cx_px", u), given.get("cy_px", v)
        outermost = float(np.hypot(corners.pixels[:, 0] - cx, corners.pixels[:, 1] - cy).max())
        for xi in xis:
            for angle in np.radians(_ANGLES_DEG).tolist():
                if math.cos(angle) <= 0.05 - min(xi, 1 / xi if xi else 0.0):
                    continue
                focal = outermost * (math.cos(angle) + xi) / math.sin(angle)
                if "camera.focal_px" not in free:
                    focal = template.camera.focal_px
                sensor = unified_sensor(*size, xi, focal, cx, cy, template.camera.aspect)
                bearings = unproject(sensor, corners.pixels)[0]
                if not np.isfinite(bearings).all():
                    continue
                poses = poses_from_bearings(corners, bearings)
                length = np.linalg.norm(residuals_of(parameters_of(sensor), corners, poses), axis=-1)
                median = float(np.median(np.where(np.isfinite(length), length, np.inf)))
                if math.isfinite(median):
                    yield median, Start(sensor, poses)


def unified_sensor(
    width_px: int, height_px: int, xi: float, focal_px: float, cx_px: float, cy_px: float, aspect: float = 1.0
) -> Sensor:
    """A sensor of the unified model without a lens, whose field is the whole domain of the model."""
    camera = Camera.model_construct(
        width_px=width_px, height_px=height_px, focal_px=focal_px, aspect=aspect, cx_px=cx_px, cy_px=cy_px
    )
    model = MODELS["unified"].model_validate({"xi": xi})
    return Sensor.model_construct(model=model, camera=camera, lens=Lens(), field=FieldOfView())


def _adjusted_unified(corners: Corners, guess: Start, free: tuple[str, ...]) -> Adjusted | None:
    parameters = Parameters(guess.sensor, free)
    in_view = visible(corners, guess.sensor, guess.poses)
    if not in_view:
        return None
    some, poses = corners.of(in_view), guess.poses.of(in_view)
    adjusted = adjust(parameters, some, parameters.vector(guess.sensor), poses, robust_px=_ROUGH_PX, rounds=40)
    if adjusted is None:
        return None
    # Again, with the better one of the two poses of each board for this sensor.
    poses = poses_for(some, parameters.sensor_at(adjusted.vector))
    again = adjust(parameters, some, adjusted.vector, poses, robust_px=_ROUGH_PX, rounds=40)
    return again if again is not None and again.cost < adjusted.cost else adjusted


def visible(corners: Corners, sensor: Sensor, poses: BoardPoses) -> list[int]:
    """The indices of the images in which a sensor can project every corner of the board."""
    lost = ~np.isfinite(residuals_of(camera_of_points(sensor), corners, poses)).all(axis=-1)
    return np.flatnonzero(np.bincount(corners.image, lost, minlength=len(corners.images)) == 0).tolist()


# --- The models, from a unified one without a lens ---------------------------------------------------------------


def _converted(template: Sensor, keys: tuple[str, ...], corners: Corners, unified: Sensor) -> list[Sensor]:
    """Sensors of the template's kind that approximate a unified one; keys not in `keys` as in the template."""
    xi: float = unified.model.xi  # type: ignore[attr-defined]
    axial = unified.camera.focal_px / (1 + xi)
    theta = np.linspace(0, float(np.nanmax(angles_off_axis(unified, corners.pixels))), 200)[1:]
    curve = _Curve(xi, theta, axial * (1 + xi) * np.sin(theta) / (np.cos(theta) + xi), axial)
    sensors = []
    for own in _OWN_KEYS[kind_of(template.model)](template.model, curve):
        new = {f"model.{name}": value for name, value in own.items()}
        sensor = with_values(template, {key: value for key, value in new.items() if key in keys})
        camera = {f"camera.{name}": getattr(unified.camera, name) for name in ("cx_px", "cy_px")}
        camera["camera.focal_px"] = axial / axial_slope(sensor.model)
        sensors.append(with_values(sensor, {key: value for key, value in camera.items() if key in keys}))
    return sensors


@dataclass(frozen=True)
class _Curve:
    """A unified model as a table of radii by angle off the axis."""

    xi: float
    theta: Array
    radius_px: Array
    axial_px: float
    """Pixels per radian at the axis."""


Own = Iterator[dict[str, float]]


def _of_unified(model: Any, curve: _Curve) -> Own:  # noqa: ARG001 - one signature
    yield {"xi": curve.xi}


def _of_hyperboloid(model: Any, curve: _Curve) -> Own:
    yield {"b_m": semi_axis(model, min(max(curve.xi, 0.05), 0.99))}


def _of_eucm(model: Any, curve: _Curve) -> Own:  # noqa: ARG001
    yield {"alpha": curve.xi / (1 + curve.xi), "beta": 1.0}


def _of_double_sphere(model: Any, curve: _Curve) -> Own:  # noqa: ARG001
    """Several guesses, as the two parameters trade off along a valley with more than one minimum.

    At an angle theta, `alpha (d_2 - xi - cos) = (1 + xi) sin/r - xi - cos`, with r in units of the slope at the axis.
    """
    sin, cos = np.sin(curve.theta), np.cos(curve.theta)
    for xi in (0.0, 0.6, 1.2, -0.3):
        ahead = xi + cos
        column = np.hypot(sin, ahead) - ahead
        right = (1 + xi) * sin * curve.axial_px / curve.radius_px - ahead
        yield {"xi": xi, "alpha": float(np.clip(column @ right / (column @ column), 0.02, 0.98))}


def _of_kannala_brandt(model: Any, curve: _Curve) -> Own:  # noqa: ARG001
    """The polynomial of the angle that best fits the curve."""
    powers = curve.theta[:, None] ** np.array([3, 5, 7, 9])
    k = np.linalg.lstsq(powers, curve.radius_px / curve.axial_px - curve.theta, rcond=None)[0].tolist()
    yield dict(zip(("k1", "k2", "k3", "k4"), k, strict=True))


def _of_ocam(model: Any, curve: _Curve) -> Own:
    """The polynomial of the radius whose rays best fit those of the curve.

    `r cos(theta) - Z(r) sin(theta)`, Z(r) = -(a_0 + a_2 r² + ...), is the distance of (r, Z) from the ray; over r it is
    an angle.
    """
    terms = np.array([i for i in range(len(model.coefficients)) if i != 1])
    scale = float(curve.radius_px[-1])
    r = curve.radius_px / scale
    columns = np.sin(curve.theta)[:, None] * r[:, None] ** (terms - 1.0)
    a = np.linalg.lstsq(columns, -np.cos(curve.theta), rcond=None)[0] * scale ** (1.0 - terms)
    yield {f"coefficients[{i}]": each for i, each in zip(terms.tolist(), a.tolist(), strict=True)}


_OWN_KEYS: dict[str, Callable[[Any, _Curve], Own]] = {
    "unified": _of_unified,
    "hyperboloid": _of_hyperboloid,
    "eucm": _of_eucm,
    "double_sphere": _of_double_sphere,
    "kannala_brandt": _of_kannala_brandt,
    "ocam": _of_ocam,
}
"""For each model a function that fits its own keys to a curve; one or more guesses."""
