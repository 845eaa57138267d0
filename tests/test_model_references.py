"""Camera models against other programs and against their formulas written out in NumPy."""

import numpy as np
import pytest
from cameras import random_sensor, seen_pixels, sensor_of

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import DoubleSphere, Equirectangular, ExtendedUnified, KannalaBrandt, OCam, Unified
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
        visible_pairs = np.array([0, 0, -sensor.model.xi])
        plane = (d - visible_pairs)[:, :2] / (d - visible_pairs)[:, 2:]
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


class TestExtendedUnified:
    @pytest.mark.parametrize("seed", range(20))
    def test_formula(self, seed):
        """From the ellipsoid beta (x² + y²) + z² = 1: of its point, a mean of two projections."""
        sensor = random_sensor("eucm", seed, skew=True)
        d = field_directions(sensor)
        alpha, beta = sensor.model.alpha, sensor.model.beta
        on_ellipsoid = d / np.sqrt(d**2 @ [beta, beta, 1])[:, None]
        plane = on_ellipsoid[:, :2] / (alpha + (1 - alpha) * on_ellipsoid[:, 2:])
        assert np.abs(project(sensor, d)[0] - in_pixels(sensor.camera, plane)).max() < PIXELS


class TestDoubleSphere:
    @pytest.mark.parametrize("seed", range(20))
    def test_formula(self, seed):
        """From the spheres: the first one's point, carried on to the second, seen from alpha/(1 - alpha) behind."""
        sensor = random_sensor("double_sphere", seed, skew=True)
        xi, alpha = sensor.model.xi, min(sensor.model.alpha, 1 - 1e-12)
        second = field_directions(sensor) + np.array([0, 0, xi])
        second /= np.linalg.norm(second, axis=1, keepdims=True)
        # The plane of the pinhole's image is where alpha makes the focal length f: (1 - alpha) of the distance.
        plane = second[:, :2] / (second[:, 2:] + alpha / (1 - alpha)) / (1 - alpha)
        assert np.abs(project(sensor, field_directions(sensor))[0] - in_pixels(sensor.camera, plane)).max() < PIXELS

    @pytest.mark.parametrize("seed", range(50))
    def test_domain_is_where_the_radius_grows(self, seed):
        """By brute force: the first angle at which the radius of the formula stops growing, or has no end."""
        rng = np.random.default_rng(seed)
        xi, alpha = rng.choice([1.0, rng.uniform(-0.9, 2)]), rng.choice([0.0, 0.5, 1.0, rng.uniform()])
        theta = np.linspace(0, np.pi, 200_001)[1:-1]
        z_2 = xi + np.cos(theta)
        ahead = alpha * np.hypot(np.sin(theta), z_2) + (1 - alpha) * z_2
        radius = np.sin(theta) / np.where(ahead > 1e-9, ahead, np.nan)
        grows = np.diff(radius) > 0  # false where it is not a number
        end = theta[-1] if grows.all() else theta[np.argmin(grows)]
        domain = DoubleSphere(xi=xi, alpha=alpha).domain(Camera(), Lens())
        assert domain.angle_rad == pytest.approx(end, abs=1e-4)  # six steps
        if np.isfinite(domain.radius):
            assert domain.radius == pytest.approx(np.nanmax(np.where(theta <= end, radius, np.nan)), rel=1e-4)


class TestUnifiedFamily:
    """Without a lens, Mei's model is UCM, EUCM with beta = 1, and double sphere with xi = 0: design of all three."""

    @pytest.mark.parametrize("xi", [0.0, 0.5, 1.0, 1.7])
    def test_same_pixels_and_same_domain(self, xi):
        camera = Camera(focal_px=200 * (1 + xi), aspect=0.97, skew_px=2.0 * (1 + xi))
        same = Camera(focal_px=200, aspect=0.97, skew_px=2.0)
        alpha = xi / (1 + xi)
        field = FieldOfView(elevation_min_deg=10, elevation_max_deg=90)
        mei = sensor_of(Unified(xi=xi), camera, field=field)
        d = field_directions(mei)
        for model in (ExtendedUnified(alpha=alpha, beta=1.0), DoubleSphere(xi=0.0, alpha=alpha)):
            assert np.abs(project(sensor_of(model, same, field=field), d)[0] - project(mei, d)[0]).max() < PIXELS
            domain, of_mei = model.domain(same, Lens()), mei.model.domain(camera, Lens())
            assert domain.angle_rad == pytest.approx(of_mei.angle_rad, abs=1e-7)  # an arccos near -1
            assert domain.radius == pytest.approx(of_mei.radius * (1 + xi), rel=1e-12)


