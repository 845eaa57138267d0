"""Range errors due to a wrongly believed rig, point by point, from the true and the believed parameters.

A point p is seen at pixel u_1 of view 1 and at u_2 of view 2 by the true rig. The believed rig takes u_1 to a direction
x_1 and u_2 to a direction x_2, turned into v1's frame. A matcher that follows the believed epipolar curve of x_1 ends
nearest to x_2: `alpha_2 = atan2(x_2·m, x_2·t̂)` in the plane of x_1 and t, with m the unit vector there at right angles
to t; what of x_2 lies across the plane is lost. The sine rule gives the range along x_1, and its error is the
difference from where that ray meets the surface.

To first order, with n the epipolar plane's unit normal `t × x_1`, and a believed motion whose view 2 is turned by delta
too far (a rotation vector in v1's frame), whose t is turned by tau too far and longer by the share s, and an error of
alpha_2:

    dd_1 = -d_2²/(|t| sin alpha_1) (delta·n) - d_1 cot(alpha_2) (tau·n) + d_1 s - d_2²/(|t| sin alpha_1) dalpha_2

(`tests/test_propagation.py` holds the code against it, and against Monte Carlo.) Errors of calibration and alignment
have no such short form: they are differentiated numerically, through both views, which share one sensor.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.models.hyperboloid import Mirror
from harness.camera.models.unified import Unified
from harness.camera.reflection import project_points
from harness.camera.sensor import Sensor, unproject
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array, normalise
from harness.geometry.pose import Motion
from harness.geometry.triangulation import range_from_angles


@dataclass(frozen=True, repr=False)
class Rig(OneLine):
    """Two views' sensors and the motion between them: as they are, or as somebody believes they are."""

    sensors: tuple[Sensor, Sensor]
    motion: Motion


@dataclass(frozen=True, eq=False, repr=False)
class Believed(OneLine):
    """The points as triangulated with a believed rig."""

    x_1: Array
    """`[..., 3]`, unit: the believed direction from view 1."""
    alpha_1: Array
    alpha_2: Array
    """`[...]`, radians: the believed angles to t."""
    across: Array
    """`[...]`, radians: how far view 2's direction lies off the believed epipolar plane, towards `t × x_1`."""
    range_m: Array
    """`[...]`, metres, along `x_1`; NaN where the rays do not meet, or a view does not see the point."""


def believed_points(points_m: Array, true: Rig, believed: Rig) -> Believed:
    """The points that the true rig sees, as triangulated with the believed rig.

    Parameters
    ----------
    points_m
        `[..., 3]`, in view 1's true frame.
    believed
        Its sensors must be central.
    """
    pixel_1, _ = project_points(true.sensors[0], points_m)
    pixel_2, _ = project_points(true.sensors[1], true.motion.apply(points_m))
    x_1 = unproject(believed.sensors[0], pixel_1)[0]
    x_2 = unproject(believed.sensors[1], pixel_2)[0] @ believed.motion.R_v2_from_v1
    t_hat = normalise(believed.motion.t_v1)
    along = np.sum(x_1 * t_hat, axis=-1, keepdims=True)
    m = normalise(x_1 - along * t_hat)
    n = np.cross(t_hat, m)
    alpha_1 = np.arctan2(np.sum(x_1 * m, axis=-1), along[..., 0])
    alpha_2 = np.arctan2(np.sum(x_2 * m, axis=-1), np.sum(x_2 * t_hat, axis=-1))
    across = np.arcsin(np.clip(np.sum(x_2 * n, axis=-1), -1, 1))
    return Believed(x_1, alpha_1, alpha_2, across, range_from_angles(alpha_1, alpha_2, believed.motion.baseline_m))


def range_errors(points_m: Array, true: Rig, believed: Rig, normals: Array | None = None) -> Array:
    """Believed range less the true one, metres `[...]`.

    Parameters
    ----------
    points_m
        `[..., 3]`, in view 1's true frame.
    normals
        `[..., 3]`: normals of the surface there, of any length; where None it faces view 1. A believed direction that
        differs from the true one meets the surface elsewhere.
    """
    believed_at = believed_points(points_m, true, believed)
    if normals is None:
        return np.asarray(believed_at.range_m - np.linalg.norm(points_m, axis=-1))
    distance = np.sum(normals * points_m, axis=-1)
    return np.asarray(believed_at.range_m - distance / np.sum(normals * believed_at.x_1, axis=-1))


