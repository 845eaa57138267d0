"""Windows whose columns follow the epipolar map: against a plain rendering of their definition, exactly."""

import numpy as np
import pytest
from bounds import check_all

from harness.geometry.angles import wrap_angle
from harness.geometry.epipolar import epipolar_curves, point_at
from harness.geometry.panorama import Grid, Panorama
from harness.matching.window.column import PER_GREY, costs_of_half_samples
from harness.matching.window.match import Reason, WindowMatcher, costs_along_curve, match, match_whole_pixels
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial

GRID = Grid(width_px=60, height_px=24, z_max=0.5, z_min=-2.0)


def noise(seed, grid=GRID, valid=None):
    values = np.random.default_rng(seed).normal(scale=30, size=grid.shape).astype(np.float32)
    return Panorama(grid, values, np.ones(grid.shape, bool) if valid is None else valid)


def columns_of(image, parts):
    """Pixels in eighths `[height, width parts]`, linear between columns, and which are there."""
    weight = np.arange(parts) / parts
    beside = [np.roll(a, -1, axis=1)[..., None] for a in (image.values, image.valid)]
    between = image.values[..., None] * (1 - weight) + beside[0] * weight
    there = image.valid[..., None] & (beside[1] | (weight == 0))
    pixels = np.rint(PER_GREY * between.reshape(len(between), -1)).astype(int)
    return pixels, there.reshape(len(there), -1)


def darker_neighbours(pixels, valid, parts):
    """Which of the 24 neighbours are below a pixel, as a tuple of truth values; None where one is missing."""
    answer = np.full(pixels.shape, None, dtype=object)
    height, width = pixels.shape
    places = [(i, j * parts) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)]
    for row in range(2, height - 2):
        for column in range(width):
            around = [(row + i, (column + j) % width) for i, j in places]
            if valid[row, column] and all(valid[place] for place in around):
                answer[row, column] = tuple(pixels[place] < pixels[row, column] for place in around)
    return answer


def pairs(first, second, t, parts, k, cost):
    """What each pixel of view 1 is compared with where sample k puts it, in eighths, as a pair; None for none.

    The epipolar map of a column as in the project's notes: z_2 = g z_1 + h, from the azimuths of both columns.
    """
    grid, (height, width) = first.grid, first.grid.shape
    own, own_valid = columns_of(first, 1)
    pixels, valid = columns_of(second, parts)
    if cost == "census":
        own_bits, bits = darker_neighbours(own, own_valid, 1), darker_neighbours(pixels, valid, parts)
    answer = {}
    for j in range(width):
        phi_1 = grid.phi[j]
        to_t = t[0] * np.sin(phi_1) - t[1] * np.cos(phi_1)
        sign = 1 if to_t > 0 else -1
        shift = sign * k * grid.phi_pitch / parts
        from_t = np.abs(wrap_angle(phi_1 - np.arctan2(t[1], t[0]))) + sign * shift
        g = (t[0] * np.sin(phi_1 + shift) - t[1] * np.cos(phi_1 + shift)) / to_t
        h = t[2] * np.sin(-shift) / to_t
        # Rows of view 2 in parts of 2^-16, as whole numbers.
        gain = round(g * 2**16)
        offset = round((((1 - g) * grid.z_max - h) / grid.z_pitch + (g - 1) / 2) * 2**16)
        column = round(j * parts + sign * k) % (width * parts)
        for i in range(height):
            position = gain * i + offset
            row, fraction = position >> 16, (position >> 8) & 255
            answer[i, j] = None
            if not (0 < from_t < np.pi and 0 <= position <= (height - 1) << 16 and own_valid[i, j]):
                continue
            if cost == "census":
                row = (position + (1 << 15)) >> 16
                if own_bits[i, j] is not None and bits[row, column] is not None:
                    answer[i, j] = own_bits[i, j], bits[row, column]
                continue
            below = min(row + 1, height - 1)
            if valid[row, column] and valid[below, column]:
                step = pixels[below, column] - pixels[row, column]
                answer[i, j] = own[i, j], pixels[row, column] + ((step * fraction + 128) >> 8)
    return answer


def window_at(i, j, half, width):
    """The places of a window, around the seam."""
    for row in range(i - half, i + half + 1):
        for column in range(j - half, j + half + 1):
            yield row, column % width


