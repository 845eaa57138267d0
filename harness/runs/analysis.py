"""The test of the law, and the spread over the noise, from the rows of a run."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.efficiency import GROSS_PX, efficiency, within_without_bias
from harness.evaluation.law import test_law
from harness.evaluation.law_images import best_baselines
from harness.runs.experiment import Planned
from harness.runs.methods import METHOD_KEYS
from harness.runs.values import Settings, shown

_NOISE = "noise.sigma_grey"
_LEAST_BASELINES = 4
"""Fewer are compared by their figures alone: the best of three is the middle one or an end."""
_NOT_A_CONDITION = ("seed", "view_2.baseline_m", *METHOD_KEYS)
"""Keys across which the law is tested (baseline, seed), or with a column of their own. All others are conditions."""


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
        matcher, subpixel = planned.method
        common = {
            "matcher": matcher,
            "subpixel": subpixel,
            "seed": trial.seed,
            "baseline_m": trial.view_2.baseline_m,
            "condition": shown(law_condition(planned)),
            "quiet": shown(planned.coordinates_without(lambda key: key == _NOISE)),
            "sigma_grey": trial.noise.sigma_grey,
        }
        tables += [common | cell for cell in payload["cells"]]
    return pd.DataFrame(tables)


def law_of(cells: pd.DataFrame) -> dict[str, Any] | None:
    """The `law` of `summary.json`; None where the trials do not differ enough in |t|/d."""
    if cells.empty or cells["baseline_m"].nunique() < 3:
        return None
    return test_law(cells)


def best_baseline_of(cells: pd.DataFrame, law: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The `best_baseline` of `summary.json`: for each method, surface and range; empty where few baselines were tried.

    Parameters
    ----------
    law
        The test of the law, if there is one: they are a part of it.
    """
    if law is not None:
        found: list[dict[str, Any]] = law["best_baseline"]
        return found
    if cells.empty or cells["baseline_m"].nunique() < _LEAST_BASELINES:
        return []
    return best_baselines(cells)


def law_condition(planned: Planned) -> Settings:
    """The coordinates of a trial that the law is not tested across: each combination has an intercept of its own."""
    return planned.coordinates_without(lambda key: not _is_condition(key))


def noise_condition(planned: Planned) -> Settings:
    """The coordinates of a trial without seed, noise and method: spreads over the noise are compared within it."""
    return planned.coordinates_without(lambda key: key in _NOT_A_DRAW)


def _is_condition(key: str) -> bool:
    # The size of an object varies the range, which is what the law is about. The scale of a whole scene does not: with
    # its textures it gives the same image, so every scale keeps an intercept of its own and stretches no axis.
    is_size = key.startswith("scene.objects.") and key.endswith(".size_m")
    return key not in _NOT_A_CONDITION and not is_size


def limit_of(done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `limit` of `summary.json`: each method's spread over seeds against the bound, its bias and its predictions.

    Trials count that keep single pixels (`scoring.sample_px`) and differ in nothing but the seed, which draws their
    noise and not their viewpoint. Of conditions without noise there is one trial, and no spread.
    """
    groups: dict[tuple[Any, ...], list[tuple[Planned, dict[str, Any]]]] = {}
    for planned, payload in done:
        placement = planned.trial.placement
        if "sample" in payload and placement.offset_m == 0 and not placement.random_yaw:
            key = (
                *planned.method,
                shown(noise_condition(planned)),
                planned.trial.noise.sigma_grey,
            )
            groups.setdefault(key, []).append((planned, payload))
    return [
        {"matcher": matcher, "subpixel": subpixel, "condition": condition, "sigma_grey": sigma_grey} | _limit(trials)
        for (matcher, subpixel, condition, sigma_grey), trials in groups.items()
    ]


_NOT_A_DRAW = ("seed", "noise.sigma_grey", *METHOD_KEYS)


def _limit(trials: list[tuple[Planned, dict[str, Any]]]) -> dict[str, Any]:
    trial = trials[0][0].trial
    errors = np.array([payload["sample"]["error_px"] for _, payload in trials], dtype=np.float64)
    unit = np.array(trials[0][1]["sample"]["bound_px"], dtype=np.float64)
    bound = unit * trial.bound_noise_grey if trial.is_noisy and np.isfinite(unit).any() else None
    spread = efficiency(errors, bound) if trial.is_noisy else None
    sigma = np.array([payload["sample"]["sigma_px"] for _, payload in trials], dtype=np.float64)
    without_bias = within_without_bias(errors, sigma) if trial.is_noisy else None
    absolute = np.abs(errors[np.isfinite(errors)])
    calibrated = [payload["calibration"] for _, payload in trials if "calibration" in payload]
    return {
        "seeds": len(trials),
        "noise_grey": trials[0][1].get("noise_grey", trial.noise.sigma_grey),
        "median_abs_px": float(np.median(absolute)) if absolute.size else None,
        "bad_1px": float(np.mean(absolute > 1)) if absolute.size else None,
        "bad_3px": float(np.mean(absolute > GROSS_PX)) if absolute.size else None,
        "density": float(np.isfinite(errors).mean()) if errors.size else None,
        "bound_px": float(np.nanmedian(bound)) if bound is not None else None,
        "std_px": None if spread is None else spread.std_px,
        "bias_px": None if spread is None else spread.bias_px,
        "std_over_bound": None if spread is None else spread.std_over_bound,
        "std_over_bound_quartiles": None if spread is None else spread.std_over_bound_quartiles,
        "rms_over_bound": None if spread is None else spread.rms_over_bound,
        "within_sigma": np.mean([each["within"] for each in calibrated], axis=0).tolist() if calibrated else None,
        "within_sigma_without_bias": None if without_bias is None else list(without_bias),
    }
