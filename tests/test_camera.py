"""The sensor as a whole: physics of the mirror, project and unproject, what is valid, and angles."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from repeats import few

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, fold_radius
from harness.camera.models.hyperboloid import Mirror, point_on_mirror, rim_radius
from harness.camera.sensor import Sensor, in_field, on_image, pixel_directions, project, rays_of, unproject
from harness.errors import InputError
from harness.geometry.angles import angle_between, cylinder_point, lengths, normalise, wrap_angle
from harness.io.calibrations.sensors import load_sensor
from harness.spec import dump_toml, parse

# The contract of the camera: the round trip closes to a millionth of what the best matcher resolves.
PIXELS = 1e-9
RADIANS = 1e-9


def random_directions(
    rng: np.random.Generator, count: int, lowest_deg: float = -90, highest_deg: float = 90
) -> np.ndarray:
    z = rng.uniform(*np.sin(np.radians([lowest_deg, highest_deg])), count)
    phi = rng.uniform(-np.pi, np.pi, count)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def random_sensor(seed: int, *, distorted: bool) -> Sensor:
    """A mirror from nearly parabolic (b/a = 0.001) to nearly flat (100), its rim about as large as the image."""
    rng = np.random.default_rng([seed, distorted])
    mirror = Mirror(a_m=0.03, b_m=0.03 * 10 ** rng.uniform(-3, 2))
    asymptote = math.degrees(mirror.asymptote_rad)
    field = FieldOfView(
        elevation_min_deg=rng.uniform(-90, -75),
        elevation_max_deg=rng.uniform(-60, min(asymptote - 0.1, 89)),
    )
    rim = rim_radius(mirror, field.elevation_max_deg)
    lens = Lens()
    while distorted:
        # Up to a quarter of the radius at the rim; redrawn in the few cases that fold within it.
        k = rng.uniform(-0.15, 0.15, 3) / rim ** np.array([2, 4, 6])
        p = rng.uniform(-0.01, 0.01, 2) / rim
        lens = Lens(k1=k[0], k2=k[1], k3=k[2], p1=p[0], p2=p[1])
        if fold_radius(lens) > 1.1 * rim:
            break
    return Sensor(
        model=mirror,
        field=field,
        lens=lens,
        camera=Camera(
            focal_px=rng.uniform(180, 300) / rim,
            aspect=rng.uniform(0.8, 1.25),
            cx_px=319.5 + rng.uniform(-40, 40),
            cy_px=239.5 + rng.uniform(-40, 40),
            skew_px=rng.uniform(-5, 5) if distorted else 0.0,
        ),
    )


class TestMirror:
    @given(st.floats(0.05, 20), st.integers(0, 2**32 - 1))
    def test_point_lies_on_the_hyperboloid_in_its_direction(self, shape: float, seed: int) -> None:
        mirror = Mirror(a_m=0.02, b_m=0.02 * shape)
        asymptote = math.degrees(mirror.asymptote_rad)
        d = random_directions(np.random.default_rng(seed), 100, -90, asymptote - 1)
        p = point_on_mirror(mirror, 3.7 * d)  # of any length
        assert np.abs(angle_between(p, d)).max() < 1e-15
        r2 = p[:, 0] ** 2 + p[:, 1] ** 2
        # The equation's two terms cancel to 1; near the asymptote each is up to some 1e6.
        upper = (p[:, 2] + mirror.e_m) / mirror.a_m
        np.testing.assert_allclose(upper**2 - r2 / mirror.b_m**2, 1, rtol=0, atol=1e-8)
        assert np.all(upper >= 1 - 1e-12)  # the upper sheet

    def test_reflection_sends_every_ray_through_the_camera(self) -> None:
        """Single viewpoint, from the law of reflection alone.

        A ray that aims at F0 meets the surface and leaves it at the angle that it came in at, about a normal
        found by central differences of the surface's height: it must pass through F1.
        """
        rng = np.random.default_rng(0)
        for _ in range(20):
            mirror = Mirror(a_m=rng.uniform(0.01, 0.05), b_m=rng.uniform(0.01, 0.05))
            d = random_directions(rng, 200, -90, math.degrees(mirror.asymptote_rad) - 5)
            p = point_on_mirror(mirror, d)

            def height(x, y, mirror=mirror):
                return mirror.a_m * np.sqrt(1 + (x * x + y * y) / mirror.b_m**2) - mirror.e_m

            h = 1e-6
            slope_x = (height(p[:, 0] + h, p[:, 1]) - height(p[:, 0] - h, p[:, 1])) / (2 * h)
            slope_y = (height(p[:, 0], p[:, 1] + h) - height(p[:, 0], p[:, 1] - h)) / (2 * h)
            normal = normalise(np.stack([slope_x, slope_y, -np.ones(200)], axis=-1))
            incoming = -d
            outgoing = incoming - 2 * np.sum(incoming * normal, axis=-1, keepdims=True) * normal
            to_camera = np.array([0, 0, -2 * mirror.e_m]) - p
            # Error of the differences: h² x the third derivative (1e-12 / b²) and rounding (1e-17 / h).
            assert angle_between(outgoing, to_camera).max() < 1e-8

    def test_apex_and_horizon(self) -> None:
        mirror = Mirror(a_m=0.03, b_m=0.04)  # e = 0.05: the apex is a - e from F0, the latus rectum b²/a wide
        points = point_on_mirror(mirror, [[0, 0, -1], [1, 0, 0]])
        np.testing.assert_allclose(points, [[0, 0, -0.02], [0.0016 / 0.03, 0, 0]], rtol=0, atol=1e-16)
        assert mirror.asymptote_rad == pytest.approx(math.asin(0.6), abs=1e-15)

    def test_no_mirror_above_the_asymptote(self) -> None:
        mirror = Mirror()
        elevation = mirror.asymptote_rad + np.array([-1e-6, 1e-6])
        d = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=-1)
        assert np.isnan(point_on_mirror(mirror, d)).any(axis=-1).tolist() == [False, True]
        nowhere = [[0, 0, 1], [0, 0, 0], [np.inf, 0, 0], [np.nan, 0, 1]]
        assert np.isnan(point_on_mirror(mirror, nowhere)).any(axis=-1).all()


class TestRoundTrip:
    @pytest.mark.slow
    @pytest.mark.parametrize("distorted", [False, True])
    @pytest.mark.parametrize("seed", few(10, range(50)))
    def test_pixel_to_direction_to_pixel_over_the_whole_image(self, seed: int, distorted: bool) -> None:
        sensor = random_sensor(seed, distorted=distorted)
        directions, valid = pixel_directions(sensor)
        assert valid.sum() > 10_000  # the test would be empty otherwise
        v, u = np.nonzero(valid)
        np.testing.assert_allclose(np.linalg.norm(directions[valid], axis=-1), 1, rtol=0, atol=1e-15)
        pixels, again = project(sensor, directions[valid])
        assert np.abs(pixels - np.stack([u, v], axis=-1)).max() < PIXELS
        assert again.all()

    @pytest.mark.parametrize("distorted", [False, True])
    @pytest.mark.parametrize("seed", range(50))
    def test_direction_to_pixel_to_direction_over_the_whole_field(self, seed: int, distorted: bool) -> None:
        sensor = random_sensor(seed, distorted=distorted)
        rng = np.random.default_rng(seed)
        field = sensor.field
        d = random_directions(rng, 5000, field.elevation_min_deg, field.elevation_max_deg)
        pixels, valid = project(sensor, d * rng.uniform(0.1, 10, (5000, 1)))  # of any length
        assert valid.sum() > 1000
        back, again = unproject(sensor, pixels)
        assert angle_between(back[valid], d[valid]).max() < RADIANS
        # The borders of the field alone may fall to either side by a rounding.
        assert (again != valid).sum() <= 5

    def test_any_shape_of_arrays(self) -> None:
        sensor = random_sensor(1, distorted=True)
        pixels = np.random.default_rng(0).uniform(100, 400, (2, 3, 4, 2))
        directions, valid = unproject(sensor, pixels)
        assert directions.shape == (2, 3, 4, 3)
        assert valid.shape == (2, 3, 4)
        one, _ = unproject(sensor, pixels[1, 2, 3])
        np.testing.assert_array_equal(one, directions[1, 2, 3])
        back, _ = project(sensor, directions)
        np.testing.assert_allclose(back, pixels, rtol=0, atol=PIXELS)

    def test_quick_form_agrees(self) -> None:
        sensor = random_sensor(2, distorted=True)
        u, v = np.random.default_rng(0).uniform(150, 350, (2, 100))
        directions, _ = unproject(sensor, np.stack([u, v], axis=-1))
        np.testing.assert_allclose(normalise(rays_of(sensor, u, v).T), directions, rtol=0, atol=1e-15)


class TestProjection:
    def test_against_the_formula_of_the_mirror(self) -> None:
        """`rho = f r / (z + 2e)` with the mirror point found by a quadratic, another way than the program's."""
        mirror, camera = Mirror(a_m=0.03, b_m=0.02), Camera(focal_px=500, aspect=1.1, cx_px=300, cy_px=200)
        sensor = Sensor(model=mirror, camera=camera)
        d = random_directions(np.random.default_rng(0), 100, -80, 20)
        c, s = np.hypot(d[:, 0], d[:, 1]), d[:, 2]
        a, b, e = mirror.a_m, mirror.b_m, mirror.e_m
        # (s t + e)²/a² - c² t²/b² = 1 for the distance t
        t = np.empty(100)
        for i in range(100):
            square, linear = (s[i] / a) ** 2 - (c[i] / b) ** 2, 2 * s[i] * e / a**2
            t[i] = min(x for x in np.roots([square, linear, (e / a) ** 2 - 1]) if x > 0 and x * s[i] + e > 0)
        rho = 500 * c * t / (s * t + 2 * e)
        phi = np.arctan2(d[:, 1], d[:, 0])
        expected = np.stack([300 + rho * np.cos(phi), 200 + 1.1 * rho * np.sin(phi)], axis=-1)
        np.testing.assert_allclose(project(sensor, d)[0], expected, rtol=0, atol=PIXELS)

    def test_default_rig_is_the_one_described(self) -> None:
        sensor = Sensor()
        elevation = math.radians(20)
        pixels, valid = project(sensor, [math.cos(elevation), 0, math.sin(elevation) - 1e-12])
        assert valid
        assert pixels[0] - 319.5 == pytest.approx(238, abs=0.005)  # the focal length is given to 0.01 px
        assert rim_radius(sensor.model, sensor.field.elevation_max_deg) * 614.12 == pytest.approx(238, abs=0.005)

    def test_axes_of_the_image(self) -> None:
        (right, down, below), _ = project(Sensor(), [[1, 0, 0], [0, 1, 0], [0, 0, -1]])
        assert right[0] > 319.5
        assert right[1] == 239.5
        assert down[1] > 239.5
        assert down[0] == pytest.approx(319.5, abs=1e-12)
        assert below.tolist() == [319.5, 239.5]