def window_cost(known, window, cost):
    """Over a window; NaN where one of its pairs is missing."""
    result = [known.get(place) for place in window]
    if None in result:
        return np.nan
    a, b = (np.array(each) for each in zip(*result, strict=True))
    if cost == "zncc":
        return 1 - np.corrcoef(a, b)[0, 1]
    if cost == "census":
        return np.count_nonzero(a != b)
    power = {"sad": 1, "ssd": 2}[cost]
    return np.sum(np.abs(a - b) ** power) / PER_GREY**power


def by_definition(first, second, t, matcher):
    """Reasons, best samples and the costs around them, by loops over everything."""
    grid, half, parts = first.grid, matcher.window_px // 2, matcher.samples_per_column
    limits = {"d_min_m": matcher.d_min_m, "d_max_m": matcher.d_max_m}
    curves = epipolar_curves(grid, t, **limits, pitch_px=matcher.pitch_px)
    pixels = columns_of(first, 1)
    own = {place: (0, 0) for place in np.ndindex(grid.shape) if first.valid[place]}
    if matcher.cost == "census":
        own = {place: (0, 0) for place, bits in np.ndenumerate(darker_neighbours(*pixels, 1)) if bits is not None}
    known = {}

    def cost(i, j, k):
        if k not in known:
            known[k] = pairs(first, second, t, parts, k, matcher.cost)
        return window_cost(known[k], window_at(i, j, half, grid.width_px), matcher.cost)

    def search(i, j):
        samples = range(curves.k_first[i, j], curves.k_last[i, j] + 1)
        if np.isnan(window_cost(own, window_at(i, j, half, grid.width_px), "sad")):
            return Reason.WINDOW_LEAVES_IMAGE
        if not curves.defined[i, j]:
            return Reason.NO_EPIPOLAR_PLANE
        if not samples:
            return Reason.NO_SAMPLE
        all_costs = [cost(i, j, number) for number in samples]
        if np.isnan(all_costs).any():
            return Reason.CURVE_LEAVES_IMAGE
        k[i, j] = samples[int(np.argmin(all_costs))]
        costs[i, j] = [cost(i, j, k[i, j] + n) for n in range(-matcher.neighbours, matcher.neighbours + 1)]
        return Reason.MATCHED

    k, costs = {}, {}
    reason = np.array([[search(i, j) for j in range(grid.width_px)] for i in range(grid.height_px)])
    return reason, k, costs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("t", "settings"),
    [
        ((0.5, 0.0, 0.0), {}),
        ((-0.3, 0.4, 0.1), {"cost": "ssd"}),
        ((0.1, -0.3, -0.1), {"pitch_px": 0.5}),
        ((0.3, 0.2, 0.05), {"window_px": 1, "d_max_m": np.inf, "neighbours": 2}),
        ((0.0, 0.4, 0.0), {"window_px": 7, "pitch_px": 1 / 3}),
        pytest.param((-0.2, 0.4, 0.1), {"cost": "zncc"}, marks=pytest.mark.long),
        ((0.4, 0.03, 0.0), {"cost": "zncc", "window_px": 5, "pitch_px": 0.5}),
        pytest.param((0.1, -0.3, -0.1), {"cost": "census"}, marks=pytest.mark.long),
        ((0.4, 0.1, 0.0), {"cost": "census", "pitch_px": 0.5}),
    ],
)
def test_matcher_does_what_its_definition_says(t, settings):
    valid = np.ones(GRID.shape, bool)
    valid[15:17, 30:33] = False
    first, second = noise(7, valid=np.roll(valid, 20, axis=1)), noise(8, valid=valid)
    settings = {"window_px": 3, "d_min_m": 0.9, "d_max_m": 12} | settings
    matcher = WindowMatcher(kind="column", **settings)
    made = match_whole_pixels(first, second, np.array(t), matcher)
    reason, k, costs = by_definition(first, second, np.array(t), matcher)
    np.testing.assert_array_equal(made.reason, reason)
    assert {Reason.MATCHED, Reason.CURVE_LEAVES_IMAGE} <= set(reason.ravel())
    for place, best in k.items():
        assert made.k[place] == best, place
        # Whole numbers, so not a bit of difference; but 1 - ZNCC is rounded to 2^-24.
        tolerance = 2.0**-24 if matcher.cost == "zncc" else 0
        np.testing.assert_allclose(made.costs[place], costs[place], rtol=0, atol=tolerance)
    assert np.isnan(made.costs[made.reason != Reason.MATCHED]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cost", "pitch_px"), [("sad", 1.0), ("ssd", 0.5), ("zncc", 1.0), ("census", 1.0), ("census", 0.5)]
)
def test_half_samples_are_samples_of_twice_as_many_columns(cost, pitch_px):
    t = np.array([0.1, -0.3, -0.1])
    valid = np.ones(GRID.shape, bool)
    valid[15:17, 30:33] = False
    first, second = noise(7), noise(8, valid=valid)
    matcher = WindowMatcher(kind="column", cost=cost, pitch_px=pitch_px, window_px=3, d_min_m=0.9, d_max_m=12)
    whole = match_whole_pixels(first, second, t, matcher)
    made = costs_of_half_samples(first, second, whole, matcher, 1)
    known = {}
    tolerance = 2.0**-24 if cost == "zncc" else 0  # as above
    result = np.argwhere(whole.reason == Reason.MATCHED)[::5]
    for i, j in result.tolist():
        for n in range(7):
            k = 2 * int(whole.k[i, j]) + n - 3
            if k not in known:
                known[k] = pairs(first, second, t, 2 * matcher.samples_per_column, k, cost)
            expected = window_cost(known[k], window_at(i, j, 1, GRID.width_px), cost)
            np.testing.assert_allclose(made[i, j, n], expected, rtol=0, atol=tolerance)
    assert len(result) > 50
    assert np.isnan(made[whole.reason != Reason.MATCHED][..., ::2]).all()


