"""Calibration files that are written: read back here, and by the program that they are for, with the same rays."""

import json

import calibration_files as files
import numpy as np
import pytest

from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import MODELS
from harness.camera.optics import Optics
from harness.io.calibrations import FORMATS, read_calibration
from harness.io.calibrations.ocamcalib import inverse_radius

SIZE = {"width_px": 640, "height_px": 480, "cx_px": 311.25, "cy_px": 243.5}
CAMERA = Camera(focal_px=231.7, aspect=1.0123, **SIZE)
LENS = Lens(k1=-0.031, k2=1.2e-5, p1=1.3e-3, p2=-2.1e-3)
CAMERAS = {
    "unified": ({"xi": 1.137}, CAMERA, LENS),
    "eucm": ({"alpha": 0.571, "beta": 1.13}, CAMERA, Lens()),
    "double_sphere": ({"xi": -0.187, "alpha": 0.583}, CAMERA, Lens()),
    "kannala_brandt": ({"k1": 0.0131, "k2": -0.0071, "k3": 0.0021, "k4": -3e-5}, CAMERA, Lens()),
    "ocam": (
        {"coefficients": [-219.3, 0, 1.9e-3, -3.1e-6, 1.2e-8], "c": 1.002, "d": 3e-4, "e": -2e-4},
        Camera(**SIZE),
        Lens(),
    ),
}
CASES = [(name, target) for name, each in FORMATS.items() for target in each.targets]


def optics_of_kind(kind, *, skew=0.0):
    keys, camera, lens = CAMERAS[kind]
    camera = camera.model_copy(update={"skew_px": skew}) if skew else camera
    return Optics(MODELS[kind].model_validate({"kind": kind} | keys), camera, lens)


def rays_of(kind, count=4000):
    """Random directions to 80° off the axis."""
    rng = np.random.default_rng(sum(map(ord, kind)))
    angle, around = np.radians(80) * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=-1)


def optics_read(path, number=0):
    camera = read_calibration(path).cameras[number]
    width, height = camera.size
    return Optics(
        MODELS[camera.model["kind"]].model_validate(camera.model),
        Camera.model_validate(camera.camera | {"width_px": width, "height_px": height}),
        Lens.model_validate(camera.lens),
    )


@pytest.mark.parametrize(("name", "target"), CASES, ids=[f"{name} {target.kind}" for name, target in CASES])
def test_what_is_written_is_read_back_with_the_same_rays(name, target, tmp_path):
    first = optics_of_kind(target.kind, skew=1.5 if target.skew and target.kind != "ocam" else 0.0)
    back = optics_read(files.write(tmp_path, FORMATS[name].write(first)))
    assert back.model.kind == target.kind
    assert (back.camera.width_px, back.camera.height_px) == (640, 480)
    pixels = first.project(rays_of(target.kind))
    # Every number is written with all its digits; COLMAP's half pixel and aspect = fy/fx cost a rounding each.
    assert np.abs(back.unproject(pixels) - first.unproject(pixels)).max() < 1e-13


@pytest.mark.parametrize("name", ["opencv", "opencv-xml"])
def test_opencv_reads_it_and_projects_alike(name, tmp_path):
    cv2 = pytest.importorskip("cv2")
    ending = "xml" if name.endswith("xml") else "yaml"
    for kind, skew in (("unified", 1.5), ("kannala_brandt", 0.0)):
        first = optics_of_kind(kind, skew=skew)
        path = files.write(tmp_path, FORMATS[name].write(first), f"{kind}.{ending}")
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        K, D = (storage.getNode(each).mat() for each in ("camera_matrix", "distortion_coefficients"))
        assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == (640, 480)
        rays = rays_of(kind)
        points, still = rays[:, None, :], np.zeros(3)
        if kind == "unified":
            theirs = cv2.omnidir.projectPoints(points, still, still, K, storage.getNode("xi").real(), D)[0]
        else:
            assert storage.getNode("fisheye_model").real() == 1
            theirs = cv2.fisheye.projectPoints(points, still, still, K, D)[0]
        # Pixels of a few hundred, a dozen roundings each.
        assert np.abs(theirs[:, 0] - first.project(rays)).max() < 1e-10


