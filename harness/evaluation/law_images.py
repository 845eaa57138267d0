"""The law of sensitivity on images, and how the error of the angle itself behaves.

Range is computed from alpha_2, so by calculus its error is the law times the error of alpha_2: plotting one against
the other proves nothing. What can fail is that sigma(alpha_2) depends neither on range nor on baseline. If it does
not, the relative error of the range grows with the law: `log(spread/d)` against `log(law/d)` has slope 1 over cells
that differ in range, baseline and direction. Here that slope is fitted, with an interval from resampling the seeds
(each seed has drawn its own viewpoint and noise; pixels of one image are correlated and are never resampled).

A table of cells has one row a cell of a trial (see `cells.Cell`), and of its trial the columns `matcher`, `subpixel`,
`seed`, `baseline_m` and `condition`: a word for all other settings that vary (window, noise, ...). Conditions differ in
sigma by design, so each keeps an intercept of its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.evaluation.regions import ALPHA_1_EDGES_DEG, middle_of_range
from harness.evaluation.statistics import resampled
from harness.geometry.angles import Array

BOOTSTRAP_DRAWS = 2000
LAWS = ("exact", "paper")
MOST_SYSTEMATIC = 0.5
"""Error without noise over error with it, in a cell that counts as limited by noise: a quarter of its variance."""
SHORT = 0.2
"""|t|/d below which both views see a surface nearly alike. Beyond it one sees a surface beside the rig up to twice as
foreshortened as the other, so that a window of fixed shape covers several disparities."""
_METHOD = ["matcher", "subpixel"]


def fit_laws(cells: pd.DataFrame, laws: Sequence[str] = LAWS) -> list[dict[str, Any]]:
    """Slopes of `log(spread/d)` on `log(law/d)`, for every method, surface and law, over all directions and in parts.

    Parameters
    ----------
    laws
        `exact`, `paper`; or `bound`, which has the exact law times the Cramér-Rao bound of each cell instead of one
        constant sigma, and needs the column `bound_alpha`.

    Returns
    -------
    list
        Tables of `matcher`, `subpixel`, `surface`, `law`, `slope`, `slope_ci95`, `r2`, `cells`, `by_alpha_1`: as in
        `summary.json`; the last with slopes of its own over cells whose baseline is `short` for their range. Slopes
        that cannot be fitted (fewer than three cells, or one law value) are None.
    """
    fits = []
    for (matcher, subpixel, surface), part in cells.groupby([*_METHOD, "surface"], sort=True):
        groups, range_m = _Groups.of(part), _numbers(part, "range_m")
        y = np.log(_numbers(part, "spread_m") / range_m)
        alpha_bin, is_short = part["alpha_bin"].to_numpy(), _numbers(part, "baseline_m") < SHORT * range_m
        for law in laws:
            x = np.log(_numbers(part, f"law_{law}") / range_m)
            by_alpha_1 = []
            for index, (low, high) in enumerate(pairwise(ALPHA_1_EDGES_DEG)):
                inside = alpha_bin == index
                short = inside & is_short
                by_alpha_1.append(
                    {
                        "from_deg": low,
                        "to_deg": high,
                        **_slope(x[inside], y[inside], groups.where(inside)),
                        "short": _slope(x[short], y[short], groups.where(short)),
                    }
                )
            fits.append(
                {
                    "matcher": matcher,
                    "subpixel": subpixel,
                    "surface": surface,
                    "law": law,
                    **_slope(x, y, groups),
                    "cells": len(part),
                    "by_alpha_1": by_alpha_1,
                }
            )
    return fits


def fit_law_and_bound(cells: pd.DataFrame) -> list[dict[str, Any]]:
    """Coefficients of `log(law/d)` and of `log(bound)` in one regression of `log(spread/d)`.

    A slope of 1 on their product (`fit_laws` with `bound`) may hide that one makes up for the other. Here each has a
    coefficient of its own: 1 for the law if range depends on the angle as calculus says, and 1 for the bound if the
    angle's error follows the texture as the bound does; 0 if it is independent of it.

    Parameters
    ----------
    cells
        With the column `bound_alpha`, the median Cramér-Rao bound of alpha_2 in the cell, radians.

    Returns
    -------
    list
        Tables of `matcher`, `subpixel`, `surface`, `law`, `law_ci95`, `bound`, `bound_ci95`, `r2`, `cells`.
    """
    fits = []
    for (matcher, subpixel, surface), part in cells.groupby([*_METHOD, "surface"], sort=True):
        groups, range_m = _Groups.of(part), _numbers(part, "range_m")
        law, bound = np.log(_numbers(part, "law_exact") / range_m), np.log(_numbers(part, "bound_alpha"))
        fit = _within_conditions(np.column_stack([law, bound]), np.log(_numbers(part, "spread_m") / range_m), groups)
        row: dict[str, Any] = {"matcher": matcher, "subpixel": subpixel, "surface": surface}
        row |= {"law": None, "law_ci95": None, "bound": None, "bound_ci95": None, "r2": None, "cells": len(part)}
        if fit is not None:
            coefficients, row["r2"] = fit
            for column, name in enumerate(("law", "bound")):
                row[name] = float(coefficients[0, column])
                row[f"{name}_ci95"] = _interval(coefficients[1:, column], groups)
        fits.append(row)
    return fits


def noise_limited(cells: pd.DataFrame) -> pd.DataFrame:
    """Cells in which noise makes most of the error: the same cell without noise has at most half of it.

    There the premise of the law, that sigma(alpha_2) is one constant of the images, has its best chance: what is left
    out are the matcher's own systematic errors, which the law does not cover.

    Parameters
    ----------
    cells
        Also with the columns `sigma_grey` and `quiet`, the trial's settings without its noise. Cells of trials with
        noise that have no partner without noise are left out.
    """
    same = [*_METHOD, "surface", "quiet", "alpha_bin", "range_bin"]
    noisy = cells[cells["sigma_grey"] > 0]
    without = cells[cells["sigma_grey"] == 0][[*same, "spread_m"]].rename(columns={"spread_m": "quiet_spread_m"})
    paired = noisy.merge(without, on=same, how="inner", validate="many_to_one")
    return paired[paired["quiet_spread_m"] <= MOST_SYSTEMATIC * paired["spread_m"]].drop(columns="quiet_spread_m")


def sigma_alpha_slopes(cells: pd.DataFrame) -> list[dict[str, Any]]:
    """Slopes of `log sigma(alpha_2)` on `log(|t|/d)`: 0 if the angle's error depends on neither baseline nor range."""
    slopes = []
    for (matcher, subpixel, surface), part in cells.groupby([*_METHOD, "surface"], sort=True):
        ratio = _numbers(part, "baseline_m") / _numbers(part, "range_m")
        fit = _slope(np.log(ratio), np.log(_numbers(part, "sigma_alpha")), _Groups.of(part))
        slopes.append(
            {
                "matcher": matcher,
                "subpixel": subpixel,
                "surface": surface,
                "slope_on_t_over_d": fit["slope"],
                "slope_ci95": fit["slope_ci95"],
            }
        )
    return slopes


