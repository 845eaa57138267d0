"""What follows from the rows of all trials, without the pixels of any: cells, and most of `summary.json`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from harness.runs.analysis import best_baseline_of, cell_table, law_of, limit_of
from harness.runs.budgets import budget_of
from harness.runs.case_figures import figures_of_cases
from harness.runs.claims import claims_of
from harness.runs.conclusions import conclusions
from harness.runs.experiment import Experiment
from harness.runs.further_scores import FURTHER
from harness.runs.headline import Findings, headline

if TYPE_CHECKING:
    from harness.runs.run import Row


@dataclass(frozen=True)
class AllTrials:
    """What all trials of a run say together."""

    cells: pd.DataFrame
    """The cells of all trials that are done, see `analysis.cell_table`."""
    entries: dict[str, Any]
    """Entries of the summary, in its order; what there is nothing to say about is empty or None."""


def all_trials_of(experiment: Experiment, rows: "Sequence[Row]") -> AllTrials:
    """What the trials that are done say together."""
    done = [row for row in rows if row.state == "done"]
    trials = [(row.planned, row.payload) for row in done]
    cells = cell_table(trials)
    law = law_of(cells) if experiment.law else None
    best_baseline = best_baseline_of(cells, law)
    claims, names = claims_of(trials), experiment.names_of_methods
    by_cases = bool(experiment.method_labels)
    further = {each.name: each.entries_of(trials) for each in FURTHER}
    by_score = [each.conclusions(further[each.name], names) for each in FURTHER]
    by_score.reverse()  # what is made of others comes first, as maps are made of range profiles
    sentences = [sentence for each in by_score for sentence in each]
    first = next(filter(None, by_score), [])
    limit, budget = limit_of(trials), budget_of(trials)
    found = Findings(law, best_baseline, limit, budget, first)
    opens_with = None if claims else headline(done, found, names, named_by_cases=by_cases)
    said = conclusions(done, names, sentences, named_by_cases=by_cases)
    entries = {
        "claims": claims,
        "limit": limit,
        "budget": budget,
        "budget_by_direction": budget_of(trials, "alpha_bin"),
        "labels": None,  # of methods that are shown in detail: to be filled in
        "cases": figures_of_cases(experiment, trials),
        "law": law,
        "best_baseline": best_baseline,
        **further,
        "headline": opens_with,
        "conclusions": [] if claims else [each for each in said if each != opens_with],
    }
    return AllTrials(cells, entries)
