"""Offsets of matches from their epipolar curves: tiles of view 1 are fitted to view 2 along the curve and across it.

An error of the geometry shifts matches along the curves, which looks like another range, and across them, which no
range explains. So each tile is fitted by least squares with its plane, gain and offset, and with an angle across: all
its points are rotated by delta about y × n, from y towards n = t × x/|t × x|, where y is the direction of its centre
from viewpoint 2 in view 1's orientation.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from harness.camera.sensor import Sensor, jacobian
from harness.display import OneLine
from harness.geometry.angles import Array, normalise
from harness.motion import _across_kernels as _kernels
from harness.motion.residuals import Turn
from harness.motion.tile_noise import TileNoise, by_correlation, noise_in
from harness.motion.tiles import (
    LEAST_CONTRAST,
    LEAST_SHARE,
    LEAST_W,
    SIDE_PX,
    Image,
    Views,
    lay_tiles,
    tangents_at,
    views,
)

_ITERATIONS = 6
_CORRELATION = 0.6
"""Least squared correlation of the two views on a tile, noise removed."""
_MOST_PX = 6.0
"""Largest angle across, pixels of view 2: beyond it a tile is a mismatch."""
_MOST_SIGMA_PX = 0.5
_BLURS_PX = {0.7: 0.9, 1.0: 0.5}
"""Standard deviations of the Gaussians that both images are smoothed with, one after the other, while there is less
texture than that share of the squared gradients, across. Noise of gradients makes false minima between the start and
the true angle: without, 0.7 to 0.8 of the angles were found in noise of 20 grey levels, and with twice the variance."""
_LEAST_KNOWN = 0.5
"""Least share of a tile's pixels with an initial inverse range."""
_OUTLYING = 9.0
"""Largest deviation of an inverse range from the median, in median deviations, in a tile's initial plane."""


@dataclass(frozen=True, repr=False)
class Across(OneLine):
    """The `n` tiles that match between the views."""

    tiles: NDArray[np.int64]
    """`[n, 2]`, first row and column in view 1's image."""
    x_1: Array
    """`[n, 3]`, unit directions of their centres from view 1."""
    planes: Array
    """`[n, 3]`: the inverse range in direction x is m · x, in 1/|t|."""
    delta: Array
    """The angle across, radians, from y towards n."""
    sigma: Array
    """Standard deviation of `delta` from the tile's own residual, radians."""
    px_per_rad: Array
    """Pixels of view 2 per radian across."""
    aside: Array
    """Error of the inverse range at the centre, 1/|t| per radian across, of a fit along the curve alone: where texture
    is oblique to the curve, a shift along it compensates one across it."""

    def __len__(self) -> int:
        return len(self.delta)

    def at(self, where: NDArray[np.bool_]) -> "Across":
        """The tiles selected by an index or a mask."""
        return Across(**{name: value[where] for name, value in vars(self).items()})

    @property
    def w(self) -> Array:
        """Inverse range at the centres, 1/|t|."""
        return np.asarray(np.sum(self.planes * self.x_1, axis=1))

    @property
    def pixels_1(self) -> Array:
        """`[n, 2]`, (u, v) of the centres."""
        return np.asarray(self.tiles[:, ::-1] + (SIDE_PX - 1) / 2, dtype=np.float64)


class Counts(NamedTuple):
    """How many tiles of view 1 came how far."""

    textured: int
    """Tiles with texture that stands out of the noise."""
    tried: int
    """Those of them with inverse ranges."""
    alike: int
    """Those of them that look alike in both views."""


def fit_across(
    images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], turn: Turn, inverse_range: Array
) -> tuple[Across, Counts]:
    """Fit tiles along and across the epipolar curves, from inverse ranges that are accurate to about a pixel.

    Parameters
    ----------
    inverse_range
        `[height, width]` of view 1's image, 1/|t|; NaN where unknown.

    Returns
    -------
    across
        The tiles that look alike in both views, and whose texture determines the angle across.
    counts
        How many tiles there are, and how many of them look alike.
    """
    noise = noise_in(images, sensors)
    across, counts, texture = _fit(views(images, sensors), noise, sensors, turn, inverse_range)
    for blur_px, least in _BLURS_PX.items():
        if texture > least:
            break
        smooth = views(images, sensors, blur_px), noise.smoothed(blur_px)
        across, counts, texture = _fit(*smooth, sensors, turn, inverse_range)
    return across, counts