def best_baselines(cells: pd.DataFrame) -> list[dict[str, Any]]:
    """The baseline with the smallest error at each range, and the one that the naive law recommends.

    Errors are averaged as logarithms over directions, conditions and seeds, over the directions and conditions that
    every baseline has at that range. The naive law, d²/|t| with a constant sigma, always recommends the longest.

    Returns
    -------
    list
        Tables of `matcher`, `subpixel`, `surface`, `range_m`, `baseline_m`, `baseline_m_ci95` (None of one seed),
        `naive_baseline_m`, and `flat_from_m`, `flat_to_m`: the baselines whose error is within 10 % of the best one's.
    """
    best_of_range = []
    for (matcher, subpixel, surface, range_bin), part in cells.groupby([*_METHOD, "surface", "range_bin"], sort=True):
        curve = baseline_curve(part)
        if curve is None:
            continue
        baselines, errors, draws = curve
        best = baselines[np.argmin(draws, axis=1)]
        flat = baselines[errors <= errors.min() + np.log(1.1)]
        best_of_range.append(
            {
                "matcher": matcher,
                "subpixel": subpixel,
                "surface": surface,
                "range_m": middle_of_range(range_bin),
                "baseline_m": float(baselines[np.argmin(errors)]),
                "baseline_m_ci95": _ends_of(best) if len(part["seed"].unique()) > 1 else None,
                "flat_from_m": float(flat.min()),
                "flat_to_m": float(flat.max()),
                "naive_baseline_m": float(baselines.max()),
            }
        )
    return best_of_range


def _ends_of(best: Array) -> list[float]:
    """The central 95 % of values that were tried: each end is one of them."""
    return [float(q) for q in np.quantile(best, [0.025, 0.975], method="nearest")]


def baseline_curve(part: pd.DataFrame) -> tuple[Array, Array, Array] | None:
    """Mean log spread for each baseline over the groups of cells that all baselines share, and its bootstrap draws.

    Returns
    -------
    baselines, errors, draws
        `[baselines]` metres, `[baselines]` log metres, `[draws, baselines]`; None when fewer than three baselines
        share any group.
    """
    groups = ["alpha_bin", "condition", "seed"]
    table = part.assign(error=np.log(part["spread_m"])).pivot_table(index=groups, columns="baseline_m", values="error")
    table = table.dropna()
    if table.shape[1] < 3 or table.empty:
        return None
    by_seed = table.groupby(level="seed", sort=True)
    sums, counts = by_seed.sum().to_numpy(), by_seed.size().to_numpy(dtype=np.float64)
    weights = resampled(len(counts), BOOTSTRAP_DRAWS)
    draws = (weights @ sums) / (weights @ counts)[:, None]
    return table.columns.to_numpy(dtype=np.float64), draws[0], draws[1:]


