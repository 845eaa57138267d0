"""Calibration files of other programs: told apart by content, read value by value, and refused in one line."""

from pathlib import Path

import calibration_files as files
import numpy as np
import pytest

from harness.errors import InputError
from harness.io.calibrations import read_calibration
from harness.io.calibrations.opencv import AMBIGUOUS, PERSPECTIVE


def read(folder: Path, text: str):
    return read_calibration(files.write(folder, text))


def one(folder: Path, text: str):
    (camera,) = read(folder, text).cameras
    return camera


# --- What is told apart --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "name", "cameras"),
    [
        (files.OMNIDIR_YAML, "opencv", 1),
        (files.OMNIDIR_XML, "opencv", 1),
        (files.FISHEYE_YAML, "opencv", 1),
        (files.ROS_CAMERA_INFO, "opencv", 1),
        (files.KALIBR, "kalibr", 4),
        (files.CAMODOCAL, "camodocal", 1),
        (files.OCAMCALIB, "ocamcalib", 1),
        (files.BASALT, "basalt", 4),
        (files.COLMAP, "colmap", 4),
        (files.OMNIMVS, "omnimvs", 2),
    ],
)
@pytest.mark.parametrize("change", [str, lambda text: "\ufeff" + text.replace("\n", "\r\n")], ids=["", "from Windows"])
def test_the_kind_follows_from_the_content(text, name, cameras, change, tmp_path):
    (tmp_path / "file").write_bytes(change(text).encode())
    result = read_calibration(tmp_path / "file")
    assert (result.format, len(result.cameras)) == (name, cameras)


def test_ocamcalib_without_its_comments(tmp_path):
    bare = "\n".join(line for line in files.OCAMCALIB.splitlines() if not line.startswith("#"))
    assert read(tmp_path, bare).cameras == read(tmp_path, files.OCAMCALIB).cameras


# --- Values --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [files.OMNIDIR_YAML, files.OMNIDIR_XML], ids=["YAML", "XML"])
def test_omnidir(text, tmp_path):
    camera = one(tmp_path, text)
    assert camera.model == {"kind": "unified", "xi": 1.1436422518426306}
    assert camera.lens == {
        "k1": 0.0775313339533257,
        "k2": 0.027664400596417553,
        "p1": 0.0013229517533848763,
        "p2": 1e-5,
    }
    assert camera.camera == pytest.approx(
        {
            "focal_px": 282.23938294331566,
            "aspect": 283.15607125 / 282.23938294331566,
            "skew_px": 0.5,
            "cx_px": 515.398535209316,
            "cy_px": 384.7398940330911,
        },
        rel=1e-15,
    )
    assert camera.size == (1024, 768)
    assert camera.notes == ()


