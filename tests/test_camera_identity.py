"""A camera model from elsewhere is identified by its source: neither a trial nor a render is shared by two versions."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from sweeps import environment, write_small

from harness.camera.models import BUILT_IN, MODELS
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.runs.load import load_experiment
from harness.third_party import identity_of

LENS = """
import math
from typing import ClassVar, Literal, NamedTuple

from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.models import MODELS, CameraModel
from harness.compiled import kernel


class Numbers(NamedTuple):
    f: float
    cu: float
    cv: float


@kernel
def _project(x, y, z, camera):
    across = math.sqrt(x * x + y * y)
    scale = BEND * camera.f * math.atan2(across, z) / across if across > 0.0 else 0.0
    return camera.cu + scale * x, camera.cv + scale * y, across > 0.0 or z > 0.0


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    return math.nan, math.nan, math.nan, math.nan


@kernel
def _rays(u, v, camera, x, y, z):
    for i in range(u.size):
        p, q = u[i] - camera.cu, v[i] - camera.cv
        r = math.sqrt(p * p + q * q)
        theta = r / (BEND * camera.f)
        scale = math.sin(theta) / r if r > 0.0 else 1.0
        x[i], y[i], z[i] = scale * p, scale * q, math.cos(theta) if theta < 3.1 else math.nan


add_compiled_model(Numbers, CompiledModel(_project, _move, _rays))


class MyLens(CameraModel):
    title: ClassVar[str] = "lens of mine"
    kind: Literal["mine"] = "mine"

    def check(self, camera, lens, edge):
        pass

    def parameters(self, camera, lens):
        return Numbers(camera.focal_px, camera.cx_px, camera.cy_px)


MODELS["mine"] = MyLens
"""

PROGRAM = """
import hashlib
import my_lens
import harness
from harness.runs.worker import run_here

result = harness.run(
    "small.toml",
    sets={
        "sensor.model": {"kind": "mine"},
        "sensor.camera.focal_px": 40.0,
        "sensor.field": {"elevation_min_deg": 0, "elevation_max_deg": 90},
        "panorama.z_max": 2.0,
        "panorama.z_min": 0.1,
    },
    out="out",
    workers=1,
    progress=False,
)
trial = result.experiment.trial
pictures = b"".join(each.tobytes() for each in run_here(trial).images)
print(trial.key, hashlib.sha256(pictures).hexdigest())
"""


@pytest.mark.long
@pytest.mark.slow  # loops of a model from elsewhere are compiled in every process
def test_two_versions_share_nothing(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    write_small(tmp_path / "small.toml")
    root = str(Path(__file__).parent.parent)

    def run(bend: float) -> tuple[list[str], int]:
        """Key and pictures of the trial, and how many renders are kept."""
        (tmp_path / "my_lens.py").write_text(LENS.replace("BEND", str(bend)))
        done = subprocess.run(
            [sys.executable, "program.py"],
            cwd=tmp_path,
            env=environment(tmp_path) | {"PYTHONPATH": os.pathsep.join([str(tmp_path), root])},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()[-2:], len(list((tmp_path / "cache" / "renders").iterdir()))

    first, renders = run(1.0)
    assert renders == 2
    second, renders = run(1.25)
    assert renders == 4
    assert first[0] != second[0]
    assert first[1] != second[1]
    assert run(1.0) == (first, 4)  # found again


def test_a_changed_source_is_noticed_while_it_is_loaded(module) -> None:
    name = module(LENS.replace("BEND", "1.0"))
    try:
        loaded = importlib.import_module(name)
        trial = load_experiment("smoke").trial
        other = trial.model_copy(update={"sensor": Sensor(model=loaded.MyLens(), camera={"focal_px": 100.0})})
        key = other.key
        assert key != trial.model_copy(update={"sensor": other.sensor.model_copy(update={"model": Sensor().model})}).key
        assert other.key == key
        Path(loaded.__file__).write_text(LENS.replace("BEND", "1.5"))
        with pytest.raises(InputError, match="has been changed since it was loaded; start the session again"):
            other.key  # noqa: B018
    finally:
        MODELS.pop("mine", None)


def test_models_of_this_program_count_by_their_settings_alone() -> None:
    """So that their trials have the keys that they had."""
    assert all(model.identity(model.model_construct()) == "" for model in BUILT_IN.values())
    assert Sensor().model.identity() == ""


def test_what_was_typed_in_is_of_this_process_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = type("Typed", (), {"__module__": "__main__"})
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    assert len(identity_of(typed)) == 32
    assert identity_of(typed) == identity_of(typed)


def test_a_script_counts_with_what_lies_beside_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    typed = type("Scripted", (), {"__module__": "__main__"})
    (tmp_path / "script.py").write_text("import beside\n")
    (tmp_path / "beside.py").write_text("x = 1\n")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(tmp_path / "script.py"), raising=False)
    before = identity_of(typed)
    (tmp_path / "beside.py").write_text("x = 2\n")
    assert identity_of(typed) != before
