"""Images of any camera as OpenCV's omnidir takes them: of the unified (Mei) model, with a lens that has no k3.

Three ways, the first that holds:

- **exact**: a hyperboloid, the unified model, or one that is the same camera in other parameters;
- **fitted**: the unified camera that is nearest, if it is at most `LARGEST_RMS_PX` away over all pixels that see
  something; the image stays as it is;
- **resampled**: the image sampled anew, by a cubic spline through its pixels, into a unified camera with xi = 1 whose
  axis points up or down, whichever leaves the smaller angle to what the panorama shows. That camera sees all
  directions but the one behind it: its image is stereographic, `rho = gamma tan(theta/2)`, and coarsest in its centre,
  where it has `_FINER` times as many pixels to a radian as the first one has in the median over its field.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.conversions import opencv_from_sensor
from harness.camera.fill import closed_image
from harness.camera.model_fitting import Conversion, Target, compared_pixels, convert
from harness.camera.models import Mirror, Unified
from harness.camera.optics import optics_of
from harness.camera.sensor import Sensor, in_use, pixel_directions, pixels_per_steradian, project, seam_px
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.panorama import directions
from harness.matching.opencv.rectify import mei
from harness.matching.pair import Pair

LARGEST_RMS_PX = 0.05
"""The RMS residual of a fitted camera: a third of the median error of StereoSGBM's disparities on the paper's box."""

_FINER = 2.0
"""Linear interpolation, OpenCV's own, loses a quarter as much from an image that is twice as fine."""
_LARGEST_PX = 4096
"""Side of a resampled image."""
_BEHIND_DEG = 165.0
"""The largest angle off the axis that a resampled image shows: at 180 it has no end."""
_BLOCK_DEG = 5.0
"""Margin around the panorama's field, degrees, for the blocks of its outermost pixels."""

Camera = tuple[Array, Array, Array]
"""K `[3, 3]`, distortion `[1, 4]` and xi `[1, 1]`, as OpenCV writes them."""


@dataclass(frozen=True)
class OmnidirView:
    """One view as OpenCV's omnidir takes it."""

    image: NDArray[np.uint8]
    camera: Camera
    opencv_from_sensor: Array
    """`[3, 3]`, orthogonal: from directions of the sensor's frame to the camera's; determinant -1 for mirror images."""
    remark: str
    """How the image or the camera was approximated, with the residual; empty if the camera is the sensor's own."""


def omnidir_views(pair: Pair, cv2: Any) -> tuple[OmnidirView, OmnidirView]:
    """Both views, with both images mirrored or neither: the motion between them is a rotation, as OpenCV expects."""
    frames = [opencv_from_sensor(sensor) for sensor in pair.sensors]
    cameras = [_camera_of(sensor) for sensor in pair.sensors]
    mirrored = [bool(np.linalg.det(frame) < 0) for frame in frames]
    # A view that is resampled can be made either; of two that are not, the second is.
    one = mirrored[0] if cameras[0][0] is not None else cameras[1][0] is not None and mirrored[1]
    views = []
    for view, ((camera, remark), frame) in enumerate(zip(cameras, frames, strict=True)):
        if camera is None or mirrored[view] != one:
            views.append(_resampled(pair, view, one, remark, cv2))
        else:
            closed, _, _ = closed_image(pair.images[view], pair.sensors[view])
            views.append(OmnidirView(_in_8_bits(closed), camera, frame, remark))
    return views[0], views[1]


@lru_cache(maxsize=16)
def _camera_of(sensor: Sensor) -> tuple[Camera | None, str]:
    """The unified camera of the sensor's images as they are, with a remark; or None, with the reason why."""
    if isinstance(sensor.model, Mirror | Unified) and not sensor.lens.k3:
        return mei(sensor), ""
    target = Target("unified", k3=False)
    try:
        nearest = convert(optics_of(sensor), compared_pixels(sensor), target)
    except InputError as error:
        return None, error.problem
    if nearest.is_exact:
        return mei(sensor.model_copy(update=_parts(nearest))), ""
    apart = f"{nearest.rms_px:.2g} px RMS, {nearest.largest_px:.2g} px at most"
    if not nearest.rms_px <= LARGEST_RMS_PX:
        return None, f"the nearest unified camera is {apart} away"
    remark = f"OpenCV's omnidir was given the unified camera nearest to the {sensor.model.title}: {apart} away"
    return mei(sensor.model_copy(update=_parts(nearest))), remark


