"""OpenCV's matchers: the same camera, the way to the rectified pair and back, known disparities, the paper's box."""

import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import ndimage
from scipy.spatial.transform import Rotation

from harness.camera.conversions import mirrored_frame
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models.hyperboloid import Mirror
from harness.camera.sensor import Sensor, in_field, pixel_directions, project, unproject
from harness.errors import InputError
from harness.geometry.angles import angle_between, normalise
from harness.geometry.epipolar import alpha_1
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.geometry.triangulation import exact_alpha_2, triangulate
from harness.matching.opencv import match as matchers
from harness.matching.opencv.omnidir import LARGEST_RMS_PX
from harness.matching.opencv.rectify import (
    Rectangle,
    Rectified,
    disparities,
    frame_along,
    mei,
    mirrored_rotation,
    on_panorama,
    rectangle_for,
    rectify,
)
from harness.matching.opencv.settings import StereoBM, StereoReconstruct, StereoSGBM
from harness.matching.pair import Pair
from harness.matching.registry import BUILT_IN
from harness.pipeline.trial import run_trial
from harness.runs.load import load_experiment

BENT = Lens(k1=-0.02, k2=0.004, p1=0.001, p2=-0.002)
SENSORS = {
    "default": Sensor(),
    "bent": Sensor(lens=BENT),
    "stretched": Sensor(
        model=Mirror(a_m=0.03, b_m=0.03),
        camera=Camera(focal_px=450.0, aspect=1.1, cx_px=330.0, cy_px=231.0),
        lens=BENT,
        field=FieldOfView(elevation_max_deg=5.0),
    ),
}
TURN = Rotation.from_euler("ZYX", [30.0, -4.0, 3.0], degrees=True).as_matrix()
BASELINES = [(0.5, 0.0, 0.0), (-0.5, 0.0, 0.0), (-0.2, 0.4, 0.1), (0.0, 0.0, 0.5), (0.2, -0.1, -0.4)]
KINDS = ["opencv-bm", "opencv-sgbm", "opencv-reconstruct"]


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2", reason="needs the extra: pip install 'omnirange[peers]'")


