"""End to end: the errors of the whole chain are what the geometry says, and planted faults are caught."""

import dataclasses

import numpy as np
import pytest
from bounds import check_all, check_pixel_level, check_subpixel_helps
from repeats import few

import harness.pipeline.trial as chain
from harness.camera.sensor import project
from harness.camera.unwrap import unwrap
from harness.geometry.panorama import cylinder
from harness.matching import pair
from harness.matching.window import match as window
from harness.matching.window.subpixel import refine
from harness.pipeline.specification import SecondView
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.runs.run import by_method


def both(trial, cache=None):
    """The trial at whole pixels and sub-pixel."""
    cache = cache or StageCache()
    return [
        run_trial(trial.model_copy(update={"matching": trial.matching.model_copy(update={"subpixel": method})}), cache)
        for method in ("none", "parabola")
    ]


def yawed(trial, yaw_deg):
    return trial.model_copy(update={"view_2": SecondView(yaw_deg=yaw_deg)})


def test_bounds_hold_for_the_papers_experiment(paper):
    named = by_method(paper.outcomes)
    check_all(named["pixel"], named["subpixel"])


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", few(3, [133.7, 180.0, -71.0, 7.3, 45.0, 90.0]))
def test_any_yaw_of_the_second_view_is_taken_out(paper, yaw_deg):
    straight = by_method(paper.outcomes)
    pixel, subpixel = both(yawed(paper.experiment.trial, yaw_deg))
    check_all(pixel, subpixel)
    for name, turned in (("pixel", pixel), ("subpixel", subpixel)):
        for where in ("all", "wall"):
            domain = turned.reference.domain & (turned.reference.wall | (where == "all"))
            before, after = straight[name].measures(domain), turned.measures(domain)
            for figure in ("disparity_median_abs_px", "range_median_abs_m"):
                # The second image is sampled at other places of its pixels, which moves the medians by a few per cent.
                assert after[figure] == pytest.approx(before[figure], rel=0.10), (name, where, figure)


@pytest.mark.slow
def test_tilted_second_view_and_general_translation_with_alpha_sampling(paper):
    """Known pitch and roll, a translation with a vertical part: nothing in the chain is made for the level case."""
    trial = paper.experiment.trial.model_copy(
        update={
            "view_2": SecondView(
                baseline_m=0.5, azimuth_deg=35, elevation_deg=20, yaw_deg=25, pitch_deg=3, roll_deg=-4
            ),
            "matching": paper.experiment.trial.matching.model_copy(update={"sampling": "alpha"}),
        }
    )
    pixel, subpixel = both(trial)
    domain = pixel.reference.domain & pixel.reference.wall
    assert pixel.measures(domain)["density"] > 0.6  # the tilt hides a part of the top rows from view 2
    # Whole pixels are right to half a step of alpha and half a row, most of the time.
    assert pixel.measures(domain)["disparity_median_abs_px"] < 0.4
    check_subpixel_helps(pixel, subpixel)


@pytest.mark.slow
def test_vertical_translation_with_alpha_sampling(paper):
    trial = paper.experiment.trial.model_copy(
        update={
            "view_2": SecondView(baseline_m=0.5, elevation_deg=90.0),
            "matching": paper.experiment.trial.matching.model_copy(update={"sampling": "alpha"}),
        }
    )
    pixel, subpixel = both(trial)
    domain = pixel.reference.domain & pixel.reference.wall
    # Viewed from half a metre higher, a wall's upper part has left the field: about half of it remains.
    assert pixel.measures(domain)["density"] > 0.3
    assert pixel.measures(domain)["disparity_median_abs_px"] < 0.4
    check_subpixel_helps(pixel, subpixel)


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["phi", "alpha"])
def test_one_image_as_both_views(paper, sampling):
    """With an assumed baseline of 0.5 m and no d_max the answer is infinity: disparity exactly 0 at whole pixels."""
    outcome = paper.outcomes[0]
    image = outcome.filtered[0]
    matcher = outcome.trial.matching.model_copy(update={"d_max_m": np.inf, "sampling": sampling, "subpixel": "none"})
    whole = window.match_whole_pixels(image, image, np.array([0.5, 0, 0]), matcher)
    matched = whole.reason == window.Reason.MATCHED
    assert matched.mean() > 0.7
    assert np.all(window.match(whole, matcher).alpha_2[matched] == whole.curves.alpha_1[matched])
    offset, _ = refine(whole.costs[matched], "parabola")
    # Costs to both sides of a perfect match are nearly alike; where texture is faint to one side they are not.
    assert np.mean(np.abs(offset) <= 0.5) >= 0.95


