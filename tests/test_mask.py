"""A mask: what it hides is neither rendered, unwrapped, matched nor scored, and nothing else changes."""

import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from harness.camera.sensor import Sensor, in_use, pixel_directions, project, unproject, used
from harness.camera.unwrap import unwrap
from harness.errors import InputError
from harness.geometry.panorama import directions
from harness.io.calibrations.sensors import load_sensor
from harness.matching.interface import Reason
from harness.matching.opencv.settings import StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted.settings import Slanted
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.rendered_view import view_of
from harness.pipeline.sight import check_sensor
from harness.pipeline.specification import Trial
from harness.pipeline.stages import StageKeys, setup_of
from harness.pipeline.trial import MATCH, NOISE, PAIR, RENDER, TRUTH, run_trial
from harness.simulation.noise import words_of
from harness.simulation.scene import load_scene
from harness.spec import as_table, parse
from harness.testing.pairs import GRID, SENSOR, TURNED, fresh, scenery

ARM = np.s_[96:130, 70:92]
"""Rows and columns of what a robot's arm covers: from 16 pixels below the middle to 50."""

MATCHERS = {
    "window": WindowMatcher(),
    "column": WindowMatcher(kind="column"),
    "sgm": SemiGlobal(),
    "slanted": Slanted(),
    "opencv-sgbm": StereoSGBM(),
    "opencv-bm": StereoBM(),
    "opencv-reconstruct": StereoReconstruct(),
}


def write_mask(path, hidden=ARM, shape=(160, 160)):
    levels = np.full(shape, 255, np.uint8)
    levels[hidden] = 0
    Image.fromarray(levels).save(path)
    return path


@pytest.fixture(scope="module")
def mask(tmp_path_factory):
    return write_mask(tmp_path_factory.mktemp("mask") / "arm.png")


@pytest.fixture(scope="module")
def masked(mask):
    return SENSOR.with_mask(mask)


# --- The sensor ---------------------------------------------------------------------------------------------------


def test_a_masked_pixel_sees_nothing(masked):
    free = pixel_directions(SENSOR)[1]
    expected = free.copy()
    expected[ARM] = False
    x, valid = pixel_directions(masked)
    assert np.array_equal(valid, expected)
    assert np.array_equal(x, pixel_directions(SENSOR)[0], equal_nan=True)
    # Between pixels the nearest one decides.
    rng = np.random.default_rng(0)
    pixels = rng.uniform(-3, 163, (20_000, 2))
    towards, visible = unproject(masked, pixels)
    column, row = np.clip(np.rint(pixels).astype(int), 0, 159).T
    assert np.array_equal(visible, unproject(SENSOR, pixels)[1] & used(masked)[row, column])
    assert np.array_equal(project(masked, towards)[1][visible], np.ones(visible.sum(), bool))
    hidden = unproject(SENSOR, pixels)[1] & ~visible
    assert hidden.sum() > 100
    assert not project(masked, towards)[1][hidden].any()


def test_what_is_in_use_goes_on_beyond_the_image(masked):
    wide = masked.model_copy(update={"camera": masked.camera.model_copy(update={"focal_px": 400.0})})
    x = directions(GRID)
    pixels, visible = project(wide, x)
    inside = in_use(wide, x)
    assert (inside & ~visible).any()
    row, column = (np.rint(pixels[..., i]).astype(int) for i in (1, 0))
    hit = (row >= 96) & (row < 130) & (column >= 70) & (column < 92)
    assert hit.any()
    free = wide.model_copy(update={"mask": None})
    assert np.array_equal(inside, in_use(free, x) & ~hit)


@pytest.mark.parametrize(("level", "expected"), [(0, False), (127, False), (128, True), (255, True)])
def test_white_is_used_and_soft_edges_are_cut_in_the_middle(tmp_path, level, expected):
    Image.fromarray(np.full((160, 160), level, np.uint8)).save(tmp_path / "even.png")
    assert used(SENSOR.with_mask(tmp_path / "even.png")).all() == expected


def test_other_formats_of_8_bits_will_do(tmp_path, masked):
    picture = Image.open(masked.mask.file)
    picture.convert("1").save(tmp_path / "two.png")
    picture.save(tmp_path / "grey.jpg", quality=95)
    for name in ("two.png", "grey.jpg"):
        assert np.array_equal(used(SENSOR.with_mask(tmp_path / name)), used(masked))


