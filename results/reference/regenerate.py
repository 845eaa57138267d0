"""Write the reference numbers anew: `python results/reference/regenerate.py`, or with the names of some of them.

`paper.json` holds the paper's claims, and its experiment in each of the shipped scenes, `matchers.json` the ladder of
matchers on all scenes and how near they come to the bound, `budget.json` what each cause makes of the range's errors,
`cameras.json` what three cameras make of the range, `law.json` the test of the sensitivity law over all trials of
`experiments/law.toml`, `law_best.json` the same with the best matcher, `localise.json` how many real images the views
made of pairs are worth, and all of them what made the numbers.
Tests compare with them (see `tests/test_reference.py`); a change of these numbers belongs into the same commit as the
change that caused it.

The runs are kept in `results/findings/`: after Ctrl-C the same command goes on. At the end it says which numbers are
not what they were. `--quick` tries all of it with few small trials, and writes no reference.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from harness.api.progress import duration
from harness.api.running import run
from harness.errors import InputError
from harness.evaluation.statistics import mean_over_seeds
from harness.machine import available_cpus
from harness.pipeline.environment import environment
from harness.runs.cases import CASE
from harness.runs.experiment import Experiment
from harness.runs.load import load_experiment
from harness.runs.plan import plan
from harness.runs.run import Result, run_experiment

HERE = Path(__file__).parent
RUNS = HERE.parent / "findings"
Results = Mapping[str, Result]
"""The results of the experiments that a file is made of."""


def paper(results: Results) -> dict[str, Any]:
    """The paper's claims in its box, and the comparison of whole pixels and sub-pixel in every scene, as in
    `summary.json`.
    """
    wanted = ("comparison", "comparison_wall")
    scenes = {scene: {name: result.summary[name] for name in wanted} for scene, result in results.items()}
    return {"scenes": scenes, "claims": results["box"].summary["claims"]}


def matchers(results: Results) -> dict[str, Any]:
    """The main figures of every trial of the ladder, and the `limit` of `summary.json`: of the box, and of slanted
    windows in the other scenes.
    """
    wanted = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "ause_px", "within_1_sigma")
    ladder = [
        without_case(row.coordinates) | {name: row.payload["figures"].get(name) for name in wanted}
        for row in results["matchers"].rows
    ]
    for each in ladder:
        each["scene"] = Path(each["scene"]).stem
    elsewhere = {scene: results[scene].summary["limit"] for scene in _OTHER_SCENES}
    return {"ladder": ladder, "limit": results["limit"].summary["limit"], "limit_elsewhere": elsewhere}


def without_case(coordinates: dict[str, Any]) -> dict[str, Any]:
    """The values of keys alone: what a case is called is no part of a reference."""
    return {key: value for key, value in coordinates.items() if key != CASE}


def cameras(results: Results) -> dict[str, Any]:
    """Range errors of every camera, and as ratios to the mirror's at the same seed; 95 % intervals over seeds."""
    result = results["cameras"]
    table = pd.DataFrame([row.coordinates | row.payload["figures"] for row in result.rows])
    table["scene"] = [Path(each).stem for each in table["scene"]]
    rows = []
    for (scene, matcher), part in table.groupby(["scene", "matching.kind"], sort=False):
        density = part.groupby("sensor")["density"].mean()
        for surface, prefix in (("all", ""), ("wall", "wall_"), ("floor", "floor_")):
            errors = part.pivot_table(f"{prefix}range_median_abs_m", index="seed", columns="sensor")
            ratios = errors.div(errors["mirror"], axis=0)
            absolute, relative = (mean_over_seeds(each, logarithmic=True) for each in (errors, ratios))
            rows += [
                {
                    "scene": scene,
                    "matcher": matcher,
                    "surface": surface,
                    "sensor": sensor,
                    "seeds": len(errors),
                    "range_median_abs_m": float(absolute.mean[i]),
                    "range_median_abs_m_ci95": [float(absolute.low[i]), float(absolute.high[i])],
                    "ratio_to_mirror": float(relative.mean[i]),
                    "ratio_to_mirror_ci95": [float(relative.low[i]), float(relative.high[i])],
                    "density": float(density[sensor]),
                }
                for i, sensor in enumerate(absolute.x)
            ]
    return {"cameras": rows}


def parts(*names: str) -> Callable[[Results], dict[str, Any]]:
    """A function that takes parts of the summary of a file's only experiment."""

    def take(results: Results) -> dict[str, Any]:
        (result,) = results.values()
        return {name: result.summary[name] for name in names}

    return take


class File(NamedTuple):
    """A file of reference numbers."""

    made_of: dict[str, tuple[str, dict[str, Any]]]
    """Experiments, each with the changes to it, by what the function calls them."""
    numbers: Callable[[Results], dict[str, Any]]


def _of(name: str, numbers: Callable[[Results], dict[str, Any]]) -> File:
    return File({name: (name, {})}, numbers)


