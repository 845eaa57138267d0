"""Epipolar curves against points whose projections are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from harness.geometry.angles import angle_between, cylinder_point, normalise, wrap_angle
from harness.geometry.epipolar import alpha_1, alpha_2_at, angular_step, epipolar_curves, point_at
from harness.geometry.panorama import Grid, cylinder
from harness.geometry.pose import Motion
from harness.geometry.triangulation import exact_alpha_2, points, triangulate

SMALL = Grid(width_px=16, height_px=3, z_max=0.7, z_min=-1.1)
INFINITE = {"d_min_m": 0.01, "d_max_m": np.inf}


def random_motions(count, seed):
    """General motions: any rotation, any direction of translation; every fifth one exactly vertical."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        t = rng.normal(size=3) if i % 5 else np.array([0, 0, rng.choice([-1.0, 1.0])])
        yield rng, Motion(Rotation.random(rng=rng).as_matrix(), t / np.linalg.norm(t) * rng.uniform(0.05, 2))


@pytest.mark.long
@pytest.mark.slow
def test_true_correspondences_lie_on_the_curve_and_give_the_true_range():
    """10^4 random motions, 48 points each, through both ways of sampling."""
    worst = {"plane": 0.0, "alpha": 0.0, "phi": 0.0, "range": 0.0, "range_2": 0.0}
    x = normalise(cylinder(SMALL))
    for rng, motion in random_motions(10_000, seed=6):
        t = motion.t_v1
        d_1 = rng.uniform(0.5, 20, SMALL.shape)
        p_v1 = points(x, d_1)
        p_v2 = motion.apply(p_v1)
        # What view 2 sees, turned back into v1's orientation as the unwrapping does.
        x_2 = normalise(p_v2) @ motion.R_v2_from_v1
        curves = epipolar_curves(SMALL, t, **INFINITE, sampling="alpha")
        worst["plane"] = max(worst["plane"], np.abs(np.sum(curves.n * x_2, axis=-1)).max())
        alpha_2 = angle_between(x_2, t)
        phi, z = point_at(curves, (alpha_2 - curves.alpha_1) / curves.step)
        on_curve = normalise(cylinder_point(phi, z))
        steep = np.hypot(x_2[..., 0], x_2[..., 1]) < 1e-3  # the cylinder has no point straight up or down
        worst["alpha"] = max(worst["alpha"], np.abs(on_curve - x_2)[~steep].max())
        estimated_1, estimated_2 = triangulate(curves.alpha_1, alpha_2, motion.baseline_m)
        # Where the rays are nearly parallel to t or to each other, the law amplifies the angles' rounding (1e-16).
        d_2 = np.linalg.norm(p_v2, axis=-1)
        fair = d_2**2 / (motion.baseline_m * np.sin(curves.alpha_1) * d_1) < 1e5
        worst["range"] = max(worst["range"], np.abs(estimated_1 / d_1 - 1)[fair].max())
        worst["range_2"] = max(worst["range_2"], np.abs(estimated_2 / d_2 - 1)[fair & (np.sin(alpha_2) > 1e-3)].max())
        if t[0] or t[1]:
            curves = epipolar_curves(SMALL, t, **INFINITE, sampling="phi")
            phi_2 = np.arctan2(x_2[..., 1], x_2[..., 0])
            k = wrap_angle(phi_2 - SMALL.phi) / curves.step
            _, z_2 = point_at(curves, k)
            fair = (np.abs(curves.n[..., 2]) > 1e-3) & ~steep
            error = np.abs(z_2 * np.hypot(x_2[..., 0], x_2[..., 1]) - x_2[..., 2])
            worst["phi"] = max(worst["phi"], error[fair].max())
            alpha_error = np.abs(alpha_2_at(curves, k) - alpha_2)
            worst["phi"] = max(worst["phi"], alpha_error[fair].max())
    # Double precision (1e-16) over a chain of a dozen operations, amplified by at most 1e3 (1/n_z, steepness) or by the
    # law, 1e5: nine digits are left.
    assert worst["plane"] < 1e-9
    assert worst["alpha"] < 1e-9
    assert worst["phi"] < 1e-9
    assert worst["range"] < 1e-9
    assert worst["range_2"] < 1e-9


