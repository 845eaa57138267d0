"""The compiled loops of slanted windows, each against another way to the same numbers."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval
from scipy import ndimage
from slanted_floor import SENSOR, motion

from harness.camera.lens import Lens
from harness.camera.sensor import pixel_directions, project
from harness.camera.spline_noise import noise_through_spline
from harness.geometry.angles import angle_between
from harness.matching.slanted import _agreement_kernels, _fit_kernels, _median_kernels, _reading_kernels
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.field import Part, warp_between
from harness.matching.slanted.means import means
from harness.matching.slanted.noise import Noise


def warped(sensor, there, image, w):
    whole = Part(sensor, 0, *(slice(0, size) for size in w.shape))
    warp = warp_between(whole, whole, there, pixel_directions(sensor)[1])
    coefficients = ndimage.spline_filter(image, 3, output=np.float64, mode="mirror")
    known = np.zeros(w.shape, bool)
    value, slope, moved = np.zeros((3, *w.shape))
    _kernels.warp_rows(
        0,
        len(w),
        warp.valid,
        warp.x,
        w,
        warp.R,
        warp.s,
        warp.camera,
        coefficients,
        known,
        value,
        slope,
        moved,
    )
    return known, value, slope, moved


@pytest.mark.parametrize("reach", [1, 2])
def test_the_start_is_a_median(reach):
    """Against Python's own sort, with holes, over more than one block of columns."""
    draws = np.random.default_rng(4)
    w = draws.normal(size=(40, 150))
    w[draws.random(w.shape) < np.linspace(0, 0.9, 150)] = np.nan
    w[5, 7], w[6, 8] = np.inf, w[6, 9]
    valid = draws.random(w.shape) < 0.9
    smooth = np.empty_like(w)
    _median_kernels.median_rows(0, len(w), reach, valid, w, smooth)
    for i, j in np.ndindex(w.shape):
        box = w[max(0, i - reach) : i + reach + 1, max(0, j - reach) : j + reach + 1]
        known = sorted(box[np.isfinite(box)].tolist())
        if valid[i, j] and 3 * len(known) >= (2 * reach + 1) ** 2:
            assert smooth[i, j] == known[len(known) // 2]
        else:
            assert np.isnan(smooth[i, j])


LENS = Lens(k1=0.1, k2=-0.05, p1=0.002, p2=-0.003, k3=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("lens", [Lens(), LENS])
def test_samples_lie_where_the_sensor_sees_the_point(lens):
    sensor, there = SENSOR.model_copy(update={"lens": lens}), motion()
    x, _ = pixel_directions(sensor)
    w = np.random.default_rng(0).uniform(0.3, 0.9, x.shape[:2])
    image = np.random.default_rng(1).normal(size=w.shape)
    known, value, _, _ = warped(sensor, there, image, w)
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels, valid = project(sensor, there.apply(x / w[..., None]))
    at = np.moveaxis(pixels[known], -1, 0)[::-1]
    expected = ndimage.map_coordinates(image, at, order=3, mode="mirror")
    assert known.sum() > 10_000
    assert valid[known].all()
    # Two closed forms of one projection, each good to some 1e-13 of 100 pixels, times slopes of a few grey levels.
    np.testing.assert_allclose(value[known], expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("lens", [Lens(), LENS])
def test_slope_is_the_derivative(lens):
    sensor, there = SENSOR.model_copy(update={"lens": lens}), motion()
    w = np.random.default_rng(0).uniform(0.3, 0.9, (220, 220))
    image = np.random.default_rng(1).normal(size=w.shape)
    known, _, slope, moved = warped(sensor, there, image, w)
    h = 1e-6
    after, before = warped(sensor, there, image, w + h), warped(sensor, there, image, w - h)
    inside = known & after[0] & before[0]
    numeric = (after[1] - before[1]) / (2 * h)
    # Central difference: rounding 1e-14/h, curvature h² times third derivatives of some (100 px per 1/m)³; the spline's
    # third derivative jumps at pixels, which an interval of 2e-4 pixels seldom meets.
    np.testing.assert_allclose(slope[inside], numeric[inside], atol=2e-4 * np.abs(slope[inside]).max())
    x, _ = pixel_directions(sensor)
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead, _ = project(sensor, there.apply(x / (w + h)[..., None]))
        behind, _ = project(sensor, there.apply(x / (w - h)[..., None]))
    expected = np.sum(((ahead - behind) / (2 * h)) ** 2, axis=-1)
    np.testing.assert_allclose(moved[inside], expected[inside], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("excess", [0.0, 100.0, -90.0])
def test_a_window_is_the_least_squares_solution(far, excess):
    """Against numpy's solver, sample by sample, on random fields with holes."""
    draws = np.random.default_rng(5)
    known = pixel_directions(SENSOR)[1]
    whole = Part(SENSOR, 0, *(slice(0, size) for size in known.shape))
    warp = warp_between(whole, whole, motion(), known)
    shape, half = warp.valid.shape, 5
    w = draws.uniform(0.4, 0.8, shape)
    known = warp.valid & (draws.random(shape) < 0.8)
    value = draws.normal(100, 20, shape).astype(np.float32)
    first = (value + draws.normal(0, 15, shape)).astype(np.float32)
    slope = draws.normal(0, 30, shape).astype(np.float32)
    moved = draws.uniform(1, 2, shape).astype(np.float32)
    plane, covariance = np.zeros((*shape, 3)), np.zeros((*shape, 6))
    residual, gain, offset, share = np.zeros((4, *shape))
    through_spline = of_value, of_slope = noise_through_spline()
    noise = Noise(1.0, 0.0, gain_squared=1.1, ratio=1.1 * 2.0 ** np.sign(excess), excess=excess)
    _fit_kernels.fit_rows(
        30, 190, half, 20.0, 0.0, far, noise.for_fit(through_spline), warp.valid, warp.x, w, first, known, value, slope,
        moved, plane, covariance, residual, gain, offset, share,
    )  # fmt: skip
    checked = 0
    for i, j in draws.integers(40, 180, (60, 2)):
        if not warp.valid[i, j]:
            continue
        box = np.s_[i - half : i + half + 1, j - half : j + half + 1]
        k = known[box]
        I_1, I_2, g, x = (a[box][k].astype(np.float64) for a in (first, value, slope, warp.x))
        a = np.sqrt((I_1.var() + noise.excess_2 * of_value**2) / (I_2.var() + noise.excess_1 / 1.1))
        columns = np.column_stack([a * g[:, None] * x, np.ones(len(g))])
        right = I_1 - a * (I_2 - g * w[box][k])
        solution, squares, _, _ = np.linalg.lstsq(columns, right, rcond=None)
        r, interpolated = squares[0] / (len(g) - 5), a * a * of_value**2
        alike = (r - 1.2 * noise.excess_1) / (1.1 + interpolated), (r + 1.2 * noise.excess_2) / (1.1 + interpolated)
        n_2 = np.clip(r / (noise.ratio + interpolated), *alike)
        assert share[i, j] == pytest.approx(n_2 * of_value * of_slope * moved[box][k].sum() / (g @ g), rel=1e-5)
        if far:
            assert 0.01 < share[i, j] < 0.95
            solution += share[i, j] * np.linalg.lstsq(columns, I_1 - a * I_2, rcond=None)[0]
            solution[3] = np.mean(right - columns[:, :3] @ solution[:3])
        # Running sums and normal equations: the square of the solver's condition, some 1e4, times 1e-16, with room.
        np.testing.assert_allclose(plane[i, j], solution[:3], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose([gain[i, j], offset[i, j]], [a, solution[3]], rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(residual[i, j], squares[0] / (len(g) - 5), rtol=1e-6)
        c = warp.x[i, j]
        at_centre = c @ np.linalg.inv(columns.T @ columns)[:3, :3] @ c
        np.testing.assert_allclose(covariance[i, j, 0], at_centre, rtol=1e-5)
        checked += 1
    assert checked > 30


@pytest.mark.parametrize("size", [5, 7, 9, 11, 17, 31, 99])
def test_sums_over_columns(size):
    tile, kinds = _fit_kernels.TILE, _fit_kernels.SUMS
    sums = np.random.default_rng(size).normal(size=(kinds, 2 * tile + size + 3 * _fit_kernels.LANES))
    out = np.full(_fit_kernels.ROWS * tile, np.nan)
    for begin in (0, tile):
        _fit_kernels._sum_over_columns(sums, begin, size, np.empty(tile + size), out)
        expected = np.lib.stride_tricks.sliding_window_view(sums, size, axis=1)[:, begin : begin + tile].sum(axis=-1)
        # Up to a hundred numbers of some ones are added up in another order.
        np.testing.assert_allclose(out[: kinds * tile].reshape(kinds, tile), expected, atol=1e-13)
    assert np.isnan(out[kinds * tile :]).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("side", [3, 17, 99])
def test_means_are_scipys_to_the_last_bit(side, kind):
    """Over more than one block of lines, and squares that are larger than the image."""
    values = np.random.default_rng(side).normal(size=(70, 150)).astype(kind)
    expected = ndimage.uniform_filter(values.astype(np.float64), side, mode="constant")
    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(means(values, side, pool, np.empty(values.shape)), expected)
        if kind is np.float64:
            np.testing.assert_array_equal(means(values, side, pool, values), expected)


@pytest.mark.parametrize("begin", [0, 64])
@pytest.mark.parametrize("half", [2, 5])
def test_planes_of_nine_windows(half, begin):
    draws = np.random.default_rng(half)
    shape = (12, 90)
    x = draws.normal(size=(*shape, 3))
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    plane = 0.3 * x + draws.normal(0, 0.02, x.shape)
    residual = np.where(draws.random(shape) < 0.3, np.inf, 1).astype(np.float32)
    t, apart, limits = np.array([0.3, 0.1, 0.05]), 0.01, (0.25, 0.35)
    tile = np.empty(_agreement_kernels.TILE_ROWS * _agreement_kernels.TILE)
    planes = np.empty((3, _agreement_kernels.TILE + 2 * half))
    for i in range(shape[0]):
        _agreement_kernels.compare_planes(i, begin, half, apart, *limits, x, t, plane, residual, planes, tile)
        rows = tile.reshape(-1, _agreement_kernels.TILE)[:, : shape[1] - begin]
        expected = np.full((9, rows.shape[1]), np.nan)
        for k in range(9):
            for j in range(rows.shape[1]):
                row, column = i + (k // 3 - 1) * half, begin + j + (k % 3 - 1) * half
                if 0 <= row < shape[0] and 0 <= column < shape[1] and np.isfinite(residual[row, column]):
                    w = plane[row, column] @ x[i, begin + j]
                    expected[k, j] = w if limits[0] <= w <= limits[1] else np.nan
        # Sums of three products are added up in another order.
        first = _agreement_kernels.PLANES // _agreement_kernels.TILE
        np.testing.assert_allclose(rows[first : first + 9], expected, rtol=1e-14)
        lowest, highest = np.fmin.reduce(expected), np.fmax.reduce(expected)
        some = np.isfinite(lowest)
        np.testing.assert_allclose(rows[0, some], lowest[some], rtol=1e-14)
        np.testing.assert_allclose(rows[1, some], highest[some], rtol=1e-14)
        # Inverse ranges as far apart as that are seen `apart` apart from viewpoint 2, in the middle of the nine.
        w, same = ((lowest + highest) / 2)[some, None], rows[2, some][:, None]
        here = x[i, begin : begin + len(some)][some]
        ends = (here - (w + 1e-4 * same * sign) * t for sign in (-0.5, 0.5))  # a ten-thousandth of it, as it is no line
        np.testing.assert_allclose(angle_between(*ends), 1e-4 * apart, rtol=1e-6)


def test_variances_are_those_of_the_tangents_of_windows():
    draws = np.random.default_rng(0)
    middle, x = draws.normal(size=(2, 40, 3))
    middle[0] = 0, 0, 1  # on the axis, where there is no parallel
    middle, x = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (middle, x))
    root = draws.normal(size=(40, 3, 3))
    inverse = root @ root.swapaxes(1, 2)
    window, found = draws.permutation(40).astype(np.int32), np.empty(40)
    upper = inverse[:, *np.triu_indices(3)].astype(np.float32)
    _reading_kernels.variances(window, x, middle, upper, found)
    for k, there in enumerate(window):
        c = middle[there]
        e = np.cross([0, 0, 1], c) / np.hypot(c[0], c[1]) if abs(c[2]) < 1 else np.array([0.0, 1.0, 0.0])
        tangents = np.stack([c, e, np.cross(c, e)]) @ x[k]
        # Single precision of the inverse normal matrix, whose terms are up to 20.
        assert found[k] == pytest.approx(tangents @ inverse[there] @ tangents, rel=1e-5, abs=1e-5)


def test_standard_deviations_are_of_the_windows_and_of_a_polynomial():
    draws = np.random.default_rng(1)
    residual, share, inflation = draws.uniform(0.5, 2, (3, 90)).astype(np.float32)
    window, smoothed, variance = draws.integers(0, 90, 150), draws.random(5), draws.random(150)
    found = variance.copy()
    _reading_kernels.spread(window, residual, share, inflation, smoothed, 0.01, found)
    f, rest = share.astype(np.float64)[window], ((residual.astype(np.float64) + 0.01) * inflation)[window]
    np.testing.assert_allclose(found**2, variance * rest * polyval(f, smoothed), rtol=1e-9)


def test_what_viewpoint_2_sees():
    draws, there = np.random.default_rng(2), motion()
    x, w = draws.normal(size=(40, 3)), draws.uniform(0, 1, 40)
    seen, (length, across, along) = np.empty((40, 3)), np.empty((3, 40))
    _reading_kernels.seen_from_2(x, w, there.t_v1, there.R_v2_from_v1, seen, length, across, along)
    points = there.apply(x / w[:, None])  # in view 2; rounding is 1e-16 of numbers of some ones, divided by up to 0.01
    np.testing.assert_allclose(seen, points / np.linalg.norm(points, axis=-1, keepdims=True), rtol=1e-12)
    np.testing.assert_allclose(length, w * np.linalg.norm(points, axis=-1), rtol=1e-12)
    angles = angle_between(seen, there.R_v2_from_v1 @ there.t_v1)
    np.testing.assert_allclose(np.arctan2(across, along), angles, rtol=1e-12)
