"""Slanted windows: on a floor whose texture is a formula, so that images, truth and gradients are exact."""

from functools import lru_cache

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, pixel_directions, project
from harness.geometry.angles import angle_between
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.geometry.triangulation import exact_alpha_2
from harness.matching.interface import Reason, as_matches
from harness.matching.slanted import _agreement_kernels, _fit_kernels, _median_kernels, _reading_kernels
from harness.matching.slanted import _slanted_kernels as _kernels
from harness.matching.slanted.field import Part, Step, steps_back, steps_forth, warp_between
from harness.matching.slanted.refine import Slanted, refine_slanted
from harness.matching.slanted.sigma import density_at_0, smoothed_noise

SENSOR = Sensor(
    camera=Camera(width_px=220, height_px=220, focal_px=560.0, cx_px=109.5, cy_px=109.5),
    field=FieldOfView(elevation_min_deg=-75, elevation_max_deg=-20),
)
GRID = Grid(width_px=240, height_px=60, z_max=-0.4, z_min=-2.0)
HEIGHT_M = 1.0
SETTINGS = Slanted(window_px=13, d_min_m=0.5)
WAVES = np.random.default_rng(3).normal(size=(60, 2)), np.random.default_rng(4).uniform(0, 2 * np.pi, 60)


def texture(x, y):
    """Sixty waves of 0.25 m and longer: eight mirror pixels or more."""
    directions, phases = WAVES
    lengths = 0.25 + 0.5 * np.linspace(0, 1, len(phases))
    k = 2 * np.pi * directions / np.linalg.norm(directions, axis=-1, keepdims=True) / lengths[:, None]
    total = np.zeros(np.shape(x))
    for (k_x, k_y), phase in zip(k, phases, strict=True):
        total += np.cos(k_x * x + k_y * y + phase)
    return 128 + 8 * total


def seen_along(directions_v1, viewpoint):
    """The floor's grey in some directions of v1's orientation, from a viewpoint given in v1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (-HEIGHT_M - viewpoint[2]) / directions_v1[..., 2]
    return texture(viewpoint[0] + reach * directions_v1[..., 0], viewpoint[1] + reach * directions_v1[..., 1])


def render(viewpoint, R=None, sensor=SENSOR):
    """A mirror image; R turns from v1 into the view."""
    x, visible = pixel_directions(sensor)
    grey = seen_along(x if R is None else x @ R, viewpoint)
    return np.where(visible, grey, 0).astype(np.float32)


def motion(t=(0.2, 0.05, 0.02), turn=(20.0, 3.0, -2.0)):
    return Motion(Rotation.from_euler("ZYX", turn, degrees=True).as_matrix(), np.array(t))


@lru_cache
def pair(t=(0.2, 0.05, 0.02), turn=(20.0, 3.0, -2.0)):
    there = motion(t, turn)
    return render(np.zeros(3)), render(there.t_v1, there.R_v2_from_v1)


def truth(there, grid=GRID):
    x = directions(grid)
    return exact_alpha_2(x * (-HEIGHT_M / x[..., 2:]), there.t_v1)


def start(there, error_px=0.5, outliers=0.05, seed=0):
    """The truth, wrong by up to half a pixel; some pixels by up to ten."""
    draws = np.random.default_rng(seed)
    error = draws.uniform(-error_px, error_px, GRID.shape)
    error = np.where(draws.random(GRID.shape) < outliers, draws.uniform(-10, 10, GRID.shape), error)
    return truth(there) + error * GRID.phi_pitch


def refine(images, there, begin=None, **settings):
    threads = settings.pop("threads", 2)
    begin = start(there) if begin is None else begin
    chosen = SETTINGS.model_copy(update=settings)
    return refine_slanted(images, (SENSOR, SENSOR), there, GRID, begin, settings=chosen, threads=threads)


def errors_px(matches, there):
    return (matches.alpha_2 - truth(there)) / GRID.phi_pitch


def steep(there):
    """Not towards the epipoles, where disparity says little about range and errors are not the matcher's."""
    x = directions(GRID)
    return np.linalg.norm(np.cross(x, there.t_v1 / np.linalg.norm(there.t_v1)), axis=-1) >= 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("t", "turn"),
    [((0.2, 0.05, 0.02), (20.0, 3.0, -2.0)), ((0.0, 0.0, 0.2), (0.0, 0.0, 0.0)), ((-0.1, 0.2, 0.0), (170.0, 0.0, 0.0))],
)
def test_a_plane_is_found(t, turn):
    there = motion(t, turn)
    matches = refine(pair(t, turn), there)
    as_matches(matches, GRID, "slanted")  # what the contract asks for
    error = np.abs(errors_px(matches, there)[steep(there)])
    assert np.mean(np.isfinite(error)) > 0.97
    # A cubic spline between samples of a wave of eight pixels is wrong by (2 pi/8)^4/384 of its height in the middle,
    # 0.1 %, and a pixel moves it by 2 pi/8: 0.001 pixels of the mirror, and some of that averages out.
    assert np.nanmedian(error) < 0.001
    # Beyond the rim the image is continued by its last pixel, which the spline carries a pixel or two inwards.
    assert np.nanquantile(error, 0.99) < 0.01


