"""`omnirange range` where nobody says where view 2 is: the motion first, its length, and its share of sigma."""

import json

import numpy as np
import pytest
from PIL import Image

import harness
from harness.cli import main
from harness.errors import Notice
from harness.spec import dump_toml

BASELINE_M = 0.4
SMALL = {"camera": {"width_px": 400, "height_px": 300, "focal_px": 383.825, "cx_px": 199.5, "cy_px": 149.5}}
"""The shipped camera at five eighths of its size."""


@pytest.fixture(scope="module")
def views():
    first = harness.render("box", sensor=SMALL, position_m=(0, 0, 1), samples=4)
    second = harness.render("box", sensor=SMALL, position_m=(BASELINE_M, 0, 1), yaw_deg=40, samples=4)
    return first, second


@pytest.fixture(scope="module")
def folder(views, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    for view, name in zip(views, ("left", "right"), strict=True):
        Image.fromarray(np.rint(view.image).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "sensor.toml").write_text(dump_toml(views[0].sensor))
    return folder


def command(folder, *options, right="right.png"):
    images = [str(folder / "left.png"), str(folder / right), "--sensor", str(folder / "sensor.toml")]
    return ["range", *images, "--matcher", "column", *options]


@pytest.fixture(scope="module")
def motion(views):
    return harness.estimate_motion(views[0].image, views[1].image, views[0].sensor, camera_height_m=1.0)


@pytest.mark.slow
def test_the_length_follows_from_the_height_above_the_floor(motion):
    assert motion.baseline_m == pytest.approx(BASELINE_M, rel=1e-3)  # some sigma
    assert abs(motion.baseline_m - BASELINE_M) < 4 * motion.baseline_sigma_m
    assert motion.motion.baseline_m == pytest.approx(motion.baseline_m)
    assert any(line.startswith(f"baseline   {motion.baseline_m:.4g} m") and "floor" in line for line in motion.lines())


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_metres_by_the_floor_and_sigma_with_the_motions_share(folder, capsys):
    assert main(command(folder, "--camera-height", "1", "--out", str(folder / "out"))) == 0
    said = capsys.readouterr().out
    assert "status     ok" in said
    figures = json.loads((folder / "out" / "range.json").read_text())
    assert figures["unit"] == "metre"
    assert figures["baseline_m"] == pytest.approx(BASELINE_M, rel=1e-3)
    parts = [np.load(folder / "out" / f"sigma_{name}_m.npy") for name in ("matching", "geometry", "motion")]
    whole = np.load(folder / "out" / "sigma_m.npy")
    known = np.isfinite(whole)
    assert (parts[2][known] > 0).all()
    assert np.allclose(np.sqrt(sum(each[known] ** 2 for each in parts)), whole[known], rtol=1e-12)
    assert "The motion was estimated from the images" in (folder / "out" / "range.html").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_units_of_the_baseline_are_said(folder, views, motion, capsys):
    assert main(command(folder, "--set", "panorama.width_px=720", "--out", str(folder / "unit"))) == 0
    said = capsys.readouterr().out
    assert "in units of the baseline" in said
    assert json.loads((folder / "unit" / "range.json").read_text())["unit"] == "baseline"
    assert "The length of the baseline is not known" in (folder / "unit" / "range.html").read_text()
    in_baselines = np.load(folder / "unit" / "range.npy")
    truth = views[0].panorama_range_m / BASELINE_M
    assert np.isfinite(in_baselines).mean() > 0.5  # limits of the search are the scene's, not 1 to 10 of whatever it is
    assert np.nanmedian(np.abs(in_baselines / truth - 1)) < 0.05
    given = harness.estimate_range(views[0].image, views[1].image, views[0].sensor, motion, "column")
    assert given.has_metres
    assert np.nanmedian(np.abs(given.range_m / views[0].panorama_range_m - 1)) < 0.05


@pytest.mark.slow
def test_no_motion_is_one_line_and_no_files(folder, capsys):
    assert main(command(folder, "--out", str(folder / "none"), right="left.png")) == 1
    complaint = capsys.readouterr().err
    assert complaint.startswith("no range: the motion is not known (no parallax): a rotation alone leaves")
    assert complaint.count("\n") == 1
    assert not (folder / "none").exists()


@pytest.mark.slow
def test_a_weak_motion_warns(views):
    motion = harness.estimate_motion(views[0].image, views[1].image, views[0].sensor, calibration_px=3.0)
    assert motion.status == harness.Status.WEAK
    with pytest.warns(Notice, match="the motion is unreliable, and so are ranges from it: the sigma of"):
        harness.estimate_range(views[0].image, views[1].image, views[0].sensor, motion, "column")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--baseline", "1", "0", "0", "--camera-height", "1"], "--camera-height: --baseline says where view 2 is"),
        (["--baseline", "1", "0", "0", "--baseline-length", "1"], "--baseline-length: --baseline says where view 2"),
        (["--rotation-deg", "1", "0", "0"], "--rotation-deg: belongs to --baseline or --pose"),
        (["--views", "0", "1"], "--views: belongs to --baseline or --pose"),
        (["--camera-height", "0"], "--camera-height: must be above 0; found 0"),
    ],
)
def test_options_that_contradict_each_other(folder, options, message, capsys):
    assert main(command(folder, *options, "--out", str(folder / "no"))) == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert complaint.count("\n") == 1


def test_lengths_are_checked(views):
    image, sensor = views[0].image, views[0].sensor
    with pytest.raises(harness.InputError, match=r"^camera_height_m: must be a length above 0"):
        harness.estimate_motion(image, image, sensor, camera_height_m=-1)
    with pytest.raises(harness.InputError, match=r"^camera_height_m: the distance of the viewpoints is given"):
        harness.estimate_motion(image, image, sensor, camera_height_m=1, baseline_m=1)
