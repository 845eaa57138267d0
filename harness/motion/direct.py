"""Direct alignment: the motion is fitted to the grey levels, together with a plane, gain and offset for each tile.

The cost is the sum over tiles of `(I_1(x) - a I_2(R (x - (m·x) t)) - b)²`, weighted by the residual variance of each
tile. The five unknowns of a tile (m, a, b) are eliminated (Schur complement), which leaves the five of the motion.

View 2's gradient contains noise. It scatters the motion, most where gradients run along the epipolar curves and leave
little for the motion: noisy images are smoothed, the noisier the more, and tiles are weighted by their share of signal
as well. And the sum of its squares exceeds the signal's:
steps are slightly too short, and a covariance from that sum is too small. The sandwich estimator subtracts the gradient
noise: the covariance is `B^-1 (sum w² g g^T) B^-1`, with
`B = sum w (H - sigma² kappa N)`, reduced, and the tiles' reduced scores g.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor
from harness.camera.spline_noise import noise_after_blur
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.motion import _direct_kernels as _kernels
from harness.motion.features import Correspondences
from harness.motion.residuals import Turn
from harness.motion.sparse import Fit, Freedom, moved, tangents
from harness.motion.tiles import (
    LEAST_SHARE,
    LEAST_W,
    SIDE_PX,
    Image,
    Views,
    best_planes,
    first_planes,
    lay_tiles,
    planes_beside,
    tangents_at,
    views,
)

BLURS_PX = (0.5, 0.7, 1.0)
NOISY = 0.1
"""Share of noise in the squared gradients above which images are smoothed."""
STILL_NOISY = 0.3
"""Share of noise above which smoothed images are smoothed more: a smaller share costs less than lost texture. The
share decides, not the covariances, whose least is the one that is too small by chance."""
_START_ITERATIONS = 3
_ITERATIONS = 8
_CORRELATION = 0.5
"""Least correlation of the two views on a tile."""
_LEAST_TILES = 10
_LEAST_SHARE = 0.05
"""Least share of signal in a tile's equations: it is a difference of noisy numbers."""
_FLOOR = 0.05
"""Variance of rounding and interpolation, grey levels squared, added to that of every tile."""


@dataclass(frozen=True, repr=False)
class DirectFit(OneLine):
    """A motion fitted to grey levels."""

    turn: Turn
    covariance: Array
    """`[6, 6]`, as in `harness.motion.sparse.Fit`."""
    tiles: NDArray[np.int64]
    """`[T, 2]`, first row and column of the tiles that are used."""
    planes: Array
    """`[T, 3]`: the inverse range in direction x is m · x, in 1/|t|."""
    noise_grey: float
    """Median over tiles of the residual's standard deviation, grey levels."""
    noise_share: float
    """Share of noise in the squared gradients."""
    blur_px: float
    """Standard deviation, pixels, of the Gaussian with which both images were smoothed; 0 for none."""
    misfit_px: float = 0.0
    """Distance of tiles from their epipolar curves beyond their noise, pixels; see `harness.motion.misfit`."""

    @property
    def sigma_rotation(self) -> float:
        """Standard deviation of the angle by which the rotation is off, radians (root of the mean square)."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def sigma_direction(self) -> float:
        """Standard deviation of the angle by which the direction of t is off, radians."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


@dataclass
class _State:
    turn: Turn
    planes: Array
    gain: Array
    offset: Array


def fit_direct(
    images: tuple[Image, Image],
    sensors: tuple[Sensor, Sensor],
    start: Fit,
    pairs: Correspondences,
    freedom: Freedom = "free",
) -> DirectFit | None:
    """Fit a motion to both images, starting from one that is accurate to about a pixel.

    Parameters
    ----------
    pairs
        The pairs to which `start` was fitted.

    Returns
    -------
    DirectFit or None
        None when too few tiles correlate between the views.
    """
    prepared = views(images, sensors)
    tiles = lay_tiles(prepared)
    if len(tiles) < _LEAST_TILES:
        return None
    true = pairs.at(start.inlier)
    planes = first_planes(prepared, tiles, start.turn, true)
    for _ in range(2):
        state = _planes_fitted(prepared, tiles, start.turn, planes[0])
        planes = best_planes(prepared, tiles, start.turn, state.planes[:, None], planes)
        planes = best_planes(prepared, tiles, start.turn, planes_beside(tiles, planes[0]), planes)
    correlated = planes[1] > _CORRELATION
    if correlated.sum() < _LEAST_TILES:
        return None
    state = _planes_fitted(prepared, tiles[correlated], start.turn, planes[0][correlated])
    best = fitted = _adjusted(prepared, tiles[correlated], state, freedom)
    for blur_px in BLURS_PX:
        if best is None or fitted is None or fitted.noise_share < (STILL_NOISY if fitted.blur_px else NOISY):
            break
        count = len(fitted.tiles)
        begin = _State(fitted.turn, fitted.planes, np.ones(count), np.zeros(count))
        fitted = _adjusted(views(images, sensors, blur_px), fitted.tiles, begin, freedom)
        best = fitted or best
    return best