_ONE = {"axes": {"seed": [1]}}
_OTHER_SCENES = ("corridor", "room")
FILES = {
    "paper": File(
        {"box": ("paper", {})} | {each: ("paper", _ONE | {"sets": {"scene": each}}) for each in _OTHER_SCENES},
        paper,
    ),
    "matchers": File(
        {"matchers": ("matchers", {}), "limit": ("limit", {})}
        | {each: ("limit", {"sets": {"scene": each}, "axes": {"noise.sigma_grey": [10.0]}}) for each in _OTHER_SCENES},
        matchers,
    ),
    "budget": _of("budget", parts("trials", "budget")),
    "cameras": _of("cameras", cameras),
    "law": _of("law", parts("trials", "law")),
    "law_best": _of("law_best", parts("trials", "law")),
    "localise": _of("localise", parts("trials", "localisation")),
}
"""In the order in which they are made."""
_QUICK = {
    "sets": {"panorama.width_px": 180, "panorama.height_px": 50, "render.samples": 1},
    "axes": {"seed": [1, 2]},
}
"""Changes that make any experiment short."""
_KINDS = ("sets", "axes")
_SMALL = {
    "sensor.camera.width_px": 320,
    "sensor.camera.height_px": 240,
    "sensor.camera.focal_px": 307.06,
    "sensor.camera.cx_px": 159.5,
    "sensor.camera.cy_px": 119.5,
}
_QUICK_MORE: dict[str, dict[str, Any]] = {
    "matchers": {"sets": _SMALL},
    "limit": {"sets": _SMALL, "axes": {"seed": [1, 2, 3]}},
    "budget": {"sets": _SMALL},
    "law_best": {"sets": _SMALL, "axes": {"view_2.baseline_m": [0.25, 0.5, 1.0], "noise.sigma_grey": [8.0]}},
    "localise": {"sets": {"localisation.images": [2], "localisation.queries": 4}},
}


def experiments_of(file: File, *, quick: bool) -> dict[str, Experiment]:
    """The experiments that a file is made of."""
    loaded = {}
    for called, (name, changes) in file.made_of.items():
        more = [changes, _QUICK, _QUICK_MORE.get(name, {})] if quick else [changes]
        sets, axes = ({key: value for each in more for key, value in each.get(kind, {}).items()} for kind in _KINDS)
        loaded[called] = load_experiment(name, sets=sets, axes=axes)
    return loaded


def run_all(experiments: dict[str, Experiment], folder: Path) -> dict[str, Result]:
    """The results of experiments, whose runs are in a folder each; what is done already is not run again."""
    results = {}
    for called, experiment in experiments.items():
        where = folder / called
        where.mkdir(parents=True, exist_ok=True)
        run(experiment, out=where, progress=True)
        results[called] = run_experiment(experiment, where)
    return results


def flat(value: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """The numbers and words of nested tables, by dotted keys."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, each in items:
            yield from flat(each, f"{above}.{key}" if above else str(key))
    else:
        yield above, value


def differences(before: dict[str, Any], after: dict[str, Any], least: float = 1e-6) -> list[str]:
    """A line for each value that is not what it was, the largest change first; what made them is left out."""
    old, new = (dict(flat({key: each for key, each in table.items() if key != "made_by"})) for table in (before, after))
    changed: list[tuple[float, str]] = []
    for key in {**old, **new}:
        one, other = old.get(key, "absent"), new.get(key, "absent")
        if one == other:
            continue
        size = math.inf
        if all(isinstance(each, int | float) and not isinstance(each, bool) for each in (one, other)):
            size = abs(other - one) / max(abs(one), abs(other))
        if size > least:
            said = [f"{each:.4g}" if isinstance(each, float) else str(each) for each in (one, other)]
            changed.append((size, f"{key}: {said[0]} -> {said[1]}"))
    return [line for _, line in sorted(changed, key=lambda each: (-each[0], each[1]))]


def write(name: str, numbers: dict[str, Any], folder: Path) -> list[str]:
    """Write a file, and return what is not as it was in `HERE`, in lines."""
    made_by = environment()
    for passing in ("finished", "platform"):  # of the day and the machine; neither changes a number
        made_by.pop(passing, None)
    table = json.loads(json.dumps({"experiment": name, **numbers, "made_by": made_by}))
    before = HERE / f"{name}.json"
    known = json.loads(before.read_text(encoding="utf-8")) if before.is_file() else {}
    (folder / f"{name}.json").write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    return differences(known, table)


def main() -> int:
    """Run the experiments of the files named on the command line, or of all, and write them."""
    parser = argparse.ArgumentParser(description="Measure the reference numbers anew.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(FILES)}; default: all")
    parser.add_argument("--quick", action="store_true", help="few small trials, written into results/findings/quick")
    options = parser.parse_args()
    unknown = set(options.names) - set(FILES)
    if unknown:
        parser.error(f"no such file: {', '.join(sorted(unknown))}; there are {', '.join(FILES)}")
    names = options.names or list(FILES)
    folder = RUNS / "quick" if options.quick else RUNS
    folder.mkdir(parents=True, exist_ok=True)
    experiments = {name: experiments_of(FILES[name], quick=options.quick) for name in names}
    seconds = {
        name: sum(plan(each.planned).total_s for each in of_file.values()) / available_cpus()
        for name, of_file in experiments.items()
    }
    changed: dict[str, list[str]] = {}
    for number, name in enumerate(names):
        left = sum(seconds[each] for each in names[number:])
        about = duration(float(f"{left:.2g}"))
        print(f"{name}.json, {number + 1} of {len(names)}; it and those after it take about {about} in all", flush=True)
        numbers = FILES[name].numbers(run_all(experiments[name], folder / name))
        changed[name] = write(name, numbers, folder if options.quick else HERE)
    print()
    for name, lines in changed.items():
        print(f"{name}.json: {f'{len(lines)} values are not what they were' if lines else 'as before'}")
        for line in lines[:_MOST_SHOWN]:
            print(f"  {line}")
        if len(lines) > _MOST_SHOWN:
            print(f"  and {len(lines) - _MOST_SHOWN} more")
    return 0


_MOST_SHOWN = 5
"""Changes of a file that are printed, the largest ones."""


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("\nstopped; what is done is kept: the same command goes on", file=sys.stderr)
        sys.exit(130)
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