def damaged(folder):
    Image.fromarray(np.zeros((160, 160, 3), np.uint8)).save(folder / "colour.png")
    Image.fromarray(np.zeros((160, 160), np.uint16)).save(folder / "deep.png")
    write_mask(folder / "small.png", shape=(100, 80), hidden=np.s_[:5])
    (folder / "text.png").write_text("white")
    (folder / "folder.png").mkdir()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("absent.png", "no such file"),
        ("colour.png", "must be an 8-bit grey image, white where pixels are used; this one has colours"),
        ("deep.png", "must be an 8-bit grey image, white where pixels are used; this one has more than 8 bits"),
        ("small.png", "the image is 80x100 pixels, the masked sensor 160x160"),
        ("text.png", "cannot be read as an image"),
        ("folder.png", "is not a regular file"),
    ],
)
def test_what_is_no_mask_is_said_in_a_line(tmp_path, name, said):
    damaged(tmp_path)
    with pytest.raises(InputError) as caught:
        SENSOR.with_mask(tmp_path / name)
    assert str(caught.value).startswith("mask: '")
    assert name in str(caught.value)
    assert said in str(caught.value)
    path = tmp_path / "sensor.toml"
    camera = SENSOR.camera.model_dump()
    path.write_text(f'mask = "{name}"\n[camera]\n' + "\n".join(f"{key} = {value}" for key, value in camera.items()))
    with pytest.raises(InputError) as caught:
        load_sensor(path)
    assert str(caught.value).startswith(f"{path}: mask: '")
    assert said in str(caught.value)


def test_a_mask_is_no_number():
    with pytest.raises(InputError, match="mask: must be the path of an image, in quotes; found 3"):
        parse(Sensor, {"mask": 3})


def test_a_mask_that_changes_is_noticed_and_never_mixed(tmp_path):
    path = write_mask(tmp_path / "arm.png")
    before = SENSOR.with_mask(path)
    assert used(before).sum() == 160**2 - used(before)[ARM].size
    write_mask(path, np.s_[:50])
    after = SENSOR.with_mask(path)
    assert before != after
    assert used(after).sum() == 110 * 160
    assert used(before).sum() == 160**2 - used(before)[ARM].size  # it was read when it was that
    write_mask(path, np.s_[:60])
    with pytest.raises(InputError, match=r"arm\.png: has changed since the sensor was read"):
        used(after.model_copy(update={"camera": after.camera.model_copy(update={"width_px": 161})}))


def test_a_mask_is_its_contents_wherever_it_lies(tmp_path, masked):
    elsewhere = SENSOR.with_mask(write_mask(tmp_path / "copy.png"))
    assert elsewhere == masked
    assert hash(elsewhere) == hash(masked)
    assert elsewhere != SENSOR.with_mask(write_mask(tmp_path / "copy.png", np.s_[:1]))


def test_a_mask_that_hides_everything_is_blamed(tmp_path):
    blind = SENSOR.with_mask(write_mask(tmp_path / "black.png", np.s_[:]))
    with pytest.raises(InputError, match=r"sensor: no pixel.*; sensor\.mask hides it all: pixels in use must be white"):
        check_sensor(blind, GRID)


# --- Images -------------------------------------------------------------------------------------------------------


def test_a_rendered_view_has_nothing_there_and_is_the_same_elsewhere(masked):
    scene, pose = load_scene("box"), Trial(scene=load_scene("box")).view_1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        free, view = (view_of(scene, each, pose, samples=4, grid=GRID) for each in (SENSOR, masked))
    keeps = used(masked)
    assert not view.image[ARM].any()
    assert np.isnan(view.range_m[ARM]).all()
    assert np.array_equal(view.image[keeps], free.image[keeps])
    assert np.array_equal(view.range_m[keeps], free.range_m[keeps], equal_nan=True)
    lost = np.isnan(view.panorama) & ~np.isnan(free.panorama)
    unseen = np.isnan(view.panorama_range_m) & ~np.isnan(free.panorama_range_m)
    assert lost.any()
    # A panorama's pixel that looks at a masked pixel is made of it; one that is made of it may look at the next one.
    assert not (unseen & ~np.isnan(view.panorama)).any()
    assert (ndimage.binary_dilation(unseen, np.ones((5, 5))) | ~lost).all()
    stays = ~np.isnan(view.panorama)
    assert np.array_equal(view.panorama[stays], free.panorama[stays])


