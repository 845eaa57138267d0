"""`omnirange sensor`: what it says, what it draws, and what it converts."""

import re
import tempfile
import tomllib
from pathlib import Path

import calibration_files as files
import numpy as np
import pytest
from browser import chromium, visit
from PIL import Image

import harness
from harness import Sensor
from harness.camera.central import central_of
from harness.camera.misalignment import Misalignment
from harness.camera.models import BUILT_IN
from harness.camera.optics import optics_of
from harness.camera.sensor import pixel_directions, unproject
from harness.cli import main
from harness.cli.sensor import FORMATS
from harness.errors import InputError
from harness.io.calibrations.conversion import formats
from harness.spec import dump_toml, parse

MIRROR = Sensor()
FISHEYE = {
    "model": {"kind": "kannala_brandt", "k1": 0.01, "k2": -0.002, "k3": 0.0, "k4": 0.0},
    "camera": {"width_px": 640, "height_px": 480, "focal_px": 150.0, "cx_px": 322.0, "cy_px": 238.0},
    "field": {"elevation_min_deg": -5.0, "elevation_max_deg": 90.0},
}


def said(capsys, *arguments, code=0):
    """What goes to standard output, or to standard error when something is wrong."""
    assert main(["sensor", *map(str, arguments)]) == code
    captured = capsys.readouterr()
    return captured.err if code else captured.out


@pytest.fixture
def mirror(tmp_path):
    return files.write(tmp_path, dump_toml(MIRROR), "mirror.toml")


@pytest.fixture
def fisheye(tmp_path):
    return files.write(tmp_path, dump_toml(parse(Sensor, FISHEYE)), "fisheye.toml")


@pytest.mark.parametrize("name", ["e.yaml", "e.toml", "e.txt"])
@pytest.mark.parametrize("content", ["", " \n", "# nothing\n"])
def test_an_empty_file_is_no_sensor(name, content, tmp_path, capsys):
    file = files.write(tmp_path, content, name)
    assert "is empty; a sensor's file has tables such as [model] and [camera]" in said(capsys, file, code=2)


def test_a_mask_that_is_not_in_a_calibration_is_said(tmp_path, capsys):
    Image.new("L", (640, 480), 255).save(tmp_path / "mask.png")
    file = files.write(tmp_path, 'mask = "mask.png"\n' + dump_toml(MIRROR), "masked.toml")
    text = said(capsys, file, "--to", "kalibr", "--out", tmp_path / "k.yaml")
    assert f"the mask is not in it either: {tmp_path / 'mask.png'}" in text
    assert "the mask is not in it" not in said(capsys, file, "--to", "toml", "--out", tmp_path / "t.toml")


# --- Words and picture ---------------------------------------------------------------------------------------------


def test_what_is_said_of_the_default_sensor(mirror, tmp_path, capsys):
    text = said(capsys, mirror, "--out", tmp_path / "page.html")
    assert text.splitlines()[:2] == [f"{mirror}: a sensor file", "Hyperboloid mirror, 640 x 480 pixels"]
    facts = dict(re.findall(r"^  (\w[\w ]*?)  +(.*)$", text, re.MULTILINE))
    assert facts["mount"] == "looks down, mirrored"
    assert facts["field"].startswith("15 to 110 deg off the optical axis; the image has elevations -75 to 20 deg")
    assert facts["image circle"] == "476 px across, around (319.5, 239.5), all of it on the image"
    assert facts["blind spot"] == "42 px across, around (319.5, 239.5): up to 15 deg off the axis"
    assert facts["used"].startswith("57.5% of the image's pixels")
    assert "! " not in text
    assert "note: " not in text
    assert (tmp_path / "page.html").read_text().startswith("<!DOCTYPE html>")


