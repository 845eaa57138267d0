"""The transverse rectification that OpenCV calls LONGLATI, and the way back from it to the panorama.

A column is an angle theta to the baseline, a row a half plane around it: corresponding points lie on one row, and the
disparity of two columns is the angle `alpha_2 - alpha_1` itself, everywhere. theta is measured from -t, so that
`theta = pi - alpha`: a point moves to the left from view 1 to view 2, as OpenCV's matchers expect. In the rectified
frame, X along t, the direction of (theta, h) is `(-cos theta, -sin theta cos h, sin theta sin h)`.

Every half plane around the baseline crosses the panorama, so that all of them are kept: theta over 180° and h over
360°, both in the same step. h = 0 points up, where the sensor sees nothing, so that the seam cuts no picture; for a
steep baseline it points along -x, and does. The formula goes on past theta = 0 and 180° and around h, and margins are
more of it: matchers give no disparity in their first columns, and what is next to the seam needs neighbours.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.camera.conversions import mirrored_frame, to_unified, unified_lens
from harness.camera.fill import closed_image
from harness.camera.models import Mirror, Unified
from harness.camera.models.hyperboloid import HyperboloidCamera
from harness.camera.sensor import Sensor, in_field, on_image, parameters_of, project, seam_px
from harness.errors import InputError
from harness.geometry.angles import Array, normalise
from harness.matching.interface import MatcherSettings
from harness.matching.pair import Pair

_LANCZOS_TAPS = 8

_AROUND_THE_SEAM = 24
"""Least overlap on each side, degrees of h that appear twice: the reach of a path of StereoSGBM."""


@dataclass(frozen=True)
class Rectangle:
    """The pixels of a rectified image; of row i and column j the middle is at h = (i - cy) step, theta = (j - cx) step.

    The same for both views.
    """

    around: int
    """Rows in one turn around the baseline, even; half as many columns span the angles from -t to t."""
    margin_columns: int = 0
    margin_rows: int = 0
    """Additional rows on each side."""

    @property
    def step(self) -> float:
        """Radians from a column, or a row, to the next."""
        return 2 * math.pi / self.around

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.around + 2 * self.margin_rows, self.around // 2 + 2 * self.margin_columns

    @property
    def K(self) -> Array:
        """`[3, 3]`: OpenCV's Knew, from (theta, h) in radians to pixels."""
        return np.array(
            [[1 / self.step, 0, self.margin_columns - 0.5], [0, 1 / self.step, self.margin_rows - 0.5], [0, 0, 1]]
        )

    def pixels_of(self, R_rect_from_v1: Array, directions: Array) -> tuple[Array, Array]:
        """Row and column `[...]`, with fractions, of directions `[..., 3]` in v1's frame.

        Parameters
        ----------
        R_rect_from_v1
            `[3, 3]`, between frames as OpenCV has them (see `camera.conversions`).
        """
        x, y, z = np.moveaxis(mirrored_frame(directions) @ R_rect_from_v1.T, -1, 0)
        theta, h = np.arctan2(np.hypot(y, z), -x), np.arctan2(z, -y) % (2 * np.pi)
        return h / self.step + self.K[1, 2], theta / self.step + self.K[0, 2]

    def directions(self, R_rect_from_v1: Array) -> Array:
        """Unit directions `[rows, columns, 3]` of the pixels in v1's frame."""
        rows, columns = self.shape
        theta, h = (
            (np.arange(columns) - self.K[0, 2]) * self.step,
            ((np.arange(rows) - self.K[1, 2]) * self.step)[:, None],
        )
        sine = np.sin(theta)
        rectified = np.stack(np.broadcast_arrays(-np.cos(theta), -sine * np.cos(h), sine * np.sin(h)), axis=-1)
        return mirrored_frame(rectified @ R_rect_from_v1)


@dataclass(frozen=True)
class Rectified:
    """A pair of views on one rectangle."""

    rectangle: Rectangle
    R_rect_from_v1: Array
    """`[3, 3]`, between frames as OpenCV has them."""
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    valid: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    """Pixels that the sensor sees; the images are 0 elsewhere."""