@pytest.mark.slow
@settings(deadline=None)
@given(
    t=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda t: np.linalg.norm(t) > 0.05),
    d_min=st.floats(0.3, 2),
    d_max=st.one_of(st.floats(3, 50), st.just(np.inf)),
    sampling=st.sampled_from(["phi", "alpha"]),
    pitch=st.sampled_from([0.25, 1.0, 2.0]),
)
def test_the_interval_holds_exactly_the_samples_between_d_min_and_d_max(t, d_min, d_max, sampling, pitch):
    curves = epipolar_curves(SMALL, t, d_min_m=d_min, d_max_m=d_max, sampling=sampling, pitch_px=pitch)
    some = curves.defined & (np.abs(curves.n[..., 2]) > 1e-3) & (np.sin(curves.alpha_1) > 1e-3)
    baseline = np.linalg.norm(t)
    for k, inside in (
        (curves.k_first, True),
        (curves.k_last, True),
        (curves.k_first - 1, False),
        (curves.k_last + 1, False),
    ):
        asked = some & (curves.k_last >= curves.k_first) & (k >= 0)
        alpha_2 = alpha_2_at(curves, k)
        # A sample past the epipole comes round on the other side: it is no point in front of both views any more.
        asked &= (alpha_2 > curves.alpha_1) | (k == 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(k == 0, np.inf, triangulate(curves.alpha_1, alpha_2, baseline)[0])
        within = (distance >= d_min * (1 - 1e-4)) & (distance <= d_max * (1 + 1e-4))
        if inside:
            assert within[asked].all()
        else:
            strictly = (distance > d_min * (1 + 1e-4)) & (distance < d_max * (1 - 1e-4))
            assert not strictly[asked].any()


@pytest.mark.parametrize("t", [(0.5, 0, 0), (0.3, -0.4, 0.2), (-0.1, 0.2, 0.5)])
@pytest.mark.parametrize("sampling", ["phi", "alpha"])
def test_angular_step_is_the_numeric_derivative_of_alpha_2(t, sampling):
    curves = epipolar_curves(SMALL, t, **INFINITE, sampling=sampling)
    k = np.full(SMALL.shape, 0.7)
    h = 1e-5
    numeric = (alpha_2_at(curves, k + h) - alpha_2_at(curves, k - h)) / (2 * h)
    fair = np.abs(curves.n[..., 2]) > 0.05
    assert fair.mean() > 0.8
    analytic = angular_step(curves, alpha_2_at(curves, k))
    # Central differences of step 1e-5: 1e-10 of truncation and 1e-11 of rounding, times 1/n_z² where steep.
    np.testing.assert_allclose(np.abs(numeric)[fair], analytic[fair], rtol=1e-6)


def test_the_derotated_map_is_affine_in_z():
    """An independent form of the curve: z_2 = g z_1 + h, the same for a whole column."""
    t = np.array([0.3, -0.45, 0.2])
    grid = Grid(width_px=40, height_px=20, z_max=0.4, z_min=-1.2)
    curves = epipolar_curves(grid, t, **INFINITE)
    k = np.full(grid.shape, 1.6)
    phi_2, z_2 = point_at(curves, k)
    phi_1, z_1 = grid.phi[None, :], grid.z[:, None]
    below = t[0] * np.sin(phi_1) - t[1] * np.cos(phi_1)
    g = (t[0] * np.sin(phi_2) - t[1] * np.cos(phi_2)) / below
    h = t[2] * np.sin(phi_1 - phi_2) / below
    np.testing.assert_allclose(z_2, g * z_1 + h, rtol=1e-9, atol=1e-9)  # rounding, amplified by 1/n_z


def test_vertical_translation_is_for_alpha_alone():
    t = (0.0, 0.0, 0.5)
    assert not epipolar_curves(SMALL, t, **INFINITE, sampling="phi").defined.any()
    assert epipolar_curves(SMALL, t, **INFINITE, sampling="alpha").defined.all()


def test_a_pixel_that_looks_along_the_baseline_has_no_plane():
    grid = Grid(width_px=16, height_px=3, z_max=0.5, z_min=-0.5)
    t = 0.5 * cylinder_point(grid.phi[5], 0.0)
    curves = epipolar_curves(grid, t, d_min_m=1, d_max_m=10, sampling="alpha")
    assert not curves.defined[1, 5]
    assert curves.k_last[1, 5] < curves.k_first[1, 5]


def test_alpha_1_is_eq_5():
    t = np.array([0.4, 0.1, -0.2])
    x = cylinder(SMALL)
    by_paper = np.arccos(x @ t / (np.linalg.norm(x, axis=-1) * np.linalg.norm(t)))
    np.testing.assert_allclose(alpha_1(SMALL, t), by_paper, atol=1e-12)  # arccos away from its ends


def test_zero_baseline_is_refused():
    with pytest.raises(ValueError, match="baseline"):
        epipolar_curves(SMALL, (0, 0, 0), **INFINITE)


def test_alpha_2_of_points_is_measured_in_the_first_views_orientation():
    p = np.array([[1.0, 2.0, -0.5]])
    t = np.array([0.5, 0, 0])
    assert exact_alpha_2(p, t)[0] == pytest.approx(np.arctan2(np.hypot(2.0, 0.5), 0.5), abs=1e-15)