@pytest.mark.slow
def test_holes_in_the_start_are_filled():
    there = motion()
    begin = start(there)
    begin[20:40, 50:70] = np.nan
    error = np.abs(errors_px(refine(pair(), there, begin), there))
    assert np.nanmedian(error[22:38, 52:68]) < 0.001
    assert np.mean(np.isfinite(error[22:38, 52:68])) > 0.95


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
def test_a_window_is_the_least_squares_solution(far):
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
    _fit_kernels.fit_rows(
        30, 190, half, 20.0, 0.0, far, warp.valid, warp.x, w, first, known, value, slope, moved,
        plane, covariance, residual, gain, offset, share,
    )  # fmt: skip
    checked = 0
    for i, j in draws.integers(40, 180, (60, 2)):
        if not warp.valid[i, j]:
            continue
        box = np.s_[i - half : i + half + 1, j - half : j + half + 1]
        k = known[box]
        I_1, I_2, g, x = (a[box][k].astype(np.float64) for a in (first, value, slope, warp.x))
        a = I_1.std() / I_2.std()
        columns = np.column_stack([a * g[:, None] * x, np.ones(len(g))])
        right = I_1 - a * (I_2 - g * w[box][k])
        solution, squares, _, _ = np.linalg.lstsq(columns, right, rcond=None)
        if far:
            assert 0.05 < share[i, j] < 0.95
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


@pytest.mark.slow
def test_gain_and_offset_do_not_matter():
    there, (first, second) = motion(), pair()
    plain, changed = (refine((first, image), there) for image in (second, (1.3 * second - 25).astype(np.float32)))
    both = np.isfinite(plain.alpha_2) & np.isfinite(changed.alpha_2)
    assert both.mean() > 0.99 * np.isfinite(plain.alpha_2).mean()
    difference = np.abs(plain.alpha_2 - changed.alpha_2)[both] / GRID.phi_pitch
    # Grey levels in single precision, 1e-5 of 128, over slopes of some ten a pixel.
    assert np.quantile(difference, 0.99) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(threads):
    there = motion()
    one, other = (refine(pair(), there, threads=n) for n in (2, threads))
    for field in ("alpha_2", "sigma_alpha_2", "reason"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))


def test_what_lies_around_the_field_does_not_matter():
    """The same images within larger ones, which the sensor does not see."""
    there, (left, top) = motion(), (37, 80)  # running sums begin anew every 40 rows, at the same ones then
    height, width = pair()[0].shape
    camera = SENSOR.camera.model_copy(
        update={
            "width_px": width + left + 50,
            "height_px": height + top + 30,
            "cx_px": SENSOR.camera.cx_px + left,
            "cy_px": SENSOR.camera.cy_px + top,
        }
    )
    larger = SENSOR.model_copy(update={"camera": camera})
    images = [np.pad(image, ((top, 30), (left, 50)), constant_values=77) for image in pair()]
    here = refine(pair(), there)
    same = refine_slanted((images[0], images[1]), (larger, larger), there, GRID, start(there), settings=SETTINGS)
    np.testing.assert_array_equal(same.reason, here.reason)
    # The spline's coefficients are rounded to single precision, 1e-5 of 128 grey levels, over slopes of some ten.
    np.testing.assert_allclose(same.alpha_2, here.alpha_2, rtol=0, atol=1e-5 * GRID.phi_pitch)
    np.testing.assert_allclose(same.sigma_alpha_2, here.sigma_alpha_2, rtol=1e-4)


@pytest.mark.slow
def test_the_seam_is_no_border():
    """A quarter turn of a square image about its middle is exact, and moves the seam by a quarter of the panorama."""
    there = motion()
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = Motion(quarter @ there.R_v2_from_v1 @ quarter.T, quarter @ there.t_v1)
    begin = start(there)
    straight = refine(pair(), there, begin)
    images = tuple(np.ascontiguousarray(np.rot90(image, -1)) for image in pair())
    shift = GRID.width_px // 4
    rolled = refine(images, turned, np.roll(begin, shift, axis=1))
    difference = np.abs(straight.alpha_2 - np.roll(rolled.alpha_2, -shift, axis=1)) / GRID.phi_pitch
    assert np.mean(np.isfinite(difference)) > 0.97
    # Sums run the other way, which is rounding; but a start on the edge of two mirror pixels may fall to the other, and
    # in the outer rows, whose windows are cut, of two planes that fit alike the other may be taken.
    assert np.nanmedian(difference) < 1e-6
    assert np.nanmax(difference[10:40]) < 1e-4