class TestValidity:
    def test_blind_disc_rim_and_corners(self) -> None:
        sensor = Sensor()
        pixels = [[319.5, 239.5], [330, 239.5], [319.5 + 237.9, 239.5], [319.5 + 238.1, 239.5], [0, 0]]
        directions, valid = unproject(sensor, pixels)
        assert valid.tolist() == [False, False, True, False, False]
        assert np.isfinite(directions).all()  # outside the field they go on smoothly

    def test_directions_outside_the_field(self) -> None:
        elevation = np.radians([-90, -75.01, -74.99, 0, 19.99, 20.01, 50, 51, 90])
        d = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=-1)
        pixels, valid = project(Sensor(), d)
        assert valid.tolist() == [False, False, True, True, True, False, False, False, False]
        # The mirror's asymptote is at 50.2°: up to there the image goes on, beyond there is none.
        assert np.isnan(pixels).any(axis=-1).tolist() == [False] * 7 + [True] * 2
        assert in_field(Sensor(), 5 * d).tolist() == valid.tolist()

    def test_directions_off_the_image(self) -> None:
        sensor = Sensor(camera=Camera(width_px=300, cx_px=149.5))
        pixels, valid = project(sensor, [[1, 0, 0], [0, 1, 0]])
        assert valid.tolist() == [False, True]
        assert pixels[0, 0] > 299.5  # known, and known to be off

    def test_image_spans_whole_pixels(self) -> None:
        pixels = [[-0.5, -0.5], [639.5, 479.5], [-0.51, 0], [639.51, 0], [0, -0.51], [0, 479.51], [np.nan, 0]]
        assert on_image(Sensor(), pixels).tolist() == [True, True, False, False, False, False, False]

    def test_what_is_no_number_is_not_valid(self) -> None:
        for function, width in ((project, 3), (unproject, 2)):
            values = np.ones((4, width)) * np.array([[0], [np.nan], [np.inf], [-np.inf]])
            _, valid = function(Sensor(), values)
            assert not valid.any()

    def test_beyond_the_fold_of_the_lens_is_nan(self) -> None:
        sensor = Sensor(lens=Lens(k1=-1.1))  # folds at 0.55, the rim is at 0.39
        reach = 2 / 3 * fold_radius(sensor.lens) * 614.12  # of the distorted image
        directions, valid = unproject(sensor, [[319.5 + reach - 0.1, 239.5], [319.5 + reach + 0.1, 239.5]])
        assert np.isnan(directions).any(axis=-1).tolist() == [False, True]
        assert not valid.any()
        pixels, _ = project(sensor, [math.cos(0.8), 0, math.sin(0.8)])  # on the mirror, but off the lens
        assert np.isnan(pixels).all()

    def test_kept_directions_are_read_only(self) -> None:
        directions, valid = pixel_directions(Sensor())
        for array in (directions, valid):
            with pytest.raises(ValueError, match="read-only"):
                array[0, 0] = 0
        fresh, mask = unproject(Sensor(), np.moveaxis(np.mgrid[0:480, 0:640][::-1], 0, -1))
        np.testing.assert_array_equal(fresh, directions)
        np.testing.assert_array_equal(mask, valid)


