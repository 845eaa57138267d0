"""Detection of the image circle: the boundary of the mirror or lens, beyond which the image is dark."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from harness.geometry.angles import Array

_TRIES = 400


@dataclass(frozen=True)
class Circle:
    """A circle in the image: centre and radius, pixels."""

    u: float
    v: float
    radius_px: float


def find_circle(image: NDArray[np.floating] | NDArray[np.uint8]) -> Circle | None:
    """The circle within which an image `[height, width]` is bright; None without one.

    Takes the convex hull of all pixels that are brighter than the dark corners, so that dark regions inside do no harm,
    and fits a circle to its vertices by RANSAC with a fixed seed. Parts of the circle may lie off the image.
    """
    height, width = image.shape
    smooth = ndimage.gaussian_filter(image.astype(np.float32), max(1.0, min(height, width) / 300))
    edge = max(2, min(height, width) // 40)
    dark = float(np.percentile(np.concatenate([smooth[:edge].ravel(), smooth[-edge:].ravel()]), 5))
    bright = float(np.percentile(smooth, 99))
    if bright - dark < 20:
        return None
    labels, count = ndimage.label(smooth > dark + 0.2 * (bright - dark))
    if not count:
        return None
    v, u = np.nonzero(labels == 1 + np.argmax(np.bincount(labels.ravel())[1:]))
    try:
        hull = ConvexHull(np.stack([u, v], axis=-1))
    except QhullError:
        return None
    points = _along(hull.points[hull.vertices])
    inner = (points > 1).all(axis=-1) & (points[:, 0] < width - 2) & (points[:, 1] < height - 2)
    points = points[inner]
    return _fit(points, min(height, width)) if len(points) >= 12 else None


def _along(corners: Array) -> Array:
    """The vertices of a hull that lie on an arc: the ends of its short sides.

    A long side is a chord across something dark, or the border of the image.
    """
    following = np.roll(corners, -1, axis=0)
    size = np.ptp(corners, axis=0).max()
    short = np.linalg.norm(following - corners, axis=-1) < 0.1 * size
    return corners[short | np.roll(short, 1)]


def _fit(points: Array, size: int) -> Circle | None:
    rng = np.random.default_rng(0)
    best: NDArray[np.bool_] | None = None
    for _ in range(_TRIES):
        circle = _through(points[rng.choice(len(points), 3, replace=False)])
        if circle is None or not 0.15 * size < circle.radius_px < 1.5 * size:
            continue
        near = _distance(points, circle) < 0.01 * circle.radius_px
        if best is None or near.sum() > best.sum():
            best = near
    if best is None or best.sum() < max(12, 0.5 * len(points)):
        return None
    fitted = _through(points[best])
    if fitted is None:
        return None
    azimuth = np.arctan2(points[best, 1] - fitted.v, points[best, 0] - fitted.u)
    covered = np.unique(np.floor((azimuth + np.pi) / (2 * np.pi) * 24)).size / 24
    return fitted if covered >= 0.3 else None


def _distance(points: Array, circle: Circle) -> Array:
    return np.abs(np.hypot(points[:, 0] - circle.u, points[:, 1] - circle.v) - circle.radius_px)


def _through(points: Array) -> Circle | None:
    """The circle of algebraic least squares through points: `u² + v² = 2 a u + 2 b v + c`."""
    A = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
    (a, b, c), _, rank, _ = np.linalg.lstsq(A, np.sum(points * points, axis=-1), rcond=None)
    square = c + a * a + b * b
    return Circle(float(a), float(b), float(np.sqrt(square))) if rank == 3 and square > 0 else None
