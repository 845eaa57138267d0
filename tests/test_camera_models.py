"""All camera models: projection, its inverse, its derivative, its domain; and one from outside, from end to end.

Against other programs and independent evaluations: `test_model_references.py`.
"""

import math
import re
import tomllib
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from cameras import KINDS, random_sensor, seen_pixels, sensor_of
from pydantic import ValidationError

from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.conversions import to_unified
from harness.camera.intrinsics import Camera, FieldEdge
from harness.camera.lens import Lens
from harness.camera.models import MODELS, CameraModel
from harness.camera.models.axial import AxialModel
from harness.camera.sensor import Sensor, jacobian, on_image, parameters_of, project, unproject
from harness.compiled import kernel
from harness.errors import InputError
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.simulation.scene import load_scene
from harness.spec import dump_toml, parse

PIXELS = RADIANS = 1e-9
"""The contract of the camera: the round trip closes to a millionth of what the best matcher resolves."""

HAS_LENS = {kind: MODELS[kind].has_lens for kind in KINDS}
UNUSED = {kind: MODELS[kind].unused for kind in KINDS}


class EquiangularCamera(NamedTuple):
    f: float
    aspect: float
    cu: float
    cv: float


@kernel
def _project(x, y, z, camera):
    across = math.sqrt(x * x + y * y)
    theta = math.atan2(across, -z)
    m = theta / across if across > 0.0 else -1.0 / z
    return camera.f * m * x + camera.cu, camera.aspect * camera.f * m * y + camera.cv, across > 0.0 or z < 0.0


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    u, v, _ = _project(x, y, z, camera)
    across = math.sqrt(x * x + y * y)
    if across == 0.0:
        return u, v, -camera.f * dx / z, -camera.aspect * camera.f * dy / z
    theta, d_across = math.atan2(across, -z), (x * dx + y * dy) / across
    d_theta = (across * dz - z * d_across) / (across * across + z * z)
    m, dm = theta / across, (d_theta * across - theta * d_across) / (across * across)
    return u, v, camera.f * (dm * x + m * dx), camera.aspect * camera.f * (dm * y + m * dy)


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    for i in range(u.size):
        x, y = (u[i] - camera.cu) / camera.f, (v[i] - camera.cv) / (camera.aspect * camera.f)
        theta = math.sqrt(x * x + y * y)
        scale = math.sin(theta) / theta if theta > 0.0 else 1.0
        x_out[i], y_out[i], z_out[i] = scale * x, scale * y, -math.cos(theta)
        if theta >= math.pi:
            x_out[i] = y_out[i] = z_out[i] = math.nan


add_compiled_model(EquiangularCamera, CompiledModel(_project, _move, _rays))


class Equiangular(CameraModel):
    """r = f theta, theta from straight down; no lens beside it."""

    title: ClassVar[str] = "equiangular lens"
    looks: ClassVar[str] = "down"
    mirrored: ClassVar[bool] = True
    kind: Literal["equiangular"] = "equiangular"

    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:  # noqa: ARG002
        if not lens.is_pinhole:
            raise ValueError("lens: an equiangular lens has no other distortion")

    def parameters(self, camera: Camera, lens: Lens) -> EquiangularCamera:  # noqa: ARG002
        return EquiangularCamera(camera.focal_px, camera.aspect, camera.cx_px, camera.cy_px)


IMAGE = {"width_px": 160, "height_px": 120, "focal_px": 29.0, "cx_px": 79.5, "cy_px": 59.5}
"""110° from straight down to the rim, +20° of elevation, at 56 px."""
FISHEYE = {"model": {"kind": "equiangular"}, "camera": IMAGE}


@pytest.fixture
def outside(monkeypatch):
    """The table of models with one more."""
    monkeypatch.setitem(MODELS, "equiangular", Equiangular)


