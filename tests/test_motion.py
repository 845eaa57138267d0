"""Motion from two images: keypoints without bias, the whole chain on rendered views, the command and its files."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from repeats import few
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import harness
from harness.camera.sensor import Sensor, project, unproject
from harness.cli import main
from harness.errors import Notice
from harness.motion.features import _means, find_features, is_mirrored, match_features, spreads
from harness.spec import dump_toml, load

SENSOR = Sensor()
WAVES = np.random.default_rng(3).normal(size=(80, 2)), np.random.default_rng(4).uniform(0, 2 * np.pi, 80)


def texture(u, v):
    """Waves of 12 to 40 pixels, given as a formula: images of it are shifted exactly."""
    directions, phases = WAVES
    k = 2 * np.pi / np.linspace(12, 40, len(phases)) / np.linalg.norm(directions, axis=1)
    total = sum(np.cos(s * (d[0] * u + d[1] * v) + p) for s, d, p in zip(k, directions, phases, strict=True))
    return (128 + 7 * total).astype(np.float32)


def picture(shift=(0.0, 0.0), turned=False):
    """The texture moved by a shift (u, v); or turned by half a turn about the image's centre."""
    v, u = np.mgrid[0:480, 0:640].astype(float)
    if turned:
        u, v = 639 - u, 479 - v
    return texture(u - shift[0], v - shift[1])


@pytest.fixture(scope="module")
def still():
    return find_features(picture(), SENSOR)


# --- Keypoints ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("shift", few(2, [(0.5, -0.3), (3.37, 1.71), (0.25, 0.0)]))
def test_keypoints_move_with_the_picture(still, shift):
    pairs = match_features(still, find_features(picture(shift), SENSOR))
    moved = pairs.pixels_2 - pairs.pixels_1
    near = moved[np.linalg.norm(moved - shift, axis=1) < 1]
    assert len(near) > 100
    # Rounded to 8 bits, a keypoint is good to 0.05 px; the median of hundreds, and what quarter-pixel steps leave.
    assert np.allclose(np.median(near, axis=0), shift, atol=0.02)


def test_keypoints_have_no_quarter_of_a_pixel_too_much(still):
    """Turned by half a turn a bias changes its sign: without the mending, 0.5 px are left."""
    pairs = match_features(still, find_features(picture(turned=True), SENSOR))
    off = pairs.pixels_2 + pairs.pixels_1 - [639, 479]
    near = off[np.linalg.norm(off, axis=1) < 1]
    assert len(near) > 100
    assert np.allclose(np.median(near, axis=0), 0, atol=0.02)


def test_keypoints_keep_off_what_is_not_seen(still):
    _, visible = unproject(SENSOR, still.pixels)
    assert visible.all()
    radius = np.linalg.norm(still.pixels - [SENSOR.camera.cx_px, SENSOR.camera.cy_px], axis=1)
    assert radius.max() < 238 - 3  # three times the smallest scale within the rim