@pytest.mark.parametrize("interpolation", ["bilinear", "cubic"])
def test_nothing_that_a_mask_hides_enters_a_panorama(masked, interpolation):
    image = np.random.default_rng(0).uniform(0, 255, (160, 160)).astype(np.float32)
    other = image.copy()
    other[ARM] = np.random.default_rng(1).uniform(0, 255, other[ARM].shape)
    one, two = (unwrap(each, masked, GRID, interpolation=interpolation) for each in (image, other))
    assert np.array_equal(one.values, two.values)
    assert np.array_equal(one.valid, two.valid)
    free = unwrap(image, SENSOR, GRID, interpolation=interpolation)
    assert (free.valid & ~one.valid).any()
    assert not (one.valid & ~free.valid).any()
    # The spline's prefilter falls by 3.7 a pixel.
    atol = 0 if interpolation == "bilinear" else 1e-3
    far = one.valid & ~ndimage.binary_dilation(free.valid & ~one.valid, np.ones((41, 41)))
    np.testing.assert_allclose(one.values[far], free.values[far], rtol=0, atol=atol)


# --- Matching -----------------------------------------------------------------------------------------------------


@lru_cache
def answer(kind, sensor=SENSOR, seed=None, fill=0):
    """What a matcher makes of the turned pair if both cameras have a mask; the arm is `fill` or noise."""
    pair = fresh(scenery(TURNED).pair)
    images = [image.copy() for image in pair.images]
    if sensor.mask is not None:
        for image in images:
            image[ARM] = fill if seed is None else np.random.default_rng(seed).uniform(0, 255, image[ARM].shape)
    pair = replace(pair, images=tuple(images), sensors=(sensor, sensor))
    return pair, MATCHERS[kind].match(pair)


