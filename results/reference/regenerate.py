"""Write the reference numbers anew: `python results/reference/regenerate.py`.

`paper.json` holds the paper's experiment in each of the shipped scenes, and what made the numbers. Tests compare with
it (see `tests/test_reference.py`); a change of these numbers belongs into the same commit as the change that caused it.
"""

import json
from pathlib import Path

from harness.experiments.environment import environment
from harness.experiments.experiment import load_experiment
from harness.experiments.run import run_experiment

HERE = Path(__file__).parent
SCENES = ("box", "corridor", "room")


def numbers(scene: str) -> dict[str, dict[str, dict[str, float | None]]]:
    """The comparison of pixel level and sub-pixel in a scene, as in `summary.json`."""
    summary = run_experiment(load_experiment("paper", sets=[f"scene={scene}"])).summary
    return {name: summary[name] for name in ("comparison", "comparison_wall")}


def main() -> None:
    """Run the experiments and write the file."""
    made_by = environment()
    made_by.pop("finished", None)
    table = {"experiment": "paper", "scenes": {scene: numbers(scene) for scene in SCENES}, "made_by": made_by}
    path = HERE / "paper.json"
    path.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
