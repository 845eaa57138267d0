"""What is told of pixels that view 2 does not see: by hand, and on the room."""

import numpy as np
import pytest

from harness.evaluation.occlusion_scores import occlusion_scores
from harness.evaluation.regions import OCCLUDED, VISIBLE, Region
from harness.matching.interface import Reason
from harness.matching.slanted.back import farthest_beside
from harness.pipeline.row import row_of
from harness.pipeline.trial import run_trial
from harness.runs.load import load_experiment


def regions(visible=(0, 1, 2, 3), hidden=(4, 5)):
    parts = {VISIBLE: visible, OCCLUDED: hidden, "another": (0, 4)}
    return [Region("visibility", part, np.array(pixels, np.intp)) for part, pixels in parts.items() if pixels]


def said(*pixels):
    mask = np.zeros((2, 4), bool)
    mask.ravel()[list(pixels)] = True
    return mask


def test_precision_and_recall_by_hand():
    # Of three said to be hidden one is, and one (7) lies where nothing is counted; of two hidden one is found.
    assert occlusion_scores(regions(), said(0, 4, 7)) == {"occlusion_precision": 0.5, "occlusion_recall": 0.5}
    assert occlusion_scores(regions(), said(4, 5)) == {"occlusion_precision": 1.0, "occlusion_recall": 1.0}


def test_a_matcher_that_does_not_tell_has_no_scores():
    assert occlusion_scores(regions(), said()) == {}


def test_without_hidden_pixels_there_is_no_recall():
    assert occlusion_scores(regions(hidden=()), said(1)) == {"occlusion_precision": 0.0}


def test_the_farthest_of_what_lies_beside():
    draws = np.random.default_rng(2)
    w = np.where(draws.random((12, 15)) < 0.2, draws.random((12, 15)), np.nan)
    result = farthest_beside(w)
    for i, j in np.ndindex(w.shape):
        row, around = w[i], np.roll(w[i], -j)  # the row from here on, going round
        sides = [around, np.roll(row, -j - 1)[::-1], w[i:, j], w[: i + 1, j][::-1]]
        nearest = [side[np.isfinite(side)][:1] for side in sides]
        expected = np.concatenate(nearest).min(initial=np.inf)
        assert result[i, j] == (expected if np.isfinite(expected) else pytest.approx(np.nan, nan_ok=True))


@pytest.mark.slow
@pytest.mark.long
def test_slanted_windows_tell_most_of_what_the_pillars_of_the_room_hide():
    outcome = run_trial(load_experiment("paper", sets=["scene=room", "matching.kind=slanted"]).trial)
    figures = row_of(outcome)["figures"]
    # The pillars hide strips of up to thirty columns, of which the borders are a few.
    assert figures["occlusion_recall"] > 0.7
    # Among all that has no match four in ten are hidden.
    missing = ~outcome.valid & outcome.reference.sideways & np.isfinite(outcome.truth.range_m)
    missing &= outcome.truth.in_field_2
    assert figures["occlusion_precision"] > np.mean(~outcome.truth.unoccluded[missing]) + 0.05
    assert not np.isfinite(outcome.matches.alpha_2[outcome.reason == Reason.OCCLUDED]).any()