def _fit(
    prepared: Views, noise: TileNoise, sensors: tuple[Sensor, Sensor], turn: Turn, inverse_range: Array
) -> tuple[Across, Counts, float]:
    """As `fit_across`, and the median share of texture in what tiles tell of the angle."""
    laid = lay_tiles(prepared, max(LEAST_CONTRAST, noise.least_contrast))
    tiles, planes = _planes(prepared, laid, inverse_range)
    count = len(tiles)
    x_c = prepared.x[tiles[:, 0] + SIDE_PX // 2, tiles[:, 1] + SIDE_PX // 2]
    n = normalise(np.cross(turn.t, x_c))
    y = normalise(x_c - np.sum(planes * x_c, axis=1, keepdims=True) * turn.t)
    axis, px_per_rad = np.ascontiguousarray(np.cross(y, n)), pixels_per_radian(sensors[1], turn, y, n)
    delta, gain, offset = np.zeros(count), np.ones(count), np.zeros(count)
    weights, parts, residuals = np.zeros((count, 6)), *np.zeros((2, count, SIDE_PX, SIDE_PX))
    for iteration in range(_ITERATIONS + 1):
        R = turn.R @ Rotation.from_rotvec(axis * delta[:, None]).as_matrix() if count else np.zeros((0, 3, 3))
        H, g, sums = np.zeros((count, 6, 6)), np.zeros((count, 6)), np.zeros((count, 4))
        _kernels.equations_across(
            tiles, SIDE_PX, LEAST_W, prepared.known, prepared.x, prepared.grey, np.ascontiguousarray(R), turn.t, axis,
            prepared.camera, prepared.coefficients, planes, gain, offset, weights, H, g, sums, parts, residuals,
        )  # fmt: skip
        H = H + np.triu(H, 1).transpose(0, 2, 1) + _ridge(x_c, H)
        squares = sums[:, 0] * (gain * px_per_rad) ** 2
        if iteration == _ITERATIONS:
            inflation = by_correlation(parts, residuals)
            left = sums[:, 1] / np.maximum(sums[:, 0] - 6 * inflation, sums[:, 0] / 2 + 1)
            _, variance, share = noise.leave(H.copy(), squares, noise.of_2_in_residuals(gain) * left)
            variance = variance * left * inflation
        H = noise.leave(H, squares, noise.of_2**2)[0]
        if iteration == _ITERATIONS:
            break
        weights = np.ascontiguousarray(np.linalg.inv(H)[:, 0]) if count else weights
        step = np.linalg.solve(H, g[..., None])[..., 0]
        delta = delta + np.clip(step[:, 0], -0.02, 0.02)
        planes = planes + step[:, 1:4]
        gain, offset = np.clip(gain + step[:, 4], 0.1, 10.0), offset + step[:, 5]
    y = normalise(x_c - np.sum(planes * x_c, axis=1, keepdims=True) * turn.t)
    across = Across(
        tiles=tiles,
        x_1=x_c,
        planes=planes,
        delta=delta,
        sigma=np.sqrt(variance),
        px_per_rad=pixels_per_radian(sensors[1], turn, y, n),
        aside=-np.sum(np.linalg.solve(H[:, 1:, 1:], H[:, 1:, :1])[:, :3, 0] * x_c, axis=1),
    )
    alike = noise.correlation(sums, gain) > _CORRELATION
    alike &= (sums[:, 0] >= LEAST_SHARE * SIDE_PX**2) & (np.abs(delta) * across.px_per_rad < _MOST_PX)
    usable = alike & (across.sigma * across.px_per_rad < _MOST_SIGMA_PX)
    counts = Counts(textured=len(laid), tried=count, alike=int(alike.sum()))
    return across.at(usable), counts, float(np.median(share[alike])) if alike.any() else 1.0


def pixels_per_radian(sensor: Sensor, turn: Turn, y: Array, towards: Array) -> Array:
    """Pixels of view 2 `[n]` per radian from directions y `[n, 3]` towards unit vectors perpendicular to them `[n, 3]`,
    all in view 1's orientation.
    """
    moved = np.einsum("nij,nj->ni", jacobian(sensor, y @ turn.R.T), towards @ turn.R.T)
    return np.asarray(np.linalg.norm(moved, axis=1))


def _planes(given: Views, tiles: NDArray[np.int64], inverse_range: Array) -> tuple[NDArray[np.int64], Array]:
    """Planes `[n, 3]` through the inverse ranges of those tiles that have enough of them."""
    within = np.arange(SIDE_PX)
    rows, columns = tiles[:, 0, None, None] + within[:, None], tiles[:, 1, None, None] + within
    w = inverse_range[rows, columns].reshape(len(tiles), SIDE_PX**2)
    x = given.x[rows, columns].reshape(len(tiles), SIDE_PX**2, 3)
    known = np.isfinite(w) & np.isfinite(x[..., 0])
    enough = known.mean(axis=1) >= _LEAST_KNOWN
    w, x, known, tiles = w[enough], x[enough], known[enough], tiles[enough]
    # Where a tile shows two surfaces, the plane is that of the larger one.
    apart = np.abs(w - _median(w, known))
    known &= apart <= _OUTLYING * _median(apart, known) + 1e-6
    A, b = np.where(known[..., None], x, 0.0), np.where(known, w, 0.0)
    H = A.transpose(0, 2, 1) @ A
    ridge = 1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    planes = np.linalg.solve(H + ridge, np.sum(A * b[..., None], axis=1)[..., None])[..., 0]
    return np.ascontiguousarray(tiles), np.ascontiguousarray(planes)


def _median(values: Array, known: NDArray[np.bool_]) -> Array:
    """Median of the known values of each row `[n, 1]`; every row has some."""
    return np.asarray(np.nanmedian(np.where(known, values, np.nan), axis=1, keepdims=True))


def _ridge(x_c: Array, H: Array) -> Array:
    """A regulariser `[n, 6, 6]` that holds those unknowns of a tile which its texture does not determine."""
    b_1, b_2 = tangents_at(x_c)
    slopes = sum(np.einsum("ti,tj->tij", b, b) for b in (b_1, b_2))
    size = np.einsum("ti,tij,tj->t", x_c, H[:, 1:4, 1:4], x_c)
    ridge = np.zeros_like(H)
    ridge[:, 1:4, 1:4] = 1e-4 * size[:, None, None] * slopes + 1e-9 * size[:, None, None] * np.eye(3)
    for i in (0, 4, 5):
        ridge[:, i, i] = 1e-9 * H[:, i, i]
    return ridge + 1e-12 * np.eye(6)
