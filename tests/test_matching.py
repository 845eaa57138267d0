"""The window matcher against a plain rendering of its definition, and the paper's sub-pixel step against polyfit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from harness.geometry.epipolar import epipolar_curves, point_at
from harness.geometry.panorama import Grid, Panorama
from harness.matching.window.match import (
    Reason,
    WindowMatcher,
    costs_along_curve,
    match,
    match_whole_pixels,
)
from harness.matching.window.subpixel import parabola_minimum

GRID = Grid(width_px=60, height_px=24, z_max=0.5, z_min=-2.0)


def noise(seed, grid=GRID, valid=None, scale=1.0):
    values = np.random.default_rng(seed).normal(scale=scale, size=grid.shape).astype(np.float32)
    return Panorama(grid, values, np.ones(grid.shape, bool) if valid is None else valid)


def darker_neighbours(window):
    """For every pixel that has them all: which of the 24 neighbours are below it."""
    size = len(window) - 4
    middle = window[2:-2, 2:-2]
    return np.array(
        [window[i : i + size, j : j + size] < middle for i in range(5) for j in range(5) if (i, j) != (2, 2)]
    )


def dissimilarity(cost, a, b):
    """The four costs of two windows, as textbooks have them."""
    if cost == "census":
        return np.count_nonzero(darker_neighbours(a) != darker_neighbours(b))
    if cost == "zncc":
        return 1 - np.corrcoef(a.ravel(), b.ravel())[0, 1]
    return np.abs(a - b).sum() if cost == "sad" else ((a - b) ** 2).sum()


def by_definition(first, second, t, matcher, row, column):
    """Best sample, its neighbours' costs, or the reason why not: section 4 of the paper in plain Python."""
    grid, half = first.grid, matcher.window_px // 2
    margin = 2 if matcher.cost == "census" else 0  # its neighbours count as part of a window
    curves = epipolar_curves(
        grid, t, d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m, sampling=matcher.sampling, pitch_px=matcher.pitch_px
    )

    def window(image, i, j):
        reach = half + margin
        columns = np.arange(j - reach, j + reach + 1) % grid.width_px
        if i - reach < 0 or i + reach >= grid.height_px or not image.valid[i - reach : i + reach + 1][:, columns].all():
            return None
        return image.values[i - reach : i + reach + 1][:, columns].astype(np.float64)

    def cost(k):
        phi, z = (float(value) for value in point_at(curves, k, (row, column)))
        i = int(np.floor((grid.z_max - z) / grid.z_pitch))
        j = int(np.floor((phi + np.pi) / grid.phi_pitch)) % grid.width_px
        there = window(second, i, j)
        if there is None:
            return np.nan
        return dissimilarity(matcher.cost, window(first, row, column), there)

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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("t", "sampling", "cost"),
    [
        ((0.5, 0.0, 0.0), "phi", "sad"),
        ((0.5, 0.0, 0.0), "alpha", "ssd"),
        ((0.1, -0.5, 0.0), "phi", "zncc"),
        pytest.param((0.0, -0.5, 0.1), "alpha", "census", marks=pytest.mark.long),
        pytest.param((-0.3, 0.4, 0.1), "phi", "ssd", marks=pytest.mark.long),
        ((-0.3, 0.4, 0.1), "alpha", "zncc"),
        ((-0.3, 0.4, 0.1), "phi", "census"),
        ((0.02, 0.01, 0.5), "phi", "sad"),
        pytest.param((0.02, 0.01, 0.5), "alpha", "sad", marks=pytest.mark.long),
        ((0.02, 0.01, 0.5), "alpha", "census"),
    ],
)
def test_matcher_does_what_its_definition_says(t, sampling, cost):
    valid = np.ones(GRID.shape, bool)
    valid[15:17, 30:33] = False
    first, second = noise(7), noise(8, valid=valid)
    matcher = WindowMatcher(cost=cost, window_px=3, sampling=sampling, pitch_px=0.8, d_min_m=0.9, d_max_m=12)
    whole = match_whole_pixels(first, second, np.array(t), matcher)
    visible = set()
    for row in range(GRID.height_px):
        for column in range(0, GRID.width_px, 3):
            reason, best, around = by_definition(first, second, np.array(t), matcher, row, column)
            visible.add(reason)
            assert Reason(whole.reason[row, column]) == reason, (row, column)
            if reason == Reason.MATCHED:
                assert whole.k[row, column] == best
                # Single-precision pixels, summed in another order; 1 - ZNCC in doubles, near 1.
                np.testing.assert_allclose(whole.costs[row, column], around, rtol=1e-5, atol=1e-12)
    if abs(t[2]) < 0.2 or sampling == "alpha":  # steep curves sampled in phi hold hardly a sample
        assert {Reason.MATCHED, Reason.CURVE_LEAVES_IMAGE, Reason.WINDOW_LEAVES_IMAGE} <= visible


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


