"""No command writes over files of another's, or of one's own, that have the names of its files."""

import numpy as np
import pytest

import harness
from harness.cli import main
from harness.errors import InputError

SENSOR = {"camera": {"width_px": 200, "height_px": 150, "focal_px": 191.9, "cx_px": 99.5, "cy_px": 74.5}}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    for number, x in enumerate((0.0, 0.5)):
        view = harness.render("box", sensor=SENSOR, position_m=(x, 0.0, 1.0), samples=1)
        view.write(folder / str(number))
    return folder


def arguments(pair, name, out):
    more = {"range": [], "warp": ["--to", "0.2", "0", "0"], "scan": ["--height", "1"], "map": ["--height", "1"]}[name]
    images = [str(pair / each / "omni.png") for each in "01"]
    sensor = ["--sensor", str(pair / "0" / "sensor.toml"), "--baseline", "0.5", "0", "0", "--matcher", "sgm"]
    return [name, *images, *sensor, *more, "--out", str(out)]


@pytest.mark.parametrize(
    ("name", "file"),
    [("range", "range.npy"), ("warp", "range.npy"), ("warp", "README.txt"), ("scan", "scan.csv"), ("map", "map.yaml")],
)
def test_what_has_the_name_of_a_file_is_kept(name, file, pair, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(harness, "estimate_range", None)  # it is told before anything is matched
    own = tmp_path / file
    own.write_text("mine")
    assert main(arguments(pair, name, tmp_path)) == 2
    said = f"omnirange: {own}: --out: is there already, and not from the same command; give another folder\n"
    assert capsys.readouterr().err == said
    assert own.read_text() == "mine"


@pytest.mark.slow
def test_a_rendered_views_ranges_are_no_estimates(pair):
    before = (pair / "0" / "range.npy").read_bytes()
    images = [pair / each / "omni.png" for each in "01"]
    sensor = harness.load_sensor(pair / "0" / "sensor.toml")
    estimate = harness.estimate_range(*images, sensor, (0.5, 0.0, 0.0), "sgm")
    view = harness.warp_view(estimate, (0.2, 0.0, 0.0))
    for made in (estimate, view):
        with pytest.raises(InputError, match=r"range\.npy: --out: is there already"):
            made.write(pair / "0")
    assert (pair / "0" / "range.npy").read_bytes() == before
    for _ in range(2):  # its own folder is written again, and not by another
        estimate.write(pair / "range")
    with pytest.raises(InputError, match=r"range\.npy: --out: is there already"):
        view.write(pair / "range")
    np.testing.assert_array_equal(np.load(pair / "range" / "range.npy"), estimate.range_m)


def test_one_image_for_two_views(pair, tmp_path, capsys):
    words = arguments(pair, "range", tmp_path / "out")
    words[2] = words[1]
    assert main(words) == 2
    said = f"omnirange: {words[1]}: is given for two views in a row; give the image of each\n"
    assert capsys.readouterr().err == said
