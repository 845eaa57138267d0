"""Run all trials of an experiment and write what came out into a folder."""

import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import harness
from harness.evaluation.metrics import Measures, measure
from harness.experiments.files import make_folder, write
from harness.experiments.spec import Experiment
from harness.experiments.trial import Kept, Outcome, run_trial
from harness.simulation.fingerprint import fingerprint
from harness.spec import dump_toml

SCHEMA = 1
METHODS = {"none": "pixel", "parabola": "subpixel"}
"""What `summary.json` and the report call the sub-pixel settings."""


@dataclass(frozen=True)
class Result:
    """A finished experiment."""

    experiment: Experiment
    places: list[dict[str, Any]]
    """Where each trial lies on the axes."""
    outcomes: list[Outcome]
    summary: dict[str, Any]
    environment: dict[str, Any]


Observer = Callable[[int, int, str], None]
"""Called with the number of trials done, of all trials, and the name of the stage that begins."""


def run_experiment(experiment: Experiment, observe: Observer = lambda done, total, stage: None) -> Result:
    """Run every trial; what they share is computed once.

    Raises
    ------
    InputError
        When a trial's settings cannot be carried out.
    """
    expanded = experiment.trials()
    kept = Kept()
    outcomes = []
    for done, (_, trial) in enumerate(expanded):
        outcomes.append(run_trial(trial, kept, lambda stage, done=done: observe(done, len(expanded), stage)))
    places = [place for place, _ in expanded]
    return Result(experiment, places, outcomes, _summary(experiment, outcomes), _environment(experiment))


def write_result(result: Result, folder: Path) -> None:
    """Write `experiment.toml`, `environment.json`, `trials.csv`, `timings.csv` and `summary.json`.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    make_folder(folder)
    write(folder / "experiment.toml", dump_toml(result.experiment))
    write(folder / "environment.json", _json(result.environment))
    write(folder / "trials.csv", _csv(_rows(result)))
    write(folder / "timings.csv", _csv(_timings(result)))
    write(folder / "summary.json", _json(result.summary))


def compare(outcomes: dict[str, Outcome], *, wall_only: bool) -> dict[str, Measures]:
    """Figures of several methods on the same pixels: those for which all of them have an estimate."""
    anyone = next(iter(outcomes.values()))
    domain = anyone.reference.domain & anyone.reference.wall if wall_only else anyone.reference.domain
    valid = np.logical_and.reduce([outcome.valid for outcome in outcomes.values()])
    return {name: measure(domain, valid, outcome.errors) for name, outcome in outcomes.items()}


def by_method(outcomes: list[Outcome]) -> dict[str, Outcome]:
    """The first outcome of each sub-pixel method, by the name that people read."""
    named: dict[str, Outcome] = {}
    for outcome in outcomes:
        named.setdefault(METHODS[outcome.trial.matching.subpixel], outcome)
    return named


def _summary(experiment: Experiment, outcomes: list[Outcome]) -> dict[str, Any]:
    named = by_method(outcomes)
    return {
        "schema": SCHEMA,
        "experiment": experiment.name,
        "comparison": compare(named, wall_only=False),
        "comparison_wall": compare(named, wall_only=True),
    }


def _rows(result: Result) -> Iterator[dict[str, Any]]:
    for place, outcome in zip(result.places, result.outcomes, strict=True):
        domain, wall = outcome.reference.domain, outcome.reference.wall
        yield {
            "trial": outcome.trial.key,
            **place,
            **outcome.measures(domain),
            **{f"wall_{name}": value for name, value in outcome.measures(domain & wall).items()},
        }


def _timings(result: Result) -> Iterator[dict[str, Any]]:
    for outcome in result.outcomes:
        yield {"trial": outcome.trial.key, **{f"{stage}_s": value for stage, value in outcome.seconds.items()}}


def _csv(rows: Iterator[dict[str, Any]]) -> str:
    return str(pd.DataFrame(list(rows)).to_csv(index=False))


def _json(value: Any) -> str:
    return json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _environment(experiment: Experiment) -> dict[str, Any]:
    """What the numbers may depend on besides the experiment's own settings."""
    packages = ("numpy", "scipy", "numba", "embreex", "trimesh", "scikit-image", "pydantic", "pillow", "matplotlib")
    return {
        "omnirange": harness.__version__,
        "source_sha256": source_hash(),
        "scene_sha256": fingerprint(experiment.trial.scene),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": _cpu_model(),
        "cpus": len(os.sched_getaffinity(0)),
        "packages": {name: metadata.version(name) for name in packages},
    }


def source_hash() -> str:
    """SHA-256 over the program's own source files, names and contents, in alphabetical order."""
    root = Path(harness.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