@pytest.mark.parametrize("cost", ["sad", "zncc", "census"])
def test_threads_change_nothing(cost):
    first, second = noise(12), noise(13)
    matcher = WindowMatcher(window_px=3, d_min_m=0.8, cost=cost)
    results = [match_whole_pixels(first, second, np.array([0.5, 0, 0]), matcher, threads=n) for n in (1, 2, 5)]
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].k, other.k)
        np.testing.assert_array_equal(results[0].costs, other.costs)
        np.testing.assert_array_equal(results[0].reason, other.reason)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["window", "column"])
@pytest.mark.parametrize("cost", ["sad", "ssd", "zncc", "census"])
def test_the_curve_shown_is_the_curve_searched(kind, cost):
    first, second = noise(14), noise(15)
    matcher = WindowMatcher(kind=kind, cost=cost, window_px=3, d_min_m=0.8)
    whole = match_whole_pixels(first, second, np.array([0.5, 0, 0]), matcher)
    row, column = np.argwhere(whole.reason == Reason.MATCHED)[40]
    ks, costs = costs_along_curve(first, second, whole, matcher, int(row), int(column))
    assert ks[np.argmin(costs)] == whole.k[row, column]
    assert np.min(costs) == whole.costs[row, column, matcher.neighbours]


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["sad", "ssd", "zncc", "census"])
@pytest.mark.parametrize("sampling", ["phi", "alpha"])
def test_a_cost_does_not_depend_on_the_windows_beside_it(sampling, cost):
    """Side by side windows share sums of columns; the same sums in the same order for one window alone, so no
    tolerance. The row is longer than a block of those that are matched together."""
    grid = Grid(width_px=300, height_px=16, z_max=0.5, z_min=-1.5)
    first, second = noise(16, grid), noise(17, grid)
    matcher = WindowMatcher(kind="window", sampling=sampling, cost=cost, window_px=5, d_min_m=0.8, d_max_m=6.0)
    whole = match_whole_pixels(first, second, np.array([0.4, 0.3, 0]), matcher)
    matched = np.argwhere(whole.reason == Reason.MATCHED)
    assert len(matched) > 1000
    assert np.ptp(matched[:, 1]) > 256
    for row, column in matched[::17]:
        ks, costs = costs_along_curve(first, second, whole, matcher, int(row), int(column))
        at = int(whole.k[row, column] - ks[0])
        assert np.argmin(costs) == at
        for i in range(max(at - 3, 0), min(at + 4, len(ks))):
            assert costs[i] == whole.costs[row, column, matcher.neighbours + i - at]


def with_exposure(image, gain, offset):
    return Panorama(image.grid, (image.values * gain + offset).astype(np.float32), image.valid)


@settings(deadline=None, max_examples=10)
@given(gain=st.floats(0.4, 2.5), offset=st.floats(-60, 60))
def test_gain_and_offset_change_neither_zncc_nor_census(gain, offset):
    first, second = noise(16, scale=15), noise(17, scale=15)
    for cost in ("zncc", "census"):
        matcher = WindowMatcher(cost=cost, window_px=5, d_min_m=0.9)
        before, after = (
            match_whole_pixels(first, image, np.array([0.4, 0.2, 0.05]), matcher)
            for image in (second, with_exposure(second, gain, offset))
        )
        same = (before.k == after.k) & (before.reason == Reason.MATCHED)
        assert same.sum() > 0.99 * np.count_nonzero(before.reason == Reason.MATCHED)
        # Pixels are rounded to single precision once more; two neighbours within that of each other may change order.
        tolerance = {"zncc": 1e-5, "census": 1}[cost]
        np.testing.assert_allclose(before.costs[same], after.costs[same], atol=tolerance)