def test_finite_limits_give_finite_ranges_within_them(paper):
    for outcome in paper.outcomes:
        assert np.array_equal(outcome.valid, outcome.reason == window.Reason.MATCHED)
        d = outcome.range_m[outcome.valid]
        assert d.min() >= 1.0 - 1e-4  # the interval's ends are widened by 1e-6 steps
        assert d.max() <= 10.0 + 1e-2  # and out there a step is metres long
    assert np.array_equal(paper.outcomes[0].valid, paper.outcomes[1].valid)


# -- The bounds can fail: faults planted in the chain are caught ---------------------------------------------------


def half_column_shift(monkeypatch):
    """The second panorama is sampled half a column beside where its grid says."""
    true_unwrap = pair.unwrap
    calls = []

    def shifted(image, sensor, grid, *, R_sensor_from_panorama, interpolation):
        calls.append(1)
        angle = grid.phi_pitch / 2 if len(calls) % 2 == 0 else 0.0
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        return true_unwrap(
            image, sensor, grid, R_sensor_from_panorama=R_sensor_from_panorama @ turn, interpolation=interpolation
        )

    monkeypatch.setattr(pair, "unwrap", shifted)


def flipped_translation(monkeypatch):
    """The baseline points the wrong way: the paper's eq. 1 taken literally."""
    true_match = window.match_whole_pixels
    monkeypatch.setattr(
        window,
        "match_whole_pixels",
        lambda first, second, t, matcher, **kw: true_match(first, second, -t, matcher, **kw),
    )


def flipped_curve(monkeypatch):
    """z_2(phi) without its sign: the paper's eq. 4 as printed."""
    true_curves = window.epipolar_curves

    def curves(*args, **kwargs):
        made = true_curves(*args, **kwargs)
        return dataclasses.replace(made, n=made.n * [-1.0, -1.0, 1.0])

    monkeypatch.setattr(window, "epipolar_curves", curves)


def missing_derotation(monkeypatch):
    """The second view's yaw is not taken out."""
    true_unwrap = pair.unwrap
    monkeypatch.setattr(
        pair,
        "unwrap",
        lambda image, sensor, grid, *, interpolation, **_: true_unwrap(
            image, sensor, grid, interpolation=interpolation
        ),
    )


def range_as_depth(monkeypatch):
    """The truth holds horizontal distances instead of ranges."""
    true_truth = chain.truth

    def depth(scene, pose, directions, *args, **kwargs):
        made = true_truth(scene, pose, directions, *args, **kwargs)
        return dataclasses.replace(made, range_m=made.range_m * np.hypot(directions[..., 0], directions[..., 1]))

    monkeypatch.setattr(chain, "truth", depth)


def half_pixel_parabola(monkeypatch):
    """The parabola's offset is applied with the wrong sign."""
    true_refine = window.refine

    def refine_(costs, method):
        offset, refined = true_refine(costs, method)
        return -offset, refined

    monkeypatch.setattr(window, "refine", refine_)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "yaw_deg"),
    [
        (half_column_shift, 0.0),
        (flipped_translation, 0.0),
        (flipped_curve, 0.0),
        (missing_derotation, 10.0),
        (range_as_depth, 0.0),
        (half_pixel_parabola, 0.0),
    ],
)
def test_planted_fault_is_caught(paper, monkeypatch, fault, yaw_deg):
    trial = yawed(paper.experiment.trial, yaw_deg)
    fault(monkeypatch)
    with pytest.raises(AssertionError):
        check_all(*both(trial))


def test_half_a_pixel_in_the_mirror_image_is_caught(paper, monkeypatch):
    """Both views shifted alike hardly change a disparity; the panorama's own test sees it (see test_panorama)."""
    from test_panorama import SENSOR, pattern, picture

    from harness.camera import unwrap as unwrapping

    def off(sensor, directions):
        pixels, valid = project(sensor, directions)
        return pixels + 0.5, valid

    unwrapping._sampling_table.cache_clear()
    monkeypatch.setattr(unwrapping, "project", off)
    try:
        made = unwrap(picture(SENSOR), SENSOR, paper.experiment.trial.panorama)
    finally:
        unwrapping._sampling_table.cache_clear()
    error = (made.values - pattern(cylinder(made.grid)))[made.valid]
    assert np.abs(error).max() > 0.1  # the bound in test_panorama


@pytest.mark.slow
def test_a_fault_in_one_view_alone_is_caught_at_its_size(paper, monkeypatch):
    """Half a column shows as half a pixel of bias, and as half of the pixels outside half a step."""
    half_column_shift(monkeypatch)
    pixel, _ = both(paper.experiment.trial)
    scored = pixel.reference.domain & pixel.reference.wall & pixel.valid
    upper = pixel.trial.panorama.phi[None, :] > 0
    for side in (scored & upper, scored & ~upper):
        assert 0.3 < abs(np.median(pixel.errors.disparity_px[side])) < 0.7
    with pytest.raises(AssertionError, match="half steps"):
        check_pixel_level(pixel)