def disparities(limits: MatcherSettings, baseline_m: float, step: float) -> int:
    """The number of disparities that OpenCV has to search, a multiple of 16.

    Seen from d_min the baseline spans at most asin(|t|/d_min), the disparity of the nearest point searched; two more,
    so that it has neighbours for the sub-pixel step. If d_min is not beyond the baseline: a half circle.
    """
    nearest = math.asin(baseline_m / limits.d_min_m) if baseline_m < limits.d_min_m else math.pi
    return 16 * math.ceil((math.ceil(nearest / step) + 2) / 16)


def around_of(pair: Pair, scale: float) -> int:
    """Rows of a rectangle that has `scale` columns to a column of the panorama."""
    return 2 * round(pair.grid.width_px * scale / 2)


def rectangle_for(pair: Pair, scale: float, number: int, block_px: int) -> Rectangle:
    """A rectangle with the margins that `number` disparities and a block need."""
    around = around_of(pair, scale)
    return Rectangle(around, number + block_px, max(block_px, math.ceil(around * _AROUND_THE_SEAM / 360)))


def frame_along(t_v1: Array) -> Array:
    """`R_rect_from_v1 [3, 3]`, between frames as OpenCV has them: X along t, -Y up.

    As `cv2.omnidir.stereoRectify`, except for the choice of Y, which it leaves undefined for a vertical baseline.
    """
    x = normalise(mirrored_frame(t_v1))
    steep = abs(x[2]) > np.hypot(x[0], x[1])
    reference = np.array([1.0, 0.0, 0.0]) if steep else np.array([0.0, 0.0, 1.0])
    y = normalise(reference - (reference @ x) * x)
    return np.stack([x, y, np.cross(x, y)])


def mei(sensor: Sensor) -> tuple[Array, Array, Array]:
    """The sensor as OpenCV writes it: K `[3, 3]`, distortion `[1, 4]` and xi `[1, 1]`.

    Raises
    ------
    InputError
        When the camera model is not one that OpenCV's omnidir has, or the lens has a k3, which omnidir lacks.
    """
    if not isinstance(sensor.model, Mirror | Unified):
        raise InputError(
            f"OpenCV's omnidir knows the unified model alone, and no {sensor.model.title}", key="sensor.model"
        )
    if sensor.lens.k3:
        raise InputError(f"OpenCV's omnidir has no k3; it must be 0, found {sensor.lens.k3:g}", key="sensor.lens.k3")
    unified, lens = to_unified(sensor), unified_lens(sensor)
    K = np.array(
        [[unified.gamma_u_px, unified.skew_px, unified.cx_px], [0, unified.gamma_v_px, unified.cy_px], [0, 0, 1.0]]
    )
    return K, np.array([[lens.k1, lens.k2, lens.p1, lens.p2]]), np.array([[unified.xi]])


def mirrored_rotation(R: Array) -> Array:
    """A rotation `[3, 3]` between our frames as OpenCV has it: S R S with S = diag(1, 1, -1)."""
    return mirrored_frame(mirrored_frame(R).T).T


