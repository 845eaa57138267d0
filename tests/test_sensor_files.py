"""Sensors from calibration files: the numbers in a file by its program's own formulas, mount, field, and refusals."""

import warnings
from pathlib import Path

import calibration_files as files
import numpy as np
import pytest

import harness
from harness import shipped
from harness.camera.conversions import UnifiedParameters, from_unified
from harness.camera.sensor import pixel_directions, project, unproject
from harness.errors import InputError, Notice
from harness.geometry.panorama import Grid, directions
from harness.io.calibrations.sensors import Chosen, load_sensor, read_sensor
from harness.runs.load import load_experiment
from harness.spec import dump_toml

RAYS = np.array([[0.3, -0.2, 1.0], [-0.7, 0.4, 0.9], [0.1, 0.8, 0.5], [0.02, 0.01, 1.0]])
"""In the lens's frame, which is the sensor's of one that looks up."""


def brown(x, y, k1, k2, p1, p2, k3=0.0):
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)


def mei(xi, lens, fu, fv, cu, cv, skew=0.0):
    x, y, z = RAYS.T
    along = z + xi * np.sqrt(x * x + y * y + z * z)
    m, n = brown(x / along, y / along, *lens)
    return np.stack([fu * m + skew * n + cu, fv * n + cv], axis=-1)


def kannala_brandt(k, fu, fv, cu, cv):
    x, y, z = RAYS.T
    across = np.hypot(x, y)
    theta = np.arctan2(across, z)
    r = theta + sum(each * theta ** (3 + 2 * i) for i, each in enumerate(k))
    return np.stack([fu * r * x / across + cu, fv * r * y / across + cv], axis=-1)


def double_sphere(xi, alpha, fu, fv, cu, cv):
    x, y, z = RAYS.T
    z_2 = z + xi * np.sqrt(x * x + y * y + z * z)
    along = alpha * np.sqrt(x * x + y * y + z_2**2) + (1 - alpha) * z_2
    return np.stack([fu * x / along + cu, fv * y / along + cv], axis=-1)


def eucm(alpha, beta, fu, fv, cu, cv):
    x, y, z = RAYS.T
    along = alpha * np.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
    return np.stack([fu * x / along + cu, fv * y / along + cv], axis=-1)