class TestKannalaBrandt:
    @pytest.mark.parametrize("seed", range(20))
    def test_formula(self, seed):
        sensor = random_sensor("kannala_brandt", seed, skew=True)
        d = field_directions(sensor)
        theta = np.arccos(d[:, 2])
        k = [sensor.model.k1, sensor.model.k2, sensor.model.k3, sensor.model.k4]
        r = theta + sum(each * theta ** (3 + 2 * i) for i, each in enumerate(k))
        phi = np.arctan2(d[:, 1], d[:, 0])
        plane = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1)
        # arccos loses half the digits next to the axis, 1e-8 of 300 pixels at worst, and the slope of r with it.
        away = theta > 0.01
        assert np.abs(project(sensor, d)[0] - in_pixels(sensor.camera, plane))[away].max() < PIXELS

    @pytest.mark.parametrize("seed", range(20))
    def test_opencv(self, seed):
        """Its formula goes through tan(theta), so up to 85 degrees; its skew is a share of the focal length."""
        cv2 = pytest.importorskip("cv2")
        sensor = random_sensor("kannala_brandt", seed, skew=True)
        camera, model = sensor.camera, sensor.model
        d = field_directions(sensor)
        d = d[d[:, 2] > np.cos(np.radians(85))]
        k = np.array([model.k1, model.k2, model.k3, model.k4])
        K = matrix(camera)
        expected, _ = cv2.fisheye.projectPoints(
            d[:, None], np.zeros(3), np.zeros(3), K, k, alpha=camera.skew_px / camera.focal_px
        )
        assert len(d) > 100
        assert np.abs(project(sensor, d)[0] - expected[:, 0]).max() < PIXELS

    def test_domain_ends_where_the_polynomial_turns(self):
        """r = theta - theta³/3 is steepest at 0 and turns at 1 rad."""
        domain = KannalaBrandt(k1=-1 / 3).domain(Camera(), Lens())
        assert domain.angle_rad == pytest.approx(1, abs=1e-12)
        assert domain.radius == pytest.approx(2 / 3, abs=1e-12)
        assert KannalaBrandt().domain(Camera(), Lens()).angle_rad == np.pi


class TestOCam:
    @pytest.mark.parametrize("seed", range(10))
    def test_inverse_by_all_roots_of_the_polynomial(self, seed):
        """rho Z(r) - z r = 0 solved by the eigenvalues of its companion matrix: the smallest root above 0."""
        sensor = random_sensor("ocam", seed)
        model, camera = sensor.model, sensor.camera
        d = field_directions(sensor, 300)
        expected = np.empty((len(d), 2))
        for i, (x, y, z) in enumerate(d):
            rho = np.hypot(x, y)
            polynomial = -rho * np.array(model.coefficients)
            polynomial[1] -= z
            roots = np.roots(polynomial[::-1])
            r = min(root.real for root in roots if abs(root.imag) < 1e-6 * abs(root) and root.real > 0)
            p, q = r * y / rho, r * x / rho
            expected[i] = model.e * p + q + camera.cx_px, model.c * p + model.d * q + camera.cy_px
        # The companion matrix is badly scaled (200⁴): eigenvalues to some 1e-13 of the largest root.
        assert np.abs(project(sensor, d)[0] - expected).max() < 1e-8

    @pytest.mark.parametrize("seed", range(10))
    def test_ray_of_a_pixel_as_ocamcalib_computes_it(self, seed):
        """In its own frame, x down, y to the right, z backwards, with the affine part as a matrix."""
        sensor = random_sensor("ocam", seed)
        model, camera = sensor.model, sensor.camera
        pixels, rays = seen_pixels(sensor, seed)
        affine = np.array([[model.c, model.d], [model.e, 1]])
        row_column = np.linalg.solve(affine, (pixels[:, ::-1] - [camera.cy_px, camera.cx_px]).T).T
        r = np.linalg.norm(row_column, axis=1)
        z = sum(a * r**k for k, a in enumerate(model.coefficients))
        own = np.column_stack([row_column, z])
        own /= np.linalg.norm(own, axis=1, keepdims=True)
        np.testing.assert_allclose(rays, own[:, [1, 0, 2]] * [1, 1, -1], rtol=0, atol=1e-14)

    def test_a_polynomial_of_degree_0_is_a_pinhole(self):
        """And of degree 2, with a_2 = 1/(4 f) and a_0 = -f: the paraboloid, r = 2 f tan(theta/2)."""
        field = FieldOfView(elevation_min_deg=20, elevation_max_deg=90)
        d = field_directions(sensor_of(OCam(coefficients=[-200]), Camera(), field=field))
        plane = d[:, :2] / d[:, 2:]
        pinhole = project(sensor_of(OCam(coefficients=[-200]), Camera(), field=field), d)[0]
        assert np.abs(pinhole - (200 * plane + [319.5, 239.5])).max() < PIXELS
        parabolic = project(sensor_of(OCam(coefficients=[-200, 0, 1 / 800]), Camera(), field=field), d)[0]
        assert np.abs(parabolic - (400 * d[:, :2] / (1 + d[:, 2:]) + [319.5, 239.5])).max() < PIXELS

    def test_domain_ends_where_the_angle_stops_growing(self):
        """Z = 100 + r²/400: Z - r Z' = 100 - r²/400 vanishes at 200, where Z = 200: 45 degrees."""
        domain = OCam(coefficients=[-100, 0, -1 / 400]).domain(Camera(), Lens())
        assert domain.radius == pytest.approx(200, abs=1e-9)
        assert domain.angle_rad == pytest.approx(np.pi / 4, abs=1e-12)