class TestSensorFile:
    def test_round_trip(self, tmp_path) -> None:
        sensor = random_sensor(3, distorted=True)
        path = tmp_path / "sensor.toml"
        path.write_text(dump_toml(sensor))
        assert load_sensor(path) == sensor
        assert parse(Sensor, tomllib.loads("")) == Sensor()  # an empty file is the default rig

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("model.a_m = 0.0", "model.a_m: must be above 0; found 0.0"),
            ("model.b_m = -0.02", "model.b_m: must be above 0; found -0.02"),
            ("model.a_m = inf", "model.a_m: must be a finite number; found inf"),
            ("model.b_m = 1e-9", "model: b_m / a_m is 3.55872e-08, which is no usable mirror"),
            ("model.e_m = 0.03", "model.e_m: unknown key 'e_m'; did you mean "),
            ("field.elevation_max_deg = 60", "field.elevation_max_deg = 60 is beyond the mirror's asymptote"),
            ("field.elevation_min_deg = 30", "field: elevation_min_deg must be below elevation_max_deg"),
            ("lens.k1 = -3", "lens: the distortion folds the image over at radius 0.333 "),
            ("camera.width_px = 640.5", "camera.width_px: must be a whole number; found 640.5"),
            ("camera.focal_px = '600'", "camera.focal_px: must be a number; found '600'"),
        ],
    )
    def test_impossible_sensor_is_refused_by_name(self, tmp_path, text: str, message: str) -> None:
        path = tmp_path / "sensor.toml"
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            load_sensor(path)
        assert str(caught.value).startswith(f"{path}: {message}")

    @pytest.mark.slow
    def test_lens_may_fold_a_pixel_beyond_the_rim_and_no_nearer(self) -> None:
        """The corners of the rim's pixels need rays, and r + k1 r³ hardly grows before its fold, 1/sqrt(-3 k1).

        There 3 pixels of the undistorted image are 0.04 of the distorted one, and 25 are 2.5: (3/614)²/0.39 x 614.
        """
        rim = rim_radius(Mirror(), 20)
        near, far = (Lens(k1=-1 / (3 * (rim + pixels / 614.12) ** 2)) for pixels in (3, 25))
        sensor = Sensor(lens=far)
        _, valid = pixel_directions(sensor)
        v, u = np.nonzero(valid)
        assert np.isfinite(rays_of(sensor, u + 0.5, v + 0.5)).all()
        with pytest.raises(ValidationError, match=r"folds the image over at radius 0\.392 .* next to the mirror's rim"):
            Sensor(lens=near)

    def test_field_up_to_the_asymptote_and_no_further(self) -> None:
        asymptote = math.degrees(Mirror().asymptote_rad)
        Sensor(field=FieldOfView(elevation_max_deg=asymptote - 0.02))
        with pytest.raises(ValidationError, match="asymptote"):
            Sensor(field=FieldOfView(elevation_max_deg=asymptote))


