"""The window matcher against a plain rendering of its definition, and the sub-pixel step against polyfit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from harness.stereo.epipolar import epipolar_curves, point_at
from harness.stereo.matching.subpixel import parabola_minimum
from harness.stereo.matching.window import (
    Reason,
    WindowMatcher,
    costs_along_curve,
    match,
    match_whole_pixels,
)
from harness.stereo.panorama import Grid, Panorama

GRID = Grid(width_px=60, height_px=24, z_max=0.5, z_min=-2.0)


def noise(seed, grid=GRID, valid=None):
    values = np.random.default_rng(seed).normal(size=grid.shape).astype(np.float32)
    return Panorama(grid, values, np.ones(grid.shape, bool) if valid is None else valid)


def by_definition(first, second, t, matcher, row, column):
    """Best sample, its neighbours' costs, or the reason why not: section 4 of the paper in plain Python."""
    grid, half = first.grid, matcher.window_px // 2
    curves = epipolar_curves(
        grid, t, d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m, sampling=matcher.sampling, pitch_px=matcher.pitch_px
    )

    def window(image, i, j):
        columns = np.arange(j - half, j + half + 1) % grid.width_px
        if i - half < 0 or i + half >= grid.height_px or not image.valid[i - half : i + half + 1][:, columns].all():
            return None
        return image.values[i - half : i + half + 1][:, columns].astype(np.float64)

    def cost(k):
        phi, z = (float(value) for value in point_at(curves, k, (row, column)))
        i = int(np.floor((grid.z_max - z) / grid.z_pitch))
        j = int(np.floor((phi + np.pi) / grid.phi_pitch)) % grid.width_px
        there = window(second, i, j)
        if there is None:
            return np.nan
        difference = window(first, row, column) - there
        return np.abs(difference).sum() if matcher.cost == "sad" else (difference**2).sum()

    if window(first, row, column) is None:
        return Reason.WINDOW_LEAVES_IMAGE, None, None
    if not curves.defined[row, column]:
        return Reason.NO_EPIPOLAR_PLANE, None, None
    ks = np.arange(curves.k_first[row, column], curves.k_last[row, column] + 1)
    if not ks.size:
        return Reason.NO_SAMPLE, None, None
    costs = np.array([cost(k) for k in ks])
    # The curve between the samples, finely: its extremum has to lie in the image as well.
    fine_phi, fine_z = point_at(curves, np.linspace(ks[0], ks[-1], 4001), (row, column))
    i = np.floor((grid.z_max - fine_z) / grid.z_pitch).astype(int)
    extreme = (i == i.min()) | (i == i.max())
    j = np.floor((fine_phi + np.pi) / grid.phi_pitch).astype(int) % grid.width_px
    ends = {(int(a), int(b)) for a, b in zip(i[extreme], j[extreme], strict=True)}
    turning = np.any(np.diff(np.sign(np.diff(fine_z))) != 0)
    outside = turning and all(window(second, a, b) is None for a, b in ends)
    if np.isnan(costs).any() or outside:
        return Reason.CURVE_LEAVES_IMAGE, None, None
    best = ks[int(np.argmin(costs))]
    around = np.array([cost(best + i) for i in range(-matcher.neighbours, matcher.neighbours + 1)])
    return Reason.MATCHED, best, around


@pytest.mark.parametrize("t", [(0.5, 0.0, 0.0), (-0.3, 0.4, 0.1), (0.02, 0.01, 0.5)])
@pytest.mark.parametrize("sampling", ["phi", "alpha"])
@pytest.mark.parametrize("cost", ["sad", "ssd"])
def test_matcher_does_what_its_definition_says(t, sampling, cost):
    valid = np.ones(GRID.shape, bool)
    valid[15:17, 30:33] = False
    first, second = noise(7), noise(8, valid=valid)
    matcher = WindowMatcher(cost=cost, window_px=3, sampling=sampling, pitch_px=0.8, d_min_m=0.9, d_max_m=12)
    whole = match_whole_pixels(first, second, np.array(t), matcher)
    seen = set()
    for row in range(GRID.height_px):
        for column in range(0, GRID.width_px, 3):
            reason, best, around = by_definition(first, second, np.array(t), matcher, row, column)
            seen.add(reason)
            assert Reason(whole.reason[row, column]) == reason, (row, column)
            if reason == Reason.MATCHED:
                assert whole.k[row, column] == best
                # Single-precision pixels, summed in another order.
                np.testing.assert_allclose(whole.costs[row, column], around, rtol=1e-5)
    if abs(t[2]) < 0.2 or sampling == "alpha":  # steep curves sampled in phi hold hardly a sample
        assert {Reason.MATCHED, Reason.CURVE_LEAVES_IMAGE, Reason.WINDOW_LEAVES_IMAGE} <= seen


