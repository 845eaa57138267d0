"""Rays of a sensor without a viewpoint, by the law of reflection: a misaligned hyperboloid mirror, or a `[profile]`.

Such a sensor is for rendering only. It has no single viewpoint: each ray starts at a point of the mirror, so that
`harness.camera.sensor.project`, `unproject` and other functions of directions alone reject it. Matchers use a central
sensor (`harness.camera.central`).
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from harness.camera._profile_kernels import reflect_at_profile
from harness.camera._reflected_point_kernels import differentiate_reflected, project_reflected
from harness.camera._reflection_kernels import ReflectingCamera, reflect_pixels
from harness.camera.lens import fold_radius
from harness.camera.models import Mirror
from harness.camera.profile_reflection import profile_camera
from harness.camera.sensor import (
    Sensor,
    field_of,
    model_from_sensor,
    not_masked,
    on_image,
    parameters_of,
    pixel_directions,
    project,
    unproject,
)
from harness.errors import InputError, with_article
from harness.geometry.angles import Array


def reflect(sensor: Sensor, pixels: ArrayLike) -> tuple[Array, Array, np.ndarray]:
    """The rays of pixels: their origins on the mirror, and their directions.

    For a hyperboloid closed form except for lens distortion; equations in `harness.camera._reflection_kernels`. Without
    misalignment the directions are those of `unproject`, and the line of each ray passes through the inner focus. For a
    mirror of a `[profile]` see `harness.camera._profile_kernels`.

    Parameters
    ----------
    sensor
        With a hyperboloid mirror, misaligned or not, or a profile.
    pixels
        `[..., 2]`, (u, v), fractions allowed.

    Returns
    -------
    origins
        `[..., 3]`: the point of the mirror, metres, in the sensor's frame (z up, origin at the mirror's inner focus,
        or at the viewpoint of the profile). NaN where the camera's ray does not hit the mirror, nor its continuation
        beyond the rim.
    directions
        `[..., 3]`, unit length, in the same frame; NaN likewise.
    valid
        `[...]`, bool: the point is within the mirror's rim, not hidden by the camera's body, and the pixel is on the
        image and not masked. The rim is a circle on the mirror, given by the field of view; the blind disc is the image
        of a round body at the camera centre, which moves with the camera. A profile has
        a rim of its own, and the field of view limits the directions of its rays.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    flat = pixels.reshape(-1, 2)
    origins, directions, valid = reflected_rays(
        sensor, np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1])
    )
    shape = pixels.shape[:-1]
    with np.errstate(invalid="ignore"):
        valid = valid.reshape(shape) & on_image(sensor, pixels) & not_masked(sensor, pixels)
    return origins.T.reshape(*shape, 3), directions.T.reshape(*shape, 3), valid


@lru_cache(maxsize=8)
def reflected_pixels(sensor: Sensor) -> tuple[Array, Array, np.ndarray]:
    """`reflect` of every pixel's centre: `[height, width, 3]` twice and `[height, width]`; read-only."""
    camera = sensor.camera
    u, v = np.meshgrid(np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px, dtype=np.float64))
    arrays = reflect(sensor, np.stack([u, v], axis=-1))
    for array in arrays:
        array.flags.writeable = False
    return arrays


def seeing_pixels(sensor: Sensor) -> np.ndarray:
    """`[height, width]`, bool: the pixels whose centre has a ray, for a central or a misaligned sensor; read-only."""
    return pixel_directions(sensor)[1] if sensor.is_central else reflected_pixels(sensor)[2]


def reflected_rays(sensor: Sensor, u: Array, v: Array) -> tuple[Array, Array, np.ndarray]:
    """Rays of many pixels as rows `[3, n]`: the fast form of `reflect`, without the checks of image and mask.

    A compiled loop that releases the interpreter's lock: bands of pixels may run in threads.

    Parameters
    ----------
    u, v
        `[n]`, contiguous float64.
    """
    rays, valid = np.empty((6, u.size)), np.empty(u.size, dtype=np.bool_)
    write_reflected_rays(sensor, u, v, rays, valid)
    return rays[:3], rays[3:], valid


def write_reflected_rays(sensor: Sensor, u: Array, v: Array, rays: Array, valid: np.ndarray) -> None:
    """Write origins and unit directions of pixels, as `reflected_rays`, to `rays [6, n]`, and their validity, `[n]`."""
    if sensor.profile is None:
        reflect_pixels(u, v, reflecting_camera(sensor), rays[:3], rays[3:], valid)
    else:
        reflect_at_profile(u, v, profile_camera(sensor), rays[:3], rays[3:], valid)