def _parts(nearest: Conversion) -> dict[str, Any]:
    return {"model": nearest.optics.model, "camera": nearest.optics.camera, "lens": nearest.optics.lens}


def _resampled(pair: Pair, view: int, mirrored: bool, why: str, cv2: Any) -> OmnidirView:
    """The view resampled to a stereographic image."""
    sensor = pair.sensors[view]
    looking = directions(pair.grid) @ (pair.motion.R_v2_from_v1.T if view else np.eye(3))
    visible = in_use(sensor, looking)
    heights = looking[visible if visible.any() else np.ones_like(visible)][:, 2]
    lowest, highest = (math.degrees(math.asin(np.clip(each, -1, 1))) for each in (heights.min(), heights.max()))
    up = 90 - lowest <= 90 + highest
    reach_deg = min((90 - lowest if up else 90 + highest) + _BLOCK_DEG, _BEHIND_DEG)
    frame = np.diag([1.0, -1.0 if up == mirrored else 1.0, 1.0 if up else -1.0])
    per_radian = _FINER * _pixels_per_radian(sensor)
    side = 2 * math.ceil(2 * per_radian * math.tan(math.radians(reach_deg) / 2)) + 1
    if side > _LARGEST_PX:
        per_radian, side = per_radian * (_LARGEST_PX - 1) / side, _LARGEST_PX - 1
    gamma, centre = 2 * per_radian, (side - 1) / 2
    image = _sampled(pair.images[view], sensor, _stereographic(side, gamma) @ frame, cv2)
    K = np.array([[gamma, 0.0, centre], [0.0, gamma, centre], [0.0, 0.0, 1.0]])
    text = f"an image of the {sensor.model.title} was resampled into a unified camera with xi = 1, {side} px wide, for"
    because = why or "one view is a mirror image and the other is none"
    return OmnidirView(image, (K, np.zeros((1, 4)), np.ones((1, 1))), frame, f"{text} OpenCV's omnidir: {because}")


@lru_cache(maxsize=16)
def _pixels_per_radian(sensor: Sensor) -> float:
    """The median over pixels that see something of the root of the pixels in a steradian."""
    rays, valid = pixel_directions(sensor)
    every = max(1, math.isqrt(int(valid.sum()) // 10_000))
    sampled = rays[::every, ::every][valid[::every, ::every]]
    return float(np.sqrt(np.median(pixels_per_steradian(sensor, sampled))))


def _stereographic(side: int, gamma: float) -> Array:
    """`[side, side, 3]`: the unit directions of the pixels, in the camera's frame."""
    across = (np.arange(side) - (side - 1) / 2) / gamma
    m, n = np.meshgrid(across, across)
    r2 = m * m + n * n
    return np.stack([2 * m, 2 * n, 1 - r2], axis=-1) / (1 + r2)[..., None]


def _sampled(image: NDArray[np.float32], sensor: Sensor, looking: Array, cv2: Any) -> NDArray[np.uint8]:
    """The image at the pixels of directions `[rows, columns, 3]` of the sensor's frame; beyond it, its border."""
    seam = seam_px(sensor)
    closed, _, _ = closed_image(image, sensor, seam)
    pixels = np.nan_to_num(project(sensor, looking)[0], nan=-1.0) + np.array([seam, 0])
    u, v = np.ascontiguousarray(np.moveaxis(pixels, -1, 0), dtype=np.float32)
    return _in_8_bits(cv2.remap(closed, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def _in_8_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
