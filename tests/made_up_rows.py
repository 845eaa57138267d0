"""Rows of trials that were never run, for what is said of a sweep."""

from types import SimpleNamespace

import numpy as np

SEEDS = range(12)


def rows(error_m, *, methods=(("column", "parabola"),), axes=None, seeds=SEEDS):
    """Trials over all of it; `error_m(method, settings, seed)` is their median range error on walls."""
    axes = axes or {"noise.sigma_grey": [0.0, 4.0]}
    combinations = [{}]
    for key, values in axes.items():
        combinations = [each | {key: value} for each in combinations for value in values]
    made = []
    for seed in seeds:
        for method in methods:
            for settings in combinations:
                error = error_m(method, settings, seed)
                figures = {"wall_range_median_abs_m": error, "range_median_abs_m": error}
                planned = SimpleNamespace(method=method, trial=SimpleNamespace(seed=seed))
                coordinates = settings | {"seed": seed, "matching.kind": method[0]}
                made.append(SimpleNamespace(planned=planned, coordinates=coordinates, payload={"figures": figures}))
    return made


def luck(seed, *words):
    return float(np.exp(0.1 * np.random.default_rng([seed, *words]).standard_normal()))