def test_without_texture_there_is_no_answer():
    there = motion()
    flat = np.full((220, 220), 90, np.float32)
    matches = refine((flat, flat), there)
    assert np.isnan(matches.alpha_2).all()
    assert set(np.unique(matches.reason)) == {Reason.NO_MATCH}


def test_texture_beside_a_blank_place_is_no_answer_for_it():
    there, x = motion(), directions(GRID)
    x_1, visible = pixel_directions(SENSOR)

    def contrast(directions_v1, viewpoint):
        with np.errstate(divide="ignore", invalid="ignore"):
            at = viewpoint + directions_v1 * ((-HEIGHT_M - viewpoint[2]) / directions_v1[..., 2:])
        return np.clip((np.hypot(at[..., 0] + 1, at[..., 1]) - 0.6) / 0.15, 0, 1)

    rays_of_both = (x_1, np.zeros(3)), (x_1 @ there.R_v2_from_v1, there.t_v1)
    images = [128 + (image - 128) * contrast(*warp) for image, warp in zip(pair(), rays_of_both, strict=True)]
    matches = refine(tuple(np.where(visible, image, 0).astype(np.float32) for image in images), there)
    pixels, _ = project(SENSOR, x)
    row, column = np.moveaxis(np.rint(pixels[..., ::-1]).astype(int), -1, 0)
    depth = ndimage.distance_transform_edt((contrast(*rays_of_both[0]) == 0) & visible)[row, column]
    # Surroundings of 9 pixels reach 4, corners 5.7; windows of 13 pixels moved by 6 reach 12, so there are planes.
    inside = (depth > 6.5) & (depth < 12)
    assert inside.sum() > 100
    assert np.isfinite(matches.alpha_2[inside]).mean() < 0.05
    assert np.isfinite(matches.alpha_2[depth == 0]).mean() > 0.95


def test_noise_is_not_taken_for_texture():
    there = motion()
    draws = np.random.default_rng(8)
    matches = refine(tuple(draws.normal(90, 5, (2, 220, 220)).astype(np.float32)), there)
    # Two windows of noise correlate by 3 standard deviations now and then.
    assert np.mean(np.isfinite(matches.alpha_2)) < 0.01


def test_what_view_2_does_not_see_has_no_answer():
    there, (first, second) = motion(), pair()
    hidden = np.zeros(second.shape, bool)
    hidden[:, :70] = True
    other = np.where(hidden, texture(*np.meshgrid(np.linspace(50, 54, 220), np.linspace(9, 13, 220))), second)
    matches = refine((first, other.astype(np.float32)), there)
    x = directions(GRID)
    pixels, _ = project(SENSOR, there.apply(x * (-HEIGHT_M / x[..., 2:])))
    gone = pixels[..., 0] < 70 - 9
    assert np.isfinite(matches.alpha_2[gone]).mean() < 0.1
    assert (matches.reason[gone] == Reason.INCONSISTENT).any()
    assert np.isfinite(matches.alpha_2[pixels[..., 0] > 70 + 14]).mean() > 0.9


@pytest.mark.slow
def test_errors_are_near_the_bound_and_as_predicted():
    """White noise against the Cramér-Rao bound of the window, from the texture's formula."""
    there, images, noise, seeds = motion(), pair(), 6.0, 6
    all_errors, sigmas = [], []
    for seed in range(seeds):
        draws = np.random.default_rng(100 + seed)
        noisy = tuple((image + noise * draws.standard_normal(image.shape)).astype(np.float32) for image in images)
        matches = refine(noisy, there, start(there, seed=seed))
        all_errors.append(errors_px(matches, there))
        sigmas.append(matches.sigma_alpha_2 / GRID.phi_pitch)
    there_and_inside = np.isfinite(all_errors).all(axis=0) & steep(there)
    there_and_inside[:6] = there_and_inside[-6:] = False  # windows are cut at the rim
    errors, sigma = np.array(all_errors)[:, there_and_inside], np.array(sigmas)[:, there_and_inside]
    bound = noise * bound_px(there)[there_and_inside]
    efficiency = np.median(np.sqrt(np.mean(errors**2, axis=0)) / bound)
    within = np.mean(np.abs(errors) < sigma)
    # The bound is for a single unknown and gradients that are known: slopes do not cost, noise in gradients does.
    assert 0.85 < efficiency < 1.3
    # Neighbouring errors share their windows: some 300 windows apart in six trials make 1 % of standard deviation.
    assert 0.64 < within < 0.72