@pytest.mark.parametrize("sampling", ["phi", "alpha"])
def test_one_image_as_both_views_has_no_disparity(sampling):
    grid = Grid(width_px=120, height_px=40, z_max=0.4, z_min=-1.7)
    smooth = noise(9, grid)
    matcher = WindowMatcher(window_px=5, sampling=sampling, d_max_m=np.inf)
    whole = match_whole_pixels(smooth, smooth, np.array([0.5, 0, 0]), matcher)
    matched = whole.reason == Reason.MATCHED
    assert matched.mean() > 0.5
    assert np.all(whole.k[matched] == 0)
    assert np.all(whole.costs[matched][:, 3] == 0)
    pixel = match(whole, matcher.model_copy(update={"subpixel": "none"}))
    assert np.all(pixel.alpha_2[matched] == whole.curves.alpha_1[matched])


@pytest.mark.parametrize("columns", [1, 25])
def test_the_seam_is_no_border(columns):
    """Turning the world by whole columns, across the seam, turns the matches and changes none of them."""
    angle = columns * GRID.phi_pitch
    t = np.array([0.5, 0.1, 0.02])
    turned_t = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]) @ t
    first, second = noise(10), noise(11)
    matcher = WindowMatcher(window_px=5, pitch_px=1.0, d_min_m=0.8)
    straight = match(match_whole_pixels(first, second, t, matcher), matcher)
    rolled = [Panorama(GRID, np.roll(image.values, columns, axis=1), image.valid) for image in (first, second)]
    turned = match(match_whole_pixels(rolled[0], rolled[1], turned_t, matcher), matcher)
    back = np.roll(turned.alpha_2, -columns, axis=1)
    # A sample within rounding of the border between two rows may fall to the other one.
    same = np.isclose(back, straight.alpha_2, atol=1e-9, equal_nan=True)
    assert same.mean() > 0.995


def test_threads_change_nothing():
    first, second = noise(12), noise(13)
    matcher = WindowMatcher(window_px=3, d_min_m=0.8)
    results = [match_whole_pixels(first, second, np.array([0.5, 0, 0]), matcher, threads=n) for n in (1, 2, 5)]
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].k, other.k)
        np.testing.assert_array_equal(results[0].costs, other.costs)
        np.testing.assert_array_equal(results[0].reason, other.reason)


def test_the_curve_shown_is_the_curve_searched():
    first, second = noise(14), noise(15)
    matcher = WindowMatcher(window_px=3, d_min_m=0.8)
    whole = match_whole_pixels(first, second, np.array([0.5, 0, 0]), matcher)
    row, column = np.argwhere(whole.reason == Reason.MATCHED)[40]
    ks, costs = costs_along_curve(first, second, whole, matcher, int(row), int(column))
    assert ks[np.argmin(costs)] == whole.k[row, column]
    assert np.min(costs) == whole.costs[row, column, matcher.neighbours]


@settings(deadline=None)
@given(
    arrays(np.float64, (5, 7), elements=st.floats(0, 1000, width=32)),
    arrays(np.bool_, (5, 7), elements=st.booleans()),
)
def test_parabola_is_that_of_polyfit(costs, missing):
    costs = np.where(missing, np.nan, costs)
    offset, refined = parabola_minimum(costs)
    x = np.arange(-3, 4)
    for row, o, r in zip(costs, offset, refined, strict=True):
        given_ = np.isfinite(row)
        if given_.sum() < 3:
            assert not r
            continue
        a, b, _ = np.polyfit(x[given_], row[given_], 2)
        if abs(a) < 1e-3:
            continue  # a straight line to rounding: either answer is right
        least = -b / (2 * a)
        inside = a > 0 and x[given_].min() <= least <= x[given_].max()
        edge = min(abs(least - end) for end in (x[given_].min(), x[given_].max())) < 1e-6
        assert r == inside or edge
        if r and inside:
            assert o == pytest.approx(-b / (2 * a), abs=1e-6)  # polyfit's own rounding at curvatures of 1e-3
        if not r:
            assert o == 0


def test_parabola_recovers_a_parabola():
    x = np.arange(-3, 4)
    true = np.linspace(-0.5, 0.5, 11)
    offset, refined = parabola_minimum(2 + 3 * (x - true[:, None]) ** 2)
    assert refined.all()
    np.testing.assert_allclose(offset, true, atol=1e-12)


def test_equal_costs_have_no_minimum():
    costs = np.full((3, 7), 4.125)  # eighths, as the column matcher gives them: every sum is exact
    costs[1, :2], costs[2] = np.nan, 0
    offset, refined = parabola_minimum(costs)
    assert not refined.any()
    assert not offset.any()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"window_px": 8}, "odd"),
        ({"d_min_m": 5, "d_max_m": 2}, "below"),
        ({"pitch_px": 0}, "greater than 0"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        WindowMatcher(**wrong)
