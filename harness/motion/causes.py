"""Likely errors of a geometry, estimated from the offsets of matches from their epipolar curves.

To first order an error theta of rotation, direction of t or calibration moves a match across its curve by E theta, and
its inverse range by W theta. E theta is measured (`harness.motion.across`); theta is fitted with a Gaussian prior of
typical sizes, scaled by one factor lambda that maximises the likelihood of the measurements (empirical Bayes): 0 if
they are noise; otherwise it also gives the size of errors that the measurements do not determine.

Errors are assumed minus true values: with a principal point that is given 1 px too far right, theta is 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.models import Mirror
from harness.camera.reflection import points_jacobian
from harness.camera.sensor import Sensor, project
from harness.display import OneLine
from harness.geometry.angles import Array, normalise
from harness.motion.across import Across
from harness.motion.features import spreads
from harness.motion.residuals import Turn
from harness.motion.scatter import common_scatter
from harness.motion.tiles import tangents_at

FLOOR_PX = 0.01
"""Standard deviation of interpolation and of surfaces that are not planar, pixels, added to that of every tile."""
FIRST_ORDER = 0.03
"""Additional standard deviation as a share of the offset across, since effects are to first order."""
_CAUCHY = 2.385
"""Standard deviations at which a residual has half its weight."""
_LAMBDAS = np.concatenate([[0.0], np.geomspace(1e-3, 30, 60)])
_ROUNDS = 5
_ALIKE = 0.97
"""Causes that explain at least this share of the best one's gain are indistinguishable from it."""
_ENOUGH = 0.9
"""Least share that a single likely cause explains."""
_CLEAR = 0.35
"""Largest remaining share of the median distance with which an error alone is convincing: it holds for most tiles."""
_FAR_M = 10.0
"""Range of the points that a displaced mirror shifts: rays start a quarter of a millimetre off the focus for each
millimetre, which is nothing beside their turning."""
_SECTORS = 4
"""Sectors of azimuth that errors are tried on, each by those fitted to the others."""
_LEAST_UNEXPLAINED_PX = 0.05
"""What has no cause, pixels, at least: interpolation, and surfaces that are not planar, reach 0.03."""
_SIGNIFICANT = 6.0
"""Least gain in log-likelihood of a significant error."""

TYPICAL = {
    "centre u": 0.5,
    "centre v": 0.5,
    "focal length": 0.5,
    "shape": 0.5,
    "tilt u": 0.25,
    "tilt v": 0.25,
    "decentring u": 0.25,
    "decentring v": 0.25,
    "aspect": 0.25,
    "skew": 0.25,
    "mirror x": 0.25,
    "mirror y": 0.25,
    "mirror z": 0.25,
    "turn x": np.radians(0.1),
    "turn y": np.radians(0.1),
    "turn z": np.radians(0.1),
    "t aside": np.radians(1.0),
    "t up": np.radians(1.0),
}
"""Typical sizes: pixels at the image's outermost tile, millimetres by which a mirror is displaced, or radians."""
_TURNS = ("turn x", "turn y", "turn z")
_STEPS = ("t aside", "t up")
MIRROR = ("mirror x", "mirror y", "mirror z")
"""Displacements of the camera from the outer focus of a hyperboloid mirror. They shift pixels by as much as several of
the other errors together, of sizes that alone are unlikely."""
CALIBRATION = tuple(name for name in TYPICAL if name not in _TURNS + _STEPS)
CAUSES: dict[str, tuple[str, ...]] = {
    "the rotation": _TURNS,
    "the direction of t": _STEPS,
    "the centre": ("centre u", "centre v"),
    "the focal length": ("focal length",),
    "the mirror's position": MIRROR,
    "the mirror or lens": CALIBRATION,
}
"""Groups of errors that are fitted separately to find likely causes; the last one contains the three before it."""


