"""Epipolar curves on the second panorama, and the part of each that has to be searched (section 3 of the paper).

Both panoramas have v1's orientation (a known rotation is taken out while unwrapping), so only the translation t is
left. With x_1 on the cylinder and n = t × x_1, the curve is `z_2(phi) = -(n_x cos phi + n_y sin phi)/n_z`: the paper's
eq. 4 with the sign that it lost. The search runs from the direction of x_1 (a point at infinity) to that of
`d_min x_1/|x_1| - t`.

A curve is sampled at whole numbers k of steps from infinity, k = 0, either in phi (the paper's way) or in alpha_2, the
angle to t inside the epipolar plane, which also serves where the curve is steep or n_z vanishes.
"""

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.display import OneLine
from harness.geometry.angles import Array, angle_between, lengths, wrap_angle
from harness.geometry.panorama import Grid, cylinder, directions

Sampling = Literal["phi", "alpha"]

_ON_AXIS = 1e-9
"""Below this sine two directions are taken to be one: their plane is not defined to single precision."""


@dataclass(frozen=True, eq=False, repr=False)
class Curves(OneLine):
    """The epipolar curve of every pixel of a panorama, ready to be sampled. Its arrays are read-only.

    Compared by identity, so that results derived from curves can be cached with them.
    """

    grid: Grid
    sampling: Sampling
    t: Array
    """`[3]`, metres, in v1's frame."""
    step: Array
    """`[height, width]`, radians of phi (with its sign) or of alpha_2 from one sample to the next."""
    alpha_1: Array
    """`[height, width]`, radians, angle between x_1 and t (eq. 5)."""
    m: Array
    """`[height, width, 3]`, the unit vector in the epipolar plane at right angles to t, on x_1's side."""
    n: Array
    """`[height, width, 3]`, the epipolar plane's unit normal, `t × x_1` scaled."""
    k_far: Array
    k_near: Array
    """`[height, width]`, samples, fractions: where a point at d_max and one at d_min would be."""
    k_first: NDArray[np.int32]
    k_last: NDArray[np.int32]
    """`[height, width]`: the whole samples between them; none where k_last < k_first."""
    defined: NDArray[np.bool_]
    """`[height, width]`: x_1 and t span a plane and the sampling can follow its curve."""


def alpha_1(grid: Grid, t: ArrayLike) -> Array:
    """Angle between each pixel's direction and t (eq. 5), `[height, width]` radians."""
    return angle_between(cylinder(grid), t)


def epipolar_curves(
    grid: Grid, t: ArrayLike, *, d_min_m: float, d_max_m: float, sampling: Sampling = "phi", pitch_px: float = 1.0
) -> Curves:
    """The curve and the search interval of every pixel; cached, since many trials share one geometry.

    Parameters
    ----------
    t
        `[3]`, metres: viewpoint 2 seen from viewpoint 1, in v1's frame; not zero.
    d_min_m, d_max_m
        The nearest and farthest range searched, from viewpoint 1; `d_max_m` may be infinite.
    pitch_px
        Distance of samples in columns: of phi, or the same angle of alpha_2.
    """
    return _curves(grid, np.asarray(t, dtype=np.float64).tobytes(), float(d_min_m), float(d_max_m), sampling, pitch_px)


