"""From the rows of a run to the test of the law."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from harness.evaluation.law import test_law
from harness.experiments.experiment import Planned, shown
from harness.stereo.matching.registry import method_of

_NOT_A_CONDITION = ("seed", "view_2.baseline_m", "matching.kind", "matching.subpixel")
"""What the law is tested across (baseline, seed), or a column of its own. All else that varies is a condition."""


def cell_table(done: Iterable[tuple[Planned, dict[str, Any]]]) -> pd.DataFrame:
    """The cells of all trials that are done, with the columns of their trials that `law_images` asks for.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them.
    """
    tables = []
    for planned, payload in done:
        trial = planned.trial
        matcher, subpixel = method_of(trial.matching)
        common = {
            "matcher": matcher,
            "subpixel": subpixel,
            "seed": trial.seed,
            "baseline_m": trial.view_2.baseline_m,
            "condition": shown({key: value for key, value in planned.place.items() if _is_condition(key)}),
        }
        tables += [common | cell for cell in payload["cells"]]
    return pd.DataFrame(tables)


def law_of(cells: pd.DataFrame) -> dict[str, Any] | None:
    """The `law` of `summary.json`; None where the trials do not differ in |t|/d enough to speak of it."""
    if cells.empty or cells["baseline_m"].nunique() < 3:
        return None
    return test_law(cells)


def _is_condition(key: str) -> bool:
    # The size of an object varies the range, which is what the law is about. The scale of a whole scene does not: with
    # its textures it gives the same image, so every scale keeps an intercept of its own and stretches no axis.
    is_size = key.startswith("scene.objects.") and key.endswith(".size_m")
    return key not in _NOT_A_CONDITION and not is_size
