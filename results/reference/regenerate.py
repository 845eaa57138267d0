"""Write the reference numbers anew: `python results/reference/regenerate.py`, or with the names of some of them.

`paper.json` holds the paper's claims, and its experiment in each of the shipped scenes, `law.json` the test of the
sensitivity law over all trials of `experiments/law.toml`, `law_best.json` the same with the best matcher,
`matchers.json` the ladder of matchers on all scenes and how near they come to the bound, `budget.json` what each
cause makes of the range's errors, `cameras.json` what three cameras make of the range, `localise.json` how many real
images the views made of pairs are worth (some minutes each), and all of them what made the numbers.
Tests compare with them (see `tests/test_reference.py`); a change of these numbers belongs into the same commit as the
change that caused it.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd

from harness.evaluation.statistics import mean_over_seeds
from harness.pipeline.environment import environment
from harness.runs.cases import CASE
from harness.runs.load import load_experiment
from harness.runs.run import run_experiment

HERE = Path(__file__).parent
SCENES = ("box", "corridor", "room")


def paper() -> dict[str, Any]:
    """The paper's claims in its box, and the comparison of whole pixels and sub-pixel in every scene, as in
    `summary.json`.
    """
    box = run_experiment(load_experiment("paper")).summary
    others = {
        scene: run_experiment(load_experiment("paper", sets=[f"scene={scene}"], axes={"seed": [1]})).summary
        for scene in SCENES
        if scene != "box"
    }
    wanted = ("comparison", "comparison_wall")
    scenes = {scene: {name: summary[name] for name in wanted} for scene, summary in ({"box": box} | others).items()}
    return {"scenes": scenes, "claims": box["claims"]}


def law(name: str = "law") -> dict[str, Any]:
    """The number of trials and the test of the law, as in `summary.json`."""
    with tempfile.TemporaryDirectory() as folder:
        summary = run_experiment(load_experiment(name), Path(folder)).summary
    return {name: summary[name] for name in ("trials", "law")}


def matchers() -> dict[str, Any]:
    """The main figures of every trial of the ladder, and the `limit` of `summary.json`."""
    result = run_experiment(load_experiment("matchers"))
    wanted = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "ause_px", "within_1_sigma")
    ladder = [
        without_case(row.coordinates) | {name: row.payload["figures"].get(name) for name in wanted}
        for row in result.rows
    ]
    for each in ladder:
        each["scene"] = Path(each["scene"]).stem
    with tempfile.TemporaryDirectory() as folder:
        limit = run_experiment(load_experiment("limit"), Path(folder)).summary["limit"]
    return {"ladder": ladder, "limit": limit}


def without_case(coordinates: dict[str, Any]) -> dict[str, Any]:
    """The values of keys alone: what a case is called is no part of a reference."""
    return {key: value for key, value in coordinates.items() if key != CASE}


def cameras(folder: Path | None = None) -> dict[str, Any]:
    """Range errors of every camera, and as ratios to the mirror's at the same seed; 95 % intervals over seeds.

    Parameters
    ----------
    folder
        Of a run to go on with; a temporary one when None.
    """
    with tempfile.TemporaryDirectory() as temporary:
        result = run_experiment(load_experiment("cameras"), folder or Path(temporary))
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


def budget() -> dict[str, Any]:
    """Errors by cause, predicted and measured, as in `summary.json`."""
    with tempfile.TemporaryDirectory() as folder:
        summary = run_experiment(load_experiment("budget"), Path(folder)).summary
    return {name: summary[name] for name in ("trials", "budget")}


def localise() -> dict[str, Any]:
    """Localisation errors against the number of real images, as in `summary.json`."""
    with tempfile.TemporaryDirectory() as folder:
        summary = run_experiment(load_experiment("localise"), Path(folder)).summary
    return {name: summary[name] for name in ("trials", "localisation")}


def main() -> None:
    """Run the experiments named on the command line, or all, and write their files."""
    known = {
        "paper": paper,
        "law": law,
        "law_best": lambda: law("law_best"),
        "matchers": matchers,
        "budget": budget,
        "cameras": cameras,
        "localise": localise,
    }
    for name in sys.argv[1:] or known:
        numbers = known[name]()
        made_by = environment()
        for passing in ("finished", "platform"):  # of the day and the machine; neither changes a number
            made_by.pop(passing, None)
        path = HERE / f"{name}.json"
        path.write_text(
            json.dumps({"experiment": name, **numbers, "made_by": made_by}, indent=2) + "\n", encoding="utf-8"
        )
        print(path)


if __name__ == "__main__":
    main()
