"""Sub-pixel steps: formulas on costs with a known minimum, and all of them on patterns with a known shift."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from scipy import ndimage

from harness.geometry.epipolar import alpha_2_at, epipolar_curves, point_at
from harness.geometry.panorama import Grid, Panorama
from harness.matching.interface import Reason
from harness.matching.window import square
from harness.matching.window.match import WindowMatcher, match, match_whole_pixels
from harness.matching.window.subpixel import FROM_COSTS, cancelled_minimum, refine

X3, X7 = np.arange(-1.0, 2), np.arange(-3, 4) / 2
TRUE = np.linspace(-0.49, 0.49, 15)


# -- Fits of costs -----------------------------------------------------------------------------------------------------


def test_parabola_through_three_recovers_a_parabola():
    offset, refined = refine(7 + 3 * (X3 - TRUE[:, None]) ** 2, "parabola3")
    assert refined.all()
    np.testing.assert_allclose(offset, TRUE, atol=1e-14)


def test_v_recovers_a_v():
    offset, refined = refine(7 + 3 * np.abs(X3 - TRUE[:, None]), "v")
    assert refined.all()
    np.testing.assert_allclose(offset, TRUE, atol=1e-14)


@pytest.mark.parametrize("equiangular", [True, False])
def test_cancellation_recovers_the_shape_of_its_fits(equiangular):
    distance = np.abs(X7 - TRUE[:, None])
    offset, refined = cancelled_minimum(7 + 3 * distance ** (1 if equiangular else 2), equiangular=equiangular)
    assert refined.all()
    np.testing.assert_allclose(offset, TRUE, atol=1e-14)


@pytest.mark.parametrize("method", ["parabola3", "v"])
@pytest.mark.parametrize(
    "costs", [(4, 4, 4), (3, 4, 5), (3, 4, 3), (3, 1, np.nan), (np.nan, 1, 2), (5, 4, 0), (np.nan, np.nan, np.nan)]
)
def test_costs_without_a_minimum_among_them_say_nothing(method, costs):
    """Flat, straight, bent downwards, one missing, or least far outside."""
    offset, refined = refine(np.array([costs], dtype=float), method)
    assert not refined.any()
    assert not offset.any()


def test_only_the_middle_counts_for_three_points():
    costs = np.array([9.0, 0.0, 3.0, 1.0, 2.0, np.nan, 4.0])
    for method in ("parabola3", "v"):
        assert refine(costs, method) == refine(costs[2:5], method)


def test_cancellation_needs_both_fits():
    costs = 1 + np.abs(X7 - 0.3)
    costs[6] = np.nan  # at 1.5: the second fit's, on this side
    assert not cancelled_minimum(costs, equiangular=True)[1]
    assert cancelled_minimum(costs[::-1], equiangular=True)[1] == np.False_
    costs = 1 + np.abs(X7 - 0.3)
    costs[0] = np.nan  # the other side's
    assert cancelled_minimum(costs, equiangular=True)[1]


def mean_squares_of_sinusoids(x, true, wavelength):
    """Mean over a whole wave of (sin(u) - sin(u + shift))²: 1 - cos(shift)."""
    return 1 - np.cos(2 * np.pi * (x - true[:, None]) / wavelength)


@examples(deadline=None)
@given(wavelength=st.floats(2.5, 12))
def test_cancellation_locks_less_than_the_parabola(wavelength):
    """On the SSD of a sinusoid, where every fit's error can be written down."""
    plain = refine(mean_squares_of_sinusoids(X3, TRUE, wavelength), "parabola3")[0] - TRUE
    cancelled = cancelled_minimum(mean_squares_of_sinusoids(X7, TRUE, wavelength), equiangular=False)[0] - TRUE
    # In closed form: tan(2 pi delta/L)/(2 tan(pi/L)) for the parabola, and with it the mean of both.
    shape = (
        np.tan(2 * np.pi * TRUE / wavelength)
        * np.sin(2 * np.pi / wavelength)
        / (2 * (1 - np.cos(2 * np.pi / wavelength)))
    )
    np.testing.assert_allclose(plain, shape - TRUE, atol=1e-12)
    assert np.abs(cancelled).max() < 0.4 * np.abs(plain).max()


# -- Patterns that are shifted along the curves by a known part of a sample ------------------------------------------
#
# Waves of at least 6 columns and 8 rows on view 1, and a view 2 in which every pixel of view 1 is seen where a given
# place k of its own curve lies. With t horizontal, that is in the column k columns farther from t, stretched along z.

GRID = Grid(width_px=240, height_px=40, z_max=0.25, z_min=-0.7972)
T = np.array([0.5, 0.0, 0.0])