def test_what_is_said_of_a_camera_in_a_rig(tmp_path, capsys):
    path = files.write(tmp_path, files.KALIBR)
    text = said(capsys, path, "--camera", 1, "--angle-max", 100, "--out", tmp_path / "a.svg")
    assert text.startswith(
        f"{path}: Kalibr camchain (YAML), camera 1 (cam1) of 4\nDouble sphere camera, 512 x 512 pixels\n"
    )
    assert "looks up, not mirrored" in text
    # By hand: cam0 at the origin; cam1 is at -R^T t, turned by 90° about z.
    assert "--baseline -0.2 0.1 -0.3 --rotation-deg -90 0 0" in text
    assert "note: the file does not say how the camera is mounted" in text
    assert "how far the lens sees" not in text  # it was told


@pytest.mark.slow
def test_what_does_not_fit_is_said(tmp_path, capsys):
    corner = FISHEYE | {"camera": FISHEYE["camera"] | {"focal_px": 40.0, "cx_px": 100.0, "cy_px": 90.0}}
    text = said(capsys, files.write(tmp_path, dump_toml(parse(Sensor, corner))), "--out", tmp_path / "a.png")
    assert "! The optical axis meets the image at (100.0, 90.0), 266 px from its middle (319.5, 239.5)" in text
    assert "lies 220 px left, 150 px up of its middle" in text
    assert "Is the focal length that of another resolution?" in text
    cut = FISHEYE | {"camera": FISHEYE["camera"] | {"focal_px": 180.0}}
    text = said(capsys, files.write(tmp_path, dump_toml(parse(Sensor, cut))), "--out", tmp_path / "a.png")
    assert re.search(r"! The edge of the field leaves the image at the top and bottom: \d+% of its directions", text)
    said(capsys, files.write(tmp_path, dump_toml(parse(Sensor, FISHEYE))), "--out", tmp_path / "a.png")


@pytest.mark.slow
def test_pictures_alone(mirror, tmp_path, capsys):
    for name in ("a.svg", "a.png"):
        said(capsys, mirror, "--out", tmp_path / name)
    assert (tmp_path / "a.svg").read_text().lstrip().startswith("<?xml")
    with Image.open(tmp_path / "a.png") as image:
        assert image.width > 1500
    assert "must end in .html, .svg or .png" in said(capsys, mirror, "--out", tmp_path / "a.gif", code=2)


def test_from_python():
    described = harness.describe_sensor()
    assert str(described).startswith("Hyperboloid mirror, 640 x 480 pixels\n  model ")
    assert described.coverage.used == pytest.approx(pixel_directions(MIRROR)[1].mean())
    assert described._repr_html_().startswith('<img alt="" style')
    with pytest.raises(InputError, match="no pixel sees anything"):
        harness.describe_sensor(
            FISHEYE | {"field": {"elevation_min_deg": -75.0, "elevation_max_deg": -60.0, "angle_max_deg": 120.0}}
        )


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_is_readable_on_a_desk_and_on_a_phone(tmp_path):
    with chromium(tmp_path / "profile", scripts=False) as context:
        for name, sensor in (("mirror", MIRROR), ("fisheye", parse(Sensor, FISHEYE))):
            harness.describe_sensor(sensor).write(tmp_path / f"{name}.html", ("a note",))
            for width, columns in ((1200, 2), (400, 1)):
                visited = visit(context, tmp_path / f"{name}.html", width=width)
                assert not visited.requests
                assert not visited.complaints
                assert visited.page.evaluate("document.documentElement.scrollWidth") <= width
                boxes = [visited.page.locator("figure img").nth(i).bounding_box() for i in (0, 1)]
                assert all(box["width"] > 300 for box in boxes)
                assert len({round(box["x"]) for box in boxes}) == columns  # beside each other, or below


# --- Conversion ----------------------------------------------------------------------------------------------------


def test_the_formats_are_those_of_the_reader():
    assert set(FORMATS) == set(formats())


def rays_apart(one, other):
    """The largest difference of unit rays over what the first sensor sees."""
    _, valid = pixel_directions(one)
    v, u = np.nonzero(valid)
    pixels = np.stack([u, v], axis=-1)[::7].astype(float)
    return np.abs(unproject(one, pixels)[0] - unproject(other, pixels)[0]).max()