def test_spreads_are_how_bearings_move_with_pixels(still):
    pixels, step = still.pixels[:50], 1e-4
    for axis in range(2):
        ahead, back = (unproject(SENSOR, pixels + s * step * np.eye(2)[axis])[0] for s in (1, -1))
        # Central differences: a third derivative of a few units, times step², and rounding over step.
        assert np.allclose((ahead - back) / (2 * step), spreads(SENSOR, still.bearings[:50])[..., axis], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("flip", [False, True])
def test_of_a_large_image_the_seen_part_at_half_the_size_is_enough(monkeypatch, flip):
    whole = find_features(picture(), SENSOR, flip=flip)
    for limit in ("_LARGE_PX", "_HALVED_PX"):
        monkeypatch.setattr(f"harness.motion.features.{limit}", 0)
    part = find_features(picture(), SENSOR, flip=flip)
    distance, nearest = cKDTree(whole.pixels).query(part.pixels)
    same = distance < 0.5
    assert np.mean(same) > 0.5  # the finest of the whole are lost; those of a pyramid begun elsewhere are others
    # The mean of a thousand offsets of 0.06 px each is 0.002: half a pixel of either size, forgotten, would be 0.25.
    assert np.abs(np.mean((part.pixels - whole.pixels[nearest])[same], axis=0)).max() < 0.03


def test_means_over_squares_drop_what_is_left_over():
    assert _means(np.array([[0, 2, 9], [4, 5, 9], [9, 9, 9]], np.uint8), 2).tolist() == [[3]]  # of 2.75
    assert _means(np.array([[7, 8]], np.uint8), 1).tolist() == [[7, 8]]


@pytest.mark.slow
def test_an_image_from_behind_has_the_same_keypoints(still):
    flipped = find_features(picture()[:, ::-1], SENSOR, flip=True)
    assert len(flipped.pixels) == pytest.approx(len(still.pixels), rel=0.02)
    pairs = match_features(still, flipped)
    off = pairs.pixels_1 + pairs.pixels_2 * [1, -1] - [639, 0]
    assert np.median(np.abs(off)) < 1e-3  # single precision of the keypoints
    assert is_mirrored(SENSOR)


# --- Rendered views -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def views():
    first = harness.render("box", position_m=(0, 0, 1), samples=4)
    second = harness.render("box", position_m=(0.4, 0.2, 1.05), yaw_deg=100, pitch_deg=2, roll_deg=-3, samples=4)
    return first, second


@pytest.fixture(scope="module")
def folder(views, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    for view, name in zip(views, ("left", "right"), strict=True):
        Image.fromarray(np.rint(view.image).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "sensor.toml").write_text(dump_toml(views[0].sensor))
    return folder


def truth(views):
    return harness.relative_motion(views[0].pose, views[1].pose)


def off_deg(estimate, true):
    rotation = Rotation.from_matrix(estimate.R_v2_from_v1.T @ true.R_v2_from_v1).magnitude()
    cosine = estimate.t_v1 @ true.t_v1 / estimate.baseline_m / true.baseline_m
    return np.degrees(rotation), np.degrees(np.arccos(min(cosine, 1)))


@pytest.mark.slow
def test_the_motion_of_rendered_views_is_found(views):
    first, second = views
    estimate = harness.estimate_motion(first.image, second.image, first.sensor, baseline_m=0.45)
    assert estimate.status == harness.Status.OK
    rotation, direction = off_deg(estimate.motion, truth(views))
    assert rotation < 0.02  # some sigma of keypoints that are good to 0.05 px of 0.2 degrees
    assert direction < 0.05
    assert estimate.motion.baseline_m == pytest.approx(0.45)
    assert repr(estimate).startswith("MotionEstimate('ok'; yaw 100.")
    assert len(repr(estimate)) < 160


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_what_range_reads(views, folder, capsys):
    left, right, sensor = (str(folder / name) for name in ("left.png", "right.png", "sensor.toml"))
    out, figures = folder / "motion.toml", folder / "motion.json"
    command = ["motion", left, right, "--sensor", sensor, "--out", str(out), "--json", str(figures)]
    assert main([*command, "--baseline-length", "0.5"]) == 0
    said = capsys.readouterr().out
    assert "status     ok" in said
    assert "baseline   0.5 m, as given" in said
    table = json.loads(figures.read_text())
    assert table["status"] == "ok"
    assert table["pairs_agreeing"] > 100
    motion = harness.relative_motion(harness.Pose(), load(harness.Pose, out))
    assert np.allclose(motion.R_v2_from_v1, table["R_v2_from_v1"], atol=1e-12)  # some roundings
    assert np.allclose(motion.t_v1, 0.5 * np.array(table["direction_v1"]), atol=1e-12)
    assert max(off_deg(motion, truth(views))) < 0.1
    ranged = ["range", left, right, "--sensor", sensor, "--pose", str(out), "--matcher", "column"]
    ranged += ["--set", "panorama.width_px=360"]
    assert main([*ranged, "--out", str(folder / "range")]) == 0
    assert np.isfinite(np.load(folder / "range" / "range.npy")).mean() > 0.3
    capsys.readouterr()
    assert main([*ranged, "--rotation-deg", "1", "0", "0", "--out", str(folder / "no")]) == 2
    assert "--rotation-deg: the rotation is in the file of --pose" in capsys.readouterr().err


@pytest.mark.slow
def test_images_that_tell_nothing_end_in_exit_code_1(folder, capsys):
    noise = np.random.default_rng(1).integers(0, 256, (480, 640)).astype(np.uint8)
    Image.fromarray(noise).save(folder / "noise.png")
    sensor = str(folder / "sensor.toml")
    out = folder / "none.toml"
    command = ["motion", str(folder / "left.png"), str(folder / "noise.png"), "--sensor", sensor, "--out", str(out)]
    assert main(command) == 1
    said = capsys.readouterr().out
    assert "status     failed" in said
    assert f"{out} is not written: no motion was found" in said
    assert not out.exists()
    command[2] = str(folder / "left.png")
    assert main([*command, "--json", str(folder / "still.json")]) == 1
    assert "status     no parallax" in capsys.readouterr().out
    assert json.loads((folder / "still.json").read_text())["direction_v1"] is None


def test_wrong_arguments_are_one_line(folder, capsys):
    left, sensor = str(folder / "left.png"), str(folder / "sensor.toml")
    for extra, said in (
        (["--baseline-length", "-1"], "--baseline-length: must be above 0; found -1"),
        (["--seed", "-1"], "--seed: must be 0 or more"),
        (["--upright", "--planar"], "--planar: excludes --upright; leave one of them out"),
    ):
        try:
            code = main(["motion", left, left, "--sensor", sensor, *extra])
        except SystemExit as error:
            code = error.code
        assert code == 2
        complaint = capsys.readouterr().err
        assert said in complaint
        assert complaint.count("\n") == 1
    with pytest.raises(harness.InputError, match=r"^freedom: must be 'free', 'upright' or 'planar'; found 'flat'"):
        harness.estimate_motion(left, left, sensor, freedom="flat")


def test_projection_is_where_bearings_come_from(still):
    assert np.allclose(project(SENSOR, still.bearings)[0], still.pixels, atol=1e-9)  # rounding of hundreds of pixels


@pytest.mark.slow
def test_a_pair_on_a_desk(tmp_path):
    """Photographs of a mirror on a desk, turned by hand; the yaw is that of a calibration board in them."""
    real = Path(os.environ.get("OMNIRANGE_REAL", tmp_path / "absent")) / "vmr"
    if not real.is_dir():
        pytest.skip("OMNIRANGE_REAL names no folder with vmr")
    images = [real / f"VMRImage{i}.jpg" for i in (0, 1, 4, 5)]
    with pytest.warns(Notice, match="mirror"):
        sensor = harness.load_sensor(real / "vmr_sensor.toml")
    estimate = harness.estimate_motion(*images[2:], sensor)
    assert estimate.angles_deg["yaw"] == pytest.approx(55.14, abs=0.2)
    assert harness.estimate_motion(*images[:2], sensor).status == harness.Status.NO_PARALLAX
