"""Rays of a camera that sees the world in a mirror of revolution (`[profile]`); equations in `_profile_kernels`."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from harness.camera._profile_kernels import ProfileCamera, heights, meet_pieces, reflect_at_profile
from harness.camera.lens import fold_radius
from harness.camera.profile import Cone, Equiangular, Paraboloid, Profile, Sphere, Table
from harness.camera.sensor import Sensor, field_of, model_from_sensor
from harness.geometry.angles import Array

_PIECES = 2000
"""Cubics of an equiangular profile: of the fourth order, they are right to 1e-13 of its radius."""
_MOST_PARTS = 1 << 16
"""Most parts in which a radius is looked up."""
_STARTS = 1 << 12
"""Points of the profile from which the compiled iteration begins."""
_MOST_STEPS = 4
"""Most steps of that iteration."""
_PIECEWISE = 3
"""Kind of a profile of pieces."""
_COMPARED = 10_000
"""Approximate number of pixels whose rays determine the sensor's origin."""


def profile_of(sensor: Sensor) -> Profile:
    """The mirror's profile.

    Raises
    ------
    TypeError
        When the sensor has no profile.
    """
    if sensor.profile is None:
        raise TypeError("the sensor has no [profile]")
    return sensor.profile


@lru_cache(maxsize=64)
def profile_camera(sensor: Sensor) -> ProfileCamera:
    """The argument of the compiled reflection."""
    return _camera(sensor, viewpoint_of(sensor))


def profile_heights(sensor: Sensor, r_m: ArrayLike) -> tuple[Array, Array]:
    """Height above the apex, metres, and slope of the mirror at distances from its axis, metres, of any shape."""
    r = np.asarray(r_m, dtype=np.float64)
    z, slope = np.empty(r.shape), np.empty(r.shape)
    heights(np.ascontiguousarray(r).reshape(-1), profile_camera(sensor), z.reshape(-1), slope.reshape(-1))
    return z, slope


def viewpoint_of(sensor: Sensor) -> float:
    """Height of the sensor's origin above the mirror's apex, metres.

    Unless it is given, the point of the axis with the least squared distances from the rays of the aligned camera's
    pixels: with `n = I - r r^T`, `w = Σ e_z·n p / Σ e_z·n e_z`. For a hyperboloid that is its inner focus.
    """
    given = profile_of(sensor).viewpoint_m
    return _nearest_to_rays(sensor.aligned.model_copy(update={"mask": None})) if given is None else given


