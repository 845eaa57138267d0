"""`omnirange range`: two images of one's own, through the real command line."""

import json

import numpy as np
import pandas as pd
import pytest
import trimesh
from browser import chromium, visit
from PIL import Image
from sweeps import omnirange

from harness.camera.sensor import Sensor, in_field
from harness.cli import main
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Pose
from harness.pipeline.photographs import read_photograph
from harness.simulation.render import render
from harness.simulation.scene import load_scene
from harness.simulation.truth import truth
from harness.spec import dump_toml

SENSOR = Sensor()
FIRST = Pose(position_m=(0.3, -0.2, 1.0))
SECOND = Pose(position_m=(0.7, 0.1, 1.1), yaw_deg=25.0, pitch_deg=2.0)
BASELINE = [str(b - a) for a, b in zip(FIRST.position_m, SECOND.position_m, strict=True)]


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Both views of the box as files: a colour photograph, and one of 16 bits."""
    folder = tmp_path_factory.mktemp("images")
    (folder / "sensor.toml").write_text(dump_toml(SENSOR))
    scene = load_scene("box")
    first, second = (render(scene, SENSOR, pose, 4) for pose in (FIRST, SECOND))
    grey = np.clip(np.rint(first), 0, 255).astype(np.uint8)
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(folder / "left.png")
    Image.fromarray(np.rint(second * (65535 / 255)).astype(np.uint16)).save(folder / "right.png")
    return folder


@pytest.fixture(scope="module")
def answer(images):
    ran = omnirange(
        images, "range", images / "left.png", images / "right.png", "--sensor", images / "sensor.toml",
        "--baseline", *BASELINE,
        "--rotation-deg", 25, 2, 0, "--matcher", "column", "--set", "window_px=9", "--set", "panorama.width_px=720",
        "--out", images / "out",
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""
    return images / "out"


def true_range():
    looking = directions(Grid())
    return truth(load_scene("box"), FIRST, looking, in_field(SENSOR, looking), pose_2=SECOND, sensor_2=SENSOR)


@pytest.mark.slow
def test_ranges_are_those_of_the_scene(answer):
    result, visible = np.load(answer / "range.npy"), true_range()
    wall = visible.visible & (np.abs(visible.normal[..., 2]) < 0.5) & np.isfinite(result)
    assert wall.sum() > 20_000
    # A column window's parabola is good to a few hundredths of a metre at 3 m and half a metre of baseline; a wrong
    # sign, frame or order of rotations leaves nothing of that.
    assert np.median(np.abs(result - visible.range_m)[wall]) < 0.05


@pytest.mark.slow
def test_files_say_the_same(answer):
    result = np.load(answer / "range.npy")
    there = np.isfinite(result)
    assert np.array_equal(np.load(answer / "reason.npy") == 0, there)
    millimetres = np.asarray(Image.open(answer / "range_mm.png"))
    assert np.array_equal(millimetres > 0, there)
    assert np.abs(millimetres[there] / 1000 - result[there]).max() <= 0.0005 + 1e-9  # half a millimetre of rounding
    sigma = np.load(answer / "sigma_m.npy")
    assert np.isfinite(sigma[there]).mean() > 0.95
    assert (sigma[np.isfinite(sigma)] >= 0).all()
    parts = [np.load(answer / f"sigma_{part}_m.npy") for part in ("matching", "geometry")]
    np.testing.assert_allclose(np.hypot(*parts), sigma, rtol=1e-15)
    figures = json.loads((answer / "range.json").read_text())
    assert figures["geometry"]["verdict"] == "ok"
    assert figures["density"] == there.mean()
    assert len(pd.read_csv(answer / "across.csv")) == figures["geometry"]["tiles"] > 300
    cloud = trimesh.load(answer / "points.ply")
    # The file has single precision: 1e-6 of ten metres.
    assert np.allclose(np.linalg.norm(cloud.vertices, axis=1), result[there], atol=1e-5)
    assert len(cloud.colors) == there.sum()
    assert np.asarray(cloud.colors)[:, :3].std() > 20  # the photograph's, not one colour


@pytest.mark.slow
def test_points_lie_on_the_box(answer):
    cloud = np.asarray(trimesh.load(answer / "points.ply").vertices) + FIRST.position_m
    distance = np.abs(np.stack([np.abs(cloud[:, 0]) - 3, np.abs(cloud[:, 1]) - 3, cloud[:, 2]])).min(axis=0)
    assert np.median(distance) < 0.05


@pytest.mark.slow
@pytest.mark.browser
def test_page(answer, tmp_path):
    with chromium(tmp_path / "profile") as context:
        for width in (1200, 390):
            visited = visit(context, answer / "range.html", width=width)
            assert visited.complaints == []
            assert visited.requests == []
            assert visited.page.evaluate("document.documentElement.scrollWidth") <= width
            sizes = visited.page.locator("figure img").evaluate_all("all => all.map(one => one.naturalWidth)")
            # Panorama, range, sigma, reasons, two of the cloud, what lies across, photographs with curves and without.
            assert len(sizes) == 11
            assert min(sizes) > 0


@pytest.mark.slow
def test_a_grey_image_may_have_any_depth(tmp_path):
    shape = (SENSOR.camera.height_px, SENSOR.camera.width_px)
    eight = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    Image.fromarray(eight).save(tmp_path / "eight.png")
    Image.fromarray(257 * eight.astype(np.uint16)).save(tmp_path / "sixteen.png")
    Image.fromarray(eight.astype(np.float32) / 255).save(tmp_path / "float.tiff")
    for name in ("eight.png", "sixteen.png", "float.tiff"):
        # Single precision of a share of white.
        assert np.allclose(read_photograph(tmp_path / name, SENSOR).grey, eight, atol=1e-3)


@pytest.mark.slow
def test_wrong_input_is_one_line(images, tmp_path, capsys):
    (tmp_path / "no.png").write_bytes((images / "left.png").read_bytes()[:1000])
    Image.new("L", (320, 240)).save(tmp_path / "small.png")
    left, right, sensor = images / "left.png", images / "right.png", ("--sensor", images / "sensor.toml")
    baseline, out = ("--baseline", "0.5", "0", "0"), ("--out", tmp_path / "out")
    for arguments, said in (
        ((left, tmp_path / "missing.png", *sensor, *baseline, *out), "missing.png: no such file"),
        ((left, tmp_path / "no.png", *sensor, *baseline, *out), "no.png: cannot be read as an image"),
        ((left, tmp_path / "small.png", *sensor, *baseline, *out), "320x240 pixels, the sensor 640x480"),
        ((left, right, "--sensor", tmp_path / "s.toml", *baseline, *out), "s.toml: no such file"),
        ((left, right, *sensor, "--baseline", "0", "0", "0", *out), "--baseline: must not be zero"),
        ((left, right, *sensor, *baseline, *out, "--matcher", "colum"), "did you mean 'column'?"),
        ((left, right, *sensor, *baseline, *out, "--set", "window_px=8"), "window_px must be odd"),
        ((left, right, *sensor, *baseline, *out, "--set", "windw_px=9"), "did you mean 'window_px'?"),
    ):
        assert main(["range", *map(str, arguments)]) == 2
        complaint = capsys.readouterr().err
        assert said in complaint
        assert complaint.count("\n") == 1
    assert not (tmp_path / "out").exists()
