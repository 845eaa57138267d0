"""All camera models: projection, its inverse, its derivative, its domain; and one from outside, from end to end."""

import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import pytest

from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import MODELS, CameraModel
from harness.camera.sensor import Sensor, jacobian, parameters_of, project, unproject
from harness.camera.unified import to_unified
from harness.compiled import kernel
from harness.errors import InputError
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.simulation.scene import load_scene
from harness.spec import dump_toml, parse


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
    kind: Literal["equiangular"] = "equiangular"

    def check(self, camera: Camera, lens: Lens, field: FieldOfView) -> None:  # noqa: ARG002
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


SENSORS = [
    Sensor(),
    Sensor(camera=Camera(aspect=1.02), lens=Lens(k1=-0.1, k2=0.02, p1=2e-3, p2=-1e-3, k3=-1e-3)),
    Sensor(model=Equiangular(), camera=Camera(**IMAGE)),
]


@pytest.mark.parametrize("sensor", SENSORS, ids=["hyperboloid", "with a lens", "equiangular"])
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
        assert np.isnan(project(sensor, [0.0, 0.0, 1.0])[0]).all()
        assert np.isnan(jacobian(sensor, [0.0, 0.0, 1.0])).all()
        assert not project(sensor, [0.0, 0.0, 1.0])[1]


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
        with pytest.raises(InputError, match=r"model\.kind: unknown kind 'fish'; valid: hyperboloid, equiangular"):
            parse(Sensor, {"model": {"kind": "fish"}})
        with pytest.raises(InputError, match="equiangular lens has no other distortion"):
            parse(Sensor, {"model": {"kind": "equiangular"}, "lens": {"k1": 0.1}})
        with pytest.raises(InputError, match="equiangular lens is not written in the unified model"):
            to_unified(self.trial().sensor)

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