@dataclass(frozen=True, repr=False)
class Effects(OneLine):
    """Derivatives of matches by errors: `[n, k]` for the k names."""

    names: tuple[str, ...]
    across: Array
    """Radians across."""
    w: Array
    """The same of the inverse range, 1/|t|, in the direction in which a match appears."""
    w_1: Array
    """`[n]`, the inverse ranges themselves."""
    outermost_px: float
    """Distance from the centre, pixels, at which errors are counted."""
    x: Array
    """`[n, 3]`, directions from view 1."""
    y: Array
    """`[n, 3]`, directions from view 2, in view 1's orientation."""
    planes: Array
    """`[n, 3]`: the inverse range in direction x is planes · x, in 1/|t|."""
    t: Array
    by_1: Array
    """`[n, 3, k - 5]`: derivatives of x by errors of the calibration."""
    by_2: Array
    """The same of y."""

    def true_inverse_range(self, theta: Array) -> Array:
        """Inverse ranges `[n]` in the directions x once errors theta `[k]` are undone, 1/|t|.

        From the corrected directions, since errors of ranges may be as large as the ranges; only the shifts of pixels
        are to first order.
        """
        R = Rotation.from_rotvec(theta[:3]).as_matrix()
        t = normalise(self.t - sum(a * axis for a, axis in zip(theta[3:5], directions_aside(self.t), strict=True)))
        y = self.y + (self.across @ theta)[:, None] * normalise(np.cross(self.t, self.x))  # where its match is
        x, y = normalise(self.x - self.by_1 @ theta[5:]), normalise(y - self.by_2 @ theta[5:]) @ R.T
        aside = np.cross(np.cross(t, x), t)
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
        # Angles in the epipolar plane; what is still across it is of second order.
        alpha_1, alpha_2 = (np.arctan2(np.sum(each * aside, axis=1), each @ t) for each in (x, y))
        w = np.sin(alpha_2 - alpha_1) / np.maximum(np.sin(alpha_2), 1e-6)
        return np.asarray(w + np.sum(self.planes * (self.x - x), axis=1))

    def columns(self, names: tuple[str, ...]) -> list[int]:
        """The columns of these errors, of either view."""
        return [i for i, each in enumerate(self.names) if each.removesuffix(" of view 2") in names]


def typical_sizes(names: tuple[str, ...]) -> Array:
    """`TYPICAL` of some errors."""
    return np.array([TYPICAL[each.removesuffix(" of view 2")] for each in names])


def columns_of(effects: Effects, cause: str) -> list[int]:
    """The columns of a cause's errors: of one of `CAUSES`, otherwise of all together."""
    return effects.columns(CAUSES.get(cause, tuple(TYPICAL)))


def effects_of(
    x: Array, planes: Array, sensors: tuple[Sensor, Sensor], turn: Turn, outermost_px: float | None = None
) -> Effects:
    """Derivatives of matches by errors of the geometry.

    Parameters
    ----------
    x
        `[n, 3]`, unit directions from view 1.
    planes
        `[n, 3]`: the inverse range in direction x is m · x, in 1/|t|.
    outermost_px
        Distance from the centre at which errors of the calibration are counted; that of the outermost match unless
        given.
    """
    w = np.sum(planes * x, axis=1)
    y = normalise(x - w[:, None] * turn.t)
    fields, outermost_px = _pixel_fields(sensors, x, y @ turn.R.T, outermost_px)
    (first, second) = ({name: -np.einsum("nij,nj->ni", S, shift) for name, shift in each.items()} for S, each in fields)
    by_1, by_2 = np.stack(list(first.values()), axis=2), turn.R.T @ np.stack(list(second.values()), axis=2)
    names = (*_TURNS, *_STEPS, *first)
    if sensors[0] != sensors[1]:
        names = (*names, *(f"{name} of view 2" for name in second))
        by_1, by_2 = (np.concatenate(each, axis=2) for each in ((by_1, 0 * by_2), (0 * by_1, by_2)))
    across, moved_w = _derivatives(x, y, planes, turn.t, by_1, by_2)
    return Effects(names, across, moved_w, w, outermost_px, x, y, planes, turn.t, by_1, by_2)


def _derivatives(x: Array, y: Array, planes: Array, t: Array, by_1: Array, by_2: Array) -> tuple[Array, Array]:
    """Derivatives `[n, k]` of the angle across and of the inverse range; see `Effects`."""
    n = normalise(np.cross(t, x))
    alpha_1, alpha_2 = (np.arccos(np.clip(each @ t, -1, 1)) for each in (x, y))
    sine_1, sine_2 = np.sin(alpha_1), np.sin(alpha_2)

    def moved(dx: Array, dy: Array, dt: Array) -> tuple[Array, Array]:
        across = (np.sum(np.cross(t, dx) * y, axis=1) + np.sum(np.cross(dt, x) * y, axis=1)) / sine_1
        across = across + np.sum(n * dy, axis=1)
        d_1 = -(np.sum(dt * x, axis=1) + dx @ t) / sine_1
        d_2 = -(np.sum(dt * y, axis=1) + dy @ t) / sine_2
        # w = sin(alpha_2 - alpha_1)/sin(alpha_2); the plane's inverse range in direction x + dx is larger by m · dx.
        parallax = alpha_2 - alpha_1
        w = (np.cos(parallax) * (d_2 - d_1) - np.sin(parallax) * np.cos(alpha_2) / sine_2 * d_2) / sine_2
        return across, w - np.sum(planes * dx, axis=1)

    none = np.zeros_like(x)
    moves = [moved(none, np.cross(y, axis), none) for axis in np.eye(3)]
    moves += [moved(none, none, np.broadcast_to(axis, x.shape)) for axis in directions_aside(t)]
    moves += [moved(by_1[..., i], by_2[..., i], none) for i in range(by_1.shape[2])]
    across, moved_w = zip(*moves, strict=True)
    return np.stack(across, axis=1), np.stack(moved_w, axis=1)