def from_text(text, camera=None, **choices):
    """A sensor from a calibration file's text, whose field ends before the image's corners."""
    with tempfile.TemporaryDirectory() as folder:
        return harness.load_sensor(
            files.write(Path(folder), text), camera=camera, **({"angle_max_deg": 70.0} | choices)
        )


EXACT = [
    (MIRROR, "opencv", None),
    (MIRROR, "opencv-xml", "unified"),
    (MIRROR, "kalibr", "unified"),
    (MIRROR, "kalibr", "eucm"),
    (MIRROR, "kalibr", "double_sphere"),
    (MIRROR, "camodocal", None),
    (MIRROR, "basalt", None),
    (MIRROR, "colmap", "eucm"),
    (MIRROR, "toml", "unified"),
    (FISHEYE, "opencv", None),
    (FISHEYE, "kalibr", None),
    (FISHEYE, "camodocal", None),
    (FISHEYE, "basalt", None),
    (FISHEYE, "colmap", None),
    (FISHEYE, "toml", None),
    (from_text(files.OMNIDIR_YAML), "opencv", None),
    (from_text(files.OMNIDIR_XML, looks="down", mirrored=True), "opencv-xml", None),
    (from_text(files.FISHEYE_YAML, looks="forward"), "opencv", None),
    (from_text(files.KALIBR, 0), "kalibr", None),
    (from_text(files.KALIBR, 1), "kalibr", None),
    (from_text(files.KALIBR, 2, angle_max_deg=50.0), "kalibr", None),
    (from_text(files.KALIBR, 3, looks="down"), "kalibr", None),
    (from_text(files.CAMODOCAL), "camodocal", None),
    (from_text(files.OCAMCALIB), "ocamcalib", None),
    (from_text(files.BASALT, 0), "basalt", None),
    (from_text(files.BASALT, 3), "basalt", None),
    (from_text(files.COLMAP, 0), "colmap", None),
    (from_text(files.COLMAP, 1, angle_max_deg=50.0), "colmap", None),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "to", "model"), EXACT, ids=lambda each: None if isinstance(each, dict | Sensor) else each
)
def test_an_exact_conversion_has_the_same_rays(sensor, to, model, tmp_path, capsys):
    """There, back into ours, and there again: to 1e-9 rad, of which roundings make 1e-12."""
    first = parse(Sensor, sensor) if isinstance(sensor, dict) else sensor
    path = files.write(tmp_path, dump_toml(first), "first.toml")
    words = [path, "--to", to, *(["--model", model] if model else []), "--out", tmp_path / "there"]
    text = said(capsys, *words)
    assert ", exact; rays differ by " in text
    choices = re.search(r"read it with (.*)", text)[1].split() if to != "toml" else []
    said(capsys, tmp_path / "there", *choices, "--to", "toml", "--out", tmp_path / "back.toml")
    back = harness.load_sensor(tmp_path / "back.toml")
    assert rays_apart(first, back) < 1e-9
    assert (pixel_directions(first)[1] != pixel_directions(back)[1]).mean() < 1e-4  # the field is the same
    said(
        capsys, tmp_path / "back.toml", "--to", to, *(["--model", model] if model else []), "--out", tmp_path / "again"
    )
    again = harness.load_sensor(tmp_path / "again", looks=first.looks, mirrored=first.mirrored)
    assert rays_apart(first, again) < 1e-9


def test_a_conversion_that_is_not_exact_says_how_near(fisheye, tmp_path, capsys):
    text = said(capsys, fisheye, "--to", "kalibr", "--model", "double_sphere", "--out", tmp_path / "ds.yaml")
    result = re.search(
        r"the nearest: RMS (\S+) deg \((\S+) px\), at most (\S+) deg \((\S+) px\), "
        r"over (\d+) pixels, (\S+) to (\S+) deg",
        text,
    )
    rms_deg, rms_px, most_deg, most_px, pixels, low, high = map(float, result.groups())
    first = parse(Sensor, FISHEYE)
    second = harness.load_sensor(tmp_path / "ds.yaml", elevation_deg=(-5.0, 90.0))
    v, u = np.nonzero(pixel_directions(first)[1])
    there = np.stack([u, v], axis=-1).astype(float)
    one, other = optics_of(first).unproject(there), optics_of(second).unproject(there)
    angles = np.degrees(2 * np.arcsin(np.linalg.norm(one - other, axis=-1) / 2))
    # It was measured over a part of these pixels and the border's.
    assert rms_deg == pytest.approx(np.sqrt(np.mean(angles**2)), rel=0.1)
    assert most_deg == pytest.approx(angles.max(), rel=0.1)
    apart = np.linalg.norm(optics_of(second).project(one) - there, axis=-1)
    assert (rms_px, most_px) == pytest.approx((np.sqrt(np.mean(apart**2)), apart.max()), rel=0.1)
    assert rms_px < 0.2
    assert pixels > 5000
    assert (low, high) == pytest.approx((0, 95), abs=1)