@pytest.mark.parametrize("ending", ["yaml", "xml", "json"])
def test_what_opencv_itself_writes(ending, tmp_path):
    """Every version has a header and number format of its own: this is the installed one's."""
    cv2 = pytest.importorskip("cv2")
    K, D = np.array([[282.2, 0.25, 515.4], [0, 283.1, 384.7], [0, 0, 1]]), np.array([[0.07, 1e-7, -1e-3, 2e-3]])
    storage = cv2.FileStorage(str(tmp_path / f"a.{ending}"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1024)
    storage.write("image_height", 768)
    storage.write("K", K)
    storage.write("D", D)
    storage.write("xi", np.array([[1.25]]))
    storage.release()
    (camera,) = read_calibration((tmp_path / f"a.{ending}").rename(tmp_path / "file")).cameras
    assert camera.model == {"kind": "unified", "xi": 1.25}
    assert list(camera.lens.values()) == D[0].tolist()
    assert [camera.camera[key] for key in ("focal_px", "skew_px", "cx_px", "cy_px")] == [282.2, 0.25, 515.4, 384.7]
    assert camera.camera["aspect"] * 282.2 == pytest.approx(283.1, rel=1e-15)
    assert camera.size == (1024, 768)


def test_opencv_fisheye(tmp_path):
    camera = one(tmp_path, files.FISHEYE_YAML)
    assert camera.model == {"kind": "kannala_brandt", "k1": -0.013, "k2": 0.0041, "k3": -0.0023, "k4": 0.00031}
    assert camera.lens == {}
    assert camera.notes == ()
    guessed = one(tmp_path, files.FISHEYE_YAML.replace("fisheye_model: 1\n", ""))
    assert guessed.model == camera.model
    assert guessed.notes == (AMBIGUOUS,)
    words = one(tmp_path, files.FISHEYE_YAML.replace("fisheye_model: 1", "fisheye_model: 0"))
    assert words.model == {"kind": "unified", "xi": 0.0}
    assert words.lens == {"k1": -0.013, "k2": 0.0041, "p1": -0.0023, "p2": 0.00031}


def test_a_perspective_camera_is_the_unified_model_without_a_mirror(tmp_path):
    camera = one(tmp_path, files.ROS_CAMERA_INFO)
    assert camera.model == {"kind": "unified", "xi": 0.0}
    assert camera.lens == {"k1": -0.28, "k2": 0.07, "p1": 0.0009, "p2": 0.0001, "k3": -0.006}
    assert camera.notes == (PERSPECTIVE,)


def test_opencv_stereo(tmp_path):
    text = files.OMNIDIR_YAML.replace("camera_matrix", "K1").replace("distortion_coefficients", "D1")
    second = text[text.index("K1") :].replace("K1", "K2").replace("D1", "D2").replace("xi: 1.14", "xi2: 1.24")
    motion = "R: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\nT: [0.1, 0.2, 0.3]\n"
    first, second = read(tmp_path, text.replace("\nxi:", "\nxi1:") + second.replace("rms", "rms_2") + motion).cameras
    assert (first.model["xi"], second.model["xi"]) == (1.1436422518426306, 1.2436422518426306)
    assert first.T_cam_from_first is None
    assert second.T_cam_from_first.tolist() == [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]


def test_kalibr(tmp_path):
    omni, ds, eucm, equi = read(tmp_path, files.KALIBR).cameras
    assert [each.name for each in (omni, ds, eucm, equi)] == ["cam0", "cam1", "cam2", "cam3"]
    assert omni.model == {"kind": "unified", "xi": 1.45}
    assert omni.lens == {"k1": -0.21, "k2": 0.13, "p1": 0.0006, "p2": -0.0004}
    assert omni.camera == {"focal_px": 833.0, "aspect": 830.3 / 833.0, "cx_px": 373.9, "cy_px": 253.7}
    assert ds.model == {"kind": "double_sphere", "xi": -0.18, "alpha": 0.59}
    assert ds.camera == {"focal_px": 158.2, "aspect": 158.4 / 158.2, "cx_px": 255.0, "cy_px": 256.1}
    assert eucm.model == {"kind": "eucm", "alpha": 0.63, "beta": 1.04}
    assert equi.model == {"kind": "kannala_brandt", "k1": -0.0131, "k2": 0.0501, "k3": -0.0451, "k4": 0.0124}
    assert all(each.lens == {} for each in (ds, eucm, equi))
    assert [each.size for each in (omni, ds)] == [(752, 480), (512, 512)]


def test_kalibr_chains_the_motions(tmp_path):
    """By hand: cam1 turns by 90° and moves; cam2 only moves, in cam1's axes."""
    cameras = read(tmp_path, files.KALIBR).cameras
    point = np.array([1.0, 2.0, 3.0, 1.0])
    assert (cameras[0].T_cam_from_first @ point).tolist() == [1, 2, 3, 1]
    assert cameras[1].T_cam_from_first @ point == pytest.approx([-2 + 0.1, 1 + 0.2, 3 + 0.3, 1], abs=1e-15)
    assert cameras[2].T_cam_from_first @ point == pytest.approx([-2 + 0.1 - 0.5, 1.2, 3.3, 1], abs=1e-15)


def test_camodocal(tmp_path):
    camera = one(tmp_path, files.CAMODOCAL)
    assert camera.name == "camera"
    assert camera.model == {"kind": "unified", "xi": 2.213404750785489}
    assert camera.camera["focal_px"] == 1336.3220825849971
    assert camera.camera["aspect"] * camera.camera["focal_px"] == pytest.approx(1335.7883350012958, rel=1e-15)
    assert camera.lens["k2"] == 1.6548773243373522
    theirs = files.CAMODOCAL[: files.CAMODOCAL.index("mirror")].replace("MEI", "KANNALA_BRANDT")
    names = ("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0")
    values = (-0.01, 0.02, -0.03, 0.04, 500.0, 510.0, 640.0, 512.0)
    lines = "".join(f"   {name}: {value}\n" for name, value in zip(names, values, strict=True))
    fisheye = one(tmp_path, f"{theirs}projection_parameters:\n{lines}")
    assert fisheye.model == {"kind": "kannala_brandt", "k1": -0.01, "k2": 0.02, "k3": -0.03, "k4": 0.04}
    assert fisheye.camera == {"focal_px": 500.0, "aspect": 1.02, "cx_px": 640.0, "cy_px": 512.0}


def test_ocamcalib(tmp_path):
    camera = one(tmp_path, files.OCAMCALIB)
    assert camera.model == {
        "kind": "ocam",
        "coefficients": [-219.0, 0.0, 0.0019, -3.1e-6, 1.2e-8],
        "c": 0.998881,
        "d": -0.002038,
        "e": 0.003079,
    }
    assert camera.camera == {"cx_px": 385.783141, "cy_px": 241.019976}  # the file has the row first
    assert camera.size == (748, 480)  # and the height


def test_how_far_the_two_polynomials_of_ocamcalib_are_apart(tmp_path):
    """rho = 200 (theta + pi/2) against f(rho) = -200, whose angle off the axis is atan(rho/200)."""
    text = files.OCAMCALIB.replace("5 -2.190000e+02 0.000000e+00 1.900000e-03 -3.100000e-06 1.200000e-08", "2 -200 0")
    text = text.replace("6 320.255 174.57 -12.269 26.023 21.159 4.547", f"2 {200 * np.pi / 2} 200").replace(
        "241.019976 385.783141", "40 50"
    )
    short = one(tmp_path, text.replace("480 748", "81 101")).notes[0]
    assert "up to 50 px" in short
    assert f"off by {50 - 200 * np.arctan(50 / 200):.2g} px at most" in short
    assert short.endswith("from the centre")
    (long,) = one(tmp_path, text.replace("480 748", "81 251")).doubts
    assert f"off by {200 - 200 * np.arctan(1):.2g} px at most" in long
    assert long.endswith("from the centre; programs that project with it get other pixels")


def test_what_follows_the_size_is_named(tmp_path):
    assert "600 235" in one(tmp_path, files.OCAMCALIB + "#ROI max min radius\n\n600 235\n").notes[0]


def test_basalt(tmp_path):
    ds, kb, eucm, ucm = read(tmp_path, files.BASALT).cameras
    assert ds.model == {"kind": "double_sphere", "xi": -0.18, "alpha": 0.59}
    assert kb.model == {"kind": "kannala_brandt", "k1": 0.0034, "k2": 0.0007, "k3": -0.002, "k4": 0.0002}
    assert eucm.model == {"kind": "eucm", "alpha": 0.63, "beta": 1.04}
    assert ucm.model == {"kind": "eucm", "alpha": 0.6, "beta": 1.0}
    assert ds.camera == {"focal_px": 158.2, "aspect": 158.4 / 158.2, "cx_px": 255.0, "cy_px": 256.1}
    # Camera 1 is turned by 90° about z and 0.2 m along the IMU's y; the first camera is 0.1 m along its x.
    visible = kb.T_cam_from_first @ [1.0, 2.0, 3.0, 1.0]
    assert visible == pytest.approx([2 - 0.2, -(1 + 0.1), 3, 1], abs=1e-15)


def test_colmap_has_pixels_from_their_corner(tmp_path):
    fisheye, eucm, simple, perspective = read(tmp_path, files.COLMAP).cameras
    assert fisheye.model == {"kind": "kannala_brandt", "k1": -0.013, "k2": 0.0041, "k3": -0.0023, "k4": 0.00031}
    assert fisheye.camera["cx_px"], fisheye.camera["cy_px"] == pytest.approx((803.12, 598.77), rel=1e-15)
    assert eucm.model == {"kind": "eucm", "alpha": 0.63, "beta": 1.04}
    assert simple.model == {"kind": "kannala_brandt", "k1": -0.02, "k2": 0.0, "k3": 0.0, "k4": 0.0}
    assert simple.camera == {"focal_px": 300.0, "aspect": 1.0, "cx_px": 319.5, "cy_px": 239.5}
    assert perspective.model == {"kind": "unified", "xi": 0.0}
    assert perspective.lens == {"k1": -0.28, "k2": 0.07, "p1": 0.0009, "p2": 0.0001, "k3": 0.0}
    assert simple.name == "camera 7"


def test_colmap_equirectangular(tmp_path):
    camera = one(tmp_path, "1 EQUIRECTANGULAR 720 360 720 360\n")
    assert camera.model == {"kind": "equirectangular"}
    assert camera.camera["focal_px"] == pytest.approx(720 / (2 * np.pi), rel=1e-15)
    assert camera.camera["aspect"] == pytest.approx(1, rel=1e-15)


# --- What is refused -----------------------------------------------------------------------------------------------


OPENCV_D = "7.7531333953325700e-02, 2.7664400596417553e-02,\n       1.3229517533848763e-03, 1e-05"


@pytest.mark.parametrize(
    ("text", "old", "new", "said"),
    [
        (files.OMNIDIR_YAML, "xi: 1.14", "xi: [1", "not valid YAML"),
        (files.OMNIDIR_YAML, "xi: 1.1436422518426306e+00", "xi: .nan", "xi: must be a finite number; found nan"),
        (files.OMNIDIR_YAML, "xi: 1.1436422518426306e+00", "xi: big", "xi: must be a number; found 'big'"),
        (files.OMNIDIR_YAML, "rows: 3", "rows: 4", "camera_matrix.data: must be 4 x 3 numbers; found 9"),
        (files.OMNIDIR_YAML, ", 0., 0., 1. ]", ", 0., 0., 2. ]", "camera_matrix: must be [f_x s c_x; 0 f_y"),
        (files.OMNIDIR_YAML, "cols: 4", "cols: 5", "distortion_coefficients.data: must be 1 x 5 numbers; found 4"),
        (files.OMNIDIR_YAML, "distortion_c", "c", "distortion_coefficients: this key is missing (or D)"),
        (files.ROS_CAMERA_INFO, "5\n  data: [-0.28", "8\n  data: [1, 2, 3, -0.28", "the coefficients after the fifth"),
        (files.ROS_CAMERA_INFO, "5\n  data: [-0.28", "6\n  data: [1, -0.28", "must be 4 coefficients, or 5 of a persp"),
        (files.OMNIDIR_XML, "<xi type", "<xi <type", "not valid XML"),
        (files.OMNIDIR_XML, "<opencv", "<!DOCTYPE x><opencv", "has a document type"),
        (files.OMNIDIR_XML, "<rows>3", "<cows>3</cows><rows>2", "camera_matrix.data: must be 2 x 3 numbers; found 9"),
        (files.KALIBR, "model: omni", "model: spherical", "cam0.camera_model: 'spherical' is not supported, only omni"),
        (files.KALIBR, "radtan", "fov", "cam0.distortion_model: fov of an omni camera is not supported, only none or"),
        (files.KALIBR, "[1.45, ", "[", "cam0.intrinsics: must be 5 numbers (xi fu fv pu pv); found 4"),
        (files.KALIBR, "833.0", "-833.0", "cam0.intrinsics: fu and fv must be above 0; found -833 and 830.3"),
        (files.KALIBR, "resolution: [752, 480]", "resolution: [752]", "cam0.resolution: must be width and height"),
        (files.KALIBR, "resolution: [752, 480]", "r: 1", "cam0.resolution: this key is missing; there are:"),
        (files.KALIBR, "- [1.0, 0.0, 0.0, 0.2]", "- [1.0, 0.1, 0.0, 0.2]", "cam1.T_cn_cnm1: is not a rotation"),
        (files.KALIBR, "  - [1.0, 0.0, 0.0, 0.2]\n", "", "cam1.T_cn_cnm1: must be 4 x 4 numbers; found 3 x 4"),
        (files.KALIBR, "[752, 480]", "&a [752, 480]\n  b: *a", "has references (*name); write the values out"),
        (files.KALIBR, "[752, 480]", "!!python/tuple [752, 480]", "not valid YAML"),
        (files.CAMODOCAL, "MEI", "SCARAMUZZA", "model_type: SCARAMUZZA is not supported, only MEI, KANNALA_BRANDT"),
        (files.CAMODOCAL, "   p2:", "   q2:", "distortion_parameters.p2: this key is missing; there are: k1, k2, p1"),
        (files.CAMODOCAL, "gamma1: ", "gamma1: -", "projection_parameters.gamma1: must be above 0"),
        (files.OCAMCALIB, "-2.190000e+02", "many", "direct polynomial: must be a number; found 'many'"),
        (files.OCAMCALIB, "5 -2.19", "500 -2.19", "direct polynomial: must begin with the number of its coefficients"),
        (files.OCAMCALIB, "480 748", "480", "image size: must be 2 numbers; the file ends after 1 of them"),
        (files.OCAMCALIB, "480 748", "480.5 748", "image size: must be a whole number; found 480.5"),
        (files.BASALT, '"ds"', '"fov"', "value0.intrinsics[0].camera_type: 'fov' is not supported, only ds, eucm"),
        (files.BASALT, '"xi": -0.18', '"yi": -0.18', "value0.intrinsics[0].intrinsics.xi: this key is missing"),
        (files.BASALT, "[[512, 512], ", "[", "value0.resolution: must be a list of 4; found a list of 3"),
        (files.BASALT, '"qw": 1.0', '"qw": 2.0', "value0.T_imu_cam[0]: qx, qy, qz, qw must be of unit length"),
        (files.BASALT, '"vignette": []', '"vignette": [', "not valid JSON"),
        (files.COLMAP, "2 EUCM", "2 FOV", "line 5: FOV is not supported, only SIMPLE_PINHOLE"),
        (files.COLMAP, "2 EUCM", "2 ECUM", "line 5: ECUM is not a COLMAP model, only SIMPLE_PINHOLE"),
        (files.COLMAP, "0.63 1.04", "0.63", "line 5: must be 6 numbers (fx fy cx cy alpha beta); found 5"),
        (files.COLMAP, "420.5 421.5", "0 421.5", "line 7: the focal length must be above 0; found 0"),
    ],
)  # fmt: skip
def test_bad_files_are_answered_in_one_line(text, old, new, said, tmp_path):
    assert old in text
    path = files.write(tmp_path, text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_calibration(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert said in message
    assert "\n" not in message


def test_terms_that_our_models_lack_are_refused_unless_they_are_zero(tmp_path):
    line = "1 THIN_PRISM_FISHEYE 640 480 300 300 320 240 0.01 0.02 {p1} 0 0.03 0.04 0 0\n"
    assert one(tmp_path, line.format(p1=0)).model["k4"] == 0.04
    with pytest.raises(InputError, match=r"line 1: THIN_PRISM_FISHEYE with p1 = 0\.001 is not supported, only with 0"):
        one(tmp_path, line.format(p1=0.001))
    rational = files.ROS_CAMERA_INFO.replace("cols: 5", "cols: 8").replace("-0.006]", "-0.006, 0, 0, 0]")
    assert one(tmp_path, rational).lens["k3"] == -0.006


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is neither a sensor file nor a calibration in a known format; known are a sensor's TOML, CamOdoCal"),
        (b"\xff\xd8\xff\xe0", "file: is a JPEG image; a text file is read here"),
        (b"hello world\n", "is neither a sensor file nor a calibration"),
        (b"a\0b", "file: is no text file: it has null bytes"),
        (b"{" * 100_000, "not valid JSON"),
        (b"[" * 100_000, "nested more than 64 deep"),
        (b"cam0: " + b"[" * 100_000, "nested more than 64 deep"),
        (b"a:\n" + b"- " * 100_000, "nested more than 64 deep"),
        (b'{"value0": ' + b"[" * 100_000, "nested more than 64 deep"),
        (b"<a>" * 1000 + b"</a>" * 1000, "nested more than 64 deep"),
        (b"K: 2026-99-99\n", "not valid YAML"),
        (b"? [1]\n: 2\nK: 3\n", "not valid YAML"),
    ],
    ids=range(12),
)
def test_what_is_no_calibration(data, said, tmp_path):
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_calibration(tmp_path / "file")
    assert said in str(caught.value)
    assert len(str(caught.value)) < 600


def test_xml_without_a_camera(tmp_path):
    text = files.OMNIDIR_XML.replace("camera_matrix", "points")
    with pytest.raises(
        InputError, match="camera_matrix: this key is missing \\(or K\\); there are: image_width, image_h"
    ):
        read(tmp_path, text)
