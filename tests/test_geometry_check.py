"""The verdict on a geometry: effects of errors, what lies across epipolar curves, causes, and standard deviations."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

import harness
from harness.camera.misalignment import Misalignment
from harness.camera.models import KannalaBrandt
from harness.camera.reflection import ray_directions
from harness.camera.sensor import Sensor, project
from harness.geometry.angles import angle_between, normalise
from harness.geometry.panorama import directions
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching.pair import Pair
from harness.motion.across import Across
from harness.motion.causes import MIRROR, directions_aside, effects_of, fit_causes
from harness.motion.residuals import Turn
from harness.pipeline.geometry_check import Verdict, check_geometry
from harness.pipeline.geometry_cost import cost_of

SENSOR = Sensor()
MOTION = relative_motion(Pose(), Pose(position_m=(0.4, 0.25, 0.05), yaw_deg=70.0, pitch_deg=2.0))
TURN = Turn(MOTION.R_v2_from_v1, normalise(MOTION.t_v1))
STEP = 1e-5


def _points(count=200):
    """Directions from view 1 and planes, inverse ranges in 1/|t|, of points that both views see."""
    rng = np.random.default_rng(5)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(-50, 15, count))
    x = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1)
    w = rng.uniform(0.05, 0.4, count)
    planes = w[:, None] * x + rng.normal(0, 0.1, (count, 3)) @ (np.eye(3) * 0.3)
    planes += (w - np.sum(planes * x, axis=1))[:, None] * x
    in_view = project(SENSOR, (x - w[:, None] * TURN.t) @ TURN.R.T)[1] & (angle_between(x, TURN.t) > 0.3)
    in_view &= np.pi - angle_between(x, TURN.t) > 0.3
    return x[in_view], planes[in_view]


def _tiles(x, planes, delta=None):
    count = len(x)
    return Across(
        tiles=np.zeros((count, 2), np.int64),
        x_1=x,
        planes=planes,
        delta=np.zeros(count) if delta is None else delta,
        sigma=np.full(count, 1e-4),
        px_per_rad=np.full(count, 200.0),
        aside=np.zeros(count),
    )


def _apparent(x, planes, sensor, turn):
    """Across and inverse range that a geometry makes of the true pixels, less the true inverse range there."""
    w = np.sum(planes * x, axis=1)
    pixels = [project(SENSOR, x)[0], project(SENSOR, (x - w[:, None] * TURN.t) @ TURN.R.T)[0]]
    x_1, x_2 = (ray_directions(sensor, each)[0] for each in pixels)
    y = x_2 @ turn.R
    n = normalise(np.cross(turn.t, x_1))
    across = np.arcsin(np.sum(n * y, axis=1))
    alpha_1, alpha_2 = angle_between(x_1, turn.t), angle_between(y - np.sum(n * y, axis=1)[:, None] * n, turn.t)
    return across, np.sin(alpha_2 - alpha_1) / np.sin(alpha_2) - np.sum(planes * x_1, axis=1)


def _with_errors(change):
    """The same of several errors, of the sensor or of the motion."""
    sensor, turn = SENSOR, TURN
    for name, size in change.items():
        one, other = _with_error(name, size)
        camera = {
            key: getattr(sensor.camera, key) + getattr(one.camera, key) - getattr(SENSOR.camera, key)
            for key in ("cx_px", "cy_px")
        }
        sensor = sensor.model_copy(update={"camera": sensor.camera.model_copy(update=camera)})
        turn = Turn(turn.R @ TURN.R.T @ other.R, normalise(turn.t + other.t - TURN.t))
    return sensor, turn


def _with_error(name, size):
    """Sensor and motion that are off by an error, which this computes from its definition alone."""
    camera, turn = SENSOR.camera, TURN
    if name.startswith("mirror"):
        return SENSOR.model_copy(update={"misalignment": Misalignment(**{f"{name[-1]}_mm": size})}), TURN
    if name.startswith("turn"):
        omega = size * np.eye(3)["xyz".index(name[-1])]
        return SENSOR, Turn(TURN.R @ Rotation.from_rotvec(omega).as_matrix(), TURN.t)
    if name.startswith("t "):
        return SENSOR, Turn(TURN.R, normalise(TURN.t + size * directions_aside(TURN.t)[name == "t up"]))
    change = {
        "centre u": {"cx_px": camera.cx_px + size},
        "centre v": {"cy_px": camera.cy_px + size},
    }[name]
    return SENSOR.model_copy(update={"camera": camera.model_copy(update=change)}), turn


@pytest.mark.parametrize("name", ["turn x", "turn y", "turn z", "t aside", "t up", "centre u", "centre v"])
def test_effects_are_differences_of_the_whole_geometry(name):
    x, planes = _points()
    effects = effects_of(x, planes, (SENSOR, SENSOR), TURN)
    column = effects.names.index(name)
    ahead, behind = (_apparent(x, planes, *_with_error(name, sign * STEP)) for sign in (1, -1))
    for mine, plus, minus in zip((effects.across, effects.w), ahead, behind, strict=True):
        # Central differences: truncation STEP², rounding 1e-12/STEP, each times some ten.
        np.testing.assert_allclose(mine[:, column], (plus - minus) / (2 * STEP), rtol=1e-5, atol=3e-7)


@pytest.mark.parametrize(
    "change",
    [
        {"turn z": np.radians(2.0)},
        {"t aside": np.radians(8.0)},
        {"centre u": 1.0, "t up": np.radians(-2.0)},
    ],
    ids=", ".join,
)
def test_large_errors_are_undone(change):
    x, planes = _points()
    sensor, turn = _with_errors(change)
    across, off = _apparent(x, planes, sensor, turn)
    pixels = project(SENSOR, x)[0]
    seen = ray_directions(sensor, pixels)[0]
    w_seen, w_true = np.sum(planes * seen, axis=1) + off, np.sum(planes * seen, axis=1)
    slopes = planes + (w_seen - np.sum(planes * seen, axis=1))[:, None] * seen
    effects = effects_of(seen, slopes, (sensor, sensor), turn)
    theta = np.zeros(len(effects.names))
    for name, size in change.items():
        theta[effects.names.index(name)] = size
    undone = np.abs(effects.true_inverse_range(theta) - w_true)
    to_first_order = np.abs(w_seen - effects.w @ theta - w_true)
    # What is left is of second order in the angle across, and in the pixels' spreads.
    assert np.median(undone) < 0.01 * np.median(np.abs(off))
    assert np.median(undone) < 0.3 * np.median(to_first_order)
    assert np.median(np.abs(across)) > 1e-3


@pytest.mark.parametrize("name", MIRROR)
def test_a_displaced_mirror_turns_rays_as_reflection_does(name):
    x, planes = _points()
    effects = effects_of(x, planes, (SENSOR, SENSOR), TURN)
    column, step_mm = effects.names.index(name), 1e-3
    ahead, behind = (_apparent(x, planes, *_with_error(name, sign * step_mm)) for sign in (1, -1))
    for mine, plus, minus in zip((effects.across, effects.w), ahead, behind, strict=True):
        slope = (plus - minus) / (2 * step_mm)
        # Rays are those of reflection, but they start up to 0.5 mm off the focus for a millimetre, which at 10 m is
        # 5e-5 rad: two hundredths of what the least of the three turns them by.
        np.testing.assert_allclose(mine[:, column], slope, atol=2e-4)
        assert np.abs(slope).max() > 20 * 2e-4


def test_only_a_hyperboloid_can_be_displaced():
    x, planes = _points()
    lens = Sensor(model=KannalaBrandt(k1=0, k2=0, k3=0, k4=0), camera=SENSOR.camera)
    alike, one_of_each = (effects_of(x, planes, each, TURN).names for each in ((lens, lens), (SENSOR, lens)))
    assert not set(MIRROR) & set(alike)
    assert [name for name in one_of_each if name.startswith("mirror")] == list(MIRROR)
    assert "skew of view 2" in one_of_each


def test_a_focal_length_moves_pixels_along_the_radius():
    x, planes = _points()
    effects = effects_of(x, planes, (SENSOR, SENSOR), TURN)
    camera = SENSOR.camera
    centre = [camera.cx_px, camera.cy_px]
    seen_at = x, (x - np.sum(planes * x, axis=1)[:, None] * TURN.t) @ TURN.R.T
    outermost = max(np.linalg.norm(project(SENSOR, each)[0] - centre, axis=1).max() for each in seen_at)
    ratio = STEP / outermost  # pixels of error at the outermost tile
    ahead, behind = (
        _apparent(x, planes, SENSOR.model_copy(update={"camera": camera.model_copy(update={"focal_px": f})}), TURN)
        for f in (camera.focal_px * (1 + ratio), camera.focal_px * (1 - ratio))
    )
    column = effects.names.index("focal length")
    # As above; that a focal length is off by a share of itself is exact to first order.
    np.testing.assert_allclose(effects.across[:, column], (ahead[0] - behind[0]) / (2 * STEP), rtol=1e-5, atol=3e-7)
    np.testing.assert_allclose(effects.w[:, column], (ahead[1] - behind[1]) / (2 * STEP), rtol=1e-5, atol=3e-7)


@pytest.mark.parametrize(
    ("name", "size", "cause"),
    [
        ("turn z", np.radians(0.25), "the rotation"),
        ("t aside", np.radians(3.0), "the direction of t"),
        ("centre u", 1 / 3, "the centre"),
    ],
)
def test_causes_are_told(name, size, cause):
    x, planes = _points()
    # What is across is the prediction of the wrong geometry, as tiles are fitted to it.
    across, _ = _apparent(x, planes, *_with_error(name, size))
    noise = np.random.default_rng(3).normal(0, 1e-4, len(x))
    causes = fit_causes(_tiles(x, planes, across + noise), (SENSOR, SENSOR), TURN)
    best = causes.likely[0]
    assert best.name == cause
    # To first order, and against noise of 1e-4 rad over 150 tiles.
    assert best.errors[name] == pytest.approx(size, rel=0.05)


@pytest.mark.parametrize("name", MIRROR)
def test_a_displaced_mirror_is_among_the_causes(name):
    x, planes = _points()
    across, _ = _apparent(x, planes, *_with_error(name, 0.3))
    noise = np.random.default_rng(3).normal(0, 1e-4, len(x))
    causes = fit_causes(_tiles(x, planes, across + noise), (SENSOR, SENSOR), TURN)
    likely = {each.name: each for each in causes.likely}
    # A centre or a focal length that is off looks much the same.
    mirror = likely["the mirror's position"]
    # Of 0.3 mm: to first order, and rays start off the focus, which a displacement of 0.01 mm makes up for.
    assert mirror.errors[name] == pytest.approx(0.3, abs=0.03)


def test_noise_alone_has_no_cause():
    x, planes = _points()
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 1e-4, len(x))
        causes = fit_causes(_tiles(x, planes, noise), (SENSOR, SENSOR), TURN)
        assert not causes.significant
        assert not causes.theta.any()


# -- What errors do to ranges ------------------------------------------------------------------------------------------

WIDE = harness.Grid(width_px=180, height_px=50)
HALF_M = np.array([2.5, 2.0, 1.2])


def _box():
    """Directions of a panorama, and the planes of a box's walls there, in 1/|t|."""
    x = directions(WIDE)
    walls = np.sign(x) * HALF_M / np.where(x == 0, 1e-9, x)
    axis = np.argmin(walls, axis=-1)
    planes = np.sign(np.take_along_axis(x, axis[..., None], -1)) * np.eye(3)[axis] / HALF_M[axis][..., None]
    return x, planes * MOTION.baseline_m


