"""Calibrations of real cameras, from a folder that is not part of the project: `OMNIRANGE_REAL`."""

import os
from pathlib import Path

import numpy as np
import pytest

from harness.calibration.corner_files import read_corners
from harness.calibration.corners import Board, Corners, corners_of
from harness.calibration.corners_in_images import find_corners
from harness.calibration.sensor_calibration import calibrate_sensor
from harness.calibration.uncertainty import RayGrid, ray_difference
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import Unified
from harness.camera.sensor import Sensor, unproject

REAL = os.environ.get("OMNIRANGE_REAL")
pytestmark = [pytest.mark.skipif(not REAL, reason="OMNIRANGE_REAL names no folder"), pytest.mark.slow]
FOLDER = Path(REAL or ".")
TURNED_BOARD = Board(columns=7, rows=6, square_m=0.03)


def mirror_corners() -> Corners:
    """21 boards of 70 corners, of which two are a pixel or more off."""
    return read_corners(FOLDER / "calib" / "omni_calib_data.xml", size=(1280, 960))


def desk_corners() -> Corners:
    """10 boards of 42 corners that another program has found; counted from 1."""
    from scipy.io import loadmat

    grid = loadmat(FOLDER / "vmr" / "VMRImagePts.mat")["gridInfo"][0, 0]
    places = [(f"VMRImage{i}", grid["X"][0, i][:2].T / 1000, grid["x"][0, i].T - 1.0) for i in range(10)]
    return corners_of(places, 1024, 768)


def opencv_sensor(corners: Corners) -> tuple[Sensor, float]:
    """What `cv2.omnidir.calibrate` makes of the corners, and its RMS."""
    cv2 = pytest.importorskip("cv2")
    points, pixels = [], []
    for i in range(len(corners.images)):
        own = corners.image == i
        flat = np.concatenate([corners.points_m[own], np.zeros((own.sum(), 1))], axis=1)
        points.append(flat.reshape(1, -1, 3))
        pixels.append(corners.pixels[own].reshape(1, -1, 2))
    size = (corners.width_px, corners.height_px)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-10)
    rms, K, xi, D, *_ = cv2.omnidir.calibrate(points, pixels, size, None, None, None, cv2.omnidir.CALIB_FIX_SKEW, stop)
    k1, k2, p1, p2 = D.ravel().tolist()
    camera = {"focal_px": K[0, 0], "aspect": K[1, 1] / K[0, 0], "cx_px": K[0, 2], "cy_px": K[1, 2]}
    sensor = Sensor(
        model=Unified(xi=float(xi.ravel()[0])),
        camera=Camera(width_px=size[0], height_px=size[1], **camera),
        lens=Lens(k1=k1, k2=k2, p1=p1, p2=p2),
        field=FieldOfView(elevation_min_deg=-10, elevation_max_deg=90),
    )
    return sensor, rms


def difference_at_corners(first: Sensor, second: Sensor, corners: Corners) -> np.ndarray:
    directions = np.ascontiguousarray(unproject(first, corners.pixels)[0])
    none = np.zeros(0)
    grid = RayGrid(none, none, np.zeros((0, 0), dtype=bool), directions)
    return np.linalg.norm(ray_difference(first, second, grid), axis=-1)


@pytest.mark.parametrize(("corners", "most_px"), [(mirror_corners, 0.12), (desk_corners, 0.34)])
def test_rms_and_rays_are_those_of_opencv(corners, most_px):
    calibration = calibrate_sensor(corners(), "unified")
    assert calibration.rms_px < most_px
    other, rms = opencv_sensor(calibration.corners)  # those that we left out move its rays by 0.4 px
    assert calibration.rms_px == pytest.approx(rms, rel=1e-3)
    assert difference_at_corners(calibration.sensor, other, calibration.corners).max() < 0.1


@pytest.mark.parametrize(("corners", "most_px"), [(mirror_corners, 0.087), (desk_corners, 0.334)])
def test_misalignment_of_real_mirrors(corners, most_px):
    """The first is aligned to a few hundredths of a millimetre; the second is not, and fits better than any central."""
    calibration = calibrate_sensor(corners(), "hyperboloid", free=["misalignment"])
    assert calibration.rms_px < most_px
    assert calibration.rms_px <= calibration.central.rms_px
    aligned = any("no significant misalignment" in note for note in calibration.notes)
    assert aligned == (corners is mirror_corners)


def test_mistaken_corners_are_the_ones_left_out():
    calibration = calibrate_sensor(mirror_corners(), "unified")
    assert len(calibration.left_out.image) == 2
    assert calibration.rms_px < 0.09
    assert calibration.halves.difference_px.max() < 0.6


def test_boards_are_found_in_real_mirror_images():
    files = [FOLDER / "vmr" / f"VMRImage{i}.jpg" for i in range(10)]
    search = find_corners(files, TURNED_BOARD)
    assert len(search.corners.images) >= 8
    assert search.circle.radius_px == pytest.approx(454, abs=4)
    calibration = calibrate_sensor(search.corners, "unified", circle=search.circle)
    assert calibration.rms_px < 0.34
    theirs = desk_corners()
    for i, name in enumerate(search.corners.images):
        own = search.corners.pixels[search.corners.image == i]
        other = theirs.pixels[theirs.image == theirs.images.index(name.removesuffix(".jpg"))]
        nearest = np.linalg.norm(own[:, None] - other[None], axis=-1).min(axis=1)
        assert np.median(nearest) < 0.25  # two detectors in soft images