OMNIDIR = mei(
    1.1436422518426306,
    (0.0775313339533257, 0.027664400596417553, 0.0013229517533848763, 1e-5),
    282.23938294331566, 283.15607125, 515.39853520931602, 384.7398940330911, 0.5,
)  # fmt: skip
FISHEYE = kannala_brandt((-0.013, 0.0041, -0.0023, 0.00031), 401.23, 400.98, 803.12, 598.77)
BY_HAND = {
    "omnidir YAML": (files.OMNIDIR_YAML, None, OMNIDIR),
    "omnidir XML": (files.OMNIDIR_XML, None, OMNIDIR),
    "OpenCV fisheye": (files.FISHEYE_YAML, None, FISHEYE),
    "Kalibr omni": (files.KALIBR, 0, mei(1.45, (-0.21, 0.13, 0.0006, -0.0004), 833.0, 830.3, 373.9, 253.7)),
    "Kalibr ds": (files.KALIBR, 1, double_sphere(-0.18, 0.59, 158.2, 158.4, 255.0, 256.1)),
    "Kalibr eucm": (files.KALIBR, 2, eucm(0.63, 1.04, 461.6, 460.2, 362.7, 246.0)),
    "Kalibr equi": (
        files.KALIBR, 3, kannala_brandt((-0.0131, 0.0501, -0.0451, 0.0124), 190.9, 190.8, 254.9, 256.9),
    ),
    "CamOdoCal": (
        files.CAMODOCAL, None,
        mei(
            2.213404750785489,
            (0.016798235660113681, 1.6548773243373522, 4.2223943394772046e-04, 4.2462134260997584e-04),
            1336.3220825849971, 1335.7883350012958, 716.94323510126321, 505.76421000000002,
        ),
    ),
    "basalt ds": (files.BASALT, 0, double_sphere(-0.18, 0.59, 158.2, 158.4, 255.0, 256.1)),
    "basalt kb4": (files.BASALT, 1, kannala_brandt((0.0034, 0.0007, -0.002, 0.0002), 190.9, 190.8, 254.9, 256.9)),
    "basalt eucm": (files.BASALT, 2, eucm(0.63, 1.04, 190.4, 190.5, 253.9, 257.9)),
    "basalt ucm": (files.BASALT, 3, eucm(0.6, 1.0, 190.4, 190.5, 253.9, 257.9)),
    "COLMAP": (files.COLMAP, 0, FISHEYE),
    "COLMAP perspective": (
        files.COLMAP, 3, mei(0.0, (-0.28, 0.07, 0.0009, 0.0001), 420.5, 421.5, 318.2, 242.9),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BY_HAND)
def test_pixels_are_those_of_the_programs_own_formulas(name, tmp_path):
    text, number, expected = BY_HAND[name]
    sensor = load_sensor(files.write(tmp_path, text), Chosen(camera=number))
    result, _ = project(sensor, RAYS)
    # What is outside the domain (a perspective lens's fold) has no pixel; of two rays at least it must be known.
    known = np.isfinite(result).all(axis=-1)
    assert known.sum() >= 2
    assert result[known] == pytest.approx(expected[known], abs=1e-9)  # a dozen roundings of a few hundred pixels


def test_rays_of_ocamcalib_are_those_of_its_manual(tmp_path):
    """x along rows, y along columns, z = f(rho), the axis along -z: (X, Y, Z) = (y, x, -z)."""
    sensor = load_sensor(files.write(tmp_path, files.OCAMCALIB))
    u, v = 500.25, 100.5
    x, y = np.linalg.solve([[0.998881, -0.002038], [0.003079, 1]], [v - 241.019976, u - 385.783141])
    rho = np.hypot(x, y)
    ray = np.array([y, x, -(-219 + 1.9e-3 * rho**2 - 3.1e-6 * rho**3 + 1.2e-8 * rho**4)])
    assert unproject(sensor, [u, v])[0] == pytest.approx(ray / np.linalg.norm(ray), abs=1e-14)


# --- What the file does not say ------------------------------------------------------------------------------------


def test_as_far_as_the_image_or_the_model_reaches(tmp_path):
    """By hand, of an equidistant lens: to the corner that is farthest from the centre."""
    text = "1 FISHEYE 640 480 300 300 320 240\n"
    sensor_file = read_sensor(files.write(tmp_path, text))
    corner = np.degrees(np.hypot(320, 240) / 300)
    assert sensor_file.sensor.field.elevation_min_deg == pytest.approx(90 - corner, abs=2e-6)
    assert sensor_file.sensor.field.elevation_max_deg == 90
    assert any(f"all that the image allows is taken, {corner:.4g} deg" in note for note in sensor_file.notes)
    assert any("it looks up and is not mirrored" in note for note in sensor_file.notes)
    wide = read_sensor(files.write(tmp_path, text.replace("300 300", "100 100")))
    assert any("all that the model allows is taken" in note for note in wide.notes)


def test_a_field_that_is_chosen(tmp_path):
    path = files.write(tmp_path, files.FISHEYE_YAML)
    sensor = load_sensor(path, Chosen(angle_max_deg=95.0))
    assert (sensor.field.elevation_min_deg, sensor.field.elevation_max_deg) == (-5, 90)
    assert sensor.field.angle_max_deg == 95
    down = load_sensor(path, Chosen(looks="down", mirrored=True, elevation_deg=(-60.0, 15.0)))
    assert (down.field.elevation_min_deg, down.field.elevation_max_deg) == (-60, 15)
    forward = load_sensor(path, Chosen(looks="forward", angle_max_deg=70.0))
    assert (forward.field.elevation_min_deg, forward.field.elevation_max_deg) == (-70, 70)
    assert read_sensor(path, Chosen(looks="up", angle_max_deg=95.0)).notes == ()


@pytest.mark.parametrize(
    ("looks", "mirrored", "turned"),
    [
        ("up", False, lambda X, Y, Z: (X, Y, Z)),
        ("up", True, lambda X, Y, Z: (X, -Y, Z)),
        ("down", False, lambda X, Y, Z: (X, -Y, -Z)),
        ("down", True, lambda X, Y, Z: (X, Y, -Z)),
        ("forward", False, lambda X, Y, Z: (Z, -X, -Y)),
        ("forward", True, lambda X, Y, Z: (Z, X, -Y)),
    ],
)
def test_how_it_is_mounted(looks, mirrored, turned, tmp_path):
    """The same pixels, of directions in the sensor's frame: z up, and X, Y, Z of the lens where it is mounted."""
    sensor = load_sensor(files.write(tmp_path, files.FISHEYE_YAML), Chosen(looks=looks, mirrored=mirrored))
    directions = np.stack(turned(*RAYS.T), axis=-1)
    assert project(sensor, directions)[0] == pytest.approx(FISHEYE, abs=1e-9)


def test_a_mirror_by_omnidir_is_the_hyperboloid(tmp_path):
    """A mirror without lens terms: the sensor that `from_unified` makes, which looks down and is mirrored."""
    text = files.OMNIDIR_YAML.replace("1.1436422518426306e+00", "0.96").replace("7.7531333953325700e-02", "0.0")
    text = text.replace("2.7664400596417553e-02", "0.").replace("1.3229517533848763e-03", "0.").replace("1e-05", "0.")
    sensor = load_sensor(files.write(tmp_path, text), Chosen(looks="down", mirrored=True))
    unified = UnifiedParameters(
        xi=0.96, gamma_u_px=282.23938294331566, gamma_v_px=283.15607125, skew_px=0.5,
        cx_px=515.39853520931602, cy_px=384.7398940330911,
    )  # fmt: skip
    mirror = from_unified(unified, 1024, 768)
    directions = RAYS * [1, 1, -1]
    assert project(sensor, directions)[0] == pytest.approx(project(mirror, directions)[0], abs=1e-9)


def test_several_cameras_have_to_be_chosen_from(tmp_path):
    path = files.write(tmp_path, files.KALIBR)
    with pytest.raises(InputError, match=r"--camera: has 4 cameras, 0 \(cam0\), 1 \(cam1\), .*; choose one"):
        load_sensor(path)
    with pytest.raises(InputError, match="--camera: there is no camera 4; the file has 0 to 3"):
        load_sensor(path, Chosen(camera=4))
    with pytest.raises(InputError, match="--camera: there is no camera 1; the file has 0 alone"):
        load_sensor(files.write(tmp_path, files.CAMODOCAL), Chosen(camera=1))


def test_the_size_of_a_file_that_has_none(tmp_path):
    text = files.FISHEYE_YAML.replace("image_width: 1600\nimage_height: 1200\n", "")
    path = files.write(tmp_path, text)
    with pytest.raises(InputError, match="--size: the file does not contain the size of the image"):
        load_sensor(path)
    assert load_sensor(path, Chosen(size=(1600, 1200))) == load_sensor(files.write(tmp_path, files.FISHEYE_YAML, "b"))
    with pytest.raises(InputError, match="--size: the file says 1600 x 1200 pixels; leave it out"):
        load_sensor(tmp_path / "b", Chosen(size=(800, 600)))


def test_what_was_guessed_is_said(tmp_path):
    path = files.write(tmp_path, files.FISHEYE_YAML.replace("fisheye_model: 1\n", ""))
    with pytest.warns(Notice, match="four distortion coefficients and no xi: read as cv2.fisheye's"):
        load_sensor(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_sensor(files.write(tmp_path, files.FISHEYE_YAML))


@pytest.mark.parametrize(
    ("text", "old", "new", "said"),
    [
        (files.KALIBR, "830.3, 373.9,", "830.3, 973.9,", "cam0.intrinsics: cx_px = 973.9 is not on an image of 752"),
        (files.KALIBR, "[1.45,", "[-1.45,", "cam0.intrinsics: must be at least 0; found -1.45"),
        (files.KALIBR, "resolution: [752, 480]", "resolution: [752, 4]", "cam0.resolution: must be at least 8; found"),
        (files.OMNIDIR_YAML, "xi: 1.14", "xi: -1.14", "xi: must be at least 0; found -1.14"),
        (files.OCAMCALIB, "5 -2.190000e+02", "5 2.190000e+02", "direct polynomial: coefficients: a_0 = 219 must"),
        (files.BASALT, '"alpha": 0.59', '"alpha": 1.59', "value0.intrinsics[0].intrinsics.alpha: must be at most 1"),
        (files.COLMAP, "401.23", "401.23e50", "line 4: must be at most"),
        (files.COLMAP, "401.23", "401.23e300", "line 4[0]: must be at most 1e+60"),
    ],
)  # fmt: skip
def test_what_no_camera_can_have_names_the_files_own_key(text, old, new, said, tmp_path):
    assert old in text
    path = files.write(tmp_path, text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_sensor(path, Chosen(camera=0))
    assert str(caught.value).startswith(f"{path}: {said}")


# --- Where sensors are taken ---------------------------------------------------------------------------------------


def test_load_sensor_takes_all_of_it(tmp_path):
    path = files.write(tmp_path, files.KALIBR)
    sensor = harness.load_sensor(path, camera=1, looks="forward", angle_max_deg=80.0)
    assert (sensor.model.kind, sensor.looks, sensor.field.angle_max_deg) == ("double_sphere", "forward", 80)
    table = {"file": str(path), "number": 1, "mount": {"looks": "forward"}, "field": {"angle_max_deg": 80.0}}
    assert harness.load_sensor(table) == sensor
    own = files.write(tmp_path, dump_toml(sensor), "sensor.toml")
    assert harness.load_sensor(own) == sensor
    assert harness.load_sensor(own, angle_max_deg=60.0).field.angle_max_deg == 60
    assert harness.load_sensor(own, mirrored=True).mirrored
    with pytest.raises(InputError, match="--size: leave it out: the sensor file says its size"):
        harness.load_sensor(own, size=(10, 10))
    with pytest.raises(InputError, match="sensor: is not a file"):
        harness.load_sensor({}, looks="up")


def test_a_file_that_is_no_toml_says_so_by_its_name(tmp_path):
    with pytest.raises(InputError, match="not valid TOML"):
        harness.load_sensor(files.write(tmp_path, "[model\nkind: 3\n", "sensor.toml"))
    with pytest.raises(InputError, match="no such file"):
        harness.load_sensor(tmp_path / "absent.yaml")


EXPERIMENT = """\
name = "e"
[trial]
scene = "box"
{sensor}
"""


@pytest.mark.parametrize(
    ("sensor", "looks", "angle"),
    [
        ('sensor = "mei.yaml"', "up", 180.0),
        ('[trial.sensor]\nfile = "mei.yaml"\nfield = {angle_max_deg = 80.0}', "up", 80.0),
        ('[trial.sensor]\nfile = "camchain.yaml"\nnumber = 2\nmount = {looks = "down", yaw_deg = 3}', "down", 180.0),
    ],
)
def test_an_experiment_names_a_calibration(sensor, looks, angle, tmp_path):
    for name, text in files.ALL.items():
        files.write(tmp_path, text, name)
    path = files.write(tmp_path, EXPERIMENT.format(sensor=sensor), "e.toml")
    result = load_experiment(path).trial.sensor
    assert (result.looks, result.field.angle_max_deg) == (looks, angle)
    assert result.model.kind == ("eucm" if looks == "down" else "unified")
    assert result.mount.yaw_deg == (3 if looks == "down" else 0)


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ('[trial.sensor]\nfile = "absent.yaml"', "absent.yaml: no such file"),
        ("[trial.sensor]\nfile = 3", "trial.sensor.file: must be text in quotes; found 3"),
        ('[trial.sensor]\nfile = "mei.yaml"\nnumber = -1', "trial.sensor.number: must be at least 0; found -1"),
        ('[trial.sensor]\nfile = "mei.yaml"\nfield = 3', "trial.sensor.field: must be a table, whose keys override"),
        ('[trial.sensor]\nfile = "mei.yaml"\nfild = {a = 3}', "trial.sensor.fild: unknown key 'fild'"),
        ('[trial.sensor]\nfile = "camchain.yaml"', "camchain.yaml: --camera: has 4 cameras"),
    ],
)
def test_an_experiment_that_names_one_wrongly(sensor, said, tmp_path):
    for name, text in files.ALL.items():
        files.write(tmp_path, text, name)
    with pytest.raises(InputError) as caught:
        load_experiment(files.write(tmp_path, EXPERIMENT.format(sensor=sensor), "e.toml"))
    assert said in str(caught.value)


# --- Rigs ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("looks", "mirrored"), [("up", False), ("down", True), ("forward", False), ("down", False)])
def test_the_motion_of_a_rig(looks, mirrored, tmp_path):
    """A point, carried by hand from cam0's lens to cam1's, and from sensor to sensor."""
    path = files.write(tmp_path, files.KALIBR)
    motion = harness.load_motion(path, 0, 1, looks=looks, mirrored=mirrored)
    assert np.linalg.det(motion.R_v2_from_v1) == pytest.approx(1, abs=1e-12)
    in_lens_0 = np.array([0.4, -0.3, 1.2])
    in_lens_1 = np.array([-in_lens_0[1] + 0.1, in_lens_0[0] + 0.2, in_lens_0[2] + 0.3])
    turn = {
        ("up", False): lambda X, Y, Z: (X, Y, Z),
        ("down", True): lambda X, Y, Z: (X, Y, -Z),
        ("down", False): lambda X, Y, Z: (X, -Y, -Z),
        ("forward", False): lambda X, Y, Z: (Z, -X, -Y),
    }[looks, mirrored]
    assert motion.apply(turn(*in_lens_0)) == pytest.approx(turn(*in_lens_1), abs=1e-12)


def test_a_motion_between_any_two(tmp_path):
    path = files.write(tmp_path, files.KALIBR)
    assert harness.load_motion(path, 1, 2).t_v1 == pytest.approx([0.5, 0, 0], abs=1e-12)
    assert harness.load_motion(path, 2, 1).t_v1 == pytest.approx([-0.5, 0, 0], abs=1e-12)
    with pytest.raises(InputError, match="there is no camera 7; the file has 0 to 3"):
        harness.load_motion(path, 0, 7)
    with pytest.raises(InputError, match="does not contain the pose of camera 1"):
        harness.load_motion(files.write(tmp_path, files.COLMAP))
    with pytest.raises(InputError, match="there is no camera 1"):
        harness.load_motion(Path(files.write(tmp_path, files.CAMODOCAL)))


def test_a_spherical_camera_of_colmap_stands_upright(tmp_path):
    """Its Z is forward, X right and Y down: our x, -y and -z."""
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP's own package is not installed")
    sensor_file = read_sensor(files.write(tmp_path, "1 EQUIRECTANGULAR 720 360 720 360\n"))
    assert sensor_file.notes == ()
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=720, height=360, params=[720, 360])
    theirs = camera.img_from_cam(RAYS) - 0.5
    X, Y, Z = RAYS.T
    assert project(sensor_file.sensor, np.stack([Z, -X, -Y], axis=-1))[0] == pytest.approx(theirs, abs=1e-9)
    described = harness.describe_sensor(sensor_file.sensor)
    assert described.coverage.used == 1
    assert described.coverage.sphere == pytest.approx(1, abs=1e-3)
    assert harness.convert_sensor(sensor_file.sensor, "toml").conversion.is_exact
    with pytest.raises(InputError, match="an equirectangular panorama cannot be written in another camera model"):
        harness.convert_sensor(sensor_file.sensor, "kalibr")