@pytest.mark.slow
@pytest.mark.parametrize("names", [("turn x", "turn y", "turn z"), ("t aside", "t up"), ("centre u", "centre v")])
def test_sigma_covers_two_thirds_of_what_an_error_does(names):
    """Against ranges that a geometry with the error triangulates."""
    x, planes = (each.reshape(-1, 3) for each in _box())
    w = np.sum(planes * x, axis=1)
    in_view = project(SENSOR, x)[1] & project(SENSOR, (x - w[:, None] * TURN.t) @ TURN.R.T)[1]
    in_view &= np.sin(angle_between(x, TURN.t)) > 0.3
    range_m = np.where(in_view, MOTION.baseline_m / w, np.nan).reshape(WIDE.shape)
    some = np.flatnonzero(in_view)[::11]
    for seed in range(4):
        draws = np.random.default_rng(seed)
        sizes = np.radians(0.1) if names[0].startswith("turn") else np.radians(0.5) if names[0][:2] == "t " else 0.3
        way = draws.normal(size=len(names))
        change = dict(zip(names, sizes * way / np.linalg.norm(way), strict=True))
        sensor, turn = _with_errors(change)
        across, off = np.full(len(x), np.nan), np.full(len(x), np.nan)
        across[in_view], off[in_view] = _apparent(x[in_view], planes[in_view], sensor, turn)
        noise = draws.normal(0, 1e-4, len(some))
        tiles = _tiles(x[some], planes[some], across[some] + noise)
        causes = fit_causes(tiles, (SENSOR, SENSOR), TURN)
        cost = cost_of(tiles, causes, (SENSOR, SENSOR), MOTION, WIDE, (range_m, 1e-5 * range_m))
        share = cost.everywhere(WIDE, MOTION.baseline_m / range_m).ravel()
        np.testing.assert_array_equal(np.isfinite(share), in_view)
        covered = np.mean(np.abs(off / w)[in_view] < share[in_view])
        # 68 %, and 3 % for _UNDERSTATED, for which there is no matcher here. The pattern of one error is smooth, and
        # the fit's own errors move its quantile. Where another error explains as much, the costlier of them counts.
        assert covered > 0.64
        assert covered < (0.8 if len(causes.likely) == 1 else 1.0)


