"""The focal length at which the whole field of view just fits on the image."""

import math

import numpy as np

from harness.camera._projection_kernels import project_all
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import CameraModel
from harness.camera.mount import Looks, camera_from_sensor
from harness.geometry.angles import Array

_STEP_DEG = 0.5
"""Between directions around the field's limits. A border is touched at a maximum, so that one half-way between two of
them lies within (0.25°)²/2, 1e-5 of the radius; straight along u and v there is a direction, and nothing is missed."""


def fitted_focal_px(
    model: CameraModel, camera: Camera, lens: Lens, field: FieldOfView, looks: Looks, *, mirrored: bool
) -> float:
    """The largest focal length with which every direction of the field is on the image, before any tilt.

    The image of the field then touches the border (the image spans -0.5 .. width - 0.5) that it would cross first: for
    a round field, the one nearest to the principal point.

    Parameters
    ----------
    camera
        Its focal length is ignored.

    Raises
    ------
    ValueError
        When part of the field cannot be projected.
    """
    own = camera_from_sensor(model.looks, mirrored=model.mirrored).T @ camera_from_sensor(looks, mirrored=mirrored)
    directions = np.ascontiguousarray(_directions(field, looks) @ own.T)
    # Pixels are affine in the focal length: the skew and the centre do not grow with it.
    one, two = (_pixels(model, camera, lens, focal_px, directions) for focal_px in (1.0, 2.0))
    slope, start = two - one, 2 * one - two
    if not np.isfinite(one).all():
        raise ValueError('camera.focal_px = "fit": the camera has no image of part of the field; use a smaller field')
    last = np.array([camera.width_px, camera.height_px]) - 0.5
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(slope > 0, (last - start) / slope, (-0.5 - start) / slope)
    return float(np.min(room[slope != 0]))


def _pixels(model: CameraModel, camera: Camera, lens: Lens, focal_px: float, directions: Array) -> Array:
    pixels = np.empty((len(directions), 2))
    parameters = model.parameters(camera.model_copy(update={"focal_px": focal_px}), lens)
    project_all(directions, parameters, pixels)
    return pixels


def _directions(field: FieldOfView, looks: Looks) -> Array:
    """Directions `[n, 3]` on the limits of a field and inside, in the untilted sensor's frame."""
    azimuths = np.radians(np.arange(-180, 180 + _STEP_DEG, _STEP_DEG))
    lowest, highest = field.elevation_min_deg, field.elevation_max_deg
    levels = np.radians(np.linspace(lowest, highest, max(2, math.ceil((highest - lowest) / 5) + 1)))[:, None]
    level = np.cos(levels)
    x, y = level * np.cos(azimuths), level * np.sin(azimuths)
    around = np.stack([x, y, np.broadcast_to(np.sin(levels), x.shape)], axis=-1).reshape(-1, 3)
    axes = camera_from_sensor(looks, mirrored=False)
    edge = math.radians(field.angle_max_deg)
    rim = np.stack(
        [math.sin(edge) * np.cos(azimuths), math.sin(edge) * np.sin(azimuths), np.full(azimuths.size, math.cos(edge))],
        axis=-1,
    )
    rim = rim @ axes
    elevations = np.degrees(np.arctan2(rim[:, 2], np.hypot(rim[:, 0], rim[:, 1])))
    inside = around[around @ axes[2] >= math.cos(edge)]
    return np.vstack([inside, rim[(elevations >= lowest) & (elevations <= highest)]])