@pytest.mark.parametrize("t", [(0.5, 0.0, 0.0), (-0.3, 0.4, 0.1)])
def test_the_middle_of_a_window_lies_on_the_epipolar_curve(t):
    """A column's map, seen from outside: an image of row numbers, matched against itself."""
    curves = epipolar_curves(GRID, np.array(t), d_min_m=0.9, d_max_m=12)
    rows = np.broadcast_to(np.arange(GRID.height_px, dtype=np.float32)[:, None], GRID.shape)
    ones = np.ones(GRID.shape, bool)
    nothing, numbers = Panorama(GRID, np.zeros(GRID.shape, np.float32), ones), Panorama(GRID, rows, ones)
    matcher = WindowMatcher(kind="column", window_px=1, d_min_m=0.9, d_max_m=12)
    whole = match_whole_pixels(nothing, numbers, np.array(t), matcher)
    asked = 0
    for row, column in np.argwhere(whole.reason == Reason.MATCHED)[::7]:
        ks, costs = costs_along_curve(nothing, numbers, whole, matcher, int(row), int(column))
        _, z = point_at(curves, ks, (row, column))
        expected = (GRID.z_max - z) / GRID.z_pitch - 0.5
        # The row number is rounded to an eighth twice: the pixel and the place between pixels.
        np.testing.assert_allclose(costs, expected, atol=1 / PER_GREY)
        asked += len(ks)
    assert asked > 500


@pytest.mark.parametrize(("threads", "cost"), [(2, "sad"), (5, "sad"), (3, "zncc"), (3, "census")])
def test_threads_change_nothing(threads, cost):
    first, second = noise(12), noise(13)
    matcher = WindowMatcher(kind="column", window_px=3, d_min_m=0.8, cost=cost)
    alone, together = (
        match_whole_pixels(first, second, np.array([0.5, 0, 0.1]), matcher, threads=n) for n in (1, threads)
    )
    np.testing.assert_array_equal(alone.k, together.k)
    np.testing.assert_array_equal(alone.costs, together.costs)
    np.testing.assert_array_equal(alone.reason, together.reason)