class TestShipped:
    """Sensors that are given by their names."""

    @pytest.mark.parametrize("name", shipped.names("sensors"))
    def test_are_those_of_the_experiment_cameras(self, name):
        sensor = harness.load_sensor(name)
        camera = sensor.camera
        assert camera.width_px * camera.height_px == pytest.approx(640 * 480, rel=1e-3)
        _, visible = pixel_directions(sensor)
        assert visible.mean() > 0.5
        # The panorama of the experiments is inside every field.
        assert project(sensor, directions(Grid()))[1].all()

    def test_mirror_is_the_default_and_the_fisheyes_rim_is_as_far_out(self):
        assert harness.load_sensor("mirror") == harness.Sensor()
        fisheye = harness.load_sensor("fisheye")
        rim = np.radians(20)
        pixel, _ = project(fisheye, [np.cos(rim), 0, np.sin(rim)])
        assert np.hypot(*(pixel - [319.5, 239.5])) == pytest.approx(238, abs=1e-3)

    def test_a_name_stays_on_an_axis_and_in_a_table(self, tmp_path):
        path = tmp_path / "mine.toml"
        path.write_text(
            'name = "mine"\n[trial]\nscene = "box"\nsensor = { file = "fisheye", mask = "m.png" }\n'
            '[axes]\n"sensor" = ["mirror", "fisheye"]\n'
        )
        (tmp_path / "m.png").touch()
        planned = load_experiment(path).planned
        assert [each.coordinates["sensor"] for each in planned] == ["mirror", "fisheye"]
        assert [each.trial.sensor.model.kind for each in planned] == ["hyperboloid", "kannala_brandt"]
