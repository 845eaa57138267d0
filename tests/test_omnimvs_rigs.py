"""Rigs of OmniMVS: which of two polynomials is the camera, and where the cameras are."""

import os
from pathlib import Path

import calibration_files as files
import numpy as np
import pytest

import harness
from harness.camera.sensor import project
from harness.errors import InputError, Notice
from harness.io.calibrations import read_calibration


def test_the_inverse_polynomial_is_the_camera_where_the_two_differ(tmp_path):
    path = files.write(tmp_path, files.OMNIMVS)
    with pytest.warns(Notice, match="its two polynomials are .* px RMS apart, .* the inverse one is used"):
        sensor = harness.load_sensor(path, camera=0)
    assert (sensor.camera.cx_px, sensor.camera.cy_px) == (500.25, 400.5)
    assert (sensor.camera.width_px, sensor.camera.height_px) == (1000, 800)
    assert sensor.field.angle_max_deg == 100
    angle = np.radians(np.linspace(0.5, 78, 50))  # below the image's top
    for azimuth in (0.0, 2.0):
        direction = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
        pixels, _ = project(sensor, direction)
        q, p = 300 * angle * np.cos(azimuth), 300 * angle * np.sin(azimuth)
        expected = np.stack([3e-4 * p + q + 500.25, 1.001 * p - 2e-4 * q + 400.5], axis=1)
        # theta cot(theta) as eleven powers, within 100 degrees: 0.003 px.
        assert np.abs(pixels - expected).max() < 0.005


def test_the_direct_polynomial_is_the_camera_where_the_two_are_alike(tmp_path):
    """theta cot(theta) = 1 - theta²/3 - theta⁴/45 ..: cut after two terms within 30 degrees it is off by 0.1 px."""
    text = files.OMNIMVS.replace("1.6666666666666668e-3", "1.111111111111111e-3").replace("160.0", "60.0")
    camera = read_calibration(files.write(tmp_path, text)).cameras[1]
    assert camera.model["coefficients"] == [-300, 0, 1.111111111111111e-3]
    assert camera.doubts == ()


def test_poses_are_from_the_camera_to_the_rig(tmp_path):
    motion = harness.load_motion(files.write(tmp_path, files.OMNIMVS))
    assert np.allclose(motion.t_v1, [0, 0, -0.2], atol=1e-15)
    # Camera 2's z points along the rig's x: a point there is straight ahead of it.
    assert np.allclose(motion.R_v2_from_v1 @ [1, 0, 0], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("model: ocam", "model: pinhole", r"cameras\[0\].model: must be ocam; found pinhole"),
        ("[2, -300.0, 0.0]", "[3, -300.0, 0.0]", r"cameras\[0\].poly: must begin with the number of its coefficients"),
        ("max_fov: 200.0", "max_fov: 0", r"cameras\[0\].max_fov: must be above 0 and below 360 degrees; found 0"),
        ("pose: [0.0, 0.0, 0.0, 0.1, 0.0, 0.0]", "pose: [0.0]", r"cameras\[0\].pose: must be 6 numbers"),
    ],
)
def test_what_is_wrong_is_named(old, new, complaint, tmp_path):
    with pytest.raises(InputError, match=complaint):
        read_calibration(files.write(tmp_path, files.OMNIMVS.replace(old, new)))


@pytest.mark.slow
def test_a_pair_of_a_real_rig_agrees_with_its_file():
    """By the direct polynomials, which are 1.8 px RMS from the inverse ones, it is 1 and 2.1 degrees off."""
    folder = Path(os.environ.get("OMNIRANGE_REAL", "absent")) / "itbt"
    if not folder.is_dir():
        pytest.skip("OMNIRANGE_REAL names no folder with itbt")
    with pytest.warns(Notice, match="two polynomials"):
        sensors = [harness.load_sensor(folder / "config.yaml", camera=i) for i in (0, 1)]
    found = harness.estimate_motion(folder / "cam1_00001.png", folder / "cam2_00001.png", *sensors).motion
    true = harness.load_motion(folder / "config.yaml")
    turned = np.trace(found.R_v2_from_v1.T @ true.R_v2_from_v1)
    assert np.degrees(np.arccos((turned - 1) / 2)) < 0.3
    assert np.degrees(np.arccos(found.t_v1 @ true.t_v1 / true.baseline_m)) < 0.3
