"""The Cramér-Rao bound against closed forms, brute force over raw pixels, and estimators under noise."""

import numpy as np
import pytest
from scipy import ndimage

from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.sensor import Sensor, in_field, pixel_directions, project, unproject
from harness.evaluation.bound import cramer_rao, least_std
from harness.geometry.angles import normalise
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Pose, relative_motion
from harness.geometry.triangulation import exact_alpha_2
from harness.simulation.chip import Chip, grey_variance
from harness.simulation.render import render
from harness.simulation.scene import Box, Scene
from harness.simulation.texture import GreyTexture, NoiseTexture
from harness.simulation.truth import ranges, truth

# Off the middle, so that no pixel's centre lies on a border of two of the panorama's columns.
SENSOR = Sensor(camera=Camera(width_px=320, height_px=240, focal_px=306, cx_px=159.2, cy_px=119.65))
GRID = Grid(width_px=360, height_px=90, z_max=0.28, z_min=-1.30)
OTHER = Sensor(
    camera=Camera(width_px=400, height_px=360, focal_px=430, aspect=1.05, cx_px=210.3, cy_px=171.8), lens=Lens(k1=-0.1)
)
"""What view 2 may have in place of the first sensor: pixels of half the area."""
WINDOW = 15
VIEWS = (
    Pose(position_m=(0, 0, 1), yaw_deg=20, pitch_deg=4, roll_deg=-3),
    Pose(position_m=(0.5, 0.1, 1.1), yaw_deg=-15, pitch_deg=2),
)
MOTION = relative_motion(*VIEWS)
X = directions(GRID)


def noise(seed):
    # At 3 m the shortest wave spans ten raw pixels: neither image is aliased, and both show the same texture.
    return NoiseTexture(kind="noise", seed=seed, tile_m=6, shortest_m=0.25, longest_m=1.5, contrast=40, size_px=512)


ROOM = Scene(
    name="room",
    objects=(
        Box(
            kind="box",
            inward=True,
            size_m=(6, 6, 6),
            x_min=GreyTexture(kind="grey", value=90),
            x_max=noise(1),
            y_min=noise(2),
            y_max=noise(3),
            bottom=noise(4),
            top=noise(5),
        ),
        Box(kind="box", position_m=(1.6, 1.2, 0), size_m=(0.5, 0.5, 1.5), yaw_deg=30, texture=noise(6)),
    ),
)


@pytest.fixture(scope="module")
def reference():
    return truth(ROOM, VIEWS[0], X, in_field(SENSOR, X), pose_2=VIEWS[1], sensor_2=SENSOR)


@pytest.fixture(scope="module")
def images():
    return tuple(render(ROOM, SENSOR, view) for view in VIEWS)


def textured(reference):
    """Pixels whose windows see texture alone."""
    return ~ndimage.maximum_filter(reference.textureless, size=WINDOW, mode=("nearest", "wrap"))


def bound_of(images, reference, sensor_2=SENSOR, **changes):
    settings = {"R_world_from_v1": VIEWS[0].R_world_from_view, "window_px": WINDOW, "sigma_grey": 1.0} | changes
    return cramer_rao(images, (SENSOR, sensor_2), MOTION, GRID, reference, **settings)


@pytest.fixture(scope="module")
def slanted(images, reference):
    return bound_of(images, reference)


# The panorama against brute force over raw pixels --------------------------------------------------------------------


def solid(points):
    """A texture that is known everywhere: grey levels of points in the world."""
    waves = np.array([[5, 2, 4], [-3, 6, 2], [6, 5, -3], [2, -4, 6]])
    return 128 + 20 * np.sin(points @ waves.T + np.arange(4)).sum(axis=-1)


def world(points_v1):
    return points_v1 @ VIEWS[0].R_world_from_view.T + VIEWS[0].position_m


@pytest.fixture(scope="module")
def solid_images():
    return solid_images_of(SENSOR)


def solid_images_of(sensor_2):
    result = []
    for view, sensor in zip(VIEWS, (SENSOR, sensor_2), strict=True):
        x, valid = pixel_directions(sensor)
        points = ranges(ROOM, view, x, valid)[..., None] * x @ view.R_world_from_view.T + view.position_m
        result.append(np.where(valid, solid(np.nan_to_num(points)), 0.0))
    return tuple(result)