# --- Parameters of a rig ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parameter:
    """A parameter of a rig that may be wrong."""

    key: str
    unit: str
    """Empty for a share."""
    step: float
    """Step of the finite differences: far above rounding, far below where the error bends."""
    changed: Callable[[Rig, float], Rig]
    """The true rig whose parameter differs by so much from that of the believed one, which is given."""


def _turned(axis: int) -> Callable[[Rig, float], Rig]:
    def changed(rig: Rig, degrees: float) -> Rig:
        turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).as_matrix()
        return replace(rig, motion=Motion(rig.motion.R_v2_from_v1 @ turn.T, rig.motion.t_v1))

    return changed


def _t_turned(axis: int) -> Callable[[Rig, float], Rig]:
    def changed(rig: Rig, degrees: float) -> Rig:
        turn = Rotation.from_rotvec(np.radians(degrees) * _across(rig.motion.t_v1)[axis]).as_matrix()
        return replace(rig, motion=Motion(rig.motion.R_v2_from_v1, turn @ rig.motion.t_v1))

    return changed


def _across(t: Array) -> Array:
    """`[2, 3]`: two unit vectors at right angles to t: horizontal, where t is not vertical, and upwards."""
    t_hat = normalise(t)
    flat = np.cross([0.0, 0.0, 1.0], t_hat)
    side = normalise(flat) if np.linalg.norm(flat) > 1e-6 else np.array([0.0, 1.0, 0.0])
    return np.stack([side, np.cross(t_hat, side)])


def _t_scaled(rig: Rig, share: float) -> Rig:
    return replace(rig, motion=Motion(rig.motion.R_v2_from_v1, (1 + share) * rig.motion.t_v1))


def _of_both_sensors(part: str, name: str, *, relative: bool = False) -> Callable[[Rig, float], Rig]:
    """A key of the sensor that took both views; of each its own, by as much, where the views have two."""

    def changed(rig: Rig, by: float) -> Rig:
        first, second = (with_error(each, part, name, by, relative=relative) for each in rig.sensors)
        return replace(rig, sensors=(first, second))

    return changed


def with_error(sensor: Sensor, part: str, name: str, by: float, *, relative: bool = False) -> Sensor:
    """The sensor with an error of one number of its `camera`, `model`, `lens` or `misalignment`, or a share of it.

    Raises
    ------
    InputError
        When it has no such parameter, as one of two sensors of different models may.
    """
    inner = getattr(sensor, part)
    old = getattr(inner, name, None)
    if not isinstance(old, float):
        raise InputError(
            f"an error of '{part}.{name}' is believed, and one of the two sensors, {sensor.model.title}, has no such "
            "number; leave such errors out where the sensors are of different models",
            key="trial.believed",
        )
    new = old * (1 + by) if relative else old + by
    return sensor.model_copy(update={part: inner.model_copy(update={name: new})})


MOTION: tuple[Parameter, ...] = (
    Parameter("rotation_x_deg", "deg", 1e-3, _turned(0)),
    Parameter("rotation_y_deg", "deg", 1e-3, _turned(1)),
    Parameter("rotation_z_deg", "deg", 1e-3, _turned(2)),
    Parameter("t_elevation_deg", "deg", 1e-3, _t_turned(0)),
    Parameter("t_azimuth_deg", "deg", 1e-3, _t_turned(1)),
    Parameter("t_length", "", 1e-5, _t_scaled),
)
"""Rotation of view 2 about v1's axes; t turned upwards and sideways; its length, as a share."""

ODOMETRY = tuple(replace(each, key=f"odometry.{each.key}") for each in MOTION)
"""The parameters of the motion, for errors that grow with it: drawn independently, in addition to the constant ones."""