@pytest.mark.parametrize("pitch_px", [1.0, 0.5])
def test_one_image_as_both_views_has_no_disparity(pitch_px):
    grid = Grid(width_px=120, height_px=40, z_max=0.4, z_min=-1.7)
    image = noise(9, grid)
    matcher = WindowMatcher(kind="column", window_px=5, d_max_m=np.inf, pitch_px=pitch_px, subpixel="none")
    whole = match_whole_pixels(image, image, np.array([0.5, 0, 0]), matcher)
    matched = whole.reason == Reason.MATCHED
    assert matched.mean() > 0.5
    assert np.all(whole.k[matched] == 0)
    assert np.all(whole.costs[matched][:, 3] == 0)
    assert np.all(match(whole, matcher).alpha_2[matched] == whole.curves.alpha_1[matched])


@pytest.mark.parametrize("columns", [1, 25])
def test_the_seam_is_no_border(columns):
    """Turning the world by whole columns, across the seam, turns the matches and changes none of them."""
    angle = columns * GRID.phi_pitch
    t = np.array([0.5, 0.1, 0.02])
    turned_t = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]) @ t
    first, second = noise(10), noise(11)
    matcher = WindowMatcher(kind="column", window_px=5, d_min_m=0.8)
    straight = match_whole_pixels(first, second, t, matcher)
    rolled = [Panorama(GRID, np.roll(image.values, columns, axis=1), image.valid) for image in (first, second)]
    turned = match_whole_pixels(*rolled, turned_t, matcher)
    for a, b in ((straight.k, turned.k), (straight.reason, turned.reason), (straight.costs, turned.costs)):
        # The map's 2^-16 of a row may round the other way, and a cost on the edge of two quanta with it.
        same = np.isclose(np.roll(b, -columns, axis=1), a, atol=1, rtol=0, equal_nan=True)
        assert same.mean() > 0.995


def test_vertical_translation_has_no_column_to_follow():
    whole = match_whole_pixels(noise(1), noise(2), np.array([0, 0, 0.5]), WindowMatcher(kind="column", window_px=3))
    assert set(whole.reason[1:-1].ravel()) == {Reason.NO_EPIPOLAR_PLANE}
    assert np.isnan(whole.costs).all()


@pytest.mark.slow
@pytest.mark.parametrize("window_px", [3, 25, 27, 41])
@pytest.mark.parametrize("cost", ["sad", "ssd"])
def test_no_sum_overflows(window_px, cost):
    """The largest differences there are, in windows for either width of the sums."""
    grid = Grid(width_px=180, height_px=60, z_max=0.3, z_min=-0.3)
    first, second = (Panorama(grid, np.full(grid.shape, v, np.float32), np.ones(grid.shape, bool)) for v in (255, -255))
    whole = match_whole_pixels(
        first, second, np.array([0.2, 0, 0]), WindowMatcher(kind="column", window_px=window_px, cost=cost)
    )
    matched = whole.reason == Reason.MATCHED
    assert matched.any()
    expected = window_px**2 * 510.0 ** {"sad": 1, "ssd": 2}[cost]
    assert set(whole.costs[matched & np.isfinite(whole.costs).all(axis=-1)].ravel()) == {expected}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sampling": "alpha"}, 'needs sampling = "phi"'),
        ({"pitch_px": 0.8}, "1/m with a whole m"),
        ({"pitch_px": 2.0}, "1/m with a whole m"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        WindowMatcher(kind="column", **wrong)


# -- On the paper's box ------------------------------------------------------------------------------------------------


def outcomes(paper, cache, **settings):
    trial = paper.experiment.trial
    return [
        run_trial(
            trial.model_copy(update={"matching": trial.matching.model_copy(update=settings | {"subpixel": s})}), cache
        )
        for s in ("none", "parabola")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("pitch_px", [1.0, 0.5])
def test_error_bounds_hold(paper, pitch_px):
    check_all(*outcomes(paper, StageCache(), kind="column", pitch_px=pitch_px))


@pytest.mark.slow
def test_what_is_found_is_what_the_square_window_finds(paper):
    """Two definitions of one idea: on walls, where both are right, they differ by less than a sample nearly always."""
    cache = StageCache()
    square, column = (outcomes(paper, cache, kind=kind)[1] for kind in ("window", "column"))
    both = square.valid & column.valid & square.reference.domain & square.reference.wall
    assert both.sum() > 0.7 * (square.reference.domain & square.reference.wall).sum()
    assert np.mean(np.abs(square.matches.k - column.matches.k)[both] < 1) > 0.9
