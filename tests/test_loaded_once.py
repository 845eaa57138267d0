"""Matchers that are classes: made once a worker, and again when what they are made of has changed."""

from pathlib import Path

import numpy as np
import pytest
from plugin_modules import Write
from sweeps import omnirange, rows, write_small

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion
from harness.matching import plugins
from harness.matching.pair import Pair
from harness.matching.registry import Plugin

NETWORK = """
import os
from pathlib import Path
import numpy as np

class Network:
    def __init__(self, *, weights_file, share=1.0):
        self.weight = share * float(Path(weights_file).read_text())
        with Path("loads.txt").open("a") as stream:
            stream.write(f"{os.getpid()}\\n")

    def __call__(self, pair, limits):
        return pair.alpha_1 + self.weight * np.sin(pair.alpha_1)
"""


@pytest.fixture
def pair() -> Pair:
    sensor = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    image = np.zeros((120, 160), np.float32)
    return Pair(
        (image, image), (sensor, sensor), Motion(np.eye(3), np.array([0.3, 0, 0])), Grid(width_px=60, height_px=16)
    )


def loads(folder: Path) -> list[str]:
    return (folder / "loads.txt").read_text().split()


@pytest.mark.slow
def test_a_network_is_loaded_once_a_worker(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(NETWORK)
    (tmp_path / "weights.txt").write_text("0.05")
    rest = (
        '[trial.matching]\nkind = "mine:Network"\nparameters.weights_file = "weights.txt"\n'
        "[axes]\nseed = [1, 2, 3, 4, 5, 6]\n"
    )
    write_small(tmp_path / "small.toml", rest)
    done = omnirange(tmp_path, "run", "small.toml", "--out", "out", "--no-report", "--workers", 2)
    assert done.returncode == 0, done.stderr
    assert len(rows(tmp_path / "out")) == 6
    assert len(loads(tmp_path)) == len(set(loads(tmp_path))) <= 2


def test_what_it_was_made_of_decides(module: Write, pair: Pair, tmp_path: Path) -> None:
    weights = tmp_path / "weights.txt"
    weights.write_text("0.05")
    kind = f"{module(NETWORK)}:Network"

    def answer(share: float = 1.0) -> float:
        matcher = Plugin(kind=kind, parameters={"weights_file": str(weights), "share": share})
        matches = matcher.match(pair)
        return float(np.nanmax((matches.alpha_2 - pair.alpha_1) / np.sin(pair.alpha_1)))

    assert [answer(), answer(), answer()] == pytest.approx([0.05] * 3)
    assert len(loads(tmp_path)) == 1
    assert [answer(2.0), answer(), answer(2.0)] == pytest.approx([0.1, 0.05, 0.1])
    assert len(loads(tmp_path)) == 2  # both are kept
    weights.write_text("0.07")
    assert answer() == pytest.approx(0.07)
    assert len(loads(tmp_path)) == 3
    for share in range(plugins.MOST_LOADED):
        answer(0.1 + share / 10)
    before = len(loads(tmp_path))
    assert answer(0.1) == pytest.approx(0.007)
    assert len(loads(tmp_path)) == before
    answer()  # the oldest one was dropped
    assert len(loads(tmp_path)) == before + 1


CALL = "    def __call__(self, pair, limits):\n        {}\n"
MADE = "class f:\n    def __init__(self{}):\n        {}\n" + CALL.format("pass")


@pytest.mark.parametrize(
    ("source", "parameters", "said"),
    [
        ("class f:\n    pass\n", {}, "f must have a method __call__(self, pair, limits)"),
        (
            "class f:\n    def __call__(self, pair):\n        pass\n",
            {},
            "must have a method __call__(self, pair, limits)",
        ),
        (MADE.format(", depth", "pass"), {}, "needs the parameter 'depth'"),
        ("class f:\n" + CALL.format("pass"), {"depth": 3}, "takes no parameter 'depth'"),
        (MADE.format("", "raise OSError('no weights')"), {}, "fails: OSError: no weights ("),
        ("class f:\n" + CALL.format("return 1 / 0"), {}, ".py, line 3)"),
    ],
)
def test_classes_that_do_not_serve(source: str, parameters: dict, said: str, module: Write, pair: Pair) -> None:
    name = module(source)
    with pytest.raises(InputError) as caught:
        Plugin(kind=f"{name}:f", parameters=parameters).match(pair)
    assert said in str(caught.value)
