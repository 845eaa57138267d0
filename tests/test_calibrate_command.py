"""`omnirange calibrate` and `harness.calibrate`: files, page, words and refusals."""

import json
import re

import numpy as np
import pytest
from boards import BOARD, MIRROR, UNIFIED, noisy, visible_boards

import harness
from harness.calibration.corner_files import corners_csv, read_corners
from harness.calibration.uncertainty import ray_difference
from harness.camera.misalignment import Misalignment
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.errors import InputError
from harness.io.view_folder import png
from harness.simulation.targets import visible_boards as boards_of


@pytest.fixture(scope="module")
def csv(tmp_path_factory):
    """Corners of eight boards in a file, two of them mistaken."""
    corners = noisy(visible_boards(MIRROR, 8, 40)[0], 0.1, 7)
    corners.pixels[[3, 200]] += [4.0, 2.0]
    file = tmp_path_factory.mktemp("corners") / "corners.csv"
    file.write_text(corners_csv(corners), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def written(csv):
    calibration = harness.calibrate(corners=csv, model="hyperboloid")
    return calibration, calibration.write(csv.parent / "mine.toml")


class TestFiles:
    def test_sensor_file_is_the_sensor(self, written):
        result, (toml, _, _) = written
        assert harness.load_sensor(toml) == result.sensor

    def test_json_has_numbers_covariance_and_corners(self, written):
        result, (_, file, _) = written
        table = json.loads(file.read_text(encoding="utf-8"))
        assert [each["key"] for each in table["parameters"]] == list(result.keys)
        np.testing.assert_array_equal(table["covariance"], result.uncertainty.covariance)
        sigma = [each["sigma"] for each in table["parameters"]]
        np.testing.assert_allclose(sigma, np.sqrt(np.diag(table["covariance"])), rtol=1e-12)
        assert table["rms_px"] == pytest.approx(0.14, rel=0.1)
        assert sum(len(each["pixels"]) for each in table["left_out"]) == 2
        again = read_corners(file)
        np.testing.assert_array_equal(again.pixels, result.corners.pixels)

    def test_poses_in_the_json_predict_the_corners(self, written):
        _, (toml, file, _) = written
        table = json.loads(file.read_text(encoding="utf-8"))
        for image in table["images"]:
            R, t = np.array(image["R_sensor_from_board"]), np.array(image["t_sensor_m"])
            p = np.array(image["points_m"]) @ R[:, :2].T + t
            pixels, _ = harness.project(harness.load_sensor(toml), p)
            residuals = pixels - image["pixels"]
            np.testing.assert_allclose(residuals, image["residuals_px"], rtol=0, atol=1e-9)
            assert np.sqrt(np.mean(np.sum(residuals**2, axis=-1))) == pytest.approx(image["rms_px"])

    def test_page_is_whole_and_needs_nothing_else(self, written):
        result, (_, _, html) = written
        page = html.read_text(encoding="utf-8")
        assert "Could not be drawn" not in page
        assert page.count("<img") == 9
        assert not re.search(r"(?:src|href)=\"(?!data:|#)", page)
        assert "nan" not in re.sub(r"data:[^\"]*", "", page).lower()
        for key in result.keys:
            assert key in page
        assert f"{result.rms_px:.3g} px" in page

    def test_notebook_shows_the_numbers(self, written):
        result, _ = written
        shown = result._repr_html_()
        assert all(key in shown for key in result.keys)
        assert len(repr(result)) < 200


@pytest.mark.slow
def test_page_of_few_images_without_noise(tmp_path):
    """Nothing to compare, nothing left: the page says so and is drawn all the same."""
    corners, _ = visible_boards(UNIFIED, 2, 41)
    calibration = harness.calibrate(corners=corners, model="unified", lens=["k1"])
    page = calibration.write(tmp_path / "a.toml")[2].read_text(encoding="utf-8")
    assert "Could not be drawn" not in page
    assert "Nothing to compare" in page
    json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))