@lru_cache(maxsize=4)
def _curves(grid: Grid, t_bytes: bytes, d_min_m: float, d_max_m: float, sampling: Sampling, pitch_px: float) -> Curves:
    t = np.frombuffer(t_bytes)
    baseline = float(np.linalg.norm(t))
    if not baseline > 0:
        raise ValueError("the baseline |t| must be above zero")
    x = directions(grid)
    t_hat = t / baseline
    along = x @ t_hat
    across = x - along[..., None] * t_hat
    sine = lengths(across)
    defined = sine > _ON_AXIS
    with np.errstate(divide="ignore", invalid="ignore"):
        m = across / sine[..., None]
        n = np.cross(t_hat, x) / sine[..., None]
    pitch = pitch_px * grid.phi_pitch
    if sampling == "alpha":
        a_1 = np.arctan2(sine, along)
        step = np.full(grid.shape, pitch)
        near, far = (_alpha_2(a_1, d, baseline) - a_1 for d in (d_min_m, d_max_m))
    else:
        a_1 = np.arctan2(sine, along)
        defined &= np.abs(n[..., 2]) > _ON_AXIS
        near_signed, far_signed = (_phi_2(grid, x, t, d) for d in (d_min_m, d_max_m))
        sign = np.where(near_signed < 0, -1.0, 1.0)
        step = sign * pitch
        near, far = sign * near_signed, sign * far_signed
    # The tolerance keeps a sample that lies on the end of the interval up to rounding.
    k_far, k_near = np.nan_to_num(far / pitch) - 1e-6, np.nan_to_num(near / pitch) + 1e-6
    k_first = np.ceil(k_far).astype(np.int32)
    k_last = np.where(defined, np.floor(k_near), k_first - 1).astype(np.int32)
    curves = Curves(grid, sampling, t, step, a_1, m, n, k_far, k_near, k_first, k_last, defined)
    for field in fields(curves):
        value = getattr(curves, field.name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return curves


def forget_curves() -> None:
    """Empty the cache of `epipolar_curves`."""
    _curves.cache_clear()


def alpha_2_at(curves: Curves, k: ArrayLike, where: tuple[Any, ...] = ()) -> Array:
    """Angle alpha_2 (radians) of sample k, fractions allowed, of every pixel (or of the pixels `where` selects)."""
    k = np.asarray(k, dtype=np.float64)
    step, a_1 = curves.step[where], curves.alpha_1[where]
    if curves.sampling == "alpha":
        return np.asarray(a_1 + k * step)
    phi = np.broadcast_to(curves.grid.phi[None, :], curves.grid.shape)[where] + k * step
    c, s, m = np.cos(phi), np.sin(phi), curves.m[where]
    # On the curve w = [c, s, z] with n · w = 0. t, m and n are at right angles, so that n_z w · m = t_x s - t_y c and
    # n_z w · t = m_y c - m_x s: no z, and no division where n_z is small.
    t_x, t_y, _ = curves.t / np.linalg.norm(curves.t)
    side = np.sign(curves.n[..., 2])[where]
    alpha = np.arctan2(side * (t_x * s - t_y * c), side * (m[..., 1] * c - m[..., 0] * s))
    # Sample 0 is the direction of x_1 itself: infinity is exactly there, not within rounding of it.
    return np.where(k == 0, a_1, alpha)


def sample_at(curves: Curves, alpha_2: ArrayLike) -> Array:
    """The sample k, with its fraction, at which each pixel's curve has an angle alpha_2 `[height, width]`, radians.

    The inverse of `alpha_2_at`; NaN where alpha_2 is.
    """
    alpha_2 = np.asarray(alpha_2, dtype=np.float64)
    if curves.sampling == "alpha":
        return np.asarray((alpha_2 - curves.alpha_1) / curves.step)
    t_x, t_y, _ = curves.t / np.linalg.norm(curves.t)
    c, s = np.cos(alpha_2), np.sin(alpha_2)
    phi = np.arctan2(c * t_y + s * curves.m[..., 1], c * t_x + s * curves.m[..., 0])
    return np.asarray(wrap_angle(phi - curves.grid.phi[None, :]) / curves.step)


def point_at(curves: Curves, k: ArrayLike, where: tuple[Any, ...] = ()) -> tuple[Array, Array]:
    """(phi_2, z_2) of sample k, fractions allowed, of every pixel (or of the pixels `where` selects)."""
    k = np.asarray(k, dtype=np.float64)
    if curves.sampling == "phi":
        phi = np.broadcast_to(curves.grid.phi[None, :], curves.grid.shape)[where] + k * curves.step[where]
        n = curves.n[where]
        with np.errstate(divide="ignore", invalid="ignore"):
            return wrap_angle(phi), -(n[..., 0] * np.cos(phi) + n[..., 1] * np.sin(phi)) / n[..., 2]
    alpha = curves.alpha_1[where] + k * curves.step[where]
    t_hat = curves.t / np.linalg.norm(curves.t)
    direction = np.cos(alpha)[..., None] * t_hat + np.sin(alpha)[..., None] * curves.m[where]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = direction[..., 2] / np.hypot(direction[..., 0], direction[..., 1])
    return np.arctan2(direction[..., 1], direction[..., 0]), z


def angular_step(curves: Curves, alpha_2: ArrayLike) -> Array:
    """Distance in alpha_2 (radians) of neighbouring samples around a given alpha_2 on the curve, `[height, width]`.

    Along w(phi) = [cos phi, sin phi, z_2(phi)] the angle grows by |w × w'|/|w|². That cross product lies along n and
    has the z component 1, so `d alpha_2/d phi = 1/(|n_z| |w|²) = (1 - u_z²)/|n_z|` with u = w/|w|.
    """
    alpha_2 = np.asarray(alpha_2, dtype=np.float64)
    if curves.sampling == "alpha":
        return np.abs(curves.step)
    t_z = curves.t[2] / np.linalg.norm(curves.t)
    u_z = np.cos(alpha_2) * t_z + np.sin(alpha_2) * curves.m[..., 2]
    with np.errstate(divide="ignore"):
        return np.asarray(np.abs(curves.step) * (1 - u_z**2) / np.abs(curves.n[..., 2]))


def _alpha_2(a_1: Array, d_1: float, baseline: float) -> Array:
    """alpha_2 of a point at range d_1 seen under alpha_1."""
    if np.isinf(d_1):
        return a_1
    return np.arctan2(d_1 * np.sin(a_1), d_1 * np.cos(a_1) - baseline)


def _phi_2(grid: Grid, x: Array, t: Array, d_1: float) -> Array:
    """phi_2 - phi_1 of a point at range d_1 along the unit directions x, in [-pi, pi)."""
    if np.isinf(d_1):
        return np.zeros(grid.shape)
    p_x, p_y = (d_1 * x[..., i] - t[i] for i in (0, 1))
    return wrap_angle(np.arctan2(p_y, p_x) - grid.phi[None, :])
