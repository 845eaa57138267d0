"""Windows whose columns follow the epipolar map: against a plain rendering of their definition, exactly."""

import numpy as np
import pytest
from bounds import check_all

from harness.camera.angles import wrap_angle
from harness.experiments.trial import Kept, run_trial
from harness.stereo.epipolar import epipolar_curves, point_at
from harness.stereo.matching.column import PER_GREY
from harness.stereo.matching.window import Reason, WindowMatcher, costs_along_curve, match, match_whole_pixels
from harness.stereo.panorama import Grid, Panorama

GRID = Grid(width_px=60, height_px=24, z_max=0.5, z_min=-2.0)


def noise(seed, grid=GRID, valid=None):
    values = np.random.default_rng(seed).normal(scale=30, size=grid.shape).astype(np.float32)
    return Panorama(grid, values, np.ones(grid.shape, bool) if valid is None else valid)


def differences(first, second, t, parts, k):
    """The difference of every pixel of view 1 and the place of view 2 where sample k puts it, in eighths; or None.

    The epipolar map of a column as in the project's notes: z_2 = g z_1 + h, from the azimuths of both columns.
    """
    grid, (height, width) = first.grid, first.grid.shape
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
        column, part = divmod(j * parts + sign * k, parts)
        left, right = column % width, (column + 1) % width
        for i in range(height):
            position = gain * i + offset
            row, fraction = position >> 16, (position >> 8) & 255
            within = 0 < from_t < np.pi and 0 <= position <= (height - 1) << 16 and first.valid[i, j]

            def pixel(r, left=left, right=right, part=part):
                r = min(r, height - 1)
                if not second.valid[r, left] or (part and not second.valid[r, right]):
                    return None
                a, b = float(second.values[r, left]), float(second.values[r, right])
                return (
                    int(np.rint(PER_GREY * (a * (1 - part / parts) + b * (part / parts))))
                    if part
                    else round(a * PER_GREY)
                )

            above, below = (pixel(row), pixel(row + 1)) if within else (None, None)
            if above is None or below is None:
                answer[i, j] = None
            else:
                value = above + (((below - above) * fraction + 128) >> 8)
                answer[i, j] = abs(round(float(first.values[i, j]) * PER_GREY) - value)
    return answer


def window_at(i, j, half, width):
    """The places of a window, around the seam."""
    for row in range(i - half, i + half + 1):
        for column in range(j - half, j + half + 1):
            yield row, column % width


def window_cost(known, window, power):
    """Sum over a window; NaN where one of its differences is missing."""
    found = [known.get(place) for place in window]
    return np.nan if None in found else sum(d**power for d in found) / PER_GREY**power


def by_definition(first, second, t, matcher):
    """Reasons, best samples and the costs around them, by loops over everything."""
    grid, half, parts = first.grid, matcher.window_px // 2, matcher.samples_per_column
    limits = {"d_min_m": matcher.d_min_m, "d_max_m": matcher.d_max_m}
    curves = epipolar_curves(grid, t, **limits, pitch_px=matcher.pitch_px)
    own = {place: 0 for place in np.ndindex(grid.shape) if first.valid[place]}
    known = {}

    def cost(i, j, k):
        if k not in known:
            known[k] = differences(first, second, t, parts, k)
        return window_cost(known[k], window_at(i, j, half, grid.width_px), {"sad": 1, "ssd": 2}[matcher.cost])

    def search(i, j):
        samples = range(curves.k_first[i, j], curves.k_last[i, j] + 1)
        if np.isnan(window_cost(own, window_at(i, j, half, grid.width_px), 1)):
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


@pytest.mark.parametrize(
    ("t", "settings"),
    [
        ((0.5, 0.0, 0.0), {}),
        ((-0.3, 0.4, 0.1), {"cost": "ssd"}),
        ((0.1, -0.3, -0.1), {"pitch_px": 0.5}),
        ((0.3, 0.2, 0.05), {"window_px": 1, "d_max_m": np.inf, "neighbours": 2}),
        ((0.0, 0.4, 0.0), {"window_px": 7, "pitch_px": 1 / 3}),
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
        np.testing.assert_array_equal(made.costs[place], costs[place])  # whole numbers: not a bit of difference
    assert np.isnan(made.costs[made.reason != Reason.MATCHED]).all()


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


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_change_nothing(threads):
    first, second = noise(12), noise(13)
    matcher = WindowMatcher(kind="column", window_px=3, d_min_m=0.8)
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


def outcomes(paper, kept, **settings):
    trial = paper.experiment.trial
    return [
        run_trial(
            trial.model_copy(update={"matching": trial.matching.model_copy(update=settings | {"subpixel": s})}), kept
        )
        for s in ("none", "parabola")
    ]


@pytest.mark.parametrize("pitch_px", [1.0, 0.5])
def test_error_bounds_hold(paper, pitch_px):
    check_all(*outcomes(paper, Kept(), kind="column", pitch_px=pitch_px))


def test_what_is_found_is_what_the_square_window_finds(paper):
    """Two definitions of one idea: on walls, where both are right, they differ by less than a sample nearly always."""
    kept = Kept()
    square, column = (outcomes(paper, kept, kind=kind)[1] for kind in ("window", "column"))
    both = square.valid & column.valid & square.reference.domain & square.reference.wall
    assert both.sum() > 0.7 * (square.reference.domain & square.reference.wall).sum()
    assert np.mean(np.abs(square.matches.k - column.matches.k)[both] < 1) > 0.9