@pytest.mark.slow
def test_what_is_too_far_is_refused_unless_it_is_allowed(tmp_path, capsys):
    """OCamCalib's affine part shears the image by 0.005, some 1.5 px at the rim; COLMAP's models have no skew."""
    path = files.write(tmp_path, files.OCAMCALIB)
    words = [path, "--angle-max", 90, "--to", "colmap"]
    text = said(capsys, *words, code=2)
    apart = float(re.search(r"--to: the nearest Kannala-Brandt fisheye is (\S+) px RMS away", text)[1])
    assert 0.2 < apart < 1
    assert "--allow-residual PX accepts it" in text
    assert said(capsys, *words, "--allow-residual", 1.01 * apart).startswith("# Camera list")
    with pytest.raises(SystemExit, match="2"):
        main(["sensor", *map(str, words), "--allow-residual", "0"])


def test_the_file_goes_to_standard_output_and_words_beside_it(mirror, capsys):
    assert main(["sensor", str(mirror), "--to", "kalibr"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("cam0:\n  cam_overlaps: []\n  camera_model: omni\n")
    assert "exact" in captured.err
    assert "read it with --looks down --mirrored --elevation -75 20" in captured.err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (
            ["--to", "colmap", "--model", "unified"],
            "--model: colmap has no model 'unified'; it has kannala_brandt, eucm",
        ),
        (["--to", "toml", "--model", "fish"], "--model: toml has no model 'fish'; it has "),
        (["--camera", 3], "--camera: has one camera, number 0"),
        (["--size", 10, 20], "--size: leave it out: the sensor file says its size"),
        (["--elevation", 30, 20], "omnirange: --elevation: the first must be below the second"),
        (["--elevation", -91, 20], "both within -90 .. 90; found -91 and 20"),
    ],
)
def test_what_cannot_be_is_answered_in_one_line(arguments, problem, mirror, capsys):
    text = said(capsys, mirror, *arguments, code=2)
    assert problem in text
    assert text.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in BUILT_IN if kind not in ("hyperboloid", "equirectangular")])
def test_every_model_of_ours_is_near_a_fisheye(kind):
    """The field stays, so that the picture is the same to a fraction of a pixel."""
    converted = harness.convert_sensor(FISHEYE, "toml", model=kind, allow_residual_px=1)
    assert f'kind = "{kind}"' in converted.text
    assert converted.conversion.rms_px < 1


def test_other_commands_take_the_same_options(tmp_path, capsys):
    """Refused where there is nothing to choose from; else read with them."""
    box = ["render", "box", "--at", "0", "0", "1", "--out", str(tmp_path / "view")]
    assert main([*box, "--looks", "up"]) == 2
    assert "--sensor: is missing: there is no file for the other options" in capsys.readouterr().err
    path = str(files.write(tmp_path, files.KALIBR))
    assert main([*box, "--sensor", path]) == 2
    assert "--camera: has 4 cameras" in capsys.readouterr().err
    pair = ["range", "a.png", "b.png", "--baseline", "1", "0", "0", "--out", str(tmp_path / "o"), "--sensor", path]
    assert main([*pair, "--camera", "1", "--camera-2", "1"]) == 2
    assert "--sensor-2: is missing: there is no file for --camera-2" in capsys.readouterr().err
    assert main([*pair, "--camera", "1", "--sensor-2", path, "--camera-2", "9"]) == 2
    assert "--camera-2: there is no camera 9; the file has 0 to 3" in capsys.readouterr().err