SENSORS = {
    "hyperboloid": Sensor(),
    "with a lens": Sensor(
        camera=Camera(aspect=1.02, skew_px=2.5), lens=Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3, k3=-1e-3)
    ),
    "equiangular": Sensor(model=Equiangular(), camera=Camera(**IMAGE)),
    **{kind: random_sensor(kind, 0, lens=kind == "unified", skew=True) for kind in KINDS},
}


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
class TestEveryModel:
    @pytest.fixture
    def directions(self, sensor, rng):
        pixels = rng.uniform([0, 0], [sensor.camera.width_px - 1, sensor.camera.height_px - 1], (4000, 2))
        directions, valid = unproject(sensor, pixels)
        assert valid.sum() > 1000
        return directions[valid] * rng.uniform(0.1, 10, (valid.sum(), 1))

    @pytest.fixture
    def rng(self):
        return np.random.default_rng(7)

    def test_there_and_back(self, sensor, directions):
        pixels, valid = project(sensor, directions)
        again, _ = unproject(sensor, pixels)
        assert valid.mean() > 0.999  # all but for rounding at the rim
        unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        assert np.abs(again - unit).max() < 1e-11  # the lens is undone to 1e-13 of the radius

    @pytest.mark.slow
    def test_derivative_is_that_of_differences(self, sensor, directions):
        """Central differences with a step of 1e-4 of the length: 1e-8 from the third order, 1e-9 from rounding."""
        analytic = jacobian(sensor, directions)
        step = 1e-4 * np.linalg.norm(directions, axis=-1, keepdims=True)
        for axis in range(3):
            moved = np.eye(3)[axis] * step
            numeric = (project(sensor, directions + moved)[0] - project(sensor, directions - moved)[0]) / (2 * step)
            scale = np.linalg.norm(analytic, axis=(-2, -1))
            assert (np.abs(numeric - analytic[..., axis]).max(axis=-1) / scale).max() < 1e-6

    def test_length_does_not_matter(self, sensor, directions):
        """Euler: a function of the direction alone does not change along it."""
        along = np.einsum("nij,nj->ni", jacobian(sensor, directions), directions)
        assert np.abs(along).max() < 1e-9 * sensor.camera.focal_px

    def test_outside_the_domain_there_is_no_pixel(self, sensor):
        behind = [0.0, 0.0, -1.0 if isinstance(sensor.model, AxialModel) else 1.0]
        assert np.isnan(project(sensor, behind)[0]).all()
        assert np.isnan(jacobian(sensor, behind)).all()
        assert not project(sensor, behind)[1]


VARIANTS = [
    pytest.param(kind, lens, skew, id=f"{kind}{' lens' * lens}{' skew' * skew}")
    for kind in KINDS
    for lens, skew in ((False, False), (False, True), (True, False), (True, True))
    if not (lens and not HAS_LENS[kind]) and not (skew and "skew_px" in UNUSED[kind])
]


@pytest.mark.parametrize(("kind", "lens", "skew"), VARIANTS)
class TestRandomCameras:
    """A hundred cameras of each kind: their fields end anywhere up to one pixel inside the domain."""

    def test_pixel_to_direction_to_pixel(self, kind, lens, skew):
        for seed in range(100):
            sensor = random_sensor(kind, seed, lens=lens, skew=skew)
            pixels, directions = seen_pixels(sensor, seed)
            np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, rtol=0, atol=1e-15)
            again, valid = project(sensor, directions)
            assert np.abs(again - pixels).max() < PIXELS
            assert valid.mean() > 0.999  # all but for rounding at the rim

    def test_direction_to_pixel_to_direction(self, kind, lens, skew):
        for seed in range(100):
            sensor = random_sensor(kind, seed, lens=lens, skew=skew)
            rng = np.random.default_rng(seed)
            field = sensor.field
            z = np.sin(np.radians(rng.uniform(field.elevation_min_deg, field.elevation_max_deg, 1000)))
            phi = rng.uniform(-np.pi, np.pi, 1000)
            directions = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=-1)
            pixels, valid = project(sensor, directions * rng.uniform(0.1, 10, (1000, 1)))
            assert np.isfinite(pixels).all()  # the whole field has pixels, though some lie beside the image
            assert valid.sum() > 150
            again, _ = unproject(sensor, pixels)
            assert np.abs(again - directions).max() < RADIANS
            np.testing.assert_array_equal(valid, on_image(sensor, pixels))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "lens", "skew"), VARIANTS)
