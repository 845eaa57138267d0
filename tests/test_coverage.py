"""What is said of a sensor's image: against the mirror's and the lenses' formulas, and counted pixels."""

import numpy as np
import pytest

from harness import Sensor
from harness.camera.coverage import coverage
from harness.camera.sensor import project
from harness.spec import parse


def equidistant(looks="up", focal_px=100.0, width_px=640, height_px=480, cx_px=319.5, cy_px=239.5, **field):
    model = {"kind": "kannala_brandt", "k1": 0, "k2": 0, "k3": 0, "k4": 0}
    camera = {"width_px": width_px, "height_px": height_px, "focal_px": focal_px, "cx_px": cx_px, "cy_px": cy_px}
    return parse(Sensor, {"model": model, "camera": camera, "mount": {"looks": looks}, "field": field})


UP = {"elevation_min_deg": 0.0, "elevation_max_deg": 90.0}


class TestMirror:
    """The default rig: +20° at 238 px, -75° and below hidden (docs)."""

    found = coverage(Sensor())

    def test_rings(self):
        rim, blind = self.found.rim, self.found.blind
        assert np.degrees(rim.angle_rad) == pytest.approx(110, abs=1e-6)
        assert np.degrees(blind.angle_rad) == pytest.approx(15, abs=1e-6)
        assert rim.diameter_px == pytest.approx((476, 476), abs=0.01)
        assert rim.centre_px == pytest.approx((319.5, 239.5), abs=1e-9)
        assert (rim.on_image, rim.sides) == (1, ())
        # By the unified form of the hyperboloid, of docs/theory: rho = gamma sin/(cos + xi), theta from -z.
        eps = np.hypot(0.0281, 0.0234) / 0.0281
        gamma, xi = 614.12 * (eps**2 - 1) / (eps**2 + 1), 2 * eps / (1 + eps**2)
        rho = gamma * np.sin(np.radians(15)) / (np.cos(np.radians(15)) + xi)
        assert blind.diameter_px == pytest.approx((2 * rho, 2 * rho), rel=1e-6)

    def test_share_of_the_image_and_of_the_sphere(self):
        rho_max, rho_min = (ring.diameter_px[0] / 2 for ring in (self.found.rim, self.found.blind))
        assert self.found.used == pytest.approx(np.pi * (rho_max**2 - rho_min**2) / (640 * 480), rel=2e-3)
        sines = np.sin(np.radians([20, -75]))
        assert self.found.sphere == pytest.approx((sines[0] - sines[1]) / 2, abs=1e-3)

    def test_resolution_at_the_horizon(self):
        """By differences of the projection: a tenth of a degree up, and around."""
        level = int(np.argmin(np.abs(self.found.resolution.elevation_rad)))
        elevation = self.found.resolution.elevation_rad[level]
        step = np.radians(0.1)
        at = project(Sensor(), [[np.cos(elevation + s), 0, np.sin(elevation + s)] for s in (-step / 2, step / 2)])[0]
        assert self.found.resolution.radial[level] == pytest.approx(10 * np.linalg.norm(at[1] - at[0]), rel=1e-5)
        around = step / np.cos(elevation)
        at = project(Sensor(), [[np.cos(a), np.sin(a), np.tan(elevation)] for a in (-around / 2, around / 2)])[0]
        assert self.found.resolution.tangential[level] == pytest.approx(10 * np.linalg.norm(at[1] - at[0]), rel=1e-5)


class TestFisheye:
    """Equidistant: rho = f theta, so that all is known by hand."""

    def test_one_that_looks_up(self):
        covered = coverage(equidistant(**UP))
        assert covered.axis_px == (319.5, 239.5)
        assert covered.blind is None
        assert covered.rim.diameter_px == pytest.approx((100 * np.pi, 100 * np.pi), rel=1e-6)
        assert covered.elevation_deg == pytest.approx((0, 90), abs=0.6)  # half a pixel is 0.3°
        visible = covered.resolution
        per_degree = 100 * np.pi / 180
        assert visible.radial == pytest.approx(np.full(361, per_degree), rel=1e-9)
        theta = visible.angle_rad
        assert visible.tangential == pytest.approx(per_degree * theta / np.sin(theta), rel=1e-9)
        assert visible.elevation_rad == pytest.approx(np.pi / 2 - theta, abs=1e-12)

    def test_one_that_looks_down(self):
        covered = coverage(equidistant("down", elevation_min_deg=-90.0, elevation_max_deg=10.0))
        assert np.degrees(covered.rim.angle_rad) == pytest.approx(100, abs=1e-6)
        assert covered.resolution.elevation_rad == pytest.approx(covered.resolution.angle_rad - np.pi / 2, abs=1e-12)

    def test_one_that_looks_forward(self):
        field = {"elevation_min_deg": -90.0, "elevation_max_deg": 90.0, "angle_max_deg": 80.0}
        covered = coverage(equidistant("forward", **field))
        assert np.degrees(covered.rim.angle_rad) == pytest.approx(80, abs=1e-6)
        assert np.isnan(covered.resolution.elevation_rad).all()
        assert covered.elevation_deg == pytest.approx((-80, 80), abs=0.6)
        assert covered.sphere == pytest.approx((1 - np.cos(np.radians(80))) / 2, abs=1e-3)

    def test_one_whose_circle_is_cut_off(self):
        """The rim at 1.4 times the half height: what is beyond, by the arc's angle on two sides."""
        covered = coverage(equidistant(focal_px=240 * 1.4 / (np.pi / 2), **UP, width_px=800, cx_px=399.5))
        assert covered.rim.sides == ("top", "bottom")
        assert covered.rim.on_image == pytest.approx(1 - 4 * np.arccos(1 / 1.4) / (2 * np.pi), abs=0.01)

    def test_one_that_is_wider_than_its_image(self):
        covered = coverage(equidistant(focal_px=400.0, **UP))
        assert covered.rim.on_image == 0
        assert covered.used == 1
        corner = np.degrees(np.hypot(319.5, 239.5) / 400)
        assert covered.elevation_deg[0] == pytest.approx(90 - corner, abs=1e-9)
        assert np.isnan(covered.resolution.radial[-1])  # nothing is on the image there


def test_a_sensor_that_sees_nothing_has_no_coverage():
    with pytest.raises(ValueError, match="no pixel sees anything"):
        coverage(equidistant(focal_px=2000.0, elevation_min_deg=0.0, elevation_max_deg=10.0))