@pytest.mark.parametrize("kind", ["kannala_brandt", "eucm"])
def test_colmap_reads_it_and_projects_alike(kind, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP's own package is not installed")
    first = optics_of_kind(kind)
    (tmp_path / "cameras.txt").write_text(FORMATS["colmap"].write(first))
    for empty in ("images.txt", "points3D.txt"):
        (tmp_path / empty).touch()
    camera = pycolmap.Reconstruction(str(tmp_path)).cameras[1]
    rays = rays_of(kind)
    theirs = camera.img_from_cam(rays)
    assert np.abs(theirs - 0.5 - first.project(rays)).max() < 1e-9  # its first pixel has its corner at (0, 0)
    assert (camera.width, camera.height) == (640, 480)


COLMAP_LINES = [
    *(each for each in files.COLMAP.splitlines() if not each.startswith("#")),
    "1 SIMPLE_PINHOLE 640 480 420.5 318.7 243.4",
    "1 PINHOLE 640 480 420.5 421.5 318.7 243.4",
    "1 SIMPLE_RADIAL 640 480 420.5 318.7 243.4 -0.1",
    "1 RADIAL 640 480 420.5 318.7 243.4 -0.1 0.02",
    "1 FULL_OPENCV 640 480 420.5 421.5 318.7 243.4 -0.1 0.02 1e-3 -2e-3 0.003 0 0 0",
    "1 SIMPLE_FISHEYE 640 480 300.5 318.7 243.4",
    "1 FISHEYE 640 480 300.5 301.5 318.7 243.4",
    "1 RADIAL_FISHEYE 640 480 300.5 318.7 243.4 -0.02 0.003",
    "1 THIN_PRISM_FISHEYE 640 480 300.5 301.5 318.7 243.4 -0.02 0.003 0 0 -0.001 0.0002 0 0",
]


@pytest.mark.parametrize("line", COLMAP_LINES, ids=lambda line: line.split()[1])
def test_colmap_projects_what_is_read_as_here(line, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP's own package is not installed")
    _, model, width, height, *parameters = line.split()
    camera = pycolmap.Camera(
        model=model, width=int(width), height=int(height), params=[float(each) for each in parameters]
    )
    rays = rays_of("colmap")
    rays = rays[rays[:, 2] > 0.8]  # narrow enough for the perspective one
    ours = optics_read(files.write(tmp_path, line)).project(rays)
    assert np.abs(camera.img_from_cam(rays) - 0.5 - ours).max() < 1e-9


class TestOCamCalib:
    """Its own two ways, as its manual has them: x along rows, y along columns, the optical axis along -z."""

    @staticmethod
    def numbers(text):
        lines = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
        direct, inverse, centre, affine, size = ([float(word) for word in line] for line in lines)
        return np.array(direct[1:]), np.array(inverse[1:]), centre, affine, size

    def test_from_the_image_to_the_ray(self):
        first = optics_of_kind("ocam")
        direct, _, (row, column), (c, d, e), size = self.numbers(FORMATS["ocamcalib"].write(first))
        assert size == [480, 640]  # height and width
        rng = np.random.default_rng(3)
        pixels = rng.uniform(0, [639, 479], (500, 2))
        x, y = np.linalg.solve([[c, d], [e, 1]], np.stack([pixels[:, 1] - row, pixels[:, 0] - column]))
        theirs = np.stack([x, y, np.polyval(direct[::-1], np.hypot(x, y))], axis=-1)
        theirs /= np.linalg.norm(theirs, axis=-1, keepdims=True)
        ours = first.unproject(pixels)
        assert np.abs(theirs[:, [1, 0, 2]] * [1, 1, -1] - ours).max() < 1e-13

    def test_from_the_ray_to_the_image_by_the_fitted_inverse(self):
        first = optics_of_kind("ocam")
        _, inverse, (row, column), (c, d, e), _ = self.numbers(FORMATS["ocamcalib"].write(first))
        rng = np.random.default_rng(4)
        pixels = rng.uniform(0, [639, 479], (500, 2))
        X, Y, Z = first.unproject(pixels).T
        x, y, z = Y, X, -Z
        across = np.hypot(x, y)
        rho = sum(each * np.arctan2(z, across) ** i for i, each in enumerate(inverse))
        theirs = np.stack(
            [e * x / across * rho + y / across * rho + column, c * x / across * rho + d * y / across * rho + row]
        )
        assert np.abs(theirs.T - pixels).max() < 2e-3  # it is fitted to a thousandth, and stretched by the affine part

    def test_the_inverse_is_as_good_as_it_says(self, tmp_path):
        text = FORMATS["ocamcalib"].write(optics_of_kind("ocam"))
        note = read_calibration(files.write(tmp_path, text)).cameras[0].notes[0]
        direct, inverse, *_ = self.numbers(text)
        rho = np.linspace(1e-3, 350, 2000)
        apart = np.abs(inverse_radius(inverse, np.arctan2(np.polyval(direct[::-1], rho), rho)) - rho).max()
        assert apart < 1e-3
        said = float(note.split("off by ")[1].split(" px")[0])
        assert said < 1e-3


def test_basalt_has_all_that_its_reader_asks_for():
    """cereal throws where a name is missing: these are those of `basalt::Calibration`."""
    root = json.loads(FORMATS["basalt"].write(optics_of_kind("eucm")))["value0"]
    assert set(root) == {
        "T_imu_cam", "intrinsics", "resolution", "calib_accel_bias", "calib_gyro_bias", "imu_update_rate",
        "accel_noise_std", "gyro_noise_std", "accel_bias_std", "gyro_bias_std", "cam_time_offset_ns", "vignette",
    }  # fmt: skip
    assert (len(root["calib_accel_bias"]), len(root["calib_gyro_bias"])) == (9, 12)


def test_kalibr_lists_are_numbers_to_yaml():
    """YAML 1.1, which Kalibr reads, takes 1e-05 for text."""
    yaml = pytest.importorskip("yaml")
    entry = yaml.safe_load(FORMATS["kalibr"].write(optics_of_kind("unified")))["cam0"]
    assert all(isinstance(each, float) for each in [*entry["intrinsics"], *entry["distortion_coeffs"]])
    assert entry["distortion_coeffs"] == [LENS.k1, LENS.k2, LENS.p1, LENS.p2]
