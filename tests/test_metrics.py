"""Figures, regions and cells against plain definitions."""

import re
from itertools import pairwise

import numpy as np
import pytest

from harness.cli import main
from harness.evaluation.cells import MIN_PIXELS, NORMAL, cells
from harness.evaluation.groups import (
    ascending,
    bins,
    grouped,
    indices_of,
    mean_of_middles,
    medians,
    medians_of_scored,
    members,
    sorted_parts,
)
from harness.evaluation.metric_table import METRICS, Metric, is_metric, metric
from harness.evaluation.metrics import (
    CORE,
    error_histograms,
    fraction_histograms,
    measure,
    measure_by_solid_angle,
    measure_more,
    measure_regions,
    share_of_estimates,
)
from harness.evaluation.pixel_errors import Errors
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.evaluation.tally import ERROR_EDGES_PX, FRACTION_BINS, tally
from harness.pipeline.row import row_of
from harness.report import written_runs
from harness.report.build import build_report
from harness.report.sections import measures
from harness.runs.load import load_experiment
from harness.runs.run import run_experiment


@pytest.fixture
def outcome(paper):
    return paper.outcomes[-1]


def errors_of(outcome):
    return tally(outcome.layout, outcome.valid, outcome.errors)


def nothing_seen(outcome):
    return tally(outcome.layout, np.zeros_like(outcome.valid), outcome.errors)


def test_core_figures_are_their_definitions(outcome):
    truth, result = outcome.reference, outcome.errors
    figures = measure(truth.domain, outcome.valid, result)
    pixels = truth.domain & outcome.valid
    angle, distance = result.alpha_2[pixels] / (2 * np.pi / 720), (outcome.range_m - truth.range_m)[pixels]
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
    truth, result = outcome.reference, outcome.errors
    figures = measure_more(errors_of(outcome))
    pixels = truth.domain & outcome.valid
    absolute = np.abs(result.disparity_px[pixels])
    estimate, true = outcome.range_m[pixels], truth.range_m[pixels]
    ratio = np.maximum(estimate / true, true / estimate)
    assert figures["bad_0.5px"] == pytest.approx(np.mean(absolute > 0.5))
    assert figures["bad_2px"] == pytest.approx(np.mean(absolute > 2))
    assert figures["bad_4px"] == pytest.approx(np.mean(absolute > 4))
    assert figures["disparity_mae_px"] == pytest.approx(np.mean(absolute))
    # The middle of the signed errors, whichever of neighbours that are one in single precision is taken.
    assert figures["disparity_bias_px"] == pytest.approx(np.median(result.disparity_px[pixels]), rel=1e-6)
    for share in (50, 90, 95, 99):
        # A quantile of 10^5 values, whichever of two neighbours is taken.
        assert figures[f"disparity_a{share}_px"] == pytest.approx(np.quantile(absolute, share / 100), rel=1e-3)
    assert figures["range_abs_rel"] == pytest.approx(np.mean(np.abs(estimate - true) / true))
    assert figures["range_sq_rel_m"] == pytest.approx(np.mean((estimate - true) ** 2 / true))
    assert figures["range_silog"] == pytest.approx(np.std(np.log(estimate) - np.log(true)))
    for limit in (1.05, 1.1, 1.25):
        assert figures[f"range_delta_{limit:g}"] == pytest.approx(np.mean(ratio < limit), abs=1e-4)


