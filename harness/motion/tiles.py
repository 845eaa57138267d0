"""Tiles of view 1's image, each with a plane: their layout, and initial planes.

A plane is three numbers m: the inverse range in direction x is m · x, in units of 1/|t|.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from harness.camera.fill import across_seam, nearest_known, without_gaps
from harness.camera.sensor import Sensor, parameters_of, pixel_directions, pixels_seen, seam_px
from harness.geometry.angles import Array, angle_between, normalise
from harness.motion import _direct_kernels as _kernels
from harness.motion.features import Correspondences
from harness.motion.residuals import Turn

Image = NDArray[np.float32]

SIDE_PX = 17
"""Side of a tile, pixels: that of the windows of slanted matching."""
LEAST_SHARE = 0.8
"""Least share of a tile's pixels that are visible in both views."""
LEAST_W = -0.02
"""The least inverse range of a pixel, in 1/|t|; negative, as noise puts far points behind the views."""
LEAST_CONTRAST = 1.0
"""Least standard deviation of a tile's grey levels: below it, rounding to 8 bits dominates."""
_STRIDE = 2
_NEIGHBOURS = 12
_SCANNED = 24
_SLOPE_RIDGE = 0.05
"""Regularisation of slopes of w per radian towards 0, as a share of a pair's weight."""


@dataclass(frozen=True)
class Views:
    """Both images in the form of the kernels' arguments."""

    grey: Image
    """`[height, width]`, view 1."""
    known: NDArray[np.bool_]
    """`[height, width]`, pixels of view 1 that are in the field and finite."""
    x: Array
    """`[height, width, 3]`, unit directions of view 1's pixels."""
    coefficients: Image
    """Coefficients of view 2's interpolating cubic B-spline; NaN outside the sensor's field."""
    camera: tuple[Any, float]
    """The parameters of view 2's camera model, and the columns by which its coefficients are padded on the left."""
    blur_px: float
    """Standard deviation of the Gaussian with which both images were smoothed, pixels."""


def views(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], blur_px: float = 0.0) -> Views:
    """Prepare two images.

    Parameters
    ----------
    blur_px
        Standard deviation of a Gaussian with which both are smoothed, pixels.
    """
    prepared = []
    for image, sensor in zip(images, sensors, strict=True):
        closed, known = without_gaps(image, pixels_seen(sensor))
        smooth = closed[nearest_known(known)].astype(np.float64)
        if blur_px:
            smooth = ndimage.gaussian_filter(smooth, blur_px, mode="nearest")
            known = ndimage.binary_erosion(known, iterations=round(3 * blur_px))
        prepared.append((smooth, known))
    (first, known_1), (second, known_2) = prepared
    seam = seam_px(sensors[1])
    spline = ndimage.spline_filter(across_seam(second, seam), 3, output=np.float32, mode="mirror")
    return Views(
        grey=np.ascontiguousarray(first, dtype=np.float32),
        known=np.ascontiguousarray(known_1),
        x=pixel_directions(sensors[0])[0],
        coefficients=np.where(across_seam(known_2, seam), spline, np.float32(np.nan)),
        camera=(parameters_of(sensors[1]), float(seam)),
        blur_px=blur_px,
    )


