"""Geometry alone: exact angles with errors of known size, triangulated."""

from functools import lru_cache

import numpy as np

from harness.evaluation.law_geometry import GeometryCheck, check_geometry
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, number, words
from harness.report.law.part import Part
from harness.report.theme import FAINT, HALF, INK, Picture

LINEAR = 0.05
"""The linearisation has ended where a spread is off by more than this share."""


@lru_cache(maxsize=1)
def _geometry() -> GeometryCheck:
    return check_geometry()


def geometry() -> Part:
    """Exact angles with known noise: measured over predicted."""
    check = _geometry()
    relative = check.relative_spread.ravel()
    kinds = {
        "spread / exact law": check.spread_over_exact.ravel(),
        "spread / short form d²/|t|": check.spread_over_paper.ravel(),
        "bias / second-order bias": check.bias_over_second_order.ravel(),
    }
    lost = int(np.isnan(kinds["spread / exact law"]).sum())
    pictures = [
        _ratios(
            relative,
            {"spread / exact law": INK, "spread / short form d²/|t|": theme.PIXEL},
            kinds,
            "(a) spread",
            (0.5, 2.6),
        ),
        _ratios(relative, {"bias / second-order bias": INK}, kinds, "(b) bias", (0.0, 3.0)),
    ]
    small = check.relative_spread[..., 0].max()
    rows = []
    for name, values, at_smallest in (
        ("Spread over the exact law", kinds["spread / exact law"], check.spread_over_exact[..., 0]),
        ("Spread over d²/|t|", kinds["spread / short form d²/|t|"], check.spread_over_paper[..., 0]),
        ("Bias over the second-order bias", kinds["bias / second-order bias"], check.bias_over_second_order[..., 0]),
        ("Spread from an error of |t| over d/|t| (eq. 10)", None, check.baseline_spread_over_eq10),
    ):
        finite = at_smallest[np.isfinite(at_smallest)]
        off = relative[np.abs(values - 1) > LINEAR] if values is not None else np.array([])
        end = number(float(off.min()), ".1f", 100) if off.size else Cell("–")
        rows.append(
            [
                words(name),
                number(float(np.median(finite)), ".3f"),
                number(float(finite.min()), ".3f"),
                number(float(finite.max()), ".3f"),
                end,
            ]
        )
    table = Table(
        [
            Heading("Measured over predicted", text=True),
            Heading("Median"),
            Heading("Smallest"),
            Heading("Largest"),
            Heading(f"First off by {100 * LINEAR:.0f}\u00a0%", "spread, % of the range"),
        ],
        rows,
    )
    data = Data(
        "law-geometry",
        ["relative_spread", "spread_over_exact", "spread_over_paper", "bias_over_second_order"],
        [list(each) for each in zip(relative, *kinds.values(), strict=True)],
    )
    return Part(
        {"ratios": pictures},
        {"geometry": table},
        {"ratios": data},
        {"lost": str(lost), "points": str(relative.size), "small": f"{100 * small:.1f}"},
    )


@theme.panel
def _ratios(
    relative: Array, drawn: dict[str, str], kinds: dict[str, Array], title: str, span: tuple[float, float]
) -> Picture:
    fig = theme.figure(HALF, 300)
    ax = theme.axes(fig, 56, 30, HALF - 70, 224)
    ax.axhline(1, color=FAINT, linewidth=0.8)
    told = []
    for (name, colour), marker in zip(drawn.items(), "oD", strict=False):
        values = kinds[name]
        inside = np.clip(values, *span)
        beyond = np.isfinite(values) & (inside != values)
        ax.plot(
            100 * relative,
            np.where(beyond, np.nan, inside),
            marker,
            color=colour,
            markersize=3.6,
            markeredgewidth=0,
            alpha=0.75,
            label=name,
        )
        ax.plot(100 * relative[beyond], inside[beyond], "|", color=colour, markersize=6)
        told.append(f"{name} median {np.nanmedian(values):.3f}, largest {np.nanmax(values):.2f}")
    theme.logarithmic(ax, "x", 100 * float(relative.min()) / 1.2, 100 * float(relative.max()) * 1.2)
    ax.set_ylim(*span)
    ax.set_xlabel("predicted spread, law × σ / d (% of the range)")
    ax.set_ylabel("measured over predicted")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=2, borderaxespad=0.2, handletextpad=0.3)
    return theme.picture(
        fig,
        f"{title[4:].capitalize()} of the range measured over predicted, against the predicted relative spread: "
        f"{'; '.join(told)}.",
        title,
    )