def pattern(phi, z, seed=3):
    """Grey levels at azimuths and heights of any one shape."""
    draws = np.random.default_rng(seed)
    value = np.zeros(np.broadcast_shapes(np.shape(phi), np.shape(z)))
    for wave in range(15, 41):
        rise = draws.uniform(-1, 1) * 2 * np.pi / (8 * GRID.z_pitch)
        value += np.cos(wave * phi + rise * z + draws.uniform(0, 2 * np.pi))
    return 10 * value


def panorama(values):
    return Panorama(GRID, np.asarray(values, dtype=np.float32), np.ones(GRID.shape, bool))


def views(k):
    """View 1, and what view 2 sees if all of view 1 is k columns of disparity away."""
    phi, z = GRID.phi[None, :], GRID.z[:, None]
    from_t = np.abs(phi) - k * GRID.phi_pitch  # where in view 1 a column of view 2 comes from; t is at azimuth 0
    came = np.sign(phi) * from_t, z * np.sin(from_t) / np.sin(np.abs(phi))
    return panorama(pattern(phi, z)), panorama(pattern(*came))


def sides(kind):
    """Away from t and -t, where whole windows come from one side; for squares, where they are hardly stretched."""
    sine, z = np.abs(np.sin(GRID.phi))[None, :], np.abs(GRID.z)[:, None]
    return (sine > 0.6) & (z < 1) if kind == "column" else (sine > 0.95) & (z < 0.1)


def found(k, **matcher):
    """Errors of the places found, in columns, on the sides."""
    settings = WindowMatcher(**({"window_px": 9, "d_min_m": 1.0, "d_max_m": 40.0} | matcher))
    first, second = views(k)
    whole = match_whole_pixels(first, second, T, settings)
    answer = match(whole, settings, (first, second))
    there = sides(settings.kind) & answer.refined
    assert there.sum() > 0.5 * np.count_nonzero(sides(settings.kind) & (whole.reason == Reason.MATCHED)) > 150
    return answer.k[there] * settings.pitch_px - k


FRACTIONS = (7.0, 7.15, 7.3, 7.5, 7.7, 7.85)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["window", "column"])
@pytest.mark.parametrize("cost", ["ssd", "census"])
def test_images_recover_the_shift(kind, cost):
    """The cubic B-spline errs by 1 % of a wave of 6 columns, a hundredth of one; a window averages most of it away.

    So it does the stretch that a square does not follow: below 5e-3 of its half width of 4 columns, where it is asked.
    """
    for k in FRACTIONS:
        error = found(k, kind=kind, cost=cost, subpixel="images")
        assert np.abs(np.median(error)) < 0.004
        assert np.median(np.abs(error)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("pitch_px", [0.5, 0.25])
def test_images_recover_the_shift_at_any_pitch(pitch_px):
    for k in FRACTIONS[::2]:
        error = found(k, kind="column", cost="sad", subpixel="images", pitch_px=pitch_px)
        assert np.median(np.abs(error)) < 0.01


@pytest.mark.slow
def test_images_recover_the_shift_along_alpha():
    """The same steps on a curve that is sampled in alpha_2."""
    k = 7.3
    first, second = views(k)
    settings = WindowMatcher(window_px=9, d_max_m=40.0, sampling="alpha", subpixel="images")
    answer = match(match_whole_pixels(first, second, T, settings), settings, (first, second))
    by_phi = epipolar_curves(GRID, T, d_min_m=1.0, d_max_m=40.0)
    there = sides("window") & answer.refined
    error = (answer.alpha_2 - alpha_2_at(by_phi, np.full(GRID.shape, k)))[there] / GRID.phi_pitch
    assert error.size > 150
    assert np.median(np.abs(error)) < 0.01  # as above; a column is a step of alpha_2 here, within 5 %


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["window", "column"])
@examples(deadline=None, max_examples=5)
@given(gain=st.floats(0.5, 1.6), offset=st.floats(-40, 40))
def test_images_fit_gain_and_offset_along_if_the_cost_is_indifferent(kind, gain, offset):
    first, second = views(7.3)
    brighter = panorama(second.values * gain + offset)
    settings = WindowMatcher(kind=kind, cost="zncc", window_px=9, d_max_m=40.0, subpixel="images")
    before, after = (
        match(match_whole_pixels(first, image, T, settings), settings, (first, image)) for image in (second, brighter)
    )
    both = sides(kind) & before.refined & after.refined
    assert both.sum() > 0.98 * np.count_nonzero(sides(kind) & before.refined) > 150
    # Single precision, and steps that end below 5e-3 of a sample, from another whole sample here and there.
    assert np.quantile(np.abs(before.k - after.k)[both], 0.99) < 2e-3


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "cost", "plain"),
    [
        ("window", "ssd", "parabola3"),
        ("window", "zncc", "parabola3"),
        ("column", "ssd", "parabola3"),
        ("column", "zncc", "parabola3"),
        ("column", "sad", "v"),
    ],
)
def test_cancellation_locks_less_on_images(kind, cost, plain):
    """Bias over the fractions of a sample, the median over the sides: less than that of the fit alone."""
    bias = {
        step: np.abs([np.median(found(k, kind=kind, cost=cost, subpixel=step)) for k in FRACTIONS]).max()
        for step in (plain, "shimizu-okutomi")
    }
    assert bias["shimizu-okutomi"] < 0.6 * bias[plain]