def lay_tiles(given: Views, least_contrast: float = LEAST_CONTRAST) -> NDArray[np.int64]:
    """First row and column `[T, 2]` of the tiles with enough visible pixels in view 1, and enough contrast: the
    standard deviation of their grey levels.
    """
    rows, columns = (np.arange(0, size - SIDE_PX + 1, SIDE_PX) for size in given.known.shape)

    def mean(values: NDArray[Any]) -> Array:
        cut = values[: rows.size * SIDE_PX, : columns.size * SIDE_PX].astype(np.float64)
        return cut.reshape(rows.size, SIDE_PX, columns.size, SIDE_PX).mean(axis=(1, 3))

    share = mean(given.known)
    first = np.where(given.known, given.grey, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = mean(first**2) / share - (mean(first) / share) ** 2
    chosen = np.argwhere((share >= LEAST_SHARE) & (variance > least_contrast**2))
    return np.ascontiguousarray(chosen * SIDE_PX, dtype=np.int64)


def first_planes(given: Views, tiles: NDArray[np.int64], turn: Turn, pairs: Correspondences) -> tuple[Array, Array]:
    """An initial plane for each tile, and the correlation of both views on it.

    Candidates are planes through nearby pairs, and the inverse ranges of nearby pairs and values between them, with the
    slopes of those planes and without.

    Parameters
    ----------
    pairs
        The inliers of the motion.

    Returns
    -------
    planes
        `[T, 3]`; NaN where no candidate correlates.
    correlation
        `[T]`; -1 where there is none.
    """
    x_c = given.x[tiles[:, 0] + SIDE_PX // 2, tiles[:, 1] + SIDE_PX // 2]
    w = inverse_ranges(pairs, turn)
    count = min(_NEIGHBOURS, len(pairs))
    near = cKDTree(pairs.pixels_1).query(tiles[:, ::-1] + SIDE_PX // 2, k=count)[1].reshape(len(tiles), count)
    local = [_plane_through(pairs.x_1[near[:, :k]], w[near[:, :k]], x_c) for k in (count // 2, count)]
    high = np.maximum(1.5 * w[near].max(axis=1), 0.02)
    values = np.concatenate([w[near[:, :4]], high[:, None] * np.linspace(0, 1, _SCANNED)], axis=1)
    frontal = values[..., None] * x_c[:, None]
    sloped = local[1][:, None] + (values - np.sum(local[1] * x_c, axis=1, keepdims=True))[..., None] * x_c[:, None]
    tried = np.concatenate([np.stack(local, axis=1), frontal, sloped], axis=1)
    return best_planes(given, tiles, turn, tried)


def best_planes(
    given: Views, tiles: NDArray[np.int64], turn: Turn, tried: Array, before: tuple[Array, Array] | None = None
) -> tuple[Array, Array]:
    """The plane of the best correlation among some `[T, K, 3]`, and those found before."""
    planes, score = before or (np.full((len(tiles), 3), np.nan), np.full(len(tiles), -1.0))
    planes, score = planes.copy(), score.copy()
    _kernels.try_planes(
        tiles, SIDE_PX, _STRIDE, LEAST_W, given.known, given.x, given.grey, turn.R, turn.t, given.camera,
        given.coefficients, np.ascontiguousarray(tried), LEAST_SHARE, planes, score,
    )  # fmt: skip
    return planes, score


def planes_beside(tiles: NDArray[np.int64], planes: Array) -> Array:
    """The planes `[T, 8, 3]` of the eight tiles around each tile; NaN where there is no tile."""
    index = {(int(row), int(column)): i for i, (row, column) in enumerate(tiles)}
    steps = [(i * SIDE_PX, j * SIDE_PX) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    beside = np.array([[index.get((row + i, column + j), -1) for i, j in steps] for row, column in tiles.tolist()])
    return np.where(beside[..., None] >= 0, planes[beside], np.nan)


def inverse_ranges(pairs: Correspondences, turn: Turn) -> Array:
    """Inverse range from view 1 of each pair `[n]`, 1/|t|: `sin(alpha_2 - alpha_1)/sin(alpha_2)`."""
    alpha_1, alpha_2 = angle_between(pairs.x_1, turn.t), angle_between(pairs.x_2 @ turn.R, turn.t)
    return np.asarray(np.sin(alpha_2 - alpha_1) / np.maximum(np.sin(alpha_2), 1e-3))


def tangents_at(x: Array) -> tuple[Array, Array]:
    """Two unit vectors `[..., 3]` perpendicular to given unit vectors and to each other."""
    other = np.where(np.abs(x[..., 2:]) < 0.8, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    b_1 = normalise(np.cross(x, other))
    return b_1, np.cross(x, b_1)


def _plane_through(x: Array, w: Array, x_c: Array) -> Array:
    """Least-squares planes m `[T, 3]` of inverse ranges w `[T, k]` in directions x `[T, k, 3]`, with damped slopes."""
    b_1, b_2 = tangents_at(x_c)
    basis = np.stack([x_c, b_1, b_2], axis=1)
    A = np.einsum("tkj,tij->tki", x, basis)
    ridge = np.diag([0.0, _SLOPE_RIDGE, _SLOPE_RIDGE]) * x.shape[1] * 0.01 + 1e-9 * np.eye(3)
    c = np.linalg.solve(A.transpose(0, 2, 1) @ A + ridge, np.einsum("tki,tk->ti", A, w)[..., None])[..., 0]
    return np.asarray(np.einsum("ti,tij->tj", c, basis))