def bound_px(there):
    """sqrt(2/sum (dI_2/dw)²) over each pixel's window, times d alpha_2/dw, in columns."""
    x, visible = pixel_directions(SENSOR)
    h = 1e-5

    def grey(w):
        return seen_along(x - w[..., None] * there.t_v1, there.t_v1)

    with np.errstate(invalid="ignore", divide="ignore"):
        w = -x[..., 2] / HEIGHT_M
        squares = np.where(visible, ((grey(w + h) - grey(w - h)) / (2 * h)) ** 2, 0)
    total = ndimage.uniform_filter(squares, SETTINGS.window_px, mode="constant") * SETTINGS.window_px**2
    direction = directions(GRID)
    pixels, _ = project(SENSOR, direction)
    row, column = np.moveaxis(np.rint(pixels[..., ::-1]).astype(int), -1, 0)
    w = -direction[..., 2:] / HEIGHT_M
    across = np.linalg.norm(np.cross(there.t_v1, direction), axis=-1)
    rate = across / np.sum((direction - w * there.t_v1) ** 2, axis=-1)
    return np.sqrt(2 / total[row, column]) * rate / GRID.phi_pitch


def test_densities_of_sums():
    # Of equal sides, centres of B-splines: cubic 2/3, quintic 11/20 (Schoenberg).
    assert [density_at_0({1.0: m}) for m in (2, 3, 4, 6)] == pytest.approx([1, 3 / 4, 2 / 3, 11 / 20], abs=1e-14)
    # Of two sides: the lower of the two densities.
    assert density_at_0({0.25: 1, 2.0: 1}) == pytest.approx(0.5, abs=1e-14)
    # A triangle of sides 1/2 over a side of 1: all of it is under the density 1.
    assert density_at_0({0.5: 2, 1.0: 1}) == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("f", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("narrow", [0, 3])
def test_noise_that_steps_leave(f, narrow):
    """The recursion itself, on an impulse of noise; every window's plane is the mean of its noise."""
    impulse = np.zeros((321, 321))
    impulse[160, 160] = 1
    steps = steps_forth(Slanted(narrow_iterations=narrow, sharp_iterations=2))
    field = np.zeros_like(impulse)
    for step in steps:
        part = f if step.sharp else f * f
        plane, before = (ndimage.uniform_filter(each, step.window_px) for each in (impulse, field))
        field = (1 - part) / (1 - f) * plane + part * before
    # Windows of 11 and 17 samples for a continuum: 1/11², a few times over.
    expected = np.sum(field**2) / np.sum(plane**2)
    assert np.polynomial.polynomial.polyval(f, smoothed_noise(steps)) == pytest.approx(expected, rel=0.015)


def test_the_last_steps_are_sharp_and_wide_whatever_their_number():
    far, narrow, sharp = Step(17, sharp=False), Step(11, sharp=False), Step(17, sharp=True)
    assert steps_forth(Slanted()) == (*[narrow] * 3, *[far] * 2, *[sharp] * 3)
    assert steps_forth(Slanted(iterations=4)) == (narrow, *[sharp] * 3)
    assert steps_forth(Slanted(iterations=1)) == (sharp,)
    assert steps_back(Slanted(window_px=5)) == (Step(5, sharp=False), Step(5, sharp=True))


def test_noise_of_interpolation():
    """The constants against white noise itself, interpolated by scipy."""
    noise = np.random.default_rng(6).standard_normal(200_000)
    spline = ndimage.spline_filter1d(noise, 3, mode="mirror")
    at = np.random.default_rng(7).uniform(10, len(noise) - 11, 200_000)
    h = 1e-4
    value, ahead, behind = (
        ndimage.map_coordinates(spline, [at + d], order=3, prefilter=False, mode="mirror") for d in (0, h, -h)
    )
    # Variances from 2e5 samples of correlated noise: 0.5 %.
    assert np.var(value) == pytest.approx(_fit_kernels.VALUE_NOISE, rel=0.02)
    assert np.var((ahead - behind) / (2 * h)) == pytest.approx(_fit_kernels.SLOPE_NOISE, rel=0.02)


@pytest.mark.parametrize("key", ["window_px", "patch_px"])
def test_windows_have_a_centre(key):
    with pytest.raises(ValueError, match=f"{key} must be odd"):
        Slanted(**{key: 8})


def test_wrong_sizes_are_refused():
    there, (first, second) = motion(), pair()
    with pytest.raises(ValueError, match="the sensor"):
        refine((first[1:], second), there)
    with pytest.raises(ValueError, match="the panorama"):
        refine((first, second), there, np.zeros((3, 3)))
