"""Write the reference numbers anew: `python results/reference/regenerate.py`, or with `paper` or `law` for one of them.

`paper.json` holds the paper's experiment in each of the shipped scenes, `law.json` the test of the sensitivity law over
all trials of `experiments/law.toml` (some minutes), and both what made the numbers. Tests compare with them (see
`tests/test_reference.py`); a change of these numbers belongs into the same commit as the change that caused it.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from harness.experiments.environment import environment
from harness.experiments.experiment import load_experiment
from harness.experiments.run import run_experiment

HERE = Path(__file__).parent
SCENES = ("box", "corridor", "room")


def paper() -> dict[str, Any]:
    """The comparison of pixel level and sub-pixel in every scene, as in `summary.json`."""
    summaries = {scene: run_experiment(load_experiment("paper", sets=[f"scene={scene}"])).summary for scene in SCENES}
    wanted = ("comparison", "comparison_wall")
    return {"scenes": {scene: {name: summary[name] for name in wanted} for scene, summary in summaries.items()}}


def law() -> dict[str, Any]:
    """The number of trials and the test of the law, as in `summary.json`."""
    with tempfile.TemporaryDirectory() as folder:
        summary = run_experiment(load_experiment("law"), Path(folder)).summary
    return {name: summary[name] for name in ("trials", "law")}


def main() -> None:
    """Run the experiments named on the command line, or all, and write their files."""
    known = {"paper": paper, "law": law}
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