def rectify(pair: Pair, rectangle: Rectangle, interpolation: str, cv2: Any, block_px: int = 1) -> Rectified:
    """Both views on the rectangle, both in v1's orientation, rounded to the 8 bits that OpenCV's matchers take.

    Where a block would cover a pixel that is not finite, or masked, nothing is seen.
    """
    how = {"linear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "lanczos4": cv2.INTER_LANCZOS4}[interpolation]
    frame = frame_along(pair.t_v1)
    images, masks = [], []
    rotations = (np.eye(3), pair.motion.R_v2_from_v1)
    for image, sensor, R in zip(pair.images, pair.sensors, rotations, strict=True):
        u, v, valid = maps_to_view(sensor, rectangle, frame.tobytes(), np.asarray(R, dtype=np.float64).tobytes(), cv2)
        valid = valid & ~around_gaps(image, sensor, (u, v), block_px, cv2)
        closed, _, _ = closed_image(image, sensor, seam_px(sensor))
        sampled = cv2.remap(closed, u, v, how, borderMode=cv2.BORDER_REPLICATE)
        images.append(np.where(valid, np.clip(np.rint(sampled), 0, 255), 0).astype(np.uint8))
        masks.append(valid)
    return Rectified(rectangle, frame, (images[0], images[1]), (masks[0], masks[1]))


def around_gaps(
    image: NDArray[np.float32],
    sensor: Sensor,
    maps: tuple[NDArray[np.float32], NDArray[np.float32]],
    block_px: int,
    cv2: Any,
) -> NDArray[np.bool_]:
    """Pixels of the rectangle whose block covers a pixel of the image that is not finite, or masked.

    maps : where on the image each of them is, (u, v). Lanczos weighs four pixels to each side.
    """
    _, _, gaps = closed_image(image, sensor, seam_px(sensor))
    if gaps is None or not gaps.any():
        return np.zeros(maps[0].shape, dtype=bool)
    reach = cv2.dilate(gaps.astype(np.uint8), np.ones((_LANCZOS_TAPS, _LANCZOS_TAPS), np.uint8))
    on_rectangle = cv2.remap(reach, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(cv2.dilate(on_rectangle, np.ones((block_px + 2, block_px + 2), np.uint8)) > 0)


@lru_cache(maxsize=4)
def maps_to_view(
    sensor: Sensor, rectangle: Rectangle, frame: bytes, rotation: bytes, cv2: Any
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """The pixel (u, v) on a view's mirror image for each pixel of the rectangle, and whether the sensor sees it.

    By OpenCV's own map for a hyperboloid that is mounted as mirrors are, whose lens OpenCV has too; by the sensor's
    projection for others. Of an image that is continued across its seam, u counts from the first of the columns before
    it.
    """
    R_rect_from_v1, R_view_from_v1 = (np.frombuffer(each).reshape(3, 3) for each in (frame, rotation))
    looking = rectangle.directions(R_rect_from_v1) @ R_view_from_v1.T
    if sensor.lens.k3 or not isinstance(parameters_of(sensor), HyperboloidCamera):
        pixels, valid = project(sensor, looking)
        pixels = np.nan_to_num(pixels, nan=-1.0) + np.array([seam_px(sensor), 0])
        u, v = np.ascontiguousarray(np.moveaxis(pixels, -1, 0), dtype=np.float32)
    else:
        u, v = cv2.omnidir.initUndistortRectifyMap(
            *mei(sensor),
            R_rect_from_v1 @ mirrored_rotation(R_view_from_v1).T,
            rectangle.K,
            rectangle.shape[::-1],
            cv2.CV_32FC1,
            cv2.omnidir.RECTIFY_LONGLATI,
        )
        # Beyond the asymptote OpenCV's formula folds back onto the image: the field of view decides what is visible.
        valid = in_field(sensor, looking) & on_image(sensor, np.stack([u, v], axis=-1))
    for array in (u, v, valid):
        array.flags.writeable = False
    return u, v, valid


def on_panorama(rectified: Rectified, disparity: Array, directions: Array) -> Array:
    """Disparities (pixels of the rectangle) of view 1's panorama, from those of its rectified image.

    Linear between the four pixels around a direction where all have a disparity and these lie within one pixel of each
    other; the nearest pixel's elsewhere, so that nothing is made up across an edge. NaN where that has no value, and
    where the match is in a direction that view 2 does not see.

    Parameters
    ----------
    disparity
        `[rows, columns]`, NaN for none.
    directions
        `[height, width, 3]`, of the panorama's pixels.
    """
    row, column = rectified.rectangle.pixels_of(rectified.R_rect_from_v1, directions)
    rows, columns = disparity.shape
    i, j = np.clip(np.floor(row).astype(int), 0, rows - 2), np.clip(np.floor(column).astype(int), 0, columns - 2)
    y, x = row - i, column - j
    taken = np.where(rectified.valid[0], disparity, np.nan)
    around = np.stack([taken[i, j], taken[i, j + 1], taken[i + 1, j], taken[i + 1, j + 1]])
    linear = (1 - y) * ((1 - x) * around[0] + x * around[1]) + y * ((1 - x) * around[2] + x * around[3])
    nearest = np.choose(2 * (y >= 0.5) + (x >= 0.5), around)
    result = np.where(np.ptp(around, axis=0) <= 1, linear, nearest)  # a NaN among them is not within anything
    other = np.rint(column - np.nan_to_num(result)).astype(int)
    in_view_2 = rectified.valid[1][np.clip(np.rint(row).astype(int), 0, rows - 1), np.clip(other, 0, columns - 1)]
    return np.where(in_view_2 & (other >= 0), result, np.nan)