@pytest.mark.slow  # the loops are compiled for a fisheye
def test_a_view_through_a_calibrated_fisheye(tmp_path, capsys):
    """Looking up in the 6 m box: the sensor's file is written as it was read, and the ceiling is 5 m above."""
    path = files.write(tmp_path, files.KALIBR)
    words = ["--sensor", path, "--camera", 3, "--angle-max", 85, "--samples", 1, "--out", tmp_path / "view"]
    assert main(["render", "box", "--at", "0", "0", "1", *map(str, words)]) == 0
    capsys.readouterr()
    sensor = harness.load_sensor(tmp_path / "view" / "sensor.toml")
    assert sensor == harness.load_sensor(path, camera=3, angle_max_deg=85.0)
    range_m = np.load(tmp_path / "view" / "range.npy")
    directions, valid = pixel_directions(sensor)
    assert np.isfinite(range_m[valid]).all()
    ceiling = valid & (directions[..., 2] > 0.9)
    assert range_m[ceiling] * directions[..., 2][ceiling] == pytest.approx(5.0, abs=1e-6)


def test_the_nearest_central_sensor_of_a_mirror_of_another_shape_is_written(tmp_path, capsys):
    own = files.write(
        tmp_path,
        '[profile]\nkind = "sphere"\nradius_m = 0.03\nrim_m = 0.0247\ncamera_m = 0.06\n[camera]\nfocal_px = 760.0\n',
        "own.toml",
    )
    assert "omnirange sensor FILE --central --to toml --out central.toml writes it" in said(
        capsys, own, "--to", "toml", code=2
    )
    written = tmp_path / "new" / "central.toml"
    assert main(["sensor", str(own), "--central", "--to", "toml", "--out", str(written)]) == 0
    assert "(0.00081 px) RMS at 3 m" in capsys.readouterr().err
    assert harness.load_sensor(written) == central_of(harness.load_sensor(own))
    assert main(["sensor", str(own), "--central", "--to", "toml", "--out", str(tmp_path)]) == 2
    assert f"{tmp_path}: --out: is a folder; give the name of a file" in capsys.readouterr().err


def test_of_a_misaligned_sensor_the_aligned_one_is_written(tmp_path, capsys):
    tilted = MIRROR.model_copy(update={"misalignment": Misalignment(x_mm=0.5)})
    file = files.write(tmp_path, dump_toml(tilted), "tilted.toml")
    text = said(capsys, file, "--central", "--to", "toml")
    assert parse(Sensor, tomllib.loads(text)) == MIRROR


def test_a_profile_that_no_pixel_sees_is_named_with_its_file(tmp_path, capsys):
    far = files.write(
        tmp_path,
        '[profile]\nkind = "sphere"\nradius_m = 0.03\nrim_m = 0.0247\ncamera_m = 90\n[camera]\nfocal_px = 760.0\n',
        "far.toml",
    )
    assert said(capsys, far, code=2).startswith(f"omnirange: {far}: profile: no pixel of the image sees anything")


def test_a_sensor_without_a_format_is_refused_before_anything_is_made(mirror, tmp_path, capsys):
    text = said(capsys, mirror, "--central", "--out", tmp_path / "new" / "c.toml", code=2)
    assert "new/c.toml: --out: must end in .html, .svg or .png; give --to FORMAT, such as --to toml" in text
    missing = said(capsys, tmp_path / "none.toml", "--to", "toml", "--out", tmp_path / "new" / "c.toml", code=2)
    assert "none.toml: no such file" in missing
    assert not (tmp_path / "new").exists()


def test_a_sensor_is_not_written_over_itself(mirror, capsys):
    before = mirror.read_bytes()
    text = said(capsys, mirror, "--to", "kalibr", "--out", mirror, code=2)
    assert f"{mirror}: --out: would be written over, and is read; give another name" in text
    assert mirror.read_bytes() == before