class TestCommand:
    @pytest.mark.slow
    def test_prints_what_it_found(self, csv, tmp_path, capsys):
        out = tmp_path / "sensor.toml"
        assert main(["calibrate", "--corners", str(csv), "--model", "hyperboloid", "--out", str(out)]) == 0
        said = capsys.readouterr().out
        assert re.search(r"camera\.focal_px +61\d\.\d+ +± \d", said)
        assert "RMS 0.1" in said
        assert "430 of 432 corners agree" in said
        assert "assumed: the camera looks down, a mirror image" in said
        assert str(out.with_suffix(".html")) in said
        assert {each.name for each in tmp_path.iterdir()} == {"sensor.toml", "sensor.json", "sensor.html"}

    @pytest.mark.slow
    def test_without_out_it_prints_the_sensor_file(self, csv, capsys):
        arguments = ["--fix", "aspect", "--fix", "cx=319.5", "--looks", "up", "--no-mirrored"]
        assert main(["calibrate", "--corners", str(csv), "--model", "eucm", *arguments]) == 0
        said = capsys.readouterr().out
        table = said[said.index("[model]") :]
        assert 'kind = "eucm"' in table
        assert "cx_px = 319.5\n" in table
        assert "aspect = 1.0\n" in table
        assert 'looks = "up"' in table
        assert main(["calibrate", "--corners", str(csv), "--model", "hyperboloid", "--elevation", "-70", "10"]) == 0
        assert "elevation_max_deg = 10.0\n" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["a.png"], "--board: give the board's inner corners, as 9x6 for 9 by 6"),
            (["a.png", "--board", "9x6"], "--square-m: give the side of a square: --square-m 0.04 for 40 mm"),
            (["--board", "9x6", "--square-m", "0.04"], "images: give images of a board, or corners"),
            (["a.png", "--board", "9x6", "--square-m", "0.04"], "a.png: no such file"),
            (["a.png", "--board", "9x6", "--square-m", "-1"], "omnirange: --square-m: must be above 0; found -1"),
            (["a.png", "--board", "1x6", "--square-m", "1"], "omnirange: --board: must be at least 2; found 1"),
            (["a.png", "--board", "2x6", "--square-m", "1"], "omnirange: --board: must be at least 3 to be found"),
            (["a.png", "--board", "9x2", "--square-m", "1"], "omnirange: --board: must be at least 3 to be found"),
            (["a.png", "--board", "9x6", "--square-m", "1", "--elevation", "20", "-60"], "omnirange: --elevation: the"),
            (["--corners", "none.csv"], "none.csv: no such file"),
            (["a.png", "--board", "9x6", "--square-m", "1", "--model", "fish"], "--model: there is no camera model"),
            (["--corners", "CSV", "--size", "800", "600"], "has images of 640 x 480 pixels; --size says 800 x 600"),
            (["--corners", "CSV", "--model", "fish"], "--model: there is no camera model 'fish'"),
            (
                ["--corners", "CSV", "--model", "equirectangular"],
                "model: a model of kind 'equirectangular' cannot be calibrated",
            ),
            (["--corners", "CSV", "--lens", "k9"], "--lens: there is no lens term 'k9'"),
            (["--corners", "CSV", "--model", "eucm", "--lens", "k1"], "has its own distortion and no [lens] terms"),
            (["--corners", "CSV", "--fix", "xi=a"], "--fix: must be KEY or KEY=NUMBER; found 'xi=a'"),
            (["--corners", "CSV", "--fix", "xi=-2"], "--fix: model.xi: must be greater than or equal to 0; found -2"),
            (
                ["--corners", "CSV", "--board", "9x6", "--square-m", "1"],
                "--board: leave it out: the file of corners",
            ),
            (["--corners", "CSV", "--free", "a_m"], "--free: there is no one key 'a_m' to estimate"),
            (["--corners", "CSV", "--start", "none.toml"], "none.toml: no such file"),
            (["--corners", "CSV", "--model", "hyperboloid", "--elevation", "-70", "70"], "cannot have this field"),
            (["b.png", "--corners", "CSV"], "--corners: give images or corners, not both"),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(self, arguments, message, csv, capsys, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        code = main(["calibrate", *(str(csv) if each == "CSV" else each for each in arguments)])
        said = capsys.readouterr()
        assert code == 2
        assert message in said.err
        assert said.err.count("\n") == 1

    def test_the_field_has_an_angle(self, capsys):
        with pytest.raises(SystemExit) as caught:
            main(["calibrate", "a.png", "--board", "9x6", "--square-m", "1", "--angle-max", "0"])
        assert caught.value.code == 2
        assert "omnirange: --angle-max: must be a number above 0; found '0'" in capsys.readouterr().err

    def test_board_is_two_numbers(self, capsys):
        with pytest.raises(SystemExit) as caught:
            main(["calibrate", "a.png", "--board", "nine"])
        assert caught.value.code == 2
        assert "must be two numbers of inner corners, as 9x6; found 'nine'" in capsys.readouterr().err


class TestArguments:
    def test_places_by_name(self):
        corners, _ = visible_boards(MIRROR, 5, 42)
        ends = [*corners.starts, len(corners.image)]
        places = {
            name: (corners.points_m[ends[i] : ends[i + 1]], corners.pixels[ends[i] : ends[i + 1]].tolist())
            for i, name in enumerate(corners.images)
        }
        calibration = harness.calibrate(corners=places, size=(640, 480), model="hyperboloid", fix={"aspect": 1.0})
        assert calibration.corners.images == corners.images
        assert np.nanmax(np.abs(ray_difference(calibration.sensor, MIRROR, calibration.grid))) < 1e-6

    @pytest.mark.parametrize(
        ("corners", "size", "message"),
        [
            ({"a": 3}, (640, 480), "corners: must be a file, or points on the board"),
            ({"a": ([1, 2], "x")}, (640, 480), "corners: must be a file, or points on the board"),
            ({}, (640, 480), "corners: contains no corners"),
            ({"a": ([1, 2], [3, 4])}, None, "size: give the width and height of the images"),
            ({"a": ([1, 2], [3, 4])}, (640, 480), "image 'a' has 1 corners"),
        ],
    )
    def test_what_is_no_corners(self, corners, size, message):
        with pytest.raises(InputError, match=message):
            harness.calibrate(corners=corners, size=size)


@pytest.mark.long
@pytest.mark.slow
def test_from_rendered_images_to_the_sensor_that_took_them(tmp_path):
    """The whole chain against the truth: images, corners, sensor."""
    camera = {"width_px": 1280, "height_px": 960, "focal_px": 1228, "aspect": 1.01, "cx_px": 645.0, "cy_px": 474.0}
    sensor = harness.load_sensor({"camera": camera, "field": {"elevation_max_deg": 19.0}})
    files = []
    for i, azimuth in enumerate(np.radians(range(0, 360, 45))):
        place = [0.35 * np.cos(azimuth), 0.35 * np.sin(azimuth), 0.9]
        turn = {"yaw_deg": 45 * i + 12 * (i % 2), "pitch_deg": 75 + 13 * (i % 3), "roll_deg": 12 * (i % 4) - 18}
        board = {"kind": "chessboard", "position_m": place, **turn}
        room = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 110}}
        view = harness.render({"name": "t", "objects": [room, board]}, sensor=sensor, position_m=(0, 0, 1))
        assert boards_of(view.scene, sensor, view.pose)[0].visible.all()
        noise = np.random.default_rng(i).normal(0, 2, view.image.shape)
        files.append(tmp_path / f"{i}.png")
        files[-1].write_bytes(png((view.image + noise).astype(np.float32)))
    said: list[str] = []
    calibration = harness.calibrate(files, board=BOARD, model="hyperboloid", tell=said.append)
    assert len(calibration.corners.images) == 8
    # Corners are good to 0.04 px (tests/test_boards_in_images.py), not all of it noise.
    assert calibration.rms_px < 0.06
    error = np.linalg.norm(ray_difference(calibration.sensor, sensor, calibration.grid), axis=-1)
    assert np.median(error) < 0.15
    assert any("8 of 8" in line for line in said)