class TestEquirectangular:
    SENSOR = sensor_of(
        Equirectangular(),
        Camera(width_px=360, height_px=180, focal_px=180 / np.pi, cx_px=179.5, cy_px=89.5),
        field=FieldOfView(elevation_min_deg=-90, elevation_max_deg=90),
    )
    """A pixel is a degree."""

    def test_degrees_by_hand(self):
        """Forward is in the middle; from there to the left is 90 degrees to the left on the image, above is above."""
        up_40 = [np.cos(np.radians(40)), 0, np.sin(np.radians(40))]
        pixels, valid = project(self.SENSOR, [[1, 0, 0], [0, 1, 0], [0, -1, 0], up_40, [1, 1, -np.sqrt(2)]])
        expected = [[179.5, 89.5], [89.5, 89.5], [269.5, 89.5], [179.5, 49.5], [134.5, 134.5]]
        np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-12)
        assert valid.all()

    def test_seam_is_behind_and_belongs_to_the_image(self):
        """Rounding must not push a direction off either end: straight behind, or a hair to either side."""
        aside = np.array([0.0, -0.0, 1e-300, -1e-300, 1e-17, -1e-17, 1e-9])
        behind = np.stack([-np.ones(7), aside, np.zeros(7)], axis=-1)
        pixels, valid = project(self.SENSOR, behind)
        assert valid.all()
        assert np.minimum(np.abs(pixels[:, 0] + 0.5), np.abs(pixels[:, 0] - 359.5)).max() < 1e-6
        assert project(self.SENSOR, [-1, 1e-9, 0])[0][0] < 0
        assert project(self.SENSOR, [-1, -1e-9, 0])[0][0] > 359

    @pytest.mark.parametrize("seed", range(20))
    def test_astronomers_formula(self, seed):
        """Longitude and latitude as complex arguments, the image's turn by a remainder about its middle."""
        sensor = random_sensor("equirectangular", seed)
        camera = sensor.camera
        d = field_directions(sensor) * [1, 1, -1]
        turn = 2 * np.pi * camera.focal_px
        u = camera.cx_px - camera.focal_px * np.angle(d[:, 0] + 1j * d[:, 1])
        middle = (camera.width_px - 1) / 2
        u = middle + np.remainder(u - middle + turn / 2, turn) - turn / 2
        v = camera.cy_px - camera.focal_px * camera.aspect * np.arcsin(d[:, 2])
        away = np.abs(d[:, 2]) < 0.999  # an arcsin loses half the digits next to the poles
        assert np.abs(project(sensor, d)[0] - np.stack([u, v], axis=-1))[away].max() < PIXELS