@pytest.mark.slow
@settings(deadline=None, max_examples=10)
@given(gain=st.sampled_from([0.5, 1.0, 2.0]), offset=st.integers(-480, 480))
def test_gain_and_offset_change_no_census_of_columns_and_hardly_a_zncc(gain, offset):
    """Pixels are counted in eighths: with whole grey levels and these gains and offsets all of them stay whole."""
    first, second = (
        Panorama(GRID, np.round(image.values), image.valid) for image in (noise(16, scale=15), noise(17, scale=15))
    )
    other = with_exposure(second, gain, offset / 8)
    # A place between two rows is rounded to an eighth: with half the contrast, by 0.5 % RMS of a standard deviation.
    for cost, share, tolerance in (("census", 1, 0), ("zncc", 0.99, 0.01)):
        matcher = WindowMatcher(kind="column", cost=cost, window_px=5, d_min_m=0.9)
        before, after = (
            match_whole_pixels(first, image, np.array([0.4, 0.2, 0.05]), matcher) for image in (second, other)
        )
        same = (before.k == after.k) & (before.reason == Reason.MATCHED)
        assert same.sum() >= share * np.count_nonzero(before.reason == Reason.MATCHED)
        np.testing.assert_allclose(before.costs[same], after.costs[same], rtol=0, atol=tolerance)


@pytest.mark.parametrize("kind", ["window", "column"])
def test_a_window_without_contrast_is_correlated_with_nothing(kind):
    flat = Panorama(GRID, np.full(GRID.shape, 100.3, np.float32), np.ones(GRID.shape, bool))
    matcher = WindowMatcher(kind=kind, cost="zncc", window_px=3, d_min_m=0.9)
    for pair in ((flat, noise(1)), (noise(1), flat), (flat, flat)):
        whole = match_whole_pixels(*pair, np.array([0.4, 0.2, 0.05]), matcher)
        matched = whole.reason == Reason.MATCHED
        assert matched.any()
        assert np.nanmin(whole.costs[matched]) == np.nanmax(whole.costs[matched]) == 1
        assert np.all(whole.k[matched] == whole.curves.k_first[matched])  # a tie goes to the sample nearer to infinity
        assert np.all(match(whole, matcher).confidence[matched] == 0)


def test_a_window_that_does_not_fit_is_not_matched():
    for kind in ("window", "column"):
        for cost in ("sad", "zncc", "census"):
            matcher = WindowMatcher(kind=kind, cost=cost, window_px=41, d_min_m=0.9)
            whole = match_whole_pixels(noise(1), noise(2), np.array([0.4, 0.2, 0.05]), matcher)
            assert set(whole.reason.ravel()) == {Reason.WINDOW_LEAVES_IMAGE}
            assert np.isnan(whole.costs).all()


@pytest.mark.parametrize("kind", ["window", "column"])
def test_confidence_is_the_contrast_of_the_minimum(kind):
    matcher = WindowMatcher(kind=kind, window_px=3, d_min_m=0.8, subpixel="none")
    valid = np.ones(GRID.shape, bool)
    valid[9:11, 20:40] = False  # some minima have one neighbour only, or none
    whole = match_whole_pixels(noise(18), noise(19, valid=valid), np.array([0.5, 0.1, 0]), matcher)
    confidence = match(whole, matcher).confidence
    matched = whole.reason == Reason.MATCHED
    assert np.isnan(confidence[~matched]).all()
    neighbours, visible = whole.costs[..., [2, 4]], set()
    for place in map(tuple, np.argwhere(matched)):
        beside = neighbours[place][np.isfinite(neighbours[place])]
        visible.add(beside.size)
        expected = 1 - whole.costs[(*place, 3)] / beside.mean() if beside.size else 0
        assert confidence[place] == pytest.approx(np.clip(expected, 0, 1), abs=1e-12)
    assert {1, 2} <= visible


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
        ({"pitch_px": 0}, "greater than"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        WindowMatcher(**wrong)