def hidden_in_view_1(sensor):
    x = directions(GRID)
    return project(SENSOR, x)[1] & ~project(sensor, x)[1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", MATCHERS)
def test_nothing_that_a_mask_hides_enters_a_match(masked, kind):
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    (_, one), (_, two) = answer(kind, masked), answer(kind, masked, seed=1)
    assert np.array_equal(one.alpha_2, two.alpha_2, equal_nan=True)
    assert np.array_equal(one.reasons, two.reasons)
    for name in ("confidence", "sigma_alpha_2"):
        if getattr(one, name) is not None:
            assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
    hidden = hidden_in_view_1(masked)
    assert hidden.sum() > 300
    assert np.isnan(one.alpha_2[hidden]).all()
    assert (one.reasons[hidden] != Reason.MATCHED).all()


REACH_PX = 26
"""Pixels of the mirror image that the widest window reaches: the slanted one has 17, and may be moved by 8. Those of 11
panorama pixels and a filter's 6 are 12 to 20 here."""


def away_from_mask(sensor, pair, matcher):
    """Pixels of the panorama that are far from the mask in view 1, and in view 2 at all ranges that are searched."""
    distance = ndimage.distance_transform_cdt(used(sensor), "chessboard")

    def far(x):
        pixels = np.nan_to_num(project(SENSOR, x)[0])
        column, row = np.moveaxis(np.clip(np.rint(pixels).astype(int), 0, 159), -1, 0)
        return distance[row, column] > REACH_PX

    x = directions(GRID)
    away = far(x)
    for inverse in np.linspace(1 / matcher.d_max_m, 1 / matcher.d_min_m, 12):
        away &= far((x - inverse * pair.t_v1) @ pair.motion.R_v2_from_v1.T)
    return away


@pytest.mark.slow
@pytest.mark.parametrize("kind", MATCHERS)
def test_a_mask_costs_nothing_elsewhere(masked, kind):
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    (pair, with_mask), (_, free) = answer(kind, masked), answer(kind)
    away = away_from_mask(masked, pair, MATCHERS[kind])
    assert away.mean() > 0.3
    if kind == "sgm":  # its planes reach further on the panorama
        away = ndimage.minimum_filter(away, MATCHERS[kind].plane_px, mode=("nearest", "wrap"))
    if kind in {"window", "column", "sgm"}:
        assert np.array_equal(with_mask.alpha_2[away], free.alpha_2[away], equal_nan=True)
        assert np.array_equal(with_mask.reasons[away], free.reasons[away])
        return
    # Planes go from window to window, step by step, and OpenCV's paths run across all of the image: what is left of the
    # mask's border there is a few thousandths of a column, and a pixel or two beside a threshold.
    one, two = np.isfinite(with_mask.alpha_2), np.isfinite(free.alpha_2)
    assert (one != two)[away].mean() < 0.003
    moved = np.abs(with_mask.alpha_2 - free.alpha_2)[away & one & two] / GRID.phi_pitch
    assert np.mean(moved > 0.05) < 0.005
    assert np.max(moved) < 1.0


# --- In the pipeline ----------------------------------------------------------------------------------------------

CAMERA = {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}
SIZES = {"panorama": {"width_px": 180, "height_px": 50}, "render": {"samples": 4}, "noise": {"sigma_grey": 2.0}}
HIDDEN = np.s_[70:105, 60:75]


def trial(mask=None, **changes):
    sensor = {"camera": CAMERA} | ({} if mask is None else {"mask": str(mask)})
    return parse(Trial, {"scene": as_table(load_scene("box")), "sensor": sensor, **SIZES, **changes})


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_mask(tmp_path_factory.mktemp("small") / "arm.png", HIDDEN, (120, 160))


def test_a_trial_counts_its_mask_by_the_contents(small, tmp_path):
    free, one = trial(), trial(small)
    assert one.key == trial(write_mask(tmp_path / "copy.png", HIDDEN, (120, 160))).key
    other = trial(write_mask(tmp_path / "other.png", np.s_[:3], (120, 160)))
    second = trial(sensor_2={"camera": CAMERA, "mask": str(small)})
    assert len({each.key for each in (free, one, other, second)}) == 4
    keys = [StageKeys(setup_of(each)) for each in (free, one, other, second)]
    for stage in (RENDER, NOISE, TRUTH, PAIR, MATCH):
        made = {tuple(each.of(stage, view) for view in stage.views) for each in keys}
        assert len(made) == 4, stage.name
    assert keys[0].of(NOISE, 0) == keys[3].of(NOISE, 0)
    assert words_of(one.sensor) == words_of(free.sensor)


def test_what_is_masked_is_neither_seen_nor_scored(small):
    free, one = run_trial(trial()), run_trial(trial(small))
    keeps = used(one.trial.sensor)
    for image, other in zip(one.images, free.images, strict=True):
        assert not image[HIDDEN].any()
        assert np.array_equal(image[keeps], other[keeps])  # with the same noise
    x = directions(one.trial.panorama)
    hidden_1 = in_use(free.trial.sensor, x) & ~in_use(one.trial.sensor, x)
    assert hidden_1.sum() > 200
    assert np.isnan(one.truth.range_m[hidden_1]).all()
    assert not one.reference.domain[hidden_1].any()
    assert not one.valid[hidden_1].any()
    stays = ~hidden_1
    assert np.array_equal(one.truth.range_m[stays], free.truth.range_m[stays], equal_nan=True)
    assert np.array_equal(one.truth.unoccluded[stays], free.truth.unoccluded[stays])
    # View 2: where it sees the true point, by the projection of the point itself.
    motion = one.trial.true_motion
    points = np.nan_to_num(free.truth.range_m)[..., None] * x
    pixels, _ = project(free.trial.sensor, (points - motion.t_v1) @ motion.R_v2_from_v1.T)
    row, column = (np.clip(np.rint(pixels[..., i]).astype(int), 0, n - 1) for i, n in ((1, 120), (0, 160)))
    expected = free.truth.in_field_2 & keeps[row, column]
    assert (free.truth.in_field_2 & ~expected).sum() > 200
    assert np.array_equal(one.truth.in_field_2[stays], expected[stays])
    assert not (one.reference.domain & ~expected).any()


def test_a_mask_of_one_view_leaves_the_other_as_it_is(small):
    free, second = run_trial(trial()), run_trial(trial(sensor_2={"camera": CAMERA, "mask": str(small)}))
    assert np.array_equal(free.images[0], second.images[0])
    assert np.array_equal(free.truth.range_m, second.truth.range_m, equal_nan=True)
    assert second.truth.visible.sum() < free.truth.visible.sum()
    assert not second.images[1][HIDDEN].any()


@pytest.mark.slow
def test_the_bound_leaves_masked_pixels_out(small):
    scoring = {"bound": True}
    free, one = run_trial(trial(scoring=scoring)), run_trial(trial(small, scoring=scoring))
    there, known = np.isfinite(free.bound_px), np.isfinite(one.bound_px)
    assert not (known & ~there).any()
    reach = one.trial.matching.support(one.trial.filter.log_sigma_px).window_px // 2
    hidden = free.truth.visible & ~one.truth.visible
    near = ndimage.maximum_filter(hidden, size=2 * reach + 1, mode=("nearest", "wrap"))
    assert not (known & near).any()
    assert (known | near)[there].all()
    # Splines through an image with its gap filled, which is a few pixels away at least.
    np.testing.assert_allclose(one.bound_px[known], free.bound_px[known], rtol=1e-3)
