"""Pixel locking: where estimates lie between the samples of their curves."""

import numpy as np
import pandas as pd

from harness.evaluation.metrics import FRACTION_BINS
from harness.report import theme
from harness.report.data import Data
from harness.report.statistics import mean_over_seeds
from harness.report.sweep import Sweep, Way
from harness.report.sweeps import SURFACES
from harness.report.theme import FAINT, Picture

MIDDLE = (np.arange(FRACTION_BINS) / FRACTION_BINS + 0.5) % 1.0 - 0.5
"""Of the bins, as a distance from the nearest whole sample."""


def histograms(sweep: Sweep) -> tuple[list[Picture], Data, dict[str, dict[str, float]]]:
    """Histograms of the fractional part of the estimates on walls and floors.

    Returns
    -------
    pictures, data, near
        The last for each sub-pixel way and surface: the share within a tenth of a sample of a whole one.
    """
    order = np.argsort(MIDDLE)
    even = 100 / FRACTION_BINS
    rows: list[list[object]] = []
    near: dict[str, dict[str, float]] = {}
    refined = [way for way in sweep.ways if way.subpixel != "none"]
    fig, panels = theme.pair()
    top = even
    for ax, (surface, words) in zip(panels, SURFACES.items(), strict=True):
        ax.set_title(words)
        drawn = False
        for way in refined:
            shares = _shares(sweep, way, surface)
            if shares.empty:
                continue
            curve = mean_over_seeds(shares)
            mean, low, high = (100 * each[order] for each in (curve.mean, curve.low, curve.high))
            edges = np.append(MIDDLE[order] - 0.5 / FRACTION_BINS, MIDDLE[order][-1] + 0.5 / FRACTION_BINS)
            if np.isfinite(low).all():
                ax.fill_between(
                    edges,
                    np.append(low, low[-1]),
                    np.append(high, high[-1]),
                    step="post",
                    color=way.colour,
                    alpha=0.2,
                    linewidth=0,
                )
            ax.stairs(mean, edges, color=way.colour, linestyle=way.stroke, linewidth=1.2)
            top, drawn = max(top, float(np.nanmax(np.append(mean, high)))), True
            near.setdefault(way.label, {})[words] = float(curve.mean[np.abs(MIDDLE) <= 0.1 + 1e-9].sum())
            rows += [
                [way.matcher, way.subpixel, surface, at, *each]
                for at, *each in zip(MIDDLE[order], mean / 100, low / 100, high / 100, strict=True)
            ]
        ax.axhline(even, color=FAINT, linestyle=(0, (5, 2)), linewidth=1.0)
        ax.set_xlim(-0.5, 0.5)
        ax.set_xticks([-0.5, 0, 0.5], ["−½", "0", "½"])
        ax.set_xlabel("distance from a whole sample")
        if not drawn:
            theme.note(ax, "no sub-pixel estimate")
    for ax in panels:
        ax.set_ylim(0, 1.1 * top)
    panels[0].set_ylabel(f"share of estimates (% per {1 / FRACTION_BINS:g})")
    told = "; ".join(
        f"{label}: {', '.join(f'{100 * share:.0f} % on {words}' for words, share in shares.items())}"
        for label, shares in near.items()
    )
    alt = (
        "Histogram of the distance of sub-pixel estimates from the nearest whole sample. Shares within a tenth of a "
        f"sample, 22.5 % if spread evenly: {told or 'none'}."
    )
    headings = ["matcher", "subpixel", "surface", "distance_samples", "share", "ci95_low", "ci95_high"]
    pictures = [theme.picture(fig, alt)] if near else []
    return pictures, Data("pixel-locking", headings, rows), near


def _shares(sweep: Sweep, way: Way, surface: str) -> pd.DataFrame:
    """One row a trial, by seed; one column a bin."""
    chosen = [
        (seed, payload["fractions"][surface])
        for seed, matcher, subpixel, payload in zip(
            sweep.trials["seed"], sweep.trials["matcher"], sweep.trials["subpixel"], sweep.payloads, strict=True
        )
        if (matcher, subpixel) == (way.matcher, way.subpixel) and sum(payload["fractions"].get(surface, ()))
    ]
    if not chosen:
        return pd.DataFrame()
    seeds, counts = zip(*chosen, strict=True)
    table = np.array(counts, dtype=np.float64)
    return pd.DataFrame(
        table / table.sum(axis=1, keepdims=True), index=pd.MultiIndex.from_arrays([seeds, range(len(seeds))])
    )