def test_solid_angle_figures_are_those_of_pixels_repeated_by_their_weight(outcome):
    truth, result, grid = outcome.reference, outcome.errors, outcome.trial.panorama
    figures = measure_by_solid_angle(errors_of(outcome))
    weight = np.broadcast_to((1 + grid.z[:, None] ** 2) ** -1.5, grid.shape)
    pixels = truth.domain & outcome.valid
    w, absolute = weight[pixels], np.abs(result.disparity_px[pixels])
    assert figures["density"] == pytest.approx(w.sum() / weight[truth.domain].sum())
    assert figures["bad_1px"] == pytest.approx(np.average(absolute > 1, weights=w))
    distance = result.range_m[pixels]
    assert figures["range_mae_m"] == pytest.approx(np.average(np.abs(distance), weights=w))
    assert figures["range_rmse_m"] == pytest.approx(np.sqrt(np.average(distance**2, weights=w)))
    assert figures["range_bias_m"] == pytest.approx(np.average(distance, weights=w))
    order = np.argsort(absolute)
    middle = absolute[order][np.searchsorted(np.cumsum(w[order]), w.sum() / 2)]
    assert figures["disparity_median_abs_px"] == pytest.approx(middle, rel=1e-6)  # float32 bins, exact within one
    order = np.argsort(np.abs(distance))
    middle = np.abs(distance)[order][np.searchsorted(np.cumsum(w[order]), w.sum() / 2)]
    assert figures["range_median_abs_m"] == pytest.approx(middle, rel=1e-6)
    # The solid angle itself: the whole cylinder's rows sum to its band of the sphere, 2 pi (sin top - sin bottom).
    whole = weight.sum() * grid.phi_pitch * grid.z_pitch
    band = 2 * np.pi * np.diff(np.sin(np.arctan([grid.z_min, grid.z_max])))[0]
    assert whole == pytest.approx(band, rel=1e-4)  # midpoint rule of 200 rows


def test_nothing_valid_gives_none_not_nan(outcome):
    nothing = np.zeros_like(outcome.valid)
    assert measure(outcome.reference.domain, nothing, outcome.errors)["density"] == 0
    assert measure(outcome.reference.domain, nothing, outcome.errors)["range_rmse_m"] is None
    assert measure(nothing, outcome.valid, outcome.errors)["density"] is None
    errors = nothing_seen(outcome)
    assert set(measure_more(errors).values()) == {None}
    assert measure_by_solid_angle(errors) == {"density": 0.0} | dict.fromkeys(CORE)
    assert all(row["density"] == 0 and row["range_rmse_m"] is None for row in measure_regions(errors))
    assert cells(errors, 0.5, 0.01) == []
    assert share_of_estimates(errors, outcome.valid) is None
    assert not any(sum(counts) for counts in error_histograms(errors).values())


def test_regions_split_the_domain(outcome):
    table = measure_regions(errors_of(outcome))
    domain = int(outcome.reference.domain.sum())
    for split in ("surface", "alpha_1", "elevation", "range"):
        assert sum(row["pixels"] for row in table if row["split"] == split) == domain, split
    wall = next(row for row in table if row["part"] == "wall")
    figures = measure(outcome.reference.domain & outcome.reference.wall, outcome.valid, outcome.errors)
    assert {name: wall[name] for name in figures} == pytest.approx(figures)
    for i, region in enumerate(outcome.regions):
        part = np.zeros(outcome.valid.size, dtype=bool)
        part[region.pixels] = True
        figures = measure(part.reshape(outcome.valid.shape), outcome.valid, outcome.errors)
        assert {name: table[i][name] for name in figures} == pytest.approx(figures, rel=1e-6), region.part


def test_cells_hold_each_pixel_of_the_domain_once_and_figures_of_their_own_pixels(outcome):
    truth = outcome.reference
    everything = np.concatenate([part.pixels for part in outcome.cells])
    np.testing.assert_array_equal(np.sort(everything), np.flatnonzero(truth.domain))
    table = cells(errors_of(outcome), 0.5, np.radians(0.5))
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
        error, angle = np.median(np.abs(outcome.errors.range_m[inside])), outcome.errors.alpha_2[inside]
        assert cell["spread_m"] == pytest.approx(NORMAL * error, rel=0.02)  # one pixel more or less
        assert cell["sigma_alpha"] == pytest.approx(NORMAL * np.median(np.abs(angle)), rel=0.02)
        assert cell["range_m"] == pytest.approx(np.median(truth.range_m[inside]), rel=0.01)
        assert cell["law_exact"] == pytest.approx(np.median(truth.law[inside]), rel=0.01)
        assert cell["law_paper"] == pytest.approx(np.median(truth.range_m[inside] ** 2 / 0.5), rel=0.01)
        bias = np.degrees(np.median(angle)) / 0.5
        assert cell["disparity_bias_px"] == pytest.approx(bias, abs=0.02 * np.median(np.abs(angle)) / np.radians(0.5))
        assert cell["gross"] == pytest.approx(np.mean(np.abs(angle) > np.radians(0.5)), abs=2 / MIN_PIXELS)


