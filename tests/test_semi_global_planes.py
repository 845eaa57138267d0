"""Planes through the matches of semi-global matching: against NumPy's least squares, and on exact planes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.geometry.epipolar import epipolar_curves
from harness.geometry.panorama import Grid, directions
from harness.geometry.triangulation import exact_alpha_2
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.semi_global.planes import fitted_to_planes
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial

GRID = Grid(width_px=72, height_px=20, z_max=0.5, z_min=-1.2)
T = np.array([0.5, 0.1, 0.0])


def curves_of(t=T, grid=GRID):
    return epipolar_curves(grid, t, d_min_m=0.6, d_max_m=np.inf, sampling="alpha")


def labels_of(m, t=T, grid=GRID):
    """Exact labels of the plane 1/d = m · x, NaN where it is not in front."""
    x, curves = directions(grid), curves_of(t, grid)
    inverse = x @ np.asarray(m)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = x / np.where(inverse > 0.05, inverse, np.nan)[..., None]
        return (exact_alpha_2(points, t) - curves.alpha_1) / curves.step


planes = st.tuples(*[st.floats(-0.4, 0.4)] * 2, st.floats(-1.0, -0.2))


@given(m=planes, t=st.tuples(st.floats(-0.5, 0.5), st.floats(0.1, 0.5), st.floats(-0.3, 0.3)))
@settings(max_examples=25, deadline=None)
def test_matches_on_a_plane_stay_where_they_are(m, t):
    """Whatever its slant: the fit is exact on planes, so only rounding is left (1e-7 of a label)."""
    k = labels_of(m, np.array(t))
    fitted = fitted_to_planes(k, curves_of(np.array(t)), 9, 1)
    known = np.isfinite(fitted)
    assert not known[~np.isfinite(k)].any()
    # Near t and -t a label hardly depends on the range: what is lost to rounding there is the inverse range.
    sideways = known & (np.sin(curves_of(np.array(t)).alpha_1) > 0.1)
    np.testing.assert_allclose(fitted[sideways], k[sideways], atol=1e-7)


@given(seed=st.integers(0, 2**32 - 1), row=st.integers(0, GRID.height_px - 1), column=st.integers(0, 71))
@settings(max_examples=25, deadline=None)
def test_it_is_weighted_least_squares(seed, row, column):
    """By NumPy, in the world's own axes; which matches count, and with what weights, is as the docstring says."""
    draws = np.random.default_rng(seed)
    curves, x = curves_of(), directions(GRID)
    k = labels_of((0.0, 0.1, -0.6)) + draws.normal(0, 0.4, GRID.shape)
    k[draws.uniform(size=GRID.shape) < 0.1] = np.nan
    k[row, column] = 5.0
    baseline, alpha_1 = np.linalg.norm(T), curves.alpha_1
    w = np.sin(k * curves.step) / (baseline * np.sin(alpha_1 + k * curves.step))
    slope = np.linalg.norm(np.cross(T, x), axis=-1) / np.linalg.norm(x - w[..., None] * T, axis=-1) ** 2
    slope /= GRID.phi_pitch
    taps = [(a, b) for a in (-4, -2, 0, 2, 4) for b in (-4, -2, 0, 2, 4) if (a + b) % 4 == 0]
    inside = [(row + a, (column + b) % 72, max(abs(a), abs(b))) for a, b in taps if 0 <= row + a < GRID.height_px]
    counted = [
        (i, j)
        for i, j, away in inside
        if abs(w[i, j] - w[row, column]) * slope[row, column] <= 1 + 0.5 * away  # False for NaN
    ]
    fitted = fitted_to_planes(k, curves, 9, 1)[row, column]
    if 2 * len(counted) < len(inside):
        assert np.isnan(fitted)
        return
    at = tuple(np.array(counted).T)
    m = np.linalg.lstsq(slope[at][:, None] * x[at], slope[at] * w[at])[0]
    expected = (exact_alpha_2(x[row, column] / (m @ x[row, column]), T) - alpha_1[row, column]) / GRID.phi_pitch
    if np.linalg.cond(slope[at][:, None] * x[at]) < 1e4:  # the matches that count may lie on a line
        assert fitted == pytest.approx(expected, abs=1e-6)


def test_a_border_stays_a_border():
    """Two walls, at 1 m and 4 m, of exact matches: those beside the border count their own side alone."""
    grid = Grid(width_px=360, height_px=20, z_max=0.3, z_min=-0.3)
    near, far = (labels_of((0.0, 1 / range_m, 0.0), grid=grid) for range_m in (1.0, 4.0))
    k = np.where(np.arange(360) < 270, near, far)  # where y is largest, nearly at right angles to t
    fitted, beside = fitted_to_planes(k, curves_of(grid=grid), 9, 1), slice(262, 278)
    assert np.abs(near - far)[:, beside].min() > 10
    np.testing.assert_allclose(fitted[:, beside], k[:, beside], atol=1e-7)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_change_nothing(threads):
    k = labels_of((0.1, 0.0, -0.5)) + np.random.default_rng(1).normal(0, 0.3, GRID.shape)
    np.testing.assert_array_equal(fitted_to_planes(k, curves_of(), 9, threads), fitted_to_planes(k, curves_of(), 9, 1))


def test_whole_labels_are_left_alone(paper):
    """Who asks for no sub-pixel step, or for no planes, gets labels, or what the sub-pixel step gives."""
    cache = StageCache()

    def k_of(**keys):
        trial = paper.experiment.trial.model_copy(update={"matching": SemiGlobal(**keys)})
        return run_trial(trial, cache).matches.k

    whole, alone, planes = k_of(subpixel="none"), k_of(plane_px=1), k_of()
    known = np.isfinite(whole)
    assert (whole[known] == np.rint(whole[known])).all()
    assert np.abs(alone - whole)[known].max() <= 0.5
    assert (np.isfinite(planes) == known).all()
    assert 0.05 < np.median(np.abs(planes - alone)[known]) < 0.2