# --- The camera and the rectangle ---------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
def test_opencv_has_the_same_camera(cv2, sensor):
    """There and back: our directions by OpenCV's projection, and by our inverse of it to directions again."""
    looking = normalise(np.random.default_rng(0).normal(size=(4000, 3)))
    looking = looking[in_field(sensor, looking)]
    K, distortion, xi = mei(sensor)
    pixels, _ = cv2.omnidir.projectPoints(
        mirrored_frame(looking)[None], np.zeros(3), np.zeros(3), K, float(xi[0, 0]), distortion
    )
    pixels = pixels.reshape(-1, 2)
    # Two dozen roundings of numbers below 1000, and Newton's method to 1e-12 on the way back.
    np.testing.assert_allclose(pixels, project(sensor, looking)[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(unproject(sensor, pixels)[0], looking, rtol=0, atol=1e-10)


@pytest.mark.parametrize("t", BASELINES)
def test_opencv_looks_where_the_rectangle_says(cv2, t):
    """OpenCV's rectification maps against our projection of the rectangle's directions, with margins, in both views."""
    pair = blank(t, TURN, SENSORS["bent"])
    rectangle = rectangle_for(pair, 1, 32, 9)
    rectified = rectify(pair, rectangle, "linear", cv2)
    looking = rectangle.directions(rectified.R_rect_from_v1)
    for R, valid in zip((np.eye(3), TURN), rectified.valid, strict=True):
        maps = cv2.omnidir.initUndistortRectifyMap(
            *mei(pair.sensor),
            rectified.R_rect_from_v1 @ mirrored_rotation(R).T,
            rectangle.K,
            rectangle.shape[::-1],
            cv2.CV_32FC1,
            cv2.omnidir.RECTIFY_LONGLATI,
        )
        pixels, visible = project(pair.sensor, looking @ R.T)
        assert valid.mean() > 0.3
        assert np.mean(valid != visible) < 1e-4  # those within rounding of the rim
        # Single precision at 512 .. 1024 is 6e-5 apart.
        np.testing.assert_allclose(np.stack(maps, axis=-1)[valid], pixels[valid], rtol=0, atol=4e-5)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_places_and_directions_are_inverse(x, y, z, seed):
    t = np.array([x, y, z])
    if np.linalg.norm(t) < 0.01:
        return
    frame = frame_along(t)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    rectangle = Rectangle(72, 5, 4)
    looking = rectangle.directions(frame)
    # A column is an angle to -t, a row a half plane around it.
    theta = (np.arange(5, 41) - 5 + 0.5) * rectangle.step
    np.testing.assert_allclose(
        np.pi - angle_between(looking[:, 5:41], t), np.broadcast_to(theta, (80, 36)), rtol=0, atol=1e-12
    )
    rng = np.random.default_rng(seed)
    i, j = rng.integers(4, 76, 50), rng.integers(5, 41, 50)
    row, column = rectangle.pixels_of(frame, looking[i, j])
    # The first columns are half a step, 0.04 rad, from the axis, which costs 25 times in the angle around it.
    np.testing.assert_allclose(row, i, rtol=0, atol=1e-11)
    np.testing.assert_allclose(column, j, rtol=0, atol=1e-11)


@given(st.floats(0.02, 3.0), st.floats(0.02, 0.98), st.sampled_from([180, 720, 1440]))
def test_disparities_reach_d_min(d_min, share, around):
    baseline, step = share * d_min, 2 * np.pi / around
    number = disparities(StereoSGBM(d_min_m=d_min), baseline, step)
    a = np.linspace(0, np.pi, 20001)
    points = d_min * np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1)
    nearest = np.max(exact_alpha_2(points, [baseline, 0, 0]) - a) / step
    assert number % 16 == 0
    assert nearest <= number - 2  # the largest one and its neighbour are among 0 .. number - 1
    assert number - 16 < nearest + 3


def test_a_baseline_beyond_d_min_is_searched_to_the_end():
    assert disparities(StereoSGBM(d_min_m=0.5), 0.7, np.pi / 360) == 368


# --- Back onto the panorama ---------------------------------------------------------------------------------------


def seen_all_over(rectangle, frame):
    """A rectified pair without pictures."""
    image, everything = np.zeros(rectangle.shape, np.uint8), np.ones(rectangle.shape, bool)
    return Rectified(rectangle, frame, (image, image), (everything, everything))


def test_disparities_are_interpolated_but_across_no_edge():
    rectangle, frame = Rectangle(180, 20, 8), frame_along(np.array([0.3, 0.2, 0.1]))
    looking = directions(Grid(width_px=90, height_px=30))
    row, column = rectangle.pixels_of(frame, looking)
    rows, columns = np.mgrid[: rectangle.shape[0], : rectangle.shape[1]]
    plane = 5 + 0.2 * columns / 2 - 0.1 * rows / 4
    # Linear in rows and columns: linear interpolation is exact.
    result = on_panorama(seen_all_over(rectangle, frame), plane, looking)
    np.testing.assert_allclose(result, 5 + 0.1 * column - 0.025 * row, rtol=0, atol=1e-12)

    step = np.where(columns < 60, 4.0, 9.0)
    result = on_panorama(seen_all_over(rectangle, frame), step, looking)
    np.testing.assert_array_equal(result, np.where(np.floor(column + 0.5) < 60, 4.0, 9.0))

    holes = np.where((rows + columns) % 5 == 0, np.nan, 7.0)
    result = on_panorama(seen_all_over(rectangle, frame), holes, looking)
    nearest = np.floor(row + 0.5).astype(int), np.floor(column + 0.5).astype(int)
    np.testing.assert_array_equal(np.isnan(result), np.isnan(holes[nearest]))
    assert np.all(result[~np.isnan(result)] == 7)


def test_nothing_is_taken_from_where_a_view_sees_nothing():
    rectangle, frame = Rectangle(180, 20, 8), frame_along(np.array([0.3, 0.2, 0.1]))
    looking = directions(Grid(width_px=90, height_px=30))
    _, column = rectangle.pixels_of(frame, looking)
    six = np.full(rectangle.shape, 6.0)
    whole = seen_all_over(rectangle, frame)
    half = np.broadcast_to(np.arange(rectangle.shape[1]) >= 60, rectangle.shape)
    nearest = np.floor(column + 0.5)
    dark_1 = on_panorama(replace(whole, valid=(half, whole.valid[1])), six, looking)
    np.testing.assert_array_equal(np.isnan(dark_1), nearest < 60)
    dark_2 = on_panorama(replace(whole, valid=(whole.valid[0], half)), six, looking)
    np.testing.assert_array_equal(np.isnan(dark_2), np.rint(column - 6) < 60)


# --- Known disparities --------------------------------------------------------------------------------------------


SMALL = Sensor(camera=Camera(width_px=320, height_px=240, focal_px=307.06, cx_px=159.5, cy_px=119.5))
GRID = Grid(width_px=360, height_px=100)


def blank(t, R=None, sensor=SMALL):
    image = np.zeros((sensor.camera.height_px, sensor.camera.width_px), np.float32)
    return Pair((image, image), (sensor, sensor), Motion(np.eye(3) if R is None else R, np.array(t, dtype=float)), GRID)


def constant(t, disparity_px, R=None, turned=0.0):
    """Two views of a world in which every direction has one disparity, in pixels of the panorama.

    Grey levels are a smooth random function of (theta, h) around t, in view 2 moved by the disparity in theta. `turned`
    turns that world about z, in radians.
    """
    pair = blank(t, R)
    rectangle, frame = Rectangle(GRID.width_px), frame_along(pair.t_v1)
    # Columns for theta from 0 to 180 degrees, and some more.
    noise = np.random.default_rng(3).normal(size=(GRID.width_px, 220))
    texture = ndimage.gaussian_filter(noise, 1.5, mode="wrap")
    spline = ndimage.spline_filter(128 + 40 * texture / texture.std(), order=3, mode="grid-wrap")
    back = Rotation.from_euler("z", -turned).as_matrix()
    looking, visible = pixel_directions(pair.sensor)
    images = []
    for view, R_view in enumerate((np.eye(3), pair.motion.R_v2_from_v1)):
        row, column = rectangle.pixels_of(frame, np.nan_to_num(looking, nan=1.0) @ R_view @ back.T)
        pixels_of = [row, column + view * disparity_px]
        values = ndimage.map_coordinates(spline, pixels_of, order=3, mode="grid-wrap", prefilter=False)
        images.append(np.where(visible, values, 0).astype(np.float32))
    return replace(pair, images=(images[0], images[1]))


@pytest.mark.slow
@pytest.mark.parametrize("t", BASELINES)
@pytest.mark.parametrize(
    ("matcher", "disparity_px", "tolerance_px"),
    [
        # A whole number of pixels is the minimum of StereoSGBM's costs itself, and its parabola leaves it there.
        (StereoSGBM(), 8.0, 0.02),
        # Between them that parabola, of costs that are no parabola, is drawn to whole pixels: it finds 8.19.
        (StereoSGBM(), 8.3, 0.13),
        # StereoBM rounds to sixteenths, 0.06 px, what its own pre-filter makes of slightly different pictures.
        (StereoBM(), 8.0, 0.07),
        (StereoBM(), 8.3, 0.07),
    ],
    ids=["sgbm whole", "sgbm", "bm whole", "bm"],
)
@pytest.mark.usefixtures("cv2")
def test_constant_disparity_is_found_all_round(t, matcher, disparity_px, tolerance_px):
    """In any direction of the baseline, with the second view turned: half a pixel's shift anywhere would show."""
    pair = constant(t, disparity_px, TURN)
    true = disparity_px * GRID.phi_pitch
    a_1 = alpha_1(GRID, t)
    error = (matcher.match(pair).alpha_2 - a_1) / GRID.phi_pitch - disparity_px
    # Where the world's range is within the limits, and both views see the place and its surroundings.
    looking = directions(GRID)
    range_m, _ = triangulate(a_1, a_1 + true, pair.motion.baseline_m)
    there = (looking * np.nan_to_num(range_m)[..., None] - pair.t_v1) @ TURN.T
    inner = Sensor(field=FieldOfView(elevation_min_deg=-70.0, elevation_max_deg=12.0))
    fit = in_field(inner, looking) & in_field(inner, there) & (range_m > 1.05) & (range_m < 9.5)
    assert fit.mean() > 0.3
    matched = fit & np.isfinite(error)
    assert matched.sum() > 0.95 * fit.sum()
    assert abs(np.median(error[matched])) < tolerance_px
    assert np.median(np.abs(error[matched])) < tolerance_px
    # A quarter of a pixel is the worst that a parabola does to costs without noise.
    assert np.percentile(np.abs(error[matched]), 95) < 0.3


@pytest.mark.parametrize("matcher", [StereoSGBM(), StereoBM(block_px=21)], ids=["sgbm", "bm"])
@pytest.mark.usefixtures("cv2")
def test_the_seam_of_the_rectangle_is_no_border(matcher):
    """For a vertical baseline the seam crosses the picture, at phi = ±pi: turning the world turns the answer.

    StereoBM matches no pixel whose block leaves the image, and would leave twenty columns blank.
    """
    half = GRID.width_px // 2
    straight, turned = (matcher.match(constant((0.0, 0.0, 0.5), 8.3, turned=angle)).alpha_2 for angle in (0.0, np.pi))
    there = np.roll(straight, half, axis=1)[:, np.r_[:10, -10:0]]
    difference = np.abs(there - turned[:, np.r_[:10, -10:0]]) / GRID.phi_pitch
    assert np.isfinite(there).mean() > 0.5
    assert np.isfinite(difference).sum() > 0.97 * np.isfinite(there).sum()
    # But for the mirror pixels, which are others after the turn.
    assert np.nanpercentile(difference, 90) < 0.2


@pytest.mark.usefixtures("cv2")
def test_no_range_is_outside_the_limits():
    pair = constant((0.5, 0.0, 0.0), 4.15)
    matched = StereoSGBM(d_min_m=3.0, d_max_m=5.0).match(pair).alpha_2
    range_m, _ = triangulate(alpha_1(GRID, pair.t_v1), matched, 0.5)
    assert np.isfinite(matched).mean() > 0.1
    np.testing.assert_array_equal(np.isnan(range_m), np.isnan(matched))
    # Rounding of a range of a few metres, a hundred times what it was in the angle.
    assert np.nanmin(range_m) >= 3 - 1e-12
    assert np.nanmax(range_m) <= 5 + 1e-12


# --- The paper's box ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def box():
    """The paper's pair, with what StereoSGBM makes of it."""
    pytest.importorskip("cv2", reason="needs the extra: pip install 'omnirange[peers]'")
    return run_trial(load_experiment("peers").trial)


@pytest.mark.parametrize(
    ("matcher", "pixels", "metres", "density"),
    # Found: 0.146 px, 12.4 mm, 99 % and 0.116 px, 11.9 mm, 69 %.
    [(StereoSGBM(), 0.17, 0.015, 0.97), (StereoBM(), 0.14, 0.014, 0.6)],
    ids=["sgbm", "bm"],
)
@pytest.mark.usefixtures("cv2")
def test_errors_on_the_papers_box(box, matcher, pixels, metres, density):
    error, range_error = scored(box, matcher)
    result = np.isfinite(error)
    assert result.mean() > density
    assert np.median(np.abs(error[result])) < pixels
    assert np.median(np.abs(range_error[result])) < metres


@pytest.mark.usefixtures("cv2")
def test_reconstruct_is_scored_by_its_own_formula(box):
    """`|t| / disparity`, not the sine rule: the ranges are those, and so are far from the truth."""
    matched = StereoReconstruct(block_px=7).match(box.pair)
    truth = box.reference
    range_m, _ = triangulate(truth.alpha_1, matched.alpha_2, 0.5)
    visible = truth.domain & np.isfinite(range_m)
    assert visible.sum() > 0.7 * truth.domain.sum()
    disparity = truth.alpha_2 - truth.alpha_1
    formula = 0.5 / disparity
    # A median error of its disparities of 0.16 px, of some 20 px.
    assert np.median(np.abs(range_m / formula - 1)[visible]) < 0.015
    assert np.median(np.abs(range_m - truth.range_m)[visible]) > 0.1
    aslant = visible & (np.sin(truth.alpha_2) < 0.6)
    # sin(alpha_2) is missing: it sees walls aslant at 1/0.6 of their distance and more.
    assert np.median((range_m / truth.range_m)[aslant]) > 1.5


def scored(outcome, matcher):
    """Errors over the domain: of the disparity in pixels of the panorama, and of the range in metres."""
    matched, truth = matcher.match(outcome.pair), outcome.reference
    range_m, _ = triangulate(truth.alpha_1, matched.alpha_2, outcome.pair.motion.baseline_m)
    pixels = (matched.alpha_2 - truth.alpha_2) / outcome.pair.grid.phi_pitch
    return pixels[truth.domain], (range_m - truth.range_m)[truth.domain]


@pytest.mark.parametrize(
    "matcher",
    [StereoBM(), *(StereoSGBM(mode=mode) for mode in ("sgbm", "hh", "3way", "hh4")), StereoReconstruct()],
    ids=lambda each: f"{each.kind} {getattr(each, 'mode', '')}",
)
def test_threads_change_nothing(cv2, matcher):
    before = cv2.getNumThreads()
    pair = constant((0.5, 0.0, 0.0), 18.3)
    one, two = (matcher.match(replace(pair, threads=n)).alpha_2 for n in (1, 2))
    np.testing.assert_array_equal(one, two)
    assert np.isfinite(one).any()
    assert cv2.getNumThreads() == before


def test_threads_are_given_back_after_a_failure(cv2, monkeypatch):
    before = cv2.getNumThreads()
    monkeypatch.setattr(matchers, "block_match", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        StereoSGBM().match(replace(blank((0.5, 0, 0)), threads=before + 1))
    assert cv2.getNumThreads() == before


# --- Settings and messages ----------------------------------------------------------------------------------------


def test_settings_reach_opencv(cv2):
    sgbm = matchers._engine(
        StereoSGBM(
            block_px=7,
            p1_per_px=4,
            p2_per_px=16.5,
            mode="hh4",
            pre_filter_cap=21,
            uniqueness_percent=3,
            disp12_max_diff_px=2,
            speckle_px=50,
            speckle_range_px=4,
        ),
        96,
        cv2,
    )
    assert (sgbm.getBlockSize(), sgbm.getNumDisparities(), sgbm.getMinDisparity()) == (7, 96, 0)
    assert (sgbm.getP1(), sgbm.getP2()) == (4 * 49, round(16.5 * 49))
    assert sgbm.getMode() == cv2.STEREO_SGBM_MODE_HH4
    assert (sgbm.getPreFilterCap(), sgbm.getUniquenessRatio(), sgbm.getDisp12MaxDiff()) == (21, 3, 2)
    assert (sgbm.getSpeckleWindowSize(), sgbm.getSpeckleRange()) == (50, 4)
    bm = matchers._engine(
        StereoBM(block_px=13, pre_filter="normalized", pre_filter_px=11, pre_filter_cap=22, texture_threshold=5),
        64,
        cv2,
    )
    assert (bm.getBlockSize(), bm.getNumDisparities()) == (13, 64)
    assert bm.getPreFilterType() == cv2.STEREO_BM_PREFILTER_NORMALIZED_RESPONSE
    assert (bm.getPreFilterSize(), bm.getPreFilterCap(), bm.getTextureThreshold()) == (11, 22, 5)
    assert (bm.getUniquenessRatio(), bm.getSpeckleWindowSize(), bm.getSpeckleRange()) == (15, 100, 32)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.usefixtures("cv2")
def test_kinds_run_as_trials(kind):
    """The pair is small; at four times its scale disparities reach the 15 pixels that `opencv-reconstruct` needs."""
    small = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    matcher = BUILT_IN[kind](block_px=5, rectified_scale=4)
    trial = load_experiment("peers").trial.model_copy(
        update={"sensor": small, "panorama": Grid(width_px=180, height_px=50), "matching": matcher}
    )
    outcome = run_trial(trial)
    assert outcome.valid.mean() > 0.1
    assert outcome.trial.model_validate(outcome.trial.model_dump(mode="json")) == outcome.trial


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("module", [None, SimpleNamespace(__name__="cv2")], ids=["missing", "without contrib"])
def test_without_opencv_it_says_what_to_install(monkeypatch, kind, module):
    monkeypatch.setitem(sys.modules, "cv2", module)
    with pytest.raises(InputError) as error:
        BUILT_IN[kind]().match(blank((0.5, 0, 0)))
    assert str(error.value) == f"{kind}: needs the extra: pip install 'omnirange[peers]'"


@pytest.mark.slow
@pytest.mark.usefixtures("cv2")
def test_a_lens_that_omnidir_has_not_is_fitted():
    """A k3 changes nothing but what `opencv-reconstruct` is given, and that is said."""
    bent = Sensor(lens=Lens(k1=-0.02, k3=0.05))
    assert StereoSGBM().match(blank((0.5, 0, 0), sensor=bent)).remark == ""
    remark = StereoReconstruct().match(blank((0.5, 0, 0), sensor=bent)).remark
    assert re.fullmatch(
        r"OpenCV's omnidir was given the unified camera nearest to the hyperboloid mirror: "
        r"(\S+) px RMS, \S+ px at most away",
        remark,
    )
    assert float(remark.split(": ")[1].split()[0]) < LARGEST_RMS_PX


@pytest.mark.usefixtures("cv2")
def test_reconstruct_says_that_it_has_no_answer_for_a_vertical_baseline():
    with pytest.raises(InputError, match=r"opencv-reconstruct: cv2\.omnidir\.stereoRectify does not handle"):
        StereoReconstruct().match(blank((0, 0, 0.5)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("block_px=4", "matching.block_px: must be odd, so that it has a centre; found 4"),
        (
            "window_px=5",
            "matching.window_px: unknown key 'window_px'; it is a key of kind 'column', 'slanted' or 'window'",
        ),
        ("d_max_m=1", "d_min_m = 1 must be below d_max_m = 1"),
        ("mode=hh5", "matching.mode: 'hh5' is not valid; did you mean 'hh'?"),
    ],
)
def test_wrong_settings_are_named(change, message):
    with pytest.raises(InputError) as error:
        load_experiment("peers", sets=[f"matching.{change}"])
    assert message in str(error.value)


def test_a_jump_of_the_disparity_costs_more_than_a_slope():
    with pytest.raises(ValidationError, match="p1_per_px = 8 must be below p2_per_px = 4"):
        StereoSGBM(p2_per_px=4)