def test_derivative_is_that_of_differences_for_random_cameras(kind, lens, skew):
    """Central differences over 2e-5 of the length.

    1e-9 comes from the rounding of pixels, and up to 1e-7 from the third derivative, which is as large as 1/s³ at the
    distance s = 0.05 rad from a pole or the end of a domain.
    """
    step = 1e-5
    for seed in range(100):
        sensor = random_sensor(kind, seed, lens=lens, skew=skew)
        _, directions = seen_pixels(sensor, seed, 200)
        directions = directions[np.abs(directions[:, 2]) < 0.998] if kind == "equirectangular" else directions
        analytic = jacobian(sensor, directions)
        scale = np.linalg.norm(analytic, axis=(-2, -1))
        for axis in range(3):
            moved = np.eye(3)[axis] * step
            difference = project(sensor, directions + moved)[0] - project(sensor, directions - moved)[0]
            across = np.abs(difference[:, 0]) > 100  # the seam lies between
            error = np.abs(difference / (2 * step) - analytic[..., axis]).max(axis=-1) / scale
            assert across.mean() < 0.01
            assert error[~across].max() < 1e-6


class TestRefusals:
    @pytest.mark.parametrize(
        ("model", "largest", "why"),
        [
            ({"kind": "unified", "xi": 0.5}, 120.0, "nothing is projected"),
            # arccos(-1/2) = 120 deg, where r = 1/sqrt(3) turns round with r'' = -8 sin(120 deg)/9 = -0.77: a pixel, or
            # 0.002, inside is sqrt(2 x 0.002/0.77) = 4.1 deg less.
            ({"kind": "unified", "xi": 2.0}, 115.8, "the image folds back on itself"),
            ({"kind": "eucm", "alpha": 0.0, "beta": 1.3}, 90.0, "nothing is projected"),
            ({"kind": "double_sphere", "xi": 0.5, "alpha": 0.0}, 120.0, "nothing is projected"),
            # r = theta - theta³/3 turns at 1 rad with r'' = -2: a pixel inside is sqrt(0.002) = 2.6 deg less.
            ({"kind": "kannala_brandt", "k1": -1 / 3}, 54.7, r"r(theta) stops growing"),
        ],
    )
    def test_a_field_beyond_the_domain_is_refused_with_what_would_fit(self, model, largest, why):
        camera, field = {"focal_px": 500.0}, {"elevation_min_deg": -60, "elevation_max_deg": 90}
        with pytest.raises(InputError, match=r"field\.elevation_min_deg = -60 is 150 deg off") as caught:
            parse(Sensor, {"model": model, "camera": camera, "field": field})
        assert f" deg {why}; use at least " in str(caught.value)
        least = float(re.search(r"use at least (\S+)", str(caught.value)).group(1))
        assert least == pytest.approx(90 - largest, abs=0.1)
        parse(Sensor, {"model": model, "camera": camera, "field": field | {"elevation_min_deg": least}})

    def test_a_lens_that_folds_the_field_over(self):
        table = {"model": {"kind": "unified", "xi": 1.0}, "lens": {"k1": -1.0}, "field": {"elevation_min_deg": 0}}
        with pytest.raises(InputError, match="the lens folds the image over"):
            parse(Sensor, table)

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"focal_px": 101.0}, r"camera\.focal_px = 101: 640 pixels span 363\.06 deg, .* 101\.859164 for 360 deg"),
            (
                {"height_px": 340},
                r"cy_px = 159\.5: the image extends 20\.00 rows beyond the lower pole, .* 320\.00",
            ),
            ({"cy_px": 170.0, "height_px": 330}, r"10\.50 rows beyond the upper pole"),
        ],
    )
    def test_a_panorama_of_more_than_the_sphere(self, change, text):
        camera = {"height_px": 320, "focal_px": 101.8592, "cy_px": 159.5}
        parse(Sensor, {"model": {"kind": "equirectangular"}, "camera": camera})
        with pytest.raises(InputError, match=text):
            parse(Sensor, {"model": {"kind": "equirectangular"}, "camera": camera | change})

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"coefficients": [200.0]}, "a_0 = 200 must be below 0"),
            ({"coefficients": [-200.0, 0.1]}, "a_1 must be 0, or the projection is not smooth"),
            ({"coefficients": []}, "a list of at least 1"),
            ({"c": 0.0}, "c - d e must be above 0"),
            ({"coefficients": [-100.0, 0.0, -1 / 400]}, r"beyond 44\... deg the ray's angle stops growing with r"),
        ],
    )
    def test_a_polynomial_that_is_none_of_ocamcalibs(self, change, text):
        table = {"kind": "ocam", "coefficients": [-200.0, 0.0, 1e-3]} | change
        with pytest.raises(InputError, match=text):
            parse(Sensor, {"model": table, "field": {"elevation_min_deg": 0, "elevation_max_deg": 90}})

    def test_what_a_model_needs_is_missing(self):
        with pytest.raises(InputError, match=r"model\.xi: this key is missing"):
            parse(Sensor, {"model": {"kind": "unified"}})

    @pytest.mark.parametrize("kind", [kind for kind in KINDS if not HAS_LENS[kind]])
    def test_lens_terms_of_a_model_without_a_lens(self, kind):
        sensor = random_sensor(kind, 0)
        with pytest.raises(ValidationError, match=r"lens\.p2 = 0\.001: the .* has no lens terms"):
            sensor_of(sensor.model, sensor.camera, Lens(p2=1e-3), sensor.field)

    @pytest.mark.parametrize(("kind", "key"), [(kind, key) for kind in KINDS for key in UNUSED[kind]])
    def test_camera_keys_that_a_model_has_no_use_for(self, kind, key):
        sensor = random_sensor(kind, 0)
        with pytest.raises(ValidationError, match=rf"camera\.{key} = 1\.5 has no meaning for the "):
            sensor_of(sensor.model, sensor.camera.model_copy(update={key: 1.5}), field=sensor.field)

    @pytest.mark.parametrize("kind", KINDS)
    def test_a_sensor_is_written_and_read_back(self, kind):
        sensor = random_sensor(kind, 0)
        assert parse(Sensor, tomllib.loads(dump_toml(sensor))) == sensor