def directions_aside(t: Array) -> tuple[Array, Array]:
    """Two unit vectors perpendicular to t: a horizontal one, and the most upright one."""
    level = np.cross([0.0, 0.0, 1.0], t)
    if np.linalg.norm(level) < 1e-6:
        one, other = tangents_at(t[None])
        return one[0], other[0]
    level = normalise(level)
    return level, np.cross(t, level)


def _pixel_fields(
    sensors: tuple[Sensor, Sensor], x_1: Array, x_2: Array, outermost_px: float | None
) -> tuple[list[tuple[Array, dict[str, Array]]], float]:
    """For each view, derivatives of bearings by pixels `[n, 3, 2]`, and the pixels' shifts `[n, 2]` by each error; and
    the distance from the centre at which these are counted.
    """
    fields = []
    radii = [
        project(sensor, x)[0] - [sensor.camera.cx_px, sensor.camera.cy_px]
        for sensor, x in zip(sensors, (x_1, x_2), strict=True)
    ]
    outermost_px = outermost_px or max(float(np.max(np.linalg.norm(each, axis=1), initial=1.0)) for each in radii)
    for sensor, x, radius in zip(sensors, (x_1, x_2), radii, strict=True):
        q = radius / outermost_px
        u, v, square = q[:, :1], q[:, 1:], np.sum(q * q, axis=1, keepdims=True)
        one, zero = np.ones_like(u), np.zeros_like(u)
        shifts = {
            "centre u": np.hstack([one, zero]),
            "centre v": np.hstack([zero, one]),
            "focal length": q,
            "shape": q * square,
            "tilt u": q * u,
            "tilt v": q * v,
            "decentring u": np.hstack([square, zero]),
            "decentring v": np.hstack([zero, square]),
            "aspect": np.hstack([u, -v]),
            "skew": np.hstack([v, u]),
        }
        if isinstance(sensor.model, Mirror):
            by_displacement = points_jacobian(sensor, _FAR_M * x)[1]
            shifts |= {name: by_displacement[:, :, i] for i, name in enumerate(MIRROR)}
        fields.append((spreads(sensor, x), shifts))
    return fields, outermost_px


# -- The fit -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cause:
    """A single kind of error."""

    name: str
    """One of `CAUSES`, or `several errors together`."""
    explains: float
    """Share, 0 .. 1, of the gain in log-likelihood of all errors together."""
    errors: dict[str, float]
    """The most likely errors by name: pixels, or radians."""
    theta: Array
    """`[k]`, the same among all errors."""


@dataclass(frozen=True, repr=False)
class Causes(OneLine):
    """Errors of a geometry that explain the tiles' offsets across their curves."""

    effects: Effects
    theta: Array
    """`[k]`: the most likely error; 0 if none is significant."""
    covariance: Array
    """`[k, k]`: covariance of theta; 0 likewise."""
    gain: float
    """Gain in log-likelihood by theta."""
    weight: Array
    """`[n]`, 0 .. 1: robust weight of each tile."""
    sigma: Array
    """`[n]`, radians: standard deviation of the residuals of theta."""
    noise: Array
    """`[n]`, radians: the part of it that each tile's own residual predicts."""
    unexplained_px: float
    """Standard deviation, pixels of view 2, of the part that is neither noise nor an error named here; 0 where noise
    may be all."""
    alone: tuple["Cause", ...]
    """The share that each of `CAUSES` explains alone, the largest first; empty if there is no error."""

    @property
    def significant(self) -> bool:
        """Whether there is a significant error."""
        return bool(self.alone)

    @property
    def likely(self) -> tuple[Cause, ...]:
        """The most likely cause, then those that are indistinguishable from it; none without a significant error.

        If no single kind of error explains the offsets, the cause is several of them together.
        """
        if self.alone and self.alone[0].explains < _ENOUGH:
            errors = dict(zip(self.effects.names, self.theta.tolist(), strict=True))
            return (Cause("several errors together", 1.0, errors, self.theta),)
        return tuple(each for each in self.alone if each.explains > _ALIKE * self.alone[0].explains)