# -- On images ---------------------------------------------------------------------------------------------------------

SMALL = Sensor.model_validate(
    {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.0, "cx_px": 159.5, "cy_px": 119.5}}
)
GRID = harness.Grid(width_px=360, height_px=100)
POSES = {"position_m": (0.0, 0.0, 1.0)}, {"position_m": (0.4, 0.25, 1.05), "yaw_deg": 70.0}


@pytest.fixture(scope="module")
def pair():
    return tuple(harness.render("box", sensor=SMALL, samples=4, grid=GRID, **pose) for pose in POSES)


def estimated(pair, sensor=SMALL, yaw_deg=0.0, noise=2.0):
    motion = relative_motion(*(each.pose for each in pair))
    R = motion.R_v2_from_v1 @ Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    rng = np.random.default_rng(1)
    images = [(each.image + rng.normal(0, noise, each.image.shape)).astype(np.float32).clip(0, 255) for each in pair]
    return harness.estimate_range(*images, sensor, Motion(R, motion.t_v1), "slanted", grid=GRID)


def within_one_sigma(pair, sigma_m, range_m):
    error = np.abs(range_m - pair[0].panorama_range_m) / sigma_m
    return np.mean(error[np.isfinite(error)] < 1)


@pytest.mark.slow
def test_a_right_geometry_is_ok_and_costs_nothing(pair):
    estimate = estimated(pair)
    assert estimate.geometry.verdict == Verdict.OK
    assert not estimate.sigma_geometry_m[estimate.valid].any()
    np.testing.assert_array_equal(estimate.sigma_m, estimate.sigma_matching_m)
    # The noise's part is as large as what is measured, within the spread of 100 tiles' median.
    assert estimate.geometry.noise_px == pytest.approx(estimate.geometry.rms_px, rel=0.5)
    assert estimate.summary()["geometry"]["verdict"] == "ok"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ({"yaw_deg": 0.5}, "the rotation"),
        (
            {"sensor": SMALL.model_copy(update={"camera": SMALL.camera.model_copy(update={"cx_px": 159.8})})},
            "the centre",
        ),
    ],
)
def test_a_wrong_geometry_is_said_and_counted_in(pair, fault, cause):
    estimate = estimated(pair, **fault)
    check = estimate.geometry
    assert check.verdict in {Verdict.DOUBTFUL, Verdict.WRONG}
    assert check.likely[0] == cause
    assert cause in " ".join(check.lines())
    assert within_one_sigma(pair, estimate.sigma_matching_m, estimate.range_m) < 0.3
    # The geometry's part is made for two thirds; its pattern is smooth, so that shares of a pair vary.
    assert 0.5 < within_one_sigma(pair, estimate.sigma_m, estimate.range_m) < 0.95
    assert len(check.table()) == len(check.tiles)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [10.0, 20.0, 30.0])
