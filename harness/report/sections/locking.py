"""Pixel locking: where estimates lie between the samples of their curves."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from harness.evaluation.statistics import Curve, mean_over_seeds
from harness.evaluation.tally import FRACTION_BINS
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.sections.error_curves import SURFACES
from harness.report.sweep import MethodStyle, Sweep
from harness.report.theme import FAINT, HALF, Picture

MIDDLE = (np.arange(FRACTION_BINS) / FRACTION_BINS + 0.5) % 1.0 - 0.5
"""Middles of the bins, as a distance from the nearest whole sample."""


_LOCKING = """
{% if near %}
Where sub-pixel estimates lie between the samples of their epipolar curves, over all trials, (a) on walls, (b) on floor
and ceiling. True positions are spread nearly evenly (dashed); a peak around 0 is pixel locking: estimates drawn towards
whole samples. A spike at 0 alone comes from estimates that the sub-pixel step could not move. Within 0.11 samples of a
whole one, where an even spread has 22.5 %, lie:
{% for label, shares in near.items() %}
{% set outer_last = loop.last %}
{{ label }} {% for words, share in shares.items() %}{{ (100 * share) | figure(".1f") }} % ({{ words }})
{{- ", " if not loop.last else ("; " if not outer_last else ". ") }}{% endfor %}{% endfor %}{{ " " }} Estimates at whole
pixels are always whole samples and are not drawn.{% if seeds > 1 %} Bands are 95 % intervals.{% endif %}
{% else %}
Where estimates lie between the samples of their epipolar curves.
{% endif %}
"""


@section_of(About.ALL_TRIALS, "locking", "Pixel locking")
def section(context: Context) -> Iterator[Block]:
    """Histograms of the estimates' positions between whole samples."""
    pictures, data, near = histograms(context.sweep)
    caption = html(_LOCKING, near=near, seeds=len(context.sweep.seeds))
    missing = "Not drawn: there is no estimate between samples."
    yield Figure("figure-locking", pictures, caption, data=data, missing=missing)


def histograms(sweep: Sweep) -> tuple[list[Picture], Data, dict[str, dict[str, float]]]:
    """Histograms of the fractional part of the estimates on walls and floors.

    Returns
    -------
    pictures, data, near
        The last for each sub-pixel method and surface: the share within 0.11 samples of a whole one.
    """
    refined = [method for method in sweep.methods if method.subpixel != "none"]
    curves = {
        (method, surface): mean_over_seeds(shares)
        for surface in SURFACES
        for method in refined
        if not (shares := _shares(sweep, method, surface)).empty
    }
    rows: list[list[object]] = []
    near: dict[str, dict[str, float]] = {}
    for (method, surface), curve in curves.items():
        near.setdefault(method.label, {})[SURFACES[surface]] = _near_whole_samples(curve)
        columns = (each[_ORDER] for each in (MIDDLE, curve.mean, curve.low, curve.high))
        rows += [[method.matcher, method.subpixel, surface, *each] for each in zip(*columns, strict=True)]
    top = 100 * max((float(np.nanmax([curve.mean, curve.high])) for curve in curves.values()), default=0.0)
    pictures = [
        _histogram({method: curve for (method, on), curve in curves.items() if on == surface}, top, words, letter)
        for (surface, words), letter in zip(SURFACES.items(), "ab", strict=True)
        if curves
    ]
    headings = ["matcher", "subpixel", "surface", "distance_samples", "share", "ci95_low", "ci95_high"]
    return pictures, Data("pixel-locking", headings, rows), near


_ORDER = np.argsort(MIDDLE)


def _near_whole_samples(curve: Curve) -> float:
    return float(curve.mean[np.abs(MIDDLE) <= 0.1 + 1e-9].sum())


@theme.panel
def _histogram(curves: dict[MethodStyle, Curve], top: float, words: str, letter: str) -> Picture:
    """The histograms of one surface on axes up to 1.25 `top` per cent."""
    order = np.append(_ORDER, _ORDER[0])  # the first bin again as the last: positions are periodic
    at = np.append(MIDDLE[_ORDER], 0.5)
    edges = np.append(at - 0.5 / FRACTION_BINS, 0.5 + 0.5 / FRACTION_BINS)
    fig = theme.figure(HALF, 280)
    ax = theme.axes(fig, 56, 12, HALF - 70, 220)
    described = []
    for method, curve in curves.items():
        mean, low, high = (100 * each[order] for each in (curve.mean, curve.low, curve.high))
        if np.isfinite(low).all():
            lower, upper = (np.append(each, each[-1]) for each in (low, high))
            ax.fill_between(edges, lower, upper, step="post", color=method.colour, alpha=0.2, linewidth=0)
        label = theme.plain(method.label)
        ax.stairs(mean, edges, color=method.colour, linestyle=method.stroke, linewidth=1.2, baseline=None, label=label)
        described.append(f"{method.label} {100 * _near_whole_samples(curve):.0f} %")
    ax.axhline(100 / FRACTION_BINS, color=FAINT, linestyle=(0, (5, 2)), linewidth=1.0)
    ax.set_xlim(-0.5, 0.5)
    ax.set_xticks([-0.5, -0.25, 0, 0.25, 0.5], ["−½", "−¼", "0", "¼", "½"])
    ax.set_ylim(0, 1.25 * top if top else 5)
    ax.set_xlabel("distance from the nearest whole sample (samples)")
    ax.set_ylabel(f"share of estimates (% per {1 / FRACTION_BINS:g})")
    if described:
        ax.legend(loc="upper left", ncol=2)
    else:
        theme.note(ax, "no sub-pixel estimate")
    alt = (
        f"Histogram of the distance of sub-pixel estimates on {words} from the nearest whole sample. Shares within "
        f"0.11 samples, 22.5 % if spread evenly: {', '.join(described) or 'none'}."
    )
    return theme.picture(fig, alt, f"({letter}) {words}")


def _shares(sweep: Sweep, method: MethodStyle, surface: str) -> pd.DataFrame:
    """The shares of the bins: one row for each trial, by seed, and one column for each bin."""
    chosen = [
        (seed, payload["fractions"][surface])
        for seed, matcher, subpixel, payload in zip(
            sweep.trials["seed"], sweep.trials["matcher"], sweep.trials["subpixel"], sweep.payloads, strict=True
        )
        if (matcher, subpixel) == (method.matcher, method.subpixel) and sum(payload["fractions"].get(surface, ()))
    ]
    if not chosen:
        return pd.DataFrame()
    seeds, counts = zip(*chosen, strict=True)
    table = np.array(counts, dtype=np.float64)
    return pd.DataFrame(
        table / table.sum(axis=1, keepdims=True), index=pd.MultiIndex.from_arrays([seeds, range(len(seeds))])
    )