@pytest.mark.usefixtures("outside")
class TestModelFromOutside:
    @staticmethod
    def trial(**changes):
        table = {
            "scene": load_scene("box").model_dump(mode="json"),
            "sensor": FISHEYE,
            "panorama": {"width_px": 180, "height_px": 50},
            "render": {"samples": 4},
            "scoring": {"bound": True},
        }
        return parse(Trial, table | changes)

    def test_is_written_and_read_back(self):
        trial = self.trial()
        assert isinstance(trial.sensor.model, Equiangular)
        assert parse(Sensor, {"model": {"kind": "hyperboloid"}}) == Sensor()
        assert 'kind = "equiangular"' in dump_toml(trial.sensor)
        assert Trial.model_validate(trial.model_dump(mode="json")) == trial

    def test_unknown_one_is_refused_by_name(self):
        with pytest.raises(InputError, match=r"model\.kind: unknown kind 'fish'; valid: hyperboloid, .*, equiangular"):
            parse(Sensor, {"model": {"kind": "fish"}})
        with pytest.raises(InputError, match="equiangular lens has no other distortion"):
            parse(Sensor, {"model": {"kind": "equiangular"}, "lens": {"k1": 0.1}})
        with pytest.raises(InputError, match="equiangular lens cannot be written in the unified model"):
            to_unified(self.trial().sensor)

    @pytest.mark.long
    @pytest.mark.slow  # its loops are compiled for it in every run
    def test_renders_unwraps_matches_and_has_a_bound(self):
        cache = StageCache()
        outcomes = {kind: run_trial(self.trial(matching={"kind": kind}), cache) for kind in ("column", "slanted")}
        for kind, outcome in outcomes.items():
            image = outcome.images[0]
            assert image[59, 79] == 0  # straight down, where the camera sees itself
            assert image[59, 92] > 0
            assert image[0, 0] == 0  # 99 px from the centre: outside the field
            domain = outcome.truth.visible
            answered = np.isfinite(outcome.range_m) & domain
            error = np.abs(outcome.range_m - outcome.truth.range_m)[answered] / outcome.truth.range_m[answered]
            assert answered.sum() > 0.3 * domain.sum(), kind
            # A pixel of this image spans 2°, the parallax at 2 m is 14°: a pixel is 14 % of the range, which samples
            # may be off by. Fractions of a tenth of a pixel are what slanted windows are for.
            assert np.median(error) < {"column": 0.14, "slanted": 0.02}[kind], kind
            bound = outcome.bound_px[np.isfinite(outcome.bound_px)]
            assert bound.size > 50, kind
            assert (bound > 0).all(), kind


def test_parameters_have_the_class_of_their_model():
    assert type(parameters_of(Sensor())).__name__ == "HyperboloidCamera"