def derivatives(rays_2, m):
    """Derivatives of the grey that rays from viewpoint 2 see, by the plane, gain and offset.

    Viewpoint 1 sees where the ray meets the changed plane in some direction, which on the true plane has a grey.
    """

    def grey(changed):
        met = MOTION.t_v1 + ((1 - changed @ MOTION.t_v1) / (rays_2 @ changed))[:, None] * rays_2
        return solid(world(met / (met @ m)[:, None]))

    step = 1e-5 * np.linalg.norm(m)
    by_m = [(grey(m + step * e) - grey(m - step * e)) / (2 * step) for e in np.eye(3)]
    return np.stack([*by_m, grey(m), np.ones(len(rays_2))], axis=-1)


def rows_and_columns(x):
    """Position on the panorama in pixels, whole numbers between pixels."""
    row = (GRID.z_max - x[:, 2] / np.hypot(x[:, 0], x[:, 1])) / GRID.z_pitch
    return row, (np.arctan2(x[:, 1], x[:, 0]) + np.pi) / GRID.phi_pitch


def inside(position, row, column):
    half = WINDOW / 2
    across = np.mod(position[1] - column - 0.5 + 180, 360) - 180
    return (np.abs(position[0] - row - 0.5) < half) & (np.abs(across) < half)


def windows(pixels, count, seed):
    """Pixels drawn at random, with their planes fitted to the ranges in their windows."""
    rng = np.random.default_rng(seed)
    for row, column in rng.permutation(np.argwhere(pixels))[:count]:
        rows = slice(row - WINDOW // 2, row + WINDOW // 2 + 1)
        columns = np.arange(column - WINDOW // 2, column + WINDOW // 2 + 1) % GRID.width_px
        yield row, column, rows, columns


def plane_of(reference, rows, columns):
    """m by least squares from the window's ranges: 1/d is linear in the direction."""
    x = X[rows][:, columns].reshape(-1, 3)
    return np.linalg.lstsq(x, 1 / reference.range_m[rows][:, columns].ravel(), rcond=None)[0]


def raw_pixels_1():
    x, valid = pixel_directions(SENSOR)
    return x[valid]


def raw_pixels_2(m, sensor_2=SENSOR):
    """Rays of image 2's pixels in v1's orientation, and the directions from viewpoint 1 of where they meet plane m."""
    x, valid = pixel_directions(sensor_2)
    rays = x[valid] @ MOTION.R_v2_from_v1
    scale = (1 - m @ MOTION.t_v1) / (rays @ m)
    rays, scale = rays[scale > 0], scale[scale > 0]
    return rays, normalise(MOTION.t_v1 + scale[:, None] * rays)


def quarters_1(members, m, sensor_2=SENSOR):
    """Directions of four points in each of some pixels of image 1, and what area of image 2 each pixel covers."""
    _, valid = pixel_directions(SENSOR)
    place = np.argwhere(valid)[members][:, ::-1]
    points = place[:, None] + 0.25 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])

    def in_image_2(offset):
        x, _ = unproject(SENSOR, place + offset)
        moved = x - (x @ m)[:, None] * MOTION.t_v1
        return project(sensor_2, moved @ MOTION.R_v2_from_v1.T)[0]

    jacobian = np.stack([in_image_2(e) - in_image_2(-e) for e in 0.01 * np.eye(2)], axis=-1) / 0.02
    return unproject(SENSOR, points)[0].reshape(-1, 3), np.repeat(np.abs(np.linalg.det(jacobian)), 4)


