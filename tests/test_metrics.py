"""Figures, regions and cells against plain definitions."""

import numpy as np
import pytest

from harness.evaluation.cells import MIN_PIXELS, NORMAL, cells
from harness.evaluation.errors import Errors
from harness.evaluation.groups import ascending, counts, grouped, means, medians
from harness.evaluation.metrics import (
    ERROR_EDGES_PX,
    FRACTION_BINS,
    error_histogram,
    fraction_histogram,
    measure,
    measure_by_solid_angle,
    measure_more,
    measure_regions,
    ranked,
)
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.experiments.row import row_of
from harness.stereo.panorama import Grid


@pytest.fixture
def outcome(paper):
    return paper.outcomes[-1]


def errors_of(outcome):
    return ranked(outcome.valid, outcome.errors, outcome.trial.panorama)


def test_core_figures_are_their_definitions(outcome):
    truth, found = outcome.reference, outcome.errors
    figures = measure(truth.domain, outcome.valid, found)
    pixels = truth.domain & outcome.valid
    angle, distance = found.alpha_2[pixels] / (2 * np.pi / 720), (outcome.range_m - truth.range_m)[pixels]
    expected = {
        "density": pixels.sum() / truth.domain.sum(),
        "disparity_median_abs_px": np.median(np.abs(angle)),
        "disparity_rmse_px": np.sqrt(np.mean(angle**2)),
        "bad_1px": np.mean(np.abs(angle) > 1),
        "range_median_abs_m": np.median(np.abs(distance)),
        "range_mae_m": np.abs(distance).mean(),
        "range_rmse_m": np.sqrt((distance**2).mean()),
        "range_bias_m": distance.mean(),
    }
    assert figures.keys() == expected.keys()
    for name, value in expected.items():
        assert figures[name] == pytest.approx(value, rel=1e-12), name  # rounding of sums in another order


def test_more_figures_are_their_definitions(outcome):
    truth, found = outcome.reference, outcome.errors
    figures = measure_more(truth.domain, errors_of(outcome), truth)
    pixels = truth.domain & outcome.valid
    absolute = np.abs(found.disparity_px[pixels])
    estimate, true = outcome.range_m[pixels], truth.range_m[pixels]
    ratio = np.maximum(estimate / true, true / estimate)
    assert figures["bad_0.5px"] == pytest.approx(np.mean(absolute > 0.5))
    assert figures["bad_4px"] == pytest.approx(np.mean(absolute > 4))
    for share in (50, 90, 95, 99):
        # A quantile of 10^5 values, whichever of two neighbours is taken.
        assert figures[f"disparity_a{share}_px"] == pytest.approx(np.quantile(absolute, share / 100), rel=1e-3)
    assert figures["range_abs_rel"] == pytest.approx(np.mean(np.abs(estimate - true) / true))
    assert figures["range_silog"] == pytest.approx(np.std(np.log(estimate) - np.log(true)))
    for limit in (1.05, 1.1, 1.25):
        assert figures[f"range_delta_{limit:g}"] == pytest.approx(np.mean(ratio < limit), abs=1e-4)


def test_solid_angle_figures_are_those_of_pixels_repeated_by_their_weight(outcome):
    truth, found, grid = outcome.reference, outcome.errors, outcome.trial.panorama
    figures = measure_by_solid_angle(truth.domain, errors_of(outcome), grid)
    weight = np.broadcast_to((1 + grid.z[:, None] ** 2) ** -1.5, grid.shape)
    pixels = truth.domain & outcome.valid
    w, absolute = weight[pixels], np.abs(found.disparity_px[pixels])
    assert figures["density"] == pytest.approx(w.sum() / weight[truth.domain].sum())
    assert figures["bad_1px"] == pytest.approx(np.average(absolute > 1, weights=w))
    order = np.argsort(absolute)
    middle = absolute[order][np.searchsorted(np.cumsum(w[order]), w.sum() / 2)]
    assert figures["disparity_median_abs_px"] == pytest.approx(middle, rel=1e-6)  # float32 bins, exact within one
    # The solid angle itself: the whole cylinder's rows sum to its band of the sphere, 2 pi (sin top - sin bottom).
    whole = weight.sum() * grid.phi_pitch * grid.z_pitch
    band = 2 * np.pi * np.diff(np.sin(np.arctan([grid.z_min, grid.z_max])))[0]
    assert whole == pytest.approx(band, rel=1e-4)  # midpoint rule of 200 rows


def test_nothing_valid_gives_none_not_nan(outcome):
    nothing = np.zeros_like(outcome.valid)
    assert measure(outcome.reference.domain, nothing, outcome.errors)["density"] == 0
    assert measure(outcome.reference.domain, nothing, outcome.errors)["range_rmse_m"] is None
    assert measure(nothing, outcome.valid, outcome.errors)["density"] is None
    assert measure_more(nothing, errors_of(outcome), outcome.reference)["range_silog"] is None


