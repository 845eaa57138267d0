"""Planes on a sensor's image: conics of cameras of the unified model, however mounted, and points of any camera."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.camera.plane_images import plane_conic, plane_points
from harness.camera.sensor import Sensor, unproject
from harness.geometry.angles import normalise

IMAGE = {"width_px": 640, "height_px": 480, "focal_px": 300.0, "cx_px": 322.0, "cy_px": 236.0, "aspect": 1.02}
UP = {"elevation_min_deg": 10.0, "elevation_max_deg": 90.0}
TURNED = {"looks": "down", "mirrored": False, "yaw_deg": 40.0, "pitch_deg": 5.0, "roll_deg": -7.0}
SENSORS = {
    "mirror": {},
    "turned mirror": {"mount": TURNED},
    "unified": {"model": {"kind": "unified", "xi": 0.8}, "camera": IMAGE | {"skew_px": 3.0}, "field": UP},
    "unified beyond 1": {"model": {"kind": "unified", "xi": 1.6}, "camera": IMAGE, "field": UP},
    "paraboloid": {"model": {"kind": "unified", "xi": 1.0}, "camera": IMAGE, "field": UP},
    "eucm": {"model": {"kind": "eucm", "alpha": 0.6, "beta": 1.0}, "camera": IMAGE, "field": UP},
    "double sphere": {"model": {"kind": "double_sphere", "xi": 0.0, "alpha": 0.55}, "camera": IMAGE, "field": UP},
}
MOTION = st.integers(0, 10**6)


@pytest.mark.parametrize("name", list(SENSORS))
@settings(deadline=None, max_examples=20)  # the first one compiles
@given(seed=MOTION)
def test_the_epipolar_plane_is_seen_on_its_conic(name, seed):
    sensor = Sensor.model_validate(SENSORS[name])
    draws = np.random.default_rng(seed)
    t, x = draws.normal(size=(2, 3))
    normal = np.cross(t, x)
    points = plane_points(sensor, normal, 90)
    points = points[np.isfinite(points[:, 0])]
    conic = plane_conic(sensor, normal)
    assert np.abs(conic.residual(points)).max(initial=0) < 1e-9
    # Rounding of a thousand pixels in double precision, beside curves that run far out.
    assert conic.distance(points[::5]).max(initial=0) < 1e-7


@pytest.mark.parametrize("name", list(SENSORS))
def test_points_off_the_plane_are_off_the_conic(name):
    sensor = Sensor.model_validate(SENSORS[name])
    normal = normalise([0.3, -0.5, 0.6])
    points = plane_points(sensor, normal, 200)
    points = points[np.isfinite(points[:, 0])]
    points += np.array([3.0, -2.0])
    x, _ = unproject(sensor, points)
    away = np.abs(x @ normal) > 0.003
    assert away.sum() > 5
    assert plane_conic(sensor, normal).distance(points[away]).min() > 0.05


def test_what_is_seen_is_on_the_plane():
    sensor = Sensor()
    normal = normalise([0.3, -0.5, 0.6])
    points = plane_points(sensor, normal)
    x, visible = unproject(sensor, points[np.isfinite(points[:, 0])])
    assert visible.mean() > 0.95  # but for rounding at the rim
    assert np.abs(x @ normal).max() < 1e-12


@pytest.mark.parametrize(
    "settings_of",
    [
        {"lens": {"k1": -0.1}},
        {
            "model": {"kind": "kannala_brandt"},
            "camera": {"width_px": 640, "height_px": 480, "focal_px": 150.0},
            "field": UP,
        },
    ],
)
def test_other_images_of_a_plane_are_no_conics(settings_of):
    sensor = Sensor.model_validate(settings_of)
    assert plane_conic(sensor, (0.3, -0.5, 0.6)) is None
    assert np.isfinite(plane_points(sensor, (0.3, -0.5, 0.6))[:, 0]).sum() > 20