class TestAngles:
    @given(st.floats(-1e6, 1e6))
    def test_wrapped_angle_is_the_same_angle_in_range(self, angle: float) -> None:
        wrapped = wrap_angle(angle)
        assert -np.pi <= wrapped < np.pi
        # pi itself is off by 1e-16, times up to 160,000 turns.
        turns = (angle - wrapped) / (2 * np.pi)
        assert turns == pytest.approx(round(float(turns)), abs=1e-9)

    @given(st.floats(-np.pi, np.pi, exclude_max=True))
    def test_angle_in_range_is_left_alone(self, angle: float) -> None:
        assert wrap_angle(angle) == angle

    @pytest.mark.parametrize(
        ("angle", "expected"),
        [
            (np.pi, -np.pi),
            (-np.pi, -np.pi),
            (np.nextafter(-np.pi, -4), -np.pi),  # the remainder of a tiny negative number rounds to 2 pi
            (3 * np.pi, -np.pi),
            (0.0, 0.0),
            (-1e-300, -1e-300),
        ],
    )
    def test_wrapping_at_the_seam(self, angle: float, expected: float) -> None:
        assert wrap_angle(angle) == expected

    @pytest.mark.parametrize("exponent", [1, 10, 26, 30, 40, 46])
    def test_angle_near_zero_and_pi_keeps_its_digits(self, exponent: int) -> None:
        """(3, 4, 0) and (3 - 4 t, 4 + 3 t, 0), exact in binary for t = 2^-n, enclose atan t.

        So do their products up to n = 46. An arccos would see no angle at all from n = 27.
        """
        t = 2.0**-exponent
        a, b = np.array([3.0, 4.0, 0.0]), np.array([3 - 4 * t, 4 + 3 * t, 0])
        assert angle_between(a, b) == pytest.approx(math.atan(t), rel=1e-15, abs=0)
        # Near pi the result itself is rounded to 4e-16.
        assert np.pi - angle_between(a, -b) == pytest.approx(math.atan(t), rel=1e-15, abs=5e-16)

    def test_angles_that_are_known(self) -> None:
        x, y = np.eye(3)[:2]
        assert angle_between(x, x) == 0
        assert angle_between(x, -x) == np.pi
        assert angle_between(x, 1e9 * y) == np.pi / 2
        assert angle_between([[1, 1, 0], [1, 0, 0]], x) == pytest.approx([np.pi / 4, 0], abs=1e-16)

    def test_cylinder_point_has_unit_radius(self) -> None:
        points = cylinder_point([0, np.pi / 2], [[-1.0], [2.0]])
        assert points.shape == (2, 2, 3)
        np.testing.assert_allclose(points[1], [[1, 0, 2], [0, 1, 2]], rtol=0, atol=1e-16)

    def test_normalise(self) -> None:
        np.testing.assert_allclose(normalise([[3, 4, 0], [0, 0, -2]]), [[0.6, 0.8, 0], [0, 0, -1]], rtol=0, atol=1e-16)


def test_a_principal_point_beside_the_image_is_refused():
    with pytest.raises(ValueError, match=r"cx_px = 319\.5 is not on an image of 160 pixels; 'centre' is .*79\.5"):
        Camera(width_px=160, height_px=480)


def test_lengths_are_those_of_numpy_to_the_last_bit_in_any_layout():
    rng = np.random.default_rng(3)
    vectors = rng.standard_normal((40, 50, 3)) * 10.0 ** rng.integers(-8, 9, (40, 50, 3))
    vectors[0, :3] = [[0, 0, 0], [np.nan, 1, 2], [np.inf, 1, 2]]
    for each in (vectors, np.asfortranarray(vectors), vectors[::3, ::-2], vectors[5, 7]):
        np.testing.assert_array_equal(lengths(each), np.linalg.norm(each, axis=-1))
