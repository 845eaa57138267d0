"""What the matchers promise, end to end on the paper's box: figures that the README states."""

import numpy as np
import pytest

from harness.evaluation.confidence import calibration, roc
from harness.pipeline.sample import confidence_map
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.runs.load import load_experiment


@pytest.fixture(scope="module")
def run():
    """Run the paper's trial with some settings; trials share what they can."""
    cache = StageCache()

    def with_settings(*sets):
        return run_trial(load_experiment("paper", [*sets, "scoring.sample_px=2", "seed=1"]).trial, cache)

    return with_settings


def errors_px(outcome):
    return np.abs(outcome.errors.disparity_px[outcome.reference.domain & outcome.valid])


def density(outcome):
    return outcome.valid[outcome.reference.domain].mean()


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["box", "corridor"])
def test_slanted_windows_without_noise(run, scene):
    result = run(f"scene={scene}", "matching.kind=slanted")
    assert density(result) >= 0.95
    assert np.median(errors_px(result)) <= 0.02
    assert np.mean(errors_px(result) > 1) <= 0.01
    assert np.median(np.abs(result.errors.range_m[result.reference.domain & result.valid])) <= 0.004


@pytest.mark.slow
def test_slanted_windows_come_near_the_bound_and_know_it(run):
    quiet = run("matching.kind=slanted")
    noisy = run("matching.kind=slanted", "noise.sigma_grey=10")
    assert density(noisy) >= 0.95
    assert np.mean(errors_px(noisy) > 3) <= 0.01
    # Over pixels instead of draws: what noise has moved each, against its own bound. 4,000 pixels of some 100
    # independent windows each know a spread to a tenth or so.
    moved = noisy.errors.disparity_px - quiet.errors.disparity_px
    ratio = moved / (10 * noisy.bound_px)
    ratio = ratio[noisy.reference.domain & np.isfinite(ratio) & (np.abs(moved) < 3)]
    assert ratio.size > 10_000
    assert 0.85 <= 1.4826 * np.median(np.abs(ratio)) <= 1.3
    error = np.where(noisy.reference.domain, noisy.errors.alpha_2, np.nan)
    assert calibration(error, noisy.matches.sigma_alpha_2).within[0] == pytest.approx(0.683, abs=0.03)


def test_semi_global_matching_finds_nearly_everything(run):
    result = run("matching.kind=sgm", "matching.subpixel=parabola")
    assert density(result) >= 0.99
    assert np.mean(errors_px(result) > 1) <= 0.01


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "sets",
    [
        ["matching.kind=column", "matching.subpixel=parabola"],  # sums of differences of the Laplacian of Gaussian
        ["matching.kind=column", "matching.cost=zncc", "matching.subpixel=parabola3", "filter.log_sigma_px=0"],
        ["matching.kind=column", "matching.cost=census", "matching.subpixel=v", "filter.log_sigma_px=0"],
        ["matching.kind=slanted"],
    ],
    ids=["LoG", "ZNCC", "census", "slanted"],
)
def test_another_exposure_of_the_second_camera_costs_little(run, sets):
    noise_set = "noise.sigma_grey=10"
    alike = np.median(errors_px(run(*sets, noise_set)))
    for change in (("exposure_2.gain=1.05", "exposure_2.offset_grey=-12.75"), ("exposure_2.gain=0.95",)):
        assert np.median(errors_px(run(*sets, noise_set, *change))) < 1.1 * alike


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0, 10])
def test_a_wall_without_texture_is_not_confident_nonsense(run, noise):
    """Hardly any of it gets an answer, and confidence tells what does, beside its borders, from what has texture."""
    blank = 'scene.objects.0.y_max={kind="grey", value=120}'
    result = run(blank, "matching.kind=slanted", f"noise.sigma_grey={noise}")
    domain, bare = result.reference.domain, result.truth.textureless
    assert (domain & bare).sum() > 10_000
    assert result.valid[domain & bare].mean() < 0.2
    assert result.valid[domain & ~bare].mean() > 0.95
    confidence = np.where(result.valid, confidence_map(result), np.nan)
    assert roc(confidence, bare, among=domain).auc > 0.95