@dataclass(frozen=True)
class _Groups:
    """The seed and the condition of each cell, as numbers `[cells]`."""

    seeds: NDArray[np.intp]
    conditions: NDArray[np.intp]

    @classmethod
    def of(cls, part: pd.DataFrame) -> "_Groups":
        """The columns of a table of cells."""
        return cls(*(pd.factorize(part[name], sort=True)[0] for name in ("seed", "condition")))

    def where(self, chosen: NDArray[np.bool_]) -> "_Groups":
        """The columns of the selected cells."""
        return _Groups(self.seeds[chosen], self.conditions[chosen])


def _numbers(part: pd.DataFrame, column: str) -> Array:
    return part[column].to_numpy(dtype=np.float64)


def _slope(x: Array, y: Array, groups: _Groups) -> dict[str, Any]:
    """The least-squares slope of y on x with an intercept for each condition, its interval, and R²."""
    fit = _within_conditions(x[:, None], y, groups)
    if fit is None:
        return {"slope": None, "slope_ci95": None, "r2": None}
    slopes, r2 = fit
    return {"slope": float(slopes[0, 0]), "slope_ci95": _interval(slopes[1:, 0], groups), "r2": r2}


def _within_conditions(x: Array, y: Array, groups: _Groups) -> tuple[Array, float | None] | None:
    """Least squares of y on all columns of x `[cells, columns]`, with an intercept for each condition.

    Returns
    -------
    coefficients, r2
        `[1 + draws, columns]`: of all seeds, and of the seeds drawn with replacement (NaN where they do not determine
        them); and R² within conditions. None with fewer than three cells, or where columns of x do not vary or are
        combinations of each other.
    """
    if len(y) < 3:
        return None
    values = np.column_stack([np.ones(len(y)), x, y])
    size = values.shape[1]
    # Sums of products are all that least squares needs; those of a drawn set of seeds are weighted sums of them.
    (seeds, seed), (conditions, condition) = (
        np.unique(each, return_inverse=True) for each in (groups.seeds, groups.conditions)
    )
    cell, cells = seed * len(conditions) + condition, len(seeds) * len(conditions)
    sums = [np.bincount(cell, values[:, i] * values[:, j], cells) for i in range(size) for j in range(size)]
    stacked = np.stack(sums, axis=-1).reshape(len(seeds), len(conditions), size, size)
    drawn = np.tensordot(resampled(len(seeds), BOOTSTRAP_DRAWS), stacked, axes=1)
    number, first = drawn[..., :1, :1], drawn[..., :1, 1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = np.nansum(drawn[..., 1:, 1:] - np.swapaxes(first, -1, -2) * first / number, axis=1)
    xx, xy, yy = scatter[:, :-1, :-1], scatter[:, :-1, -1], scatter[:, -1, -1]
    # Rounding leaves a trace where there is no spread of x at all.
    least = np.linalg.eigvalsh(xx)[:, 0]
    if not least[0] > 1e-9 * len(y):
        return None
    determined = least > 1e-9 * len(y)
    coefficients = np.full(xy.shape, np.nan)
    coefficients[determined] = np.linalg.solve(xx[determined], xy[determined][..., None])[..., 0]
    r2 = float(coefficients[0] @ xy[0] / yy[0]) if yy[0] > 0 else None
    return coefficients, r2


def _interval(draws: Array, groups: _Groups) -> list[float] | None:
    """The central 95 % of bootstrap draws; None with a single seed, which has no spread."""
    draws = draws[np.isfinite(draws)]
    if np.unique(groups.seeds).size < 2 or not draws.size:
        return None
    return [float(q) for q in np.quantile(draws, [0.025, 0.975])]


def residuals(cells: pd.DataFrame, fit: dict[str, Any]) -> Iterator[tuple[float, float]]:
    """(law/d, residual of log(spread/d)) of every cell that a fit was made from."""
    chosen = cells
    for key in (*_METHOD, "surface"):
        chosen = chosen[chosen[key] == fit[key]]
    x = np.log(chosen[f"law_{fit['law']}"] / chosen["range_m"])
    y = np.log(chosen["spread_m"] / chosen["range_m"])
    centred = y - fit["slope"] * x
    centred -= centred.groupby(chosen["condition"]).transform("mean")
    yield from zip(np.exp(x).tolist(), centred.tolist(), strict=True)