def test_regions_split_the_domain(outcome):
    table = measure_regions(outcome.layout, errors_of(outcome))
    domain = int(outcome.reference.domain.sum())
    for split in ("surface", "alpha_1", "elevation", "range"):
        assert sum(row["pixels"] for row in table if row["split"] == split) == domain, split
    wall = next(row for row in table if row["part"] == "wall")
    figures = measure(outcome.reference.domain & outcome.reference.wall, outcome.valid, outcome.errors)
    assert {name: wall[name] for name in figures} == pytest.approx(figures)


def test_cells_hold_each_pixel_of_the_domain_once_and_figures_of_their_own_pixels(outcome):
    truth = outcome.reference
    everything = np.concatenate([part.pixels for part in outcome.cells])
    np.testing.assert_array_equal(np.sort(everything), np.flatnonzero(truth.domain))
    table = cells(outcome.layout, truth, errors_of(outcome), 0.5)
    assert len(table) > 20
    alpha_deg = np.degrees(truth.alpha_1)
    for cell in table:
        low, high = ALPHA_1_EDGES_DEG[cell["alpha_bin"]], ALPHA_1_EDGES_DEG[cell["alpha_bin"] + 1]
        near = RANGE_RATIO ** cell["range_bin"]
        inside = truth.domain & outcome.valid & (truth.wall == (cell["surface"] == "wall"))
        inside &= (
            (alpha_deg >= low) & (alpha_deg < high) & (truth.range_m >= near) & (truth.range_m < near * RANGE_RATIO)
        )
        # A pixel on the edge between two bins may fall to either by rounding.
        assert abs(int(inside.sum()) - cell["pixels"]) <= 2
        assert cell["pixels"] >= MIN_PIXELS
        error = np.median(np.abs(outcome.errors.range_m[inside]))
        assert cell["spread_m"] == pytest.approx(NORMAL * error, rel=0.02)  # one pixel more or less
        assert cell["law_paper"] == pytest.approx(np.median(truth.range_m[inside] ** 2 / 0.5), rel=0.01)


def test_histograms_count_every_pixel():
    rng = np.random.default_rng(17)
    grid = Grid(width_px=50, height_px=40)
    disparity = rng.normal(size=grid.shape) * 10 ** rng.uniform(-4, 3, grid.shape)
    everywhere = np.ones(grid.shape, bool)
    errors = ranked(everywhere, Errors(disparity, disparity, disparity), grid)
    expected, _ = np.histogram(np.minimum(np.abs(disparity), ERROR_EDGES_PX[-1]), ERROR_EDGES_PX)
    assert error_histogram(everywhere, errors) == expected.tolist()
    part = disparity > 0
    assert sum(error_histogram(part, errors)) == part.sum()
    whole = fraction_histogram(everywhere, np.full(grid.shape, 7.0))
    assert whole == [2000] + [0] * (FRACTION_BINS - 1)
    half = fraction_histogram(everywhere, np.full(grid.shape, -3.5))
    assert half[FRACTION_BINS // 2] == 2000


def test_grouped_statistics_are_those_of_each_group():
    rng = np.random.default_rng(18)
    values, seen = rng.normal(size=5000), rng.random(5000) < 0.7
    members = [rng.choice(5000, size, replace=False) for size in (1, 2, 17, 400, 3000, 4999)] + [np.array([], int)]
    groups = grouped(members, 5000)
    count = counts(groups, seen)
    found_means = means(groups, seen, count, np.stack([values, values**2], axis=1))
    found_medians = medians(groups, seen, count, values, np.argsort(values))
    for i, part in enumerate(members):
        chosen = values[part][seen[part]]
        assert count[i] == chosen.size
        if chosen.size:
            assert found_medians[i] == np.median(chosen)
            # Sums in another order.
            assert found_means[i] == pytest.approx([chosen.mean(), np.mean(chosen**2)], rel=1e-12)
        else:
            assert np.isnan(found_medians[i])
            assert np.isnan(found_means[i]).all()


def test_ascending_is_argsort_to_single_precision():
    rng = np.random.default_rng(19)
    values, seen = 10 ** rng.uniform(-12, 12, 20_000), rng.random(20_000) < 0.8
    values[:5] = 0.0
    order = ascending(seen, values)
    assert set(order) == set(np.flatnonzero(seen))
    assert (np.diff(values[order].astype(np.float32)) >= 0).all()


def test_a_row_is_strict_json(outcome):
    import json

    row = row_of(outcome)
    assert json.loads(json.dumps(row, allow_nan=False)) == row