@pytest.mark.long
@pytest.mark.slow
def test_misalignment_is_told_and_written_with_the_best_central_sensor_beside_it(tmp_path, capsys):
    askew = Sensor(misalignment=Misalignment(x_mm=1, rotation_y_deg=0.5))
    corners = noisy(visible_boards(askew, 10, 30)[0], 0.1, 7)
    (tmp_path / "corners.csv").write_text(corners_csv(corners), encoding="utf-8")
    command = ["calibrate", "--corners", str(tmp_path / "corners.csv"), "--misalignment", "--model"]
    assert main([*command, "hyperboloid", "--out", str(tmp_path / "mine.toml")]) == 0
    said = capsys.readouterr().out
    assert re.search(r"misalignment\.x_mm +\S+  ± 0\.", said)
    central = re.search(r"the best central sensor, with camera and mirror aligned, leaves (0\.\d+) px", said)
    assert float(central[1]) > 0.2
    assert "mine-central.toml" in said
    sensor, other = (harness.load_sensor(tmp_path / f"mine{end}.toml") for end in ("", "-central"))
    assert abs(sensor.misalignment.x_mm - 1) < 0.5
    assert other.is_central
    table = json.loads((tmp_path / "mine.json").read_text(encoding="utf-8"))
    assert table["central"]["rms_px"] == pytest.approx(float(central[1]), abs=6e-4)
    assert "misalignment.rotation_y_deg" in [each["key"] for each in table["parameters"]]
    page = (tmp_path / "mine.html").read_text(encoding="utf-8")
    assert "Could not be drawn" not in page
    assert "RMS distance with the best central sensor" in page
    assert "misalignment.z_mm" in page
    assert (
        main(
            [
                "range",
                "a.png",
                "b.png",
                "--sensor",
                str(tmp_path / "mine.toml"),
                "--baseline",
                "0.5",
                "0",
                "0",
                "--out",
                str(tmp_path / "range"),
            ]
        )
        == 2
    )
    assert re.search(r"mine\.toml: misalignment: .* calibrate writes beside it", capsys.readouterr().err)
    assert main([*command, "unified"]) == 2
    assert "--misalignment: a unified (Mei) camera has no mirror" in capsys.readouterr().err
    assert main(["sensor", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "sensor.html")]) == 0
    assert "Camera and mirror are misaligned (x_mm = " in capsys.readouterr().out