@pytest.mark.slow
@pytest.mark.parametrize("step", ["shimizu-okutomi", "images"])
@pytest.mark.parametrize("kind", ["window", "column"])
@pytest.mark.parametrize("cost", ["sad", "ssd", "zncc", "census"])
def test_threads_change_nothing(kind, cost, step):
    first, second = views(5.6)
    holes = np.ones(GRID.shape, bool)
    holes[20:22, 50:60] = False
    second = Panorama(GRID, second.values, holes)
    settings = WindowMatcher(kind=kind, cost=cost, window_px=5, d_max_m=40.0, subpixel=step)
    whole = match_whole_pixels(first, second, T, settings)
    one, three = (match(whole, settings, (first, second), threads=n) for n in (1, 3))
    assert one.k.tobytes() == three.k.tobytes()
    assert one.confidence.tobytes() == three.confidence.tobytes()
    assert np.all(np.isfinite(one.k) == (whole.reason == Reason.MATCHED))
    assert one.refined.any()
    assert np.nanmax(np.abs(one.k - whole.k)) <= 1


@pytest.mark.slow
def test_half_samples_of_squares_are_bilinear():
    """Against windows of a panorama that is interpolated as a whole."""
    draws = np.random.default_rng(5)
    first, second = (panorama(draws.normal(scale=20, size=GRID.shape)) for _ in range(2))
    settings = WindowMatcher(window_px=5, d_max_m=40.0, cost="sad")
    t = np.array([-0.3, 0.4, 0.1])
    whole = match_whole_pixels(first, second, t, settings)
    made = square.costs_of_half_samples(first, second, whole, settings, 1)
    places = np.argwhere(np.isfinite(made).all(axis=-1))[::37]
    assert len(places) > 50
    for row, column_1 in places.tolist():
        for n in range(7):
            phi, z = point_at(whole.curves, whole.k[row, column_1] + (n - 3) / 2, (row, column_1))
            i, j = np.meshgrid(np.arange(-2, 3), np.arange(-2, 3), indexing="ij")
            y = (GRID.z_max - z) / GRID.z_pitch - 0.5 + i
            x = (phi + np.pi) / GRID.phi_pitch - 0.5 + j
            there = ndimage.map_coordinates(second.values.astype(np.float64), [y, x], order=1, mode="grid-wrap")
            own = first.values[row + i, (column_1 + j) % GRID.width_px]
            # Single precision, 25 pixels of some 20 grey levels.
            assert made[row, column_1, n] == pytest.approx(np.abs(own - there).sum(), rel=1e-5)


@pytest.mark.slow
def test_every_step_leaves_search_and_confidence_alone():
    first, second = views(5.6)
    for kind in ("window", "column"):
        settings = WindowMatcher(kind=kind, window_px=5, d_max_m=40.0)
        whole = match_whole_pixels(first, second, T, settings)
        answers = [
            match(whole, settings.model_copy(update={"subpixel": step}), (first, second))
            for step in (*FROM_COSTS, "shimizu-okutomi", "images")
        ]
        for answer in answers[1:]:
            np.testing.assert_array_equal(answer.confidence, answers[0].confidence)
            np.testing.assert_array_equal(answer.reason, answers[0].reason)
            np.testing.assert_array_equal(answer.k[~answer.refined], answers[0].k[~answer.refined])


def test_steps_that_need_images_say_so():
    settings = WindowMatcher(window_px=5, subpixel="images", d_max_m=40.0)
    whole = match_whole_pixels(*views(5.6), T, settings)
    with pytest.raises(ValueError, match="images needs the panoramas"):
        match(whole, settings)
    with pytest.raises(ValueError, match="images needs more"):
        refine(whole.costs, "images")
