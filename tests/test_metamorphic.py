"""What must not change, or change exactly so, when the whole world does."""

import numpy as np
import pytest

from harness.pipeline.row import row_of
from harness.pipeline.specification import Trial
from harness.pipeline.trial import run_trial
from harness.runs.dotted import changed
from harness.spec import parse

SMALL = {
    "sensor.camera.width_px": 320,
    "sensor.camera.height_px": 240,
    "sensor.camera.focal_px": 307.06,
    "sensor.camera.cx_px": 159.5,
    "sensor.camera.cy_px": 119.5,
    "panorama.width_px": 360,
    "panorama.height_px": 100,
    "panorama.z_max": 0.32,
    "noise.sigma_grey": 2.0,
    "seed": 5,
}


def outcome_with(paper, **settings):
    dotted = SMALL | {key.replace("__", "."): value for key, value in settings.items()}
    table = changed(paper.experiment.trial.model_dump(mode="json"), dotted)
    return run_trial(parse(Trial, table))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["window", "column"])
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_world_scaled_with_its_textures_scales_the_error_and_nothing_else(paper, scale, kind):
    """Powers of two scale floats exactly, Embree's too: images, matches and angles are the same to the bit."""
    scaled = outcome_with(
        paper,
        matching__kind=kind,
        scene__scale=scale,
        view_1__position_m=[0.0, 0.0, scale],
        view_2__baseline_m=0.5 * scale,
        matching__d_min_m=1.0 * scale,
        matching__d_max_m=10.0 * scale,
        # The noise is drawn for a scene; without it the images can be compared.
        noise__sigma_grey=0.0,
    )
    plain = outcome_with(paper, matching__kind=kind, noise__sigma_grey=0.0)
    np.testing.assert_array_equal(scaled.matches.alpha_2, plain.matches.alpha_2)
    np.testing.assert_array_equal(scaled.reference.domain, plain.reference.domain)
    domain = plain.reference.domain & plain.valid
    # The true range is computed along other floats on its way: 1e-12 of it.
    np.testing.assert_allclose(
        scaled.errors.range_m[domain], scale * plain.errors.range_m[domain], rtol=0, atol=1e-11 * scale
    )
    one, other = (row_of(each)["figures"] for each in (plain, scaled))
    assert other["disparity_median_abs_px"] == pytest.approx(one["disparity_median_abs_px"], rel=1e-9)
    assert other["wall_range_rmse_m"] == pytest.approx(scale * one["wall_range_rmse_m"], rel=1e-9)


@pytest.mark.slow
def test_noise_is_the_same_for_all_matchers_and_scales_with_sigma(paper):
    quiet = outcome_with(paper, noise__sigma_grey=0.0)
    window = outcome_with(paper)
    column = outcome_with(paper, matching__kind="column", matching__window_px=7)
    louder = outcome_with(paper, noise__sigma_grey=4.0)
    other_seed = outcome_with(paper, seed=6)
    for view in (0, 1):
        np.testing.assert_array_equal(window.images[view], column.images[view])
        noise = window.images[view] - quiet.images[view]
        visible = quiet.images[view] > 0
        # 46,000 draws: the standard error of their spread is 0.4 %.
        assert noise[visible].std() == pytest.approx(2.0, rel=0.02)
        # Sums of floats up to 255 in single precision.
        np.testing.assert_allclose(louder.images[view] - quiet.images[view], 2 * noise, atol=1e-4)
        assert np.abs(other_seed.images[view] - window.images[view]).max() > 1
    first, second = (window.images[view] - quiet.images[view] for view in (0, 1))
    both = (quiet.images[0] > 0) & (quiet.images[1] > 0)
    # Independent views: the correlation of 40,000 pairs is zero to within 0.005.
    assert abs(np.corrcoef(first[both], second[both])[0, 1]) < 0.02


def test_a_placement_is_drawn_by_the_seed_alone(paper):
    table = paper.experiment.trial.model_dump(mode="json")

    def trial(**settings):
        dotted = {key.replace("__", "."): value for key, value in settings.items()}
        drawn = {"placement.offset_m": 0.2, "placement.random_yaw": True}
        return parse(Trial, changed(table, drawn | dotted))

    one = trial(seed=1)
    assert one.poses == trial(seed=1, matching__window_px=7, noise__sigma_grey=5.0).poses
    assert one.poses != trial(seed=2).poses
    offset = np.subtract(one.poses[0].position_m, (0, 0, 1))
    assert (np.abs(offset) <= 0.2).all()
    # The baseline keeps its length and its direction in the world; both views turn alike.
    moved = np.subtract(one.poses[1].position_m, one.poses[0].position_m)
    np.testing.assert_allclose(moved, [0.5, 0, 0], atol=1e-15)
    np.testing.assert_allclose(one.true_motion.R_v2_from_v1, np.eye(3), atol=1e-15)
    longer = trial(seed=1, view_2__baseline_m=1.0)
    assert longer.poses[0] == one.poses[0]
