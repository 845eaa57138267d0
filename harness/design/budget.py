"""The error budget of a rig: the standard deviation of the range by cause, point by point."""

from dataclasses import dataclass

import numpy as np

from harness.camera.sensor import in_field, jacobian, pixels_per_steradian
from harness.design.gradients import aliased_grey, gradient_grey
from harness.design.rig import RigDesign
from harness.display import OneLine
from harness.evaluation.propagation import propagated, sensitivities
from harness.evaluation.rig_uncertainty import covariances
from harness.geometry.angles import Array, angle_between, normalise
from harness.geometry.triangulation import exact_alpha_2, sensitivity_to_alpha_2
from harness.simulation.chip import grey_variance

CAUSES = ("noise", "matching", "rotation", "t direction", "t length", "odometry", "calibration", "alignment")
"""Causes of range errors: noise of the images, fixed errors of the matcher, and wrong calibration of the rig."""

_GREY = 110.0
"""The grey level at which a chip's noise is taken."""
_OF_NOISE, _OF_ALIASING = 1.35, 1.1
"""Ratio of measured errors to those that the texture's mean gradients give: slant, gain and offset are estimated,
too, texture is uneven, and some windows reach around corners. From rendered rooms of four textures; see
`benchmarks/design.py`."""


@dataclass(frozen=True, eq=False, repr=False)
class Budget(OneLine):
    """Standard deviations of the range at points."""

    points_m: Array
    """`[..., 3]`, in view 1's frame."""
    sigma_m: dict[str, Array]
    """Standard deviations by cause, `[...]`, metres; infinite where a view does not see the point."""

    @property
    def total_m(self) -> Array:
        """All causes together, which are independent."""
        return np.asarray(np.sqrt(sum(each**2 for each in self.sigma_m.values())))

    @property
    def leading(self) -> str:
        """The cause with the largest share of the summed variance; of points that both views see."""
        known = np.isfinite(self.total_m)
        shares = {name: float(np.sum(np.where(known, each, 0.0) ** 2)) for name, each in self.sigma_m.items()}
        return max(shares, key=lambda name: shares[name])


def budget(rig: RigDesign, points_m: Array, normals: Array | None = None) -> Budget:
    """The standard deviations of the range that a rig has at points, by cause.

    Parameters
    ----------
    points_m
        `[..., 3]`, in view 1's frame.
    normals
        `[..., 3]`: of the surface there; where None it faces view 1.
    """
    believed = rig.believed
    visible = in_field(rig.sensor, points_m) & in_field(rig.sensor, believed.motion.apply(points_m))
    noise, fixed = _matching(rig, points_m, normals)
    sigma = {"noise": noise, "matching": fixed}
    for cause, parameters, covariance in covariances(rig.sensor, rig.uncertainty, believed.motion):
        if covariance.any():
            sigma[cause] = propagated(sensitivities(points_m, believed, parameters, normals), covariance)
        else:
            sigma[cause] = np.zeros(points_m.shape[:-1])
    return Budget(points_m, {name: np.where(visible & np.isfinite(each), each, np.inf) for name, each in sigma.items()})


def _matching(rig: RigDesign, points_m: Array, normals: Array | None) -> tuple[Array, Array]:
    """Standard deviation of the range by the images' noise, and by the matcher's errors without noise.

    Of a texture of gradient g_k in view k, seen by n_k pixels of a window, a shift is known to sigma/(g_k sqrt(n_k))
    pixels there (the bound, `harness.evaluation.bound`, for a window whose gradients are the texture's RMS). Both
    views' add up; the law takes the angle to the range. What is aliased acts as noise does.
    """
    motion = rig.believed.motion
    variance = _noise_variance(rig)
    views = [points_m, motion.apply(points_m)]
    facing = points_m if normals is None else normals
    ranges = [np.linalg.norm(each, axis=-1) for each in views]
    window_m2, along = np.ones(ranges[0].shape), np.ones(ranges[0].shape)
    noise, aliased = np.zeros(ranges[0].shape), np.zeros(ranges[0].shape)
    for view, (points, t) in enumerate(zip(views, (motion.t_v1, motion.R_v2_from_v1 @ motion.t_v1), strict=True)):
        texture = _visible_texture(rig, points, facing if view == 0 else facing @ motion.R_v2_from_v1.T)
        if view == 0:
            window_m2 = rig.window_px**2 / texture.per_m2
        along = _along_epipolar(rig, points, t)
        # A shift in view 1 has another angle in view 2: the same length on the surface.
        of_shift = 1 / (texture.gradient_grey**2 * window_m2 * texture.per_m2) / along**2
        of_shift = of_shift if view else of_shift * (ranges[0] / ranges[1]) ** 2
        noise = noise + variance * of_shift
        aliased = aliased + texture.aliased_grey**2 * of_shift
    alpha_1 = angle_between(points_m, motion.t_v1)
    law = np.abs(sensitivity_to_alpha_2(alpha_1, exact_alpha_2(points_m, motion.t_v1), motion.baseline_m))
    fixed = np.hypot(_OF_ALIASING * np.sqrt(aliased), rig.fixed_error_px / along)
    return law * _OF_NOISE * np.sqrt(noise), law * fixed