def test_histograms_count_every_pixel(outcome):
    rng = np.random.default_rng(17)
    shape = outcome.valid.shape
    disparity = rng.normal(size=shape) * 10 ** rng.uniform(-4, 3, shape)
    # On the edges of bins too, and a hair below them.
    disparity.flat[::7] = np.resize(ERROR_EDGES_PX, disparity.flat[::7].shape)
    disparity.flat[1::7] = np.resize(np.nextafter(ERROR_EDGES_PX, 0), disparity.flat[1::7].shape)
    errors = tally(outcome.layout, outcome.valid, Errors(disparity, disparity, disparity))
    truth = outcome.reference
    histograms = error_histograms(errors)
    for where, mask in {"wall": truth.wall, "floor": ~truth.wall}.items():
        inside = truth.domain & mask & outcome.valid
        expected, _ = np.histogram(np.minimum(np.abs(disparity[inside]), ERROR_EDGES_PX[-1]), ERROR_EDGES_PX)
        assert histograms[where] == expected.tolist()
        assert fraction_histograms(errors, np.full(shape, 7.0))[where] == [inside.sum()] + [0] * (FRACTION_BINS - 1)
        assert fraction_histograms(errors, np.full(shape, -3.5))[where][FRACTION_BINS // 2] == inside.sum()
    k = rng.uniform(-50, 50, shape)
    inside = truth.domain & truth.wall & outcome.valid
    expected = np.bincount((np.floor(k[inside] * FRACTION_BINS + 0.5) % FRACTION_BINS).astype(int))
    assert fraction_histograms(errors, k)["wall"] == expected.tolist()
    visible = truth.domain & outcome.valid
    assert share_of_estimates(errors, k > 20) == pytest.approx(np.mean(k[visible] > 20))


def labels_of(members, size):
    labels = np.full(size, -1, dtype=np.int16)
    for number, part in members.items():
        labels[part] = number
    return labels


def test_bins_and_members_are_those_of_plain_comparisons():
    rng = np.random.default_rng(21)
    values, edges = rng.normal(size=(50, 60)), (-1.0, -0.5, 0.25, 1.5)
    values[0, :4], values[1, 0] = edges, np.nan
    result = bins(values, edges)
    for i, (low, high) in enumerate(pairwise(edges)):
        np.testing.assert_array_equal(result == i, (values >= low) & (values < high))
    for i, part in enumerate(members(result, 5)):
        np.testing.assert_array_equal(part, np.flatnonzero(result == i))
    assert members(np.full(7, -1, np.int16), 0) == []


def test_grouped_statistics_are_those_of_each_group():
    rng = np.random.default_rng(18)
    values, visible = rng.normal(size=5000), rng.random(5000) < 0.7
    parts = [rng.choice(5000, size, replace=False) for size in (1, 2, 17, 400, 401, 3000, 4999, 2999)] + [
        np.array([], int)
    ]
    groups = grouped([labels_of({i: part}, 5000) for i, part in enumerate(parts)], len(parts))
    np.testing.assert_array_equal(groups.sizes, [part.size for part in parts])
    np.testing.assert_array_equal(groups.pixels, np.unique(np.concatenate(parts)))
    inside, absolute = visible[groups.pixels], np.abs(values[groups.pixels])
    count = np.array([visible[part].sum() for part in parts])
    negative = np.array([(visible[part] & (values[part] < 0)).sum() for part in parts])
    order = ascending(inside, absolute)
    strata = (2 * groups.classes + (values[groups.pixels] < 0)).astype(np.int32)
    middles, of_signs = medians(groups, strata, count, negative, order)
    of_absolute = mean_of_middles(middles, absolute)
    of_signed = mean_of_middles(of_signs, values[groups.pixels])
    for i, part in enumerate(parts):
        chosen = values[part][visible[part]]
        if chosen.size:
            assert of_absolute[i] == np.median(np.abs(chosen))
            assert of_signed[i] == np.median(chosen)
        else:
            assert np.isnan(of_absolute[i])
            assert np.isnan(of_signed[i])


@pytest.mark.parametrize("sign", [1, -1])
def test_signed_medians_of_one_sign(sign):
    values = sign * np.array([3.0, 1.0, 2.0, 5.0])
    groups = grouped([labels_of({0: [0, 1, 2], 1: [3]}, 4), labels_of({2: [0, 1, 2, 3]}, 4)], 3)
    order = ascending(np.ones(4, bool), np.abs(values))
    negative = groups.sizes * (sign < 0)
    strata = (2 * groups.classes + (sign < 0)).astype(np.int32)
    _, middles = medians(groups, strata, groups.sizes, negative, order)
    np.testing.assert_array_equal(mean_of_middles(middles, values), sign * np.array([2.0, 5.0, 2.5]))


def test_medians_of_seen_parts():
    rng = np.random.default_rng(20)
    values, part, visible = rng.random(3000), rng.integers(-1, 7, 3000), rng.random(3000) < 0.5
    visible[part == 3] = False
    count = np.bincount(part[visible & (part >= 0)], minlength=7)
    result = medians_of_scored(sorted_parts(part, 7, values), visible, count)
    expected = [np.median(values[visible & (part == i)]) if i != 3 else np.nan for i in range(7)]
    np.testing.assert_array_equal(result, expected)


def test_ascending_is_argsort_to_single_precision():
    rng = np.random.default_rng(19)
    values, visible = 10 ** rng.uniform(-60, 60, 20_000), rng.random(20_000) < 0.8
    values[:5] = 0.0
    order = indices_of(ascending(visible, values))
    assert set(order) == set(np.flatnonzero(visible))
    with np.errstate(over="ignore"):
        single = values[order].astype(np.float32)
    assert (single[1:] >= single[:-1]).all()


def test_a_row_is_strict_json(outcome):
    import json

    row = row_of(outcome)
    assert json.loads(json.dumps(row, allow_nan=False)) == row


@pytest.mark.long
@pytest.mark.slow
def test_a_metric_from_outside_is_in_rows_tables_and_comparisons(monkeypatch, tmp_path, capsys):
    """One entry, and nothing else: it is computed, written, and shown with its heading, unit and direction."""
    worst = Metric(
        "disparity_worst_px", "Disparity", "largest |error|", "px", 1, ".1f", "lower", lambda t: t.quantiles_px[-1]
    )
    monkeypatch.setitem(METRICS, worst.name, worst)
    monkeypatch.setattr(measures, "SHOWN", (*measures.SHOWN, worst.name))
    monkeypatch.setattr(written_runs, "COMPARED", (worst.name,))
    result = run_experiment(load_experiment("smoke", axes=["matching.window_px=5"]), tmp_path / "one", workers=1)
    row = next(each for each in result.rows if each.state == "done")
    assert row.payload["figures"][worst.name] > 0
    assert "Disparity, largest |error|" in build_report(result)
    assert metric("disparity_worst_px").heading == "Disparity, largest |error|"
    for name in ("a", "b"):
        assert main(["run", "smoke", "--out", str(tmp_path / name), "--no-report", "--workers", "1"]) == 0
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    assert "Disparity, largest |error|, px" in capsys.readouterr().out


def test_parts_have_the_heading_and_the_unit_of_the_whole():
    walls = metric("wall_range_median_abs_m")
    assert (walls.heading, walls.unit, walls.scale) == ("Walls: range, median |error|", "mm", 1000)
    assert metric("solid_angle_bad_1px").heading == "Solid angle: above 1\u00a0px"
    assert is_metric("floor_density")
    assert not is_metric("matching.window_px")


def test_every_figure_of_a_row_is_a_metric_or_of_confidence(outcome):
    of_confidence = re.compile(r"(ause|auc)_|within_\d_sigma")
    names = [name for name in row_of(outcome)["figures"] if not of_confidence.match(name)]
    assert [name for name in names if not is_metric(name)] == []
    assert len({each.heading for each in METRICS.values()}) == len(METRICS)