_CAMERA: tuple[Parameter, ...] = (
    Parameter("camera.focal_px", "", 1e-5, _of_both_sensors("camera", "focal_px", relative=True)),
    Parameter("camera.cx_px", "px", 1e-3, _of_both_sensors("camera", "cx_px")),
    Parameter("camera.cy_px", "px", 1e-3, _of_both_sensors("camera", "cy_px")),
)
_LENS = tuple(Parameter(f"lens.{name}", "", 1e-6, _of_both_sensors("lens", name)) for name in ("k1", "k2", "p1", "p2"))

MISALIGNMENT: tuple[Parameter, ...] = (
    *(
        Parameter(f"misalignment.{axis}_mm", "mm", 1e-3, _of_both_sensors("misalignment", f"{axis}_mm"))
        for axis in "xyz"
    ),
    *(
        Parameter(
            f"misalignment.rotation_{axis}_deg", "deg", 1e-3, _of_both_sensors("misalignment", f"rotation_{axis}_deg")
        )
        for axis in "xyz"
    ),
)
"""Misalignments of camera and hyperboloid mirror, which the assumed rig does not have."""


def calibration_parameters(sensor: Sensor) -> tuple[Parameter, ...]:
    """The parameters that a sensor's calibration estimates: focal length and shape (as shares), centre, lens terms."""
    fields = type(sensor.model).model_fields
    shape = [name for name in fields if isinstance(getattr(sensor.model, name), float)]
    relative = isinstance(sensor.model, Mirror)  # lengths; other models have numbers near 0 and 1
    own = (
        Parameter(f"model.{name}", "", 1e-5 if relative else 1e-6, _of_both_sensors("model", name, relative=relative))
        for name in shape
    )
    has_lens = isinstance(sensor.model, Mirror | Unified)
    return (*_CAMERA, *own, *(_LENS if has_lens else ()))


def sensitivities(
    points_m: Array,
    rig: Rig,
    parameters: Sequence[Parameter],
    normals: Array | None = None,
    believed_of: Callable[[Rig], Rig] | None = None,
) -> Array:
    """Derivatives of the range error by errors of parameters, `[..., parameters]`, metres per unit of each.

    By central differences around the believed rig.

    Parameters
    ----------
    points_m, normals
        As those of `range_errors`.
    rig
        Believed, and central.
    believed_of
        Gives the believed rig for a true one, if it depends on that; `rig` itself when None.
    """
    columns = []
    for each in parameters:
        trues = [each.changed(rig, side * each.step) for side in (1, -1)]
        above, below = (
            range_errors(points_m, true, rig if believed_of is None else believed_of(true), normals) for true in trues
        )
        columns.append((above - below) / (2 * each.step))
    return np.stack(columns, axis=-1)


def point_sensitivities(points_m: Array, rig: Rig, parameters: Sequence[Parameter]) -> Array:
    """Derivatives of triangulated points by errors of parameters, `[..., 3, parameters]`, metres per unit of each.

    By central differences around the believed rig, as `sensitivities`, whose range errors are what these are along the
    ray.
    """
    columns = []
    for each in parameters:
        both = [believed_points(points_m, each.changed(rig, side * each.step), rig) for side in (1, -1)]
        above, below = (at.range_m[..., None] * at.x_1 for at in both)
        columns.append((above - below) / (2 * each.step))
    return np.stack(columns, axis=-1)


def propagated(sensitivity: Array, covariance: Array) -> Array:
    """Standard deviation of the range, `sqrt(j C jᵀ)`, metres `[...]`.

    Parameters
    ----------
    sensitivity
        `[..., parameters]`, from `sensitivities`.
    covariance
        `[parameters, parameters]`, in their units.
    """
    return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", sensitivity, covariance, sensitivity)))


def diagonal(parameters: Sequence[Parameter], sigmas: Mapping[str, float]) -> Array:
    """The covariance of independent parameters, in their order; a parameter that is not in `sigmas` is exact."""
    return np.diag([sigmas.get(each.key, 0.0) ** 2 for each in parameters])