def pixel_sigma(rig: RigDesign, points_m: Array) -> Array:
    """Standard deviation of where in image 1 a point is, in each of the image's directions, pixels `[...]`.

    View 1's share of a match's: what noise, aliasing and the matcher's fixed errors leave of a window's place, on a
    surface that faces view 1.
    """
    texture = _visible_texture(rig, points_m, points_m)
    of_grey = _OF_NOISE**2 * _noise_variance(rig) + (_OF_ALIASING * texture.aliased_grey) ** 2
    return np.asarray(np.sqrt(of_grey / (texture.gradient_grey * rig.window_px) ** 2 + rig.fixed_error_px**2))


@dataclass(frozen=True, eq=False)
class _VisibleTexture:
    """The texture as the pixels of a view show it at points, `[...]` each."""

    per_m2: Array
    """Pixels per square metre of the surface."""
    gradient_grey: Array
    """Gradient, grey levels per pixel, RMS."""
    aliased_grey: Array
    """Contrast above the pixels' Nyquist frequency, grey levels, RMS."""


def _visible_texture(rig: RigDesign, points_m: Array, normals: Array) -> _VisibleTexture:
    """The texture at points, points and normals in the view's own frame."""
    slant = np.maximum(np.abs(np.sum(normalise(normals) * normalise(points_m), axis=-1)), 0.02)
    density = pixels_per_steradian(rig.sensor, normalise(points_m))
    side_m = np.linalg.norm(points_m, axis=-1) / np.sqrt(density)  # of a pixel, across the ray
    per_m2 = slant / side_m**2
    gradient = gradient_grey(rig.texture, 1 / np.sqrt(per_m2))
    return _VisibleTexture(per_m2, gradient, aliased_grey(rig.texture, side_m / slant))


def _noise_variance(rig: RigDesign) -> float:
    """Grey levels squared."""
    return float(grey_variance(np.full((1, 1), _GREY, dtype=np.float32), rig.chip, rig.noise_grey)[0, 0])


def _along_epipolar(rig: RigDesign, points_m: Array, t: Array) -> Array:
    """Pixels per radian of the angle to t."""
    x = normalise(points_m)
    along = normalise(np.sum(x * t, axis=-1, keepdims=True) * x - t)
    return np.asarray(np.linalg.norm(np.einsum("...ij,...j->...i", jacobian(rig.sensor, x), along), axis=-1))


# --- What a rig is asked ------------------------------------------------------------------------------------------

FAR_FROM_T = 0.5
"""The least sine of the angle to t of directions that count: the paper leaves out 30 degrees around the baseline."""


def directions_of(rig: RigDesign, elevations_deg: tuple[float, ...] = (-20.0, -10.0, 0.0, 10.0)) -> Array:
    """`[n, 3]`: directions around the rig, as many as it sees, without those near t."""
    elevation, azimuth = np.meshgrid(np.radians(elevations_deg), np.radians(np.arange(-180, 180, 5)))
    x = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    sine = np.linalg.norm(np.cross(x, normalise(rig.believed.motion.t_v1)), axis=-1)
    return x[in_field(rig.sensor, x) & (sine >= FAR_FROM_T)]