def test_a_right_geometry_in_noise_is_right(pair, noise):
    estimate = estimated(pair, noise=noise)
    check = estimate.geometry
    assert check.verdict == Verdict.OK
    assert not check.contradicted
    assert len(check.lines()) == 1
    # A median of 60 to 100 tiles varies by some 15 %, and texture as fine as pixels counts as noise in the gradients.
    assert 0.8 < check.noise_px / check.rms_px < 2.0


@pytest.mark.slow
def test_pixels_that_are_not_finite_do_not_change_the_verdict(pair):
    images = [each.image.astype(np.float32) for each in pair]
    images[0][100:104, 60:64] = np.nan
    seen = Pair((images[0], images[1]), (SMALL, SMALL), relative_motion(*(each.pose for each in pair)), GRID)
    range_m = pair[0].panorama_range_m
    check = check_geometry(seen, range_m, 0.01 * range_m)
    assert check.verdict == Verdict.OK
    assert len(check.tiles) > 100


@pytest.mark.slow
def test_a_wrong_geometry_in_noise_is_wrong(pair):
    check = estimated(pair, yaw_deg=1.0, noise=20.0).geometry
    assert check.verdict in {Verdict.DOUBTFUL, Verdict.WRONG}
    assert check.rms_px > 1.5 * check.noise_px