def fit_causes(tiles: Across, sensors: tuple[Sensor, Sensor], turn: Turn) -> Causes:
    """Fit errors of the geometry to the tiles' offsets across their curves."""
    effects = effects_of(tiles.x_1, tiles.planes, sensors, turn)
    size = typical_sizes(effects.names)
    E, e = effects.across * size, tiles.delta
    # A tile's own residual misses errors common to neighbours: sigma is scaled to the scatter about the fit.
    floor = np.hypot(FLOOR_PX / tiles.px_per_rad, FIRST_ORDER * 1.4826 * np.median(np.abs(e)) if len(e) else 0.0)
    sigma = np.hypot(tiles.sigma, floor)
    weight, factor = np.ones(len(e)), 1.0
    for _ in range(_ROUNDS):
        root = np.sqrt(weight) / (factor * sigma)
        A, b = E * root[:, None], e * root
        theta, covariance, gain = _likeliest(A, b)
        factor, weight = _weighed((e - E @ theta) / sigma)
    left = float(np.median(np.abs(e - E @ theta)) / max(np.median(np.abs(e)), 1e-300)) if len(e) else 1.0
    if gain <= _SIGNIFICANT or (left > _CLEAR and _gain_elsewhere(A, b, tiles.x_1) <= _SIGNIFICANT):
        gain, theta, covariance = 0.0, np.zeros(len(size)), np.zeros((len(size), len(size)))
        factor, weight = _weighed(e / sigma)
    return Causes(
        effects=effects,
        theta=theta * size,
        covariance=covariance * np.outer(size, size),
        gain=gain,
        weight=weight,
        sigma=factor * sigma,
        noise=sigma,
        unexplained_px=_unexplained_px((e - E @ theta) * tiles.px_per_rad, sigma * tiles.px_per_rad),
        alone=() if gain <= _SIGNIFICANT else _alone(effects, A, b, size, gain),
    )


def _likeliest(A: Array, b: Array) -> tuple[Array, Array, float]:
    """The posterior mean for the scale of the prior that maximises the likelihood of b, its covariance, and the gain.

    The covariance is for a scale of at most 1: gross errors, beyond first order, lead to scales that say nothing about
    undetermined errors.
    """
    k = A.shape[1]
    values, vectors = np.linalg.eigh(A.T @ A)
    values = np.maximum(values, 0.0)
    c = vectors.T @ (A.T @ b)
    squares = _LAMBDAS**2
    gains = np.array([0.5 * np.sum(s * c**2 / (1 + s * values) - np.log1p(s * values)) for s in squares])
    best = int(np.argmax(gains))
    s = squares[best]
    theta = vectors @ (s * c / (1 + s * values))
    s = min(s, 1.0)
    covariance = (vectors * (s / (1 + s * values))) @ vectors.T
    return np.asarray(theta), np.asarray(covariance).reshape(k, k), float(gains[best])


def _weighed(left: Array) -> tuple[float, Array]:
    """Robust standard deviation of residuals, at least 1, and their weights."""
    factor = max(1.0, float(1.4826 * np.median(np.abs(left)))) if left.size else 1.0
    return factor, np.asarray(1 / (1 + (left / (_CAUCHY * factor)) ** 2))


def _unexplained_px(left_px: Array, noise_px: Array) -> float:
    """What of the scatter of what is left, pixels, is common to all tiles, where it is worth saying."""
    unexplained_px = common_scatter(left_px, noise_px)
    return unexplained_px if unexplained_px > _LEAST_UNEXPLAINED_PX else 0.0


def _gain_elsewhere(A: Array, b: Array, x: Array) -> float:
    """The gain of errors in sectors of azimuth that they were not fitted to, summed over the sectors in turn.

    Something that moved fills one sector, and looks like an error of the geometry there alone. Lest it lies across the
    border of two, the sectors are laid twice, and the smaller gain counts.
    """
    turns = np.arctan2(x[:, 1], x[:, 0]) / (2 * np.pi) * _SECTORS
    gains = []
    for sector in (np.floor(turns) % _SECTORS, np.floor(turns + 0.5) % _SECTORS):
        parts = [sector == each for each in np.unique(sector)]
        fitted = [_likeliest(A[~here], b[~here])[0] for here in parts]
        gains.append(
            sum(
                0.5 * float(np.sum(b[here] ** 2) - np.sum((b[here] - A[here] @ theta) ** 2))
                for here, theta in zip(parts, fitted, strict=True)
            )
        )
    return min(gains)


def _alone(effects: Effects, A: Array, b: Array, size: Array, most: float) -> tuple[Cause, ...]:
    causes = []
    for name, members in CAUSES.items():
        columns = effects.columns(members)
        theta, _, gain = _likeliest(A[:, columns], b)
        errors = {effects.names[i]: float(theta[j] * size[i]) for j, i in enumerate(columns)}
        full = np.zeros(len(size))
        full[columns] = theta * size[columns]
        causes.append(Cause(name, float(np.clip(gain / most, 0, 1)), errors, full))
    # Of causes that explain equally much, the one with the fewest parameters comes first.
    return tuple(sorted(causes, key=lambda each: (-round(each.explains / (1 - _ALIKE)), len(each.errors))))