@pytest.mark.parametrize("name", ["s.html", "s.json", "corners.csv", "folder/"])
def test_a_file_that_is_no_toml_is_refused_before_any_of_three_replaces_another(name, tmp_path, capsys):
    assert main(["calibrate", "--corners", "corners.csv", "--out", f"{tmp_path}/{name}"]) == 2
    assert "must end in .toml: the page and all numbers are written beside it" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("given", "out"), [("a.json", "a.toml"), ("a.toml", "a.toml"), ("a-central.toml", "a.toml")])
def test_no_file_that_is_read_is_written_over(given, out, csv, tmp_path, capsys):
    file = tmp_path / given
    file.write_bytes(csv.read_bytes())
    corners = ["--corners", str(file)] if given == "a.json" else ["--corners", str(csv), "--start", str(file)]
    options = ["--model", "hyperboloid", "--misalignment", "--out", str(tmp_path / out)]
    assert main(["calibrate", *corners, *options]) == 2
    assert (
        capsys.readouterr().err == f"omnirange: {file}: --out: would be written over, and is read; give another name\n"
    )
    assert [each.name for each in tmp_path.iterdir()] == [given]
    assert file.read_bytes() == csv.read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--lens", "q1"], "--lens: there is no lens term 'q1'"),
        (["--fix", "foo"], "--fix: there is no one key 'foo' to estimate"),
        (["--fix", "xi=-1"], "--fix: model.xi"),
        (["--free", "foo"], "--free: there is no one key 'foo' to estimate"),
        (["--model", "kannala_brandt", "--misalignment"], "--misalignment: "),
    ],
)
def test_what_is_to_be_estimated_is_checked_before_corners_are_looked_for(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("harness.api.calibrating.find_corners", None)
    image = tmp_path / "a.png"
    image.write_bytes(png(np.zeros((48, 64), dtype=np.uint8)))
    assert main(["calibrate", str(image), "--board", "9x6", "--square-m", "0.04", *words]) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {said}")


def test_a_folder_is_no_file_of_corners(tmp_path, capsys):
    assert main(["calibrate", "--corners", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"omnirange: {tmp_path}: is not a regular file; give a corner file\n"


def test_a_value_of_the_camera_waits_for_the_size_of_the_images(csv, capsys):
    assert main(["calibrate", "--corners", str(csv), "--model", "hyperboloid", "--fix", "cx=-5000"]) == 2
    assert capsys.readouterr().err.startswith("omnirange: --fix: camera.cx_px")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sensor.json", "sensor.html"])
@pytest.mark.usefixtures("undrawn")
def test_files_of_ones_own_beside_the_sensor_file_are_kept(name, csv, written, tmp_path, capsys, monkeypatch):
    own = tmp_path / name
    own.write_text('{"mine": 1}')
    problem = "is there already, and nothing shows that it is from an earlier calibration; give another name"
    said = f"{own}: --out: {problem}"
    with pytest.raises(InputError, match=re.escape(said)):
        written[0].write(tmp_path / "sensor.toml")
    monkeypatch.setattr(harness, "calibrate", None)
    assert main(["calibrate", "--corners", str(csv), "--out", str(tmp_path / "sensor.toml")]) == 2
    assert capsys.readouterr().err == f"omnirange: {said}\n"
    assert own.read_text() == '{"mine": 1}'
    own.unlink()
    for _ in range(2):
        written[0].write(tmp_path / "sensor.toml")