@pytest.mark.slow
@pytest.mark.parametrize("noise", [2.0, 20.0])
def test_ranges_at_which_the_views_do_not_look_alike_contradict_the_geometry(pair, noise):
    rng = np.random.default_rng(1)
    images = [(each.image + rng.normal(0, noise, each.image.shape)).astype(np.float32).clip(0, 255) for each in pair]
    seen = Pair((images[0], images[1]), (SMALL, SMALL), relative_motion(*(each.pose for each in pair)), GRID)
    range_m = pair[0].panorama_range_m
    assert not check_geometry(seen, range_m, 0.01 * range_m).contradicted
    check = check_geometry(seen, 0.4 * range_m, 0.01 * range_m)
    assert check.verdict == Verdict.UNKNOWN
    assert check.contradicted
    assert f"{check.counts.tried - check.counts.alike} of {check.counts.tried}" in check.lines()[-1]


def _bent(image, rms_px, seed):
    """The image after a smooth random distortion, which is no error of a motion or of a camera's parameters."""
    draws = np.random.default_rng(seed)
    shift = ndimage.gaussian_filter(draws.normal(size=(2, *image.shape)), (0, 12, 12))
    rows, columns = np.indices(image.shape)
    v, u = shift * (rms_px / shift.std())
    return ndimage.map_coordinates(image, [rows + v, columns + u], order=3, mode="nearest")


@pytest.mark.slow
def test_what_no_error_explains_is_said_and_counted_in(pair):
    motion = relative_motion(*(each.pose for each in pair))
    alone, both = [], []
    for seed in range(4):
        images = [pair[0].image, _bent(pair[1].image, 0.3, seed).astype(np.float32).clip(0, 255)]
        estimate = harness.estimate_range(*images, SMALL, motion, "slanted", grid=GRID)
        check = estimate.geometry
        assert check.verdict in {Verdict.DOUBTFUL, Verdict.WRONG}
        assert check.noise_px < 0.1
        if not check.likely:
            assert "explained by no error" in check.lines()[1]
            # Across a curve it is 0.3 px; tiles average over a part of its waves, and a tenth is each draw's own.
            assert 0.2 < check.causes.unexplained_px < 0.36
        alone.append(within_one_sigma(pair, estimate.sigma_matching_m, estimate.range_m))
        both.append(within_one_sigma(pair, estimate.sigma_m, estimate.range_m))
    assert max(alone) < 0.35
    # An image holds some 40 waves, so that a draw's share varies by a tenth.
    assert 0.58 < np.mean(both) < 0.8


@pytest.fixture(scope="module")
def corridor():
    """Smooth walls of little contrast, on which noise that neighbouring pixels share does most."""
    return tuple(harness.render("corridor", sensor=SMALL, samples=4, grid=GRID, **pose) for pose in POSES)


def _with_shared_noise(images, sigma, seed):
    draws = np.random.default_rng(seed)
    for image in images:
        noise = ndimage.gaussian_filter(draws.normal(size=image.shape), 0.7)
        yield np.rint(image + noise * (sigma / noise.std())).clip(0, 255).astype(np.float32)


@pytest.mark.slow
def test_a_right_geometry_in_noise_that_neighbours_share_is_right(corridor):
    """As cameras deliver it: demosaiced, denoised, compressed."""
    motion = relative_motion(*(each.pose for each in corridor))
    for seed in range(2):
        images = _with_shared_noise([each.image for each in corridor], 8.0, seed)
        check = harness.estimate_range(*images, SMALL, motion, "slanted", grid=GRID).geometry
        assert check.verdict == Verdict.OK
        assert len(check.lines()) == 1
        assert 0.6 < check.noise_px / check.rms_px < 1.6


def test_images_without_texture_give_no_verdict():
    images = [np.full((240, 320), 128.0, np.float32)] * 2
    estimate = harness.estimate_range(*images, SMALL, (0.5, 0, 0), "column", grid=GRID)
    assert estimate.geometry.verdict == Verdict.UNKNOWN
    assert "no texture" in estimate.geometry.lines()[0]
    assert estimate.summary()["geometry"]["across_rms_px"] is None
