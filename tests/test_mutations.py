"""Whatever a file holds, the answer is a plan or one line that names the file or the key; never a traceback."""

import os
import random
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutations import mutated
from PIL import Image
from sweeps import write_small

from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.io.calibrations.sensors import load_sensor
from harness.matching.registry import BUILT_IN
from harness.runs.load import load_experiment, load_matcher
from harness.simulation.scene import load_scene
from harness.spec import dump_toml

NOISE = {"kind": "noise", "seed": 1, "tile_m": 6.0, "shortest_m": 0.1, "longest_m": 1.0, "size_px": 128}
SCENE: dict[str, Any] = {
    "name": "s",
    "closed": True,
    "scale": 1.0,
    "objects": [
        {
            "kind": "box",
            "inward": True,
            "size_m": [6.0, 6.0, 6.0],
            "position_m": [0.0, 0.0, 0.0],
            "texture": {"kind": "bundled", "name": "gravel", "tile_m": 6.0},
            "x_max": NOISE,
        },
        {"kind": "plane", "size_m": [1.0, 1.0], "pitch_deg": 90.0, "texture": {"kind": "grey", "value": 9.0}},
        {"kind": "mesh", "file": "m.obj", "texture": {"kind": "image", "file": "i.png", "tile_m": 0.5}},
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the files name, and what no file should be."""
    folder = tmp_path_factory.mktemp("mutations")
    Image.new("L", (8, 8), 90).save(folder / "i.png")
    (folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    (folder / "folder.toml").mkdir()
    (folder / "loop.toml").symlink_to("loop.toml")
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
    return folder


def answered(path: Path, read: Any) -> bool:
    """Whether the file was taken; a refusal is one line with its name or a key."""
    refusal = None
    try:
        read(path)
    except InputError as error:
        refusal = error
    if refusal is not None:
        assert refusal.file or refusal.key, str(refusal)
        assert "\n" not in str(refusal)
        assert len(str(refusal)) < 2000
    return refusal is None


def _planned(path: Path) -> None:
    for each in load_experiment(str(path)).planned[:3]:
        _ = each.trial.poses


SPECIFICATIONS = {
    "experiment": _planned,
    "scene": lambda path: load_scene(str(path)),
    "sensor": load_sensor,
    **{kind: lambda path: load_matcher(str(path)).identity() for kind in (*BUILT_IN, "mutated:match")},
}


def _valid(what: str, folder: Path) -> dict[str, Any]:
    if what == "experiment":
        table = tomllib.loads(dump_toml(load_experiment(str(write_small(folder / "base.toml")))))
        return {**table, "axes": {"seed": [1, 2]}}
    if what == "scene":
        return SCENE
    if what == "sensor":
        return tomllib.loads(dump_toml(Sensor()))
    settings = {"kind": what, "d_min_m": 1.0, "d_max_m": 10.0}
    if what in BUILT_IN:
        fields = BUILT_IN[what].model_fields
        settings |= {name: each.default for name, each in fields.items() if isinstance(each.default, str | int | float)}
    if what == "program":
        settings |= {"command": ["python3", "{input}", "{output}"]}
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
    return {"matching": {**plain, "kind": what}}


def check_some(what: str, folder: Path, seed: int) -> bool:
    path = folder / f"{what.replace(':', '-')}.toml"
    try:
        path.write_bytes(mutated(_valid(what, folder), random.Random(seed)))
    except (TypeError, ValueError, AttributeError, KeyError):  # nothing that TOML can write
        return True
    return answered(path, SPECIFICATIONS[what])


@pytest.mark.slow
@pytest.mark.parametrize("what", ["experiment", "scene", "sensor", "window", "slanted", "program", "mutated:match"])
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32))
def test_mutated_files(what: str, folder: Path, seed: int) -> None:
    (folder / "mutated.py").write_text("def match(pair, limits, **parameters): ...\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        check_some(what, folder, seed)


@pytest.mark.parametrize("what", ["experiment", "scene", "sensor", "window", "program"])
def test_the_valid_file_is_taken(what: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    path = folder / "valid.toml"
    path.write_text(tomli_w.dumps(_valid(what, folder)))
    assert answered(path, SPECIFICATIONS[what])


def test_long_words_are_cut(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.write_text(tomli_w.dumps(_valid("mutated:match", folder)).replace("mutated:match", "x" * 5000))
    with pytest.raises(InputError, match=r"matching\.kind: 'x{59} \.\.\. x+' is neither a matcher nor") as caught:
        load_matcher(str(path))
    assert len(str(caught.value)) < 800


ARGUMENTS = [
    "", "nan", "inf", "-1", "0", "[", "]", "{", "[[[[", "'", '"', "\\", "1,2", ",,,", "[1,2]", "{a=1}", "2020-01-01",
    "x" * 9000, "[" * 3000, "/dev/zero", "pipe", "loop.toml", "~nobody-here/x", "folder.toml", "../..", "a=b", "1 # c",
    "1\nseed=5", "1]\nx=[2", "window,column", "os:getcwd", "1e999", "0x10", "1_000", "+5", "1e5,nan", "\ud800", "a\0b",
]  # fmt: skip
ARGUMENT_KEYS = [
    "seed", "scene", "sensor", "matching", "matching.kind", "view_2.baseline_m", "scene.objects.0.texture.kind", "x.y",
    "matching.command", "matching.parameters", "panorama", "noise.sigma_grey", "", "a", "=", "é",
]  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_mutated_arguments(folder: Path, data: st.DataObject) -> None:
    path = write_small(folder / "small.toml")
    written = st.tuples(st.sampled_from(ARGUMENT_KEYS), st.sampled_from(ARGUMENTS)).map("=".join) | st.sampled_from(
        ARGUMENTS
    )
    sets, axes = data.draw(st.lists(written, max_size=2)), data.draw(st.lists(written, max_size=2))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        answered(path, lambda path: load_experiment(str(path), sets, axes).planned)