@pytest.mark.slow
@pytest.mark.parametrize("sensor_2", [SENSOR, OTHER], ids=["two equal sensors", "two sensors"])
def test_equals_the_sum_over_raw_pixels(sensor_2):
    """Against the plain formula, with derivatives of a texture that is known as a function.

    First with the same points, which tests all but the sampling; then with nothing but the raw pixels of both images.
    """
    images = solid_images_of(sensor_2)
    visible = truth(ROOM, VIEWS[0], X, in_field(SENSOR, X), pose_2=VIEWS[1], sensor_2=sensor_2)
    bounds = {model: bound_of(images, visible, sensor_2, model=model) for model in ("slanted", "frontal")}
    first = raw_pixels_1()
    on_panorama = rows_and_columns(first)
    same_points, raw_pixels, count_2 = [], [], []
    # A spline rings for some pixels beside an edge, which the function does not know of.
    away = ndimage.minimum_filter(bounds["slanted"].pixels, size=9, mode=("nearest", "wrap"))
    for row, column, rows, columns in windows(away, 100, seed=2):
        m, towards = plane_of(visible, rows, columns), X[row, column]
        members = inside(on_panorama, row, column)
        rays, met = raw_pixels_2(m, sensor_2)
        s_2 = derivatives(rays[inside(rows_and_columns(met), row, column)], m)
        s_1 = derivatives(first[members] / (first[members] @ m)[:, None] - MOTION.t_v1, m)
        assert bounds["slanted"].count_1[row, column] == len(s_1)
        count_2.append(bounds["slanted"].count_2[row, column] / len(s_2))
        points, kappa = quarters_1(members, m, sensor_2)
        both = derivatives(points / (points @ m)[:, None] - MOTION.t_v1, m) / 2

        def ratios(s_1, s_2, row=row, column=column, towards=towards):
            std = [
                least_std(s_1, s_2, np.append(towards, [0, 0]), 1.0),
                least_std(s_1[:, :3] @ towards[:, None], s_2[:, :3] @ towards[:, None], np.ones(1), 1.0),
            ]
            result = [bounds[model].range_m[row, column] for model in ("slanted", "frontal")]
            return np.array(result) / (visible.range_m[row, column] ** 2 * np.array(std))

        same_points.append(ratios(both, np.sqrt(kappa)[:, None] * both))
        raw_pixels.append(ratios(s_1, s_2))
    # The spline's share, at wavelengths of six raw pixels and more. Slant, gain and offset leave of the range's own
    # information a fortieth in the worst window; what little is wrong weighs more there.
    slanted, frontal = np.array(same_points).T
    assert np.max(np.abs(slanted - 1)) < 0.01
    assert np.max(np.abs(frontal - 1)) < 0.002
    # Image 2 is weighed by area in the bound. 40 to 600 raw pixels, each in or out, are a few per cent more or less.
    slanted, frontal = np.array(raw_pixels).T
    for ratio, spread in ((slanted, 0.1), (frontal, 0.05), (np.array(count_2), 0.1)):
        assert np.median(ratio) == pytest.approx(1, abs=0.015)
        assert np.mean(np.abs(ratio - 1) < spread) >= 0.9


