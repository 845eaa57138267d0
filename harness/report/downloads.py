"""The numbers behind the figures of the base trial. Maps and pictures are summed up in blocks, whatever their size."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.window.match import Reason
from harness.report.curve import Curve
from harness.report.data import Data
from harness.report.distributions import curves, histograms
from harness.report.law import example
from harness.report.methods import Method
from harness.report.profiles import Row, other_rows, row_at

BLOCKS = (20, 72)
"""At most so many blocks down and across a panorama."""


def of_base_trial(methods: list[Method], search: Curve | None, row: Row) -> dict[str, Data]:
    """By the name of the figure."""
    first = methods[0].outcome
    trial = first.trial
    found = {
        "environment": Data(
            "viewpoints",
            ["view", "x_m", "y_m", "z_m"],
            [[i + 1, *pose.position_m] for i, pose in enumerate(trial.poses)],
        ),
        "panoramas": _blocks(
            "panorama-blocks",
            methods,
            {
                "grey_mean": (first.panoramas[0].values, first.panoramas[0].valid, np.mean),
                "log_rms": (first.filtered[0].values, first.filtered[0].valid, _rms),
            },
        ),
        "profile": _profiles("profile", methods, [row.index]),
        "rows": _profiles("profiles-other-rows", methods, other_rows(methods), every=2),
        "errors": _blocks(
            "range-error-blocks",
            methods,
            {
                f"{method.key}_range_error_median_m": (
                    method.outcome.errors.range_m,
                    np.isfinite(method.outcome.errors.range_m),
                    np.median,
                )
                for method in methods
            },
        ),
        "reasons": Data(
            "reasons",
            ["reason", "pixels", "share"],
            [
                [reason.name.lower(), int(there.sum()), float(there.mean())]
                for reason in Reason
                for there in [first.reason == reason]
                if there.any()
            ],
        ),
        "distributions": Data(
            "error-distributions",
            ["kind", "error", "method", "surface", "value", "share"],
            [*curves(methods), *histograms(methods)],
        ),
        "law": Data(
            "law-example-and-measured", ["what", "alpha_1_deg", "range_error_m"], list(example.numbers(methods))
        ),
    }
    if search:
        found["curve"] = Data(
            "cost-curve",
            ["angle_deg", "cost", "in_fit", "true_deg", "best_deg", "minimum_deg"],
            [
                [angle, cost, int(near), search.true_deg, search.best_deg, search.minimum_deg]
                for angle, cost, near in zip(search.angle_deg, search.costs, search.near, strict=True)
            ],
        )
    return found


def _profiles(name: str, methods: list[Method], rows: list[int], every: int = 1) -> Data:
    """Range over azimuth, of every column or of every so many."""
    outcome = methods[0].outcome
    phi = np.degrees(outcome.trial.panorama.phi)
    every *= max(1, -(-phi.size // 720))
    lines: list[list[Any]] = []
    for index in rows:
        described = row_at(methods, index)
        for column in range(0, phi.size, every):
            found = [float(method.outcome.range_m[index, column]) for method in methods]
            lines.append(
                [index, described.elevation_deg, phi[column], float(outcome.reference.range_m[index, column]), *found]
            )
    return Data(
        name, ["row", "elevation_deg", "azimuth_deg", "true_m", *(f"{method.key}_m" for method in methods)], lines
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _blocks(
    name: str,
    methods: list[Method],
    fields: dict[str, tuple[NDArray[np.floating], NDArray[np.bool_], Callable[[Any], Any]]],
) -> Data:
    """One row a block: its middle, and each field summed up over the pixels that have it."""
    grid = methods[0].outcome.trial.panorama
    downs, acrosses = (
        np.array_split(np.arange(size), min(most, size)) for size, most in zip(grid.shape, BLOCKS, strict=True)
    )
    lines = []
    for down in downs:
        for across in acrosses:
            place = np.ix_(down, across)
            line = [float(np.degrees(grid.phi[across].mean())), float(grid.z[down].mean())]
            for values, known, sum_up in fields.values():
                chosen = values[place][known[place]]
                line.append(float(sum_up(chosen)) if chosen.size else np.nan)
            lines.append(line)
    return Data(name, ["azimuth_deg", "z", *fields], lines)