# -- Normal equations ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Equations:
    H: Array
    """`[T, 11, 11]`."""
    N: Array
    """`[T, 11, 11]`, contribution of gradient noise for pixel noise of variance 1."""
    g: Array
    """`[T, 11]`."""
    n: Array
    residual: Array
    """Variance `[T]`."""
    correlation: Array

    def at(self, where: NDArray[np.bool_]) -> "_Equations":
        """The equations of the tiles selected by an index or a mask."""
        return _Equations(*(getattr(self, name)[where] for name in ("H", "N", "g", "n", "residual", "correlation")))


def _equations(given: Views, tiles: NDArray[np.int64], state: _State) -> _Equations:
    count = len(tiles)
    H, N = np.zeros((count, 11, 11)), np.zeros((count, 9, 9))
    g, sums = np.zeros((count, 11)), np.zeros((count, 4))
    _kernels.normal_equations(
        tiles, SIDE_PX, LEAST_W, given.known, given.x, given.grey, *state.turn, given.camera, given.coefficients,
        state.planes, state.gain, state.offset, H, N, g, sums,
    )  # fmt: skip
    H, N = (a + np.triu(a, 1).transpose(0, 2, 1) for a in (H, N))
    n, square = np.maximum(sums[:, 0], 6.0), sums[:, 3] - sums[:, 2] ** 2 / np.maximum(sums[:, 0], 1.0)
    noise = np.zeros_like(H)
    value, slope = noise_after_blur(given.blur_px)
    noise[:, :9, :9] = state.gain[:, None, None] ** 2 * slope * value * N
    noise[:, 9, 9] = value**2 * sums[:, 0]
    residual = sums[:, 1] / (n - 5)
    correlation = 1 - sums[:, 1] / np.maximum(square, 1e-9)
    return _Equations(H, noise, g, sums[:, 0], residual, correlation)


def _noise_variance(equations: _Equations, gain: Array, blur_px: float) -> Array:
    """Variance of pixel noise, assumed equal in both views: a residual contains that of I_1 and of a I_2."""
    return equations.residual / (1 + gain**2 * noise_after_blur(blur_px)[0] ** 2)