@pytest.mark.slow
def test_a_window_of_mirror_pixels_equals_the_sum_over_them(solid_images, reference):
    """The same formula for a square of the mirror image, against derivatives of the known texture."""
    size = 13
    bounds = {
        model: bound_of(solid_images, reference, model=model, frame="mirror", window_px=size)
        for model in ("slanted", "frontal")
    }
    place, _ = project(SENSOR, X)
    omega, _ = pixel_directions(SENSOR)
    # A wider window on one plane, so that its corners belong to no neighbour's.
    away = ndimage.minimum_filter(bounds["slanted"].pixels & slanted_whole(reference), size=9, mode=("nearest", "wrap"))
    result = []
    for row, column, rows, columns in windows(away, 60, seed=3):
        m = plane_of(reference, rows, columns)
        u, v = np.rint(place[row, column]).astype(int)
        towards = omega[v, u]
        square = omega[v - size // 2 : v + size // 2 + 1, u - size // 2 : u + size // 2 + 1].reshape(-1, 3)
        assert bounds["slanted"].count_1[row, column] == size**2 == len(square)
        index = np.zeros(omega.shape[:2], dtype=bool)
        index[v - size // 2 : v + size // 2 + 1, u - size // 2 : u + size // 2 + 1] = True
        points, kappa = quarters_1(index[pixel_directions(SENSOR)[1]], m)
        both = derivatives(points / (points @ m)[:, None] - MOTION.t_v1, m) / 2
        other = np.sqrt(kappa)[:, None] * both
        std = [
            least_std(both, other, np.append(towards, [0, 0]), 1.0),
            least_std(both[:, :3] @ towards[:, None], other[:, :3] @ towards[:, None], np.ones(1), 1.0),
        ]
        mine = [bounds[model].range_m[row, column] for model in ("slanted", "frontal")]
        result.append(np.array(mine) / (reference.range_m[row, column] ** 2 * np.array(std)))
    # As for windows of the panorama.
    slanted, frontal = np.array(result).T
    assert np.max(np.abs(slanted - 1)) < 0.01
    assert np.max(np.abs(frontal - 1)) < 0.002


def slanted_whole(reference):
    """Pixels that have a bound for the panorama's own window too."""
    blank = tuple(np.zeros(pixel_directions(SENSOR)[1].shape) for _ in range(2))
    return bound_of(blank, reference).pixels


# Noise ---------------------------------------------------------------------------------------------------------------


def test_scales_with_the_noise(images, reference, slanted):
    doubled = bound_of(images, reference, sigma_grey=2.0)
    for name in ("alpha_2", "disparity_px", "range_m"):
        one, two = getattr(slanted, name), getattr(doubled, name)
        both = np.isfinite(two)
        np.testing.assert_allclose(two[both], 2 * one[both], rtol=1e-14)
    assert both.sum() > 0.95 * np.isfinite(one).sum()


def test_noise_pixel_by_pixel(images, reference):
    """Even noise is one sigma, whichever way it is given; twice the noise in a third of it costs up to twice there."""
    even = tuple(np.full_like(image, 2.5) for image in images)
    one, other = bound_of(images, reference, sigma_grey=2.5), bound_of(images, reference, sigma_grey=even)
    known = np.isfinite(one.range_m)
    assert other.range_m[known] == pytest.approx(one.range_m[known], rel=1e-9)
    assert other.count_1[one.pixels] == pytest.approx(one.count_1[one.pixels])
    for each in even:
        each[:, : each.shape[1] // 3] *= 2
    left = bound_of(images, reference, sigma_grey=even)
    ratio = left.range_m[known] / other.range_m[known]
    ratio = ratio[np.isfinite(ratio)]  # some windows' range is as uncertain as itself then
    assert ratio.min() == pytest.approx(1, abs=1e-9)
    assert 1.5 < ratio.max() < 2 + 1e-9


def test_knowing_more_never_hurts(images, reference, slanted):
    frontal = bound_of(images, reference, model="frontal")
    np.testing.assert_array_equal(frontal.pixels, slanted.pixels)
    both = frontal.pixels & np.isfinite(slanted.range_m)
    # 1e-9: rounding of two Schur complements.
    assert np.all(frontal.range_m[both] <= slanted.range_m[both] * (1 + 1e-9))
    assert np.median(slanted.range_m[both] / frontal.range_m[both]) > 1.02
    assert np.all(slanted.range_m[~frontal.pixels & ~np.isnan(slanted.range_m)] == np.inf)


def test_angle_and_range_agree(reference, slanted):
    step = 1e-5
    alphas = [exact_alpha_2((reference.range_m * (1 + e))[..., None] * X, MOTION.t_v1) for e in (-step, step)]
    slope = np.abs(alphas[1] - alphas[0]) / (2 * step * reference.range_m)
    finite = slanted.pixels & np.isfinite(slanted.range_m)
    # Rounding of the difference: 1e-16/1e-5 over slopes down to 1e-3.
    np.testing.assert_allclose(slanted.alpha_2[finite], (slope * slanted.range_m)[finite], rtol=1e-6)
    np.testing.assert_allclose(slanted.disparity_px, np.degrees(slanted.alpha_2), rtol=1e-12)


def test_only_windows_on_one_plane(reference, slanted):
    half, width = WINDOW // 2, GRID.width_px
    for row, column in np.random.default_rng(3).integers([0, 0], GRID.shape, size=(2000, 2)):
        whole = half <= row < GRID.height_px - half
        rows = slice(max(row - half, 0), row + half + 1)
        columns = np.arange(column - half, column + half + 1) % width
        part = [a[rows][:, columns] for a in (reference.face, reference.visible, reference.discontinuity)]
        one_plane = whole and np.all(part[0] == part[0][0, 0]) and part[1].all() and not part[2].any()
        assert slanted.pixels[row, column] == one_plane
    assert 0.3 < slanted.pixels.mean() < 0.9
    assert np.all(np.isnan(slanted.alpha_2[~slanted.pixels]))


def test_no_texture_no_bound(reference, slanted):
    near = ndimage.maximum_filter(~reference.textureless, size=WINDOW + 12, mode=("nearest", "wrap"))
    bare = slanted.pixels & ~near
    assert bare.sum() > 100
    # Six panorama pixels, twelve of the image, from the nearest texture a spline has forgotten it: 0.43^12 is left.
    assert np.all(np.isinf(slanted.disparity_px[bare]))
    assert np.all(slanted.disparity_px[slanted.pixels & textured(reference)] < 0.2)


def test_flat_images_tell_nothing(reference):
    flat = np.full((240, 320), 77.0)
    bound = bound_of((flat, flat), reference)
    assert np.all(bound.range_m[bound.pixels] == np.inf)


# Estimators ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("chip", [Chip(), Chip(saturation_e=40_000.0, bits=8)])
def test_least_squares_comes_near_it(images, reference, chip):
    """Gauss-Newton on a slanted window with gain and offset, from the truth, under noise, each pixel by its variance.

    It compares raw pixels of image 1 with a quintic spline of image 2, so it attains the bound where both images show
    the texture equally well.
    """
    draws, sigmas = 60, tuple(np.sqrt(grey_variance(image, chip, float(chip.is_ideal))) for image in images)
    slanted = bound_of(images, reference, sigma_grey=sigmas)
    chosen = textured(reference) & slanted.pixels
    first = raw_pixels_1()
    place_1 = np.argwhere(pixel_directions(SENSOR)[1])
    on_panorama = rows_and_columns(first)
    x, place, planes, at, size = [], [], [], [], []
    for row, column, rows, columns in windows(chosen, 40, seed=4):
        members = inside(on_panorama, row, column)
        x.append(first[members])
        place.append(place_1[members])
        planes.append(plane_of(reference, rows, columns))
        at.append((row, column))
        size.append(members.sum())
    x, place, planes, rows, columns = *map(np.concatenate, (x, place)), np.array(planes), *np.transpose(at)
    window, start = np.repeat(np.arange(len(size)), size), np.concatenate([[0], np.cumsum(size)[:-1]])

    def positions(m):
        moved = x - np.sum(x * m[window], axis=-1, keepdims=True) * MOTION.t_v1
        return project(SENSOR, moved @ MOTION.R_v2_from_v1.T)[0].T[::-1]

    def grey(spline, rows_columns):
        return ndimage.map_coordinates(spline, rows_columns, order=5, prefilter=False, mode="mirror")

    step = 1e-5
    motion_by_m = [(positions(planes + step * e) - positions(planes - step * e)) / (2 * step) for e in np.eye(3)]
    weight = 1 / sigmas[0][place[:, 0], place[:, 1]] ** 2
    rng, result = np.random.default_rng(5), []
    for _ in range(draws):
        noisy = [image + sigma * rng.standard_normal(image.shape) for image, sigma in zip(images, sigmas, strict=True)]
        y = noisy[0][place[:, 0], place[:, 1]]
        spline = ndimage.spline_filter(noisy[1], order=5, mode="mirror")
        m, exposure = planes.copy(), np.tile([1.0, 0.0], (len(planes), 1))
        seen_at = positions(m)
        by_row, by_column = (
            (grey(spline, seen_at + 1e-3 * e) - grey(spline, seen_at - 1e-3 * e)) / 2e-3 for e in np.eye(2)[:, :, None]
        )
        slopes = [by_row * moved[0] + by_column * moved[1] for moved in motion_by_m]
        jacobian = np.stack([*slopes, grey(spline, seen_at), np.ones(len(y))], axis=-1)
        weighted = jacobian * weight[:, None]
        normal = np.add.reduceat(weighted[:, :, None] * jacobian[:, None, :], start)
        for _ in range(3):
            residual = y - exposure[window, 0] * grey(spline, positions(m)) - exposure[window, 1]
            change = np.linalg.solve(normal, np.add.reduceat(weighted * residual[:, None], start)[..., None])[..., 0]
            m, exposure = m + change[:, :3], exposure + change[:, 3:]
        result.append(1 / np.sum(m * X[rows, columns], axis=-1))
    ratio = np.std(result, axis=0, ddof=1) / slanted.range_m[rows, columns]
    # 60 draws tell one window's to 9 %, that of all 40 together to 2 %, for windows overlap. The estimator takes its
    # slopes from the noisy spline and weighs every raw pixel alike, whatever its area on the surface.
    assert 0.95 < np.sqrt(np.mean(ratio**2)) < 1.08
    assert np.all((ratio > 0.7) & (ratio < 1.4))


# What is refused -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"window_px": 4}, "odd"),
        ({"window_px": 1}, "at least 3"),
        ({"window_px": 91}, "within the panorama"),
        ({"sigma_grey": 0.0}, "above zero"),
        ({"sigma_grey": np.nan}, "above zero"),
        ({"sigma_grey": (np.zeros((240, 320)),) * 2}, "above zero in every pixel"),
        ({"sigma_grey": (np.ones((3, 3)),) * 2}, "sigma_grey is"),
        ({"model": "curved"}, "slanted or frontal"),
    ],
)
def test_refuses_settings(images, reference, changes, message):
    with pytest.raises(ValueError, match=message):
        bound_of(images, reference, **changes)


def test_refuses_sizes_that_do_not_fit(images, reference):
    with pytest.raises(ValueError, match="the image is"):
        bound_of((images[0], images[1][1:]), reference)
    with pytest.raises(ValueError, match="the truth is"):
        cramer_rao(
            images,
            (SENSOR, SENSOR),
            MOTION,
            Grid(),
            reference,
            R_world_from_v1=np.eye(3),
            window_px=WINDOW,
            sigma_grey=1.0,
        )
