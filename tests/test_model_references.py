"""Camera models against other programs and against their formulas written out in NumPy."""

import numpy as np
import pytest
from cameras import random_sensor, sensor_of

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import Unified
from harness.camera.sensor import project

PIXELS = 1e-9
"""Both sides are a dozen roundings of numbers below 1000."""


def matrix(camera: Camera) -> np.ndarray:
    """K `[3, 3]`."""
    return np.array(
        [
            [camera.focal_px, camera.skew_px, camera.cx_px],
            [0, camera.focal_px * camera.aspect, camera.cy_px],
            [0, 0, 1.0],
        ]
    )


def field_directions(sensor, count: int = 2000) -> np.ndarray:
    """Unit directions `[n, 3]` all over the field of a sensor that looks up."""
    rng = np.random.default_rng(5)
    z = rng.uniform(np.sin(np.radians(sensor.field.elevation_min_deg)), 1, count)
    phi = rng.uniform(-np.pi, np.pi, count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=-1)


def bent(lens: Lens, m: np.ndarray) -> np.ndarray:
    """Brown and Conrady's distortion of points `[n, 2]`, written out."""
    x, y = m.T
    r2 = x**2 + y**2
    radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
    return np.stack(
        [
            x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x**2),
            y * radial + lens.p1 * (r2 + 2 * y**2) + 2 * lens.p2 * x * y,
        ],
        axis=-1,
    )


def in_pixels(camera: Camera, m: np.ndarray) -> np.ndarray:
    return m @ matrix(camera)[:2, :2].T + [camera.cx_px, camera.cy_px]


class TestUnified:
    @pytest.mark.parametrize("seed", range(20))
    def test_formula(self, seed):
        """From the sphere: its point, seen from (0, 0, -xi), meets the plane one unit ahead of there."""
        sensor = random_sensor("unified", seed, lens=True, skew=True)
        d = field_directions(sensor)
        seen_from = np.array([0, 0, -sensor.model.xi])
        plane = (d - seen_from)[:, :2] / (d - seen_from)[:, 2:]
        expected = in_pixels(sensor.camera, bent(sensor.lens, plane))
        assert np.abs(project(sensor, d)[0] - expected).max() < PIXELS

    @pytest.mark.parametrize("xi", [0.0, 0.25, 0.9, 1.0, 1.16, 2.2, 3.0])
    def test_opencv(self, xi):
        cv2 = pytest.importorskip("cv2")
        camera = Camera(focal_px=300.0, aspect=1.1, skew_px=3.0, cx_px=330.0, cy_px=230.0)
        lens = Lens(k1=-0.05, k2=0.01, p1=0.002, p2=-0.0015)
        angle = 0.8 * np.degrees(Unified(xi=xi).largest_angle_rad(camera, lens))
        sensor = sensor_of(
            Unified(xi=xi), camera, lens, FieldOfView(elevation_min_deg=90 - angle, elevation_max_deg=90)
        )
        d = field_directions(sensor)
        distortion = np.array([[lens.k1, lens.k2, lens.p1, lens.p2]])
        expected, _ = cv2.omnidir.projectPoints(d[None], np.zeros(3), np.zeros(3), matrix(camera), xi, distortion)
        assert np.abs(project(sensor, d)[0] - expected[0]).max() < PIXELS