def project_points(sensor: Sensor, points_m: ArrayLike) -> tuple[Array, np.ndarray]:
    """The pixels of points, in a misaligned mirror or a central sensor.

    For a central sensor this is `project`. For a misaligned one the pixel also depends on the distance: Newton's method
    finds the point of the mirror at which the path of light from the point to the camera is shortest
    (`harness.camera._reflected_point_kernels`).

    Parameters
    ----------
    points_m
        `[..., 3]` in the sensor's frame (z up, origin at the mirror's inner focus), metres; outside the mirror.

    Returns
    -------
    pixels
        `[..., 2]`, (u, v) in pixels. Also given beyond the rim, within the model's domain; NaN farther out.
    valid
        `[...]`, bool, as for `reflect`.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if sensor.is_central:
        return project(sensor, points)
    pixels, valid = np.empty((*points.shape[:-1], 2)), np.empty(points.shape[:-1], dtype=np.bool_)
    flat = np.ascontiguousarray(points).reshape(-1, 3)
    project_reflected(flat, reflecting_camera(sensor), pixels.reshape(-1, 2), valid.reshape(-1))
    with np.errstate(invalid="ignore"):
        return pixels, valid & on_image(sensor, pixels) & not_masked(sensor, pixels)


def points_jacobian(sensor: Sensor, points_m: ArrayLike) -> tuple[Array, Array]:
    """Derivatives of the pixels of points by the points, and by the sensor's misalignment.

    Parameters
    ----------
    sensor
        With a hyperboloid mirror, misaligned or not.
    points_m
        `[..., 3]`, as those of `project_points`.

    Returns
    -------
    by_point
        `[..., 2, 3]`, derivatives of (u, v) by the point, pixels per metre; NaN where no light arrives.
    by_misalignment
        `[..., 2, 6]`, derivatives by the keys of `Misalignment` in their order, pixels per millimetre and per degree.
    """
    points = np.asarray(points_m, dtype=np.float64)
    shape = points.shape[:-1]
    by_point, by_camera = np.empty((*shape, 2, 3)), np.empty((*shape, 2, 6))
    differentiate_reflected(
        np.ascontiguousarray(points).reshape(-1, 3),
        sensor.misalignment.rotation_axes,
        reflecting_camera(sensor),
        by_point.reshape(-1, 2, 3),
        by_camera.reshape(-1, 2, 6),
    )
    return by_point, by_camera * np.repeat([1e-3, math.radians(1)], 3)


def ray_directions(sensor: Sensor, pixels: ArrayLike) -> tuple[Array, np.ndarray]:
    """Directions `[..., 3]` in which pixels `[..., 2]` look, and validity, of any sensor: `unproject` or `reflect`."""
    if sensor.is_central:
        return unproject(sensor, pixels)
    _, directions, valid = reflect(sensor, pixels)
    return directions, valid


def camera_of_points(sensor: Sensor) -> Any:
    """The argument with which the compiled projections project points, metres, instead of directions.

    The parameters of a central sensor, for which points and directions are equivalent, or a `ReflectingCamera`.
    """
    return parameters_of(sensor) if sensor.is_central else reflecting_camera(sensor)


@lru_cache(maxsize=64)
def reflecting_camera(sensor: Sensor) -> ReflectingCamera:
    """The argument of the compiled reflection.

    Raises
    ------
    TypeError
        Unless the sensor has a hyperboloid mirror.
    InputError
        When it has a profile: points are not projected through one.
    """
    if sensor.profile is not None:
        raise InputError(
            f"a hyperboloid mirror is needed here, not {with_article(sensor.profile.title)}; leave [profile] out",
            key="profile",
        )
    mirror = sensor.model
    if not isinstance(mirror, Mirror):
        raise TypeError(f"{with_article(mirror.title)} is no hyperboloid mirror")
    lens, misalignment = sensor.lens, sensor.misalignment
    c_x, c_y, c_z = (np.array([0.0, 0.0, -2 * mirror.e_m]) + misalignment.offset_m).tolist()
    R, M = misalignment.R_mirror_from_camera, model_from_sensor(sensor)
    rows = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
    field, body = field_of(sensor), 0.0
    # The angle off the axis within which the camera sees itself, from the limits of the field of view.
    blind_deg = {"down": 90 + sensor.field.elevation_min_deg, "up": 90 - sensor.field.elevation_max_deg}.get(
        sensor.looks, 0.0
    )
    if 0 < blind_deg < 90:
        field = field._replace(**{"lowest": -2.0} if sensor.looks == "down" else {"highest": 2.0})
        body = 2 * mirror.e_m * math.tan(math.radians(blind_deg))
    return ReflectingCamera(
        **sensor.camera.matrix,
        k1=lens.k1,
        k2=lens.k2,
        p1=lens.p1,
        p2=lens.p2,
        k3=lens.k3,
        fold=fold_radius(lens),
        a=mirror.a_m,
        b=mirror.b_m,
        e=mirror.e_m,
        c_x=c_x,
        c_y=c_y,
        c_z=c_z,
        **{f"r_{name}": each for name, each in zip(rows, R.ravel().tolist(), strict=True)},
        **{f"m_{name}": each for name, each in zip(rows, M.ravel().tolist(), strict=True)},
        field=field,
        body=body,
    )