@lru_cache(maxsize=64)
def _nearest_to_rays(sensor: Sensor) -> float:
    camera = sensor.camera
    step = max(1, math.isqrt(camera.width_px * camera.height_px // _COMPARED))
    u, v = np.meshgrid(np.arange(0.0, camera.width_px, step), np.arange(0.0, camera.height_px, step))
    p, r, valid = np.empty((3, u.size)), np.empty((3, u.size)), np.empty(u.size, dtype=np.bool_)
    reflect_at_profile(u.ravel(), v.ravel(), _camera(sensor, 0.0), p, r, valid)
    if not valid.any():
        return 0.0
    p, r = (model_from_sensor(sensor) @ each[:, valid] for each in (p, r))
    return float(np.sum(p[2] - r[2] * np.sum(r * p, axis=0)) / np.sum(1 - r[2] ** 2))


def _camera(sensor: Sensor, viewpoint_m: float) -> ProfileCamera:
    profile, lens, misalignment = profile_of(sensor), sensor.lens, sensor.misalignment
    kind, size, (knots, cubics), rim = _shape_of(profile)
    # So many that each holds one knot at most, if that is not too many.
    parts = min(_MOST_PARTS, math.ceil(1.01 * knots[-1] / np.diff(knots).min()))
    edges = np.arange(parts + 1) / parts * knots[-1]
    piece = np.searchsorted(knots, edges, side="right")
    # One piece earlier than it may be, since a radius can be rounded into the part before its own.
    first = np.clip(piece[:-1] - 2, 0, knots.size - 2)
    c_x, c_y, c_z = (np.array([0.0, 0.0, -profile.camera_m]) + misalignment.offset_m).tolist()
    rows = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
    R, M = misalignment.R_mirror_from_camera, model_from_sensor(sensor)
    camera = ProfileCamera(
        **sensor.camera.matrix,
        k1=lens.k1,
        k2=lens.k2,
        p1=lens.p1,
        p2=lens.p2,
        k3=lens.k3,
        fold=fold_radius(lens),
        kind=kind,
        size=size,
        rim=rim,
        knots=knots,
        cubics=cubics,
        first=first.astype(np.int32),
        sparse=bool((np.diff(piece) <= 1).all()),
        depths=np.zeros(2),
        widest=0.0,
        steps=1,
        viewpoint=viewpoint_m,
        c_x=c_x,
        c_y=c_y,
        c_z=c_z,
        **{f"r_{name}": each for name, each in zip(rows, R.ravel().tolist(), strict=True)},
        **{f"m_{name}": each for name, each in zip(rows, M.ravel().tolist(), strict=True)},
        field=field_of(sensor),
    )
    r, z = np.linspace(0, 1.1 * rim, 4 * _STARTS), np.empty((2, 4 * _STARTS))
    heights(r, camera, z[0], z[1])
    depth = z[0] + profile.camera_m
    slope = r / depth
    if not (np.diff(slope) > 0).all():  # the camera does not see all of the mirror
        return camera
    widest = float(slope[-1])
    depths = np.interp(np.linspace(0, widest, _STARTS + 1), slope, depth)
    camera = camera._replace(depths=depths, widest=widest)
    if kind != _PIECEWISE or not camera.sparse:
        return camera
    return camera._replace(steps=_steps_that_suffice(camera, R, sensor))


def _steps_that_suffice(camera: ProfileCamera, R_mirror_from_camera: Array, sensor: Sensor) -> int:
    """The least number of steps after which all but a hundredth as many rays of pixels are found as after the most."""
    width, height = sensor.camera.width_px, sensor.camera.height_px
    v, u = np.mgrid[0 : height - 1 : 40j, 0 : width - 1 : 40j].reshape(2, -1)
    y = (v - camera.cv) / camera.fv
    rays = R_mirror_from_camera @ np.stack([(u - camera.cu - camera.skew * y) / camera.fu, y, np.ones(y.size)])
    s, slope, met = np.empty(y.size), np.empty(y.size), np.empty(y.size, dtype=np.bool_)
    counts = []
    for steps in range(1, _MOST_STEPS + 1):
        meet_pieces(camera._replace(steps=steps), np.ascontiguousarray(rays), s, slope, met)
        counts.append(np.count_nonzero(met))
    return 1 + int(np.argmax(np.array(counts) >= 0.99 * max(counts)))


Pieces = tuple[Array, Array]
"""Knots `[n + 1]` of a profile of cubics, metres, and the cubics `[4, n]`."""
_NO_PIECES: Pieces = (np.array([0.0, 1.0]), np.zeros((4, 1)))


def _shape_of(profile: Profile) -> tuple[int, float, Pieces, float]:
    """Kind, size, cubics and rim of a profile, as `ProfileCamera` has them."""
    if isinstance(profile, Sphere):
        return 0, profile.radius_m, _NO_PIECES, profile.rim_m
    if isinstance(profile, Cone):
        return 1, 1 / math.tan(math.radians(profile.half_angle_deg)), _NO_PIECES, profile.rim_m
    if isinstance(profile, Paraboloid):
        return 2, 1 / (4 * profile.focal_length_m), _NO_PIECES, profile.rim_m
    if isinstance(profile, Equiangular):
        return _PIECEWISE, 0.0, _equiangular(profile), profile.rim_m
    if isinstance(profile, Table):
        from scipy.interpolate import PchipInterpolator  # loading it takes long

        z = np.asarray(profile.z_mm)
        return (
            _PIECEWISE,
            0.0,
            _of_spline(PchipInterpolator(np.asarray(profile.r_mm) / 1000, (z - z[0]) / 1000)),
            profile.rim_m,
        )
    raise TypeError(f"no such profile: {type(profile).__name__}")


def _of_spline(spline: Any) -> Pieces:
    return spline.x, np.ascontiguousarray(spline.c)


def _equiangular(profile: Equiangular) -> Pieces:
    """Points and slopes of the closed form. The slope is `tan((gain - 1) t/2)`: light turns by twice its angle."""
    from scipy.interpolate import CubicHermiteSpline

    k, h = profile.k, profile.camera_m
    # r grows with t; the last t is the rim's, by bisection.
    low, high = 0.0, math.pi / (2 * k)
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if profile.radius_at(middle) < profile.rim_m else (low, middle)
    t = np.linspace(0.0, high, _PIECES + 1)
    rho = h * np.cos(k * t) ** (-1 / k)
    return _of_spline(CubicHermiteSpline(rho * np.sin(t), rho * np.cos(t) - h, np.tan((profile.gain - 1) * t / 2)))