def _ridge(given: Views, tiles: NDArray[np.int64], H: Array) -> Array:
    """A regulariser `[T, 5, 5]` that holds those unknowns of a tile which its texture does not determine."""
    x_c = given.x[tiles[:, 0] + SIDE_PX // 2, tiles[:, 1] + SIDE_PX // 2]
    b_1, b_2 = tangents_at(x_c)
    slopes = sum(np.einsum("ti,tj->tij", b, b) for b in (b_1, b_2))
    size = np.einsum("ti,tij,tj->t", x_c, H[:, 6:9, 6:9], x_c)
    ridge = np.zeros((len(tiles), 5, 5))
    ridge[:, :3, :3] = 1e-4 * size[:, None, None] * slopes + 1e-9 * size[:, None, None] * np.eye(3)
    ridge[:, 3, 3], ridge[:, 4, 4] = 1e-9 * H[:, 9, 9], 1e-9 * H[:, 10, 10]
    return ridge + 1e-12 * np.eye(5)


def _planes_fitted(given: Views, tiles: NDArray[np.int64], turn: Turn, planes: Array) -> _State:
    """The least-squares planes, gains and offsets for a fixed motion."""
    known = np.isfinite(planes[:, 0])
    state = _State(turn, np.where(known[:, None], planes, 0.0), np.ones(len(tiles)), np.zeros(len(tiles)))
    for _ in range(_START_ITERATIONS):
        equations = _equations(given, tiles, state)
        inner = equations.H[:, 6:, 6:] + _ridge(given, tiles, equations.H)
        _step(state, np.asarray(np.linalg.solve(inner, equations.g[:, 6:, None])[..., 0]))
    state.planes[~known] = np.nan
    return state


def _step(state: _State, change: NDArray[np.floating]) -> None:
    state.planes = state.planes + change[:, :3]
    state.gain = np.clip(state.gain + change[:, 3], 0.1, 10.0)
    state.offset = state.offset + change[:, 4]


# -- The motion ------------------------------------------------------------------------------------------------------


def _adjusted(given: Views, tiles: NDArray[np.int64], state: _State, freedom: Freedom) -> DirectFit | None:
    """The least-squares motion and planes."""
    for iteration in range(_ITERATIONS + 1):
        equations = _equations(given, tiles, state)
        usable = (equations.n >= LEAST_SHARE * SIDE_PX**2) & (equations.correlation > _CORRELATION)
        if usable.sum() < _LEAST_TILES:
            return None
        tiles, equations = tiles[usable], equations.at(usable)
        state.planes, state.gain, state.offset = state.planes[usable], state.gain[usable], state.offset[usable]
        turns, steps = tangents(state.turn, freedom)
        basis = np.vstack([turns, steps])
        reduced = _reduced(equations.H, basis, _ridge(given, tiles, equations.H))
        score = equations.g[:, :6] @ basis - np.einsum("tik,ti->tk", reduced.carried, equations.g[:, 6:])
        variance = _noise_variance(equations, state.gain, given.blur_px)[:, None, None]
        share = _signal_share(reduced, basis, variance * equations.N)
        weight = 2 * share / (1 + share) / (equations.residual + _FLOOR)
        if iteration == _ITERATIONS:
            break
        motion = np.linalg.solve(np.einsum("t,tij->ij", weight, reduced.H), weight @ score)
        left = equations.g[:, 6:] - reduced.mixed.transpose(0, 2, 1) @ motion
        state.turn = moved(state.turn, turns @ motion, steps @ motion)
        _step(state, np.asarray(np.linalg.solve(reduced.inner, left[..., None])[..., 0]))
    clean = _reduced(equations.H - variance * equations.N, basis, _ridge(given, tiles, equations.H))
    inverse = np.linalg.inv(np.einsum("t,tij->ij", weight, clean.H))
    weighted = weight[:, None] * score
    noise = np.einsum("tii->t", variance * equations.N[:, 6:9, 6:9]) / np.einsum("tii->t", equations.H[:, 6:9, 6:9])
    return DirectFit(
        turn=state.turn,
        covariance=basis @ inverse @ weighted.T @ weighted @ inverse @ basis.T,
        tiles=tiles,
        planes=state.planes,
        noise_grey=float(np.sqrt(np.median(equations.residual))),
        noise_share=float(np.median(noise)),
        blur_px=given.blur_px,
    )


def _signal_share(reduced: "_Reduced", basis: Array, noise: Array) -> Array:
    """The share `[T]` of the signal in what tiles tell of the motion, where the rest is noise of gradients.

    Tiles with gradients along the epipolar curves tell little, and that of noise. With H = A + N, of signal and noise,
    the variance of a score is in proportion to 2 A + N, since the product of two noises has half the variance of what
    they add to the squares: the best weight A/(2 A + N) is share/(1 + share).

    Parameters
    ----------
    noise
        `[T, 11, 11]`, what noise adds to H.
    """
    k = basis.shape[1]
    onto = np.concatenate([np.broadcast_to(basis, (len(noise), *basis.shape)), -reduced.carried], axis=1)
    metric = np.linalg.inv(reduced.H.sum(axis=0) + 1e-12 * np.trace(reduced.H.sum(axis=0)) * np.eye(k))
    of_noise = np.einsum("ij,tmi,tmn,tnj->t", metric, onto, noise, onto, optimize=True)
    whole = np.einsum("ij,tij->t", metric, reduced.H)
    return np.clip(1 - of_noise / np.maximum(whole, 1e-300), _LEAST_SHARE, 1.0)


@dataclass(frozen=True)
class _Reduced:
    """Normal equations of the motion, with the unknowns of each tile eliminated."""

    H: Array
    """`[T, k, k]`."""
    mixed: Array
    """`[T, k, 5]`."""
    inner: Array
    """`[T, 5, 5]`."""
    carried: Array
    """`[T, 5, k]`: inner^-1 mixed^T."""


def _reduced(H: Array, held: Array, ridge: Array) -> _Reduced:
    mixed, inner = held.T @ H[:, :6, 6:], H[:, 6:, 6:] + ridge
    carried = np.asarray(np.linalg.solve(inner, mixed.transpose(0, 2, 1)), dtype=np.float64)
    return _Reduced(held.T @ H[:, :6, :6] @ held - mixed @ carried, mixed, inner, carried)
