"""Geometry alone: exact angles with errors of known size, triangulated."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from harness.evaluation.law_geometry import GeometryCheck, check_geometry
from harness.geometry.angles import Array
from harness.report import theme
from harness.report.data import Cell, Data, Heading, Table, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, Paragraph, TableBlock, section_of
from harness.report.theme import FAINT, HALF, INK, Picture

LINEAR = 0.05
"""The linearisation breaks down where a spread is off by more than this share."""


_WORDS = """
<p>Exact angles are given Gaussian errors of known size and triangulated, for a baseline of 0.5 m, three ranges, six
directions and six sizes of error. No images are involved: this verifies the formulas and shows where they break
down.</p>
"""
_RATIOS = """
Measured over predicted, one mark for each of the {{ points }} combinations, against the spread that the exact law
predicts as a share of the range. (a) Spread of the range over that by the exact law (black) and by d²/|<b>t</b>|
(orange). (b) Mean error of the range over the bias of second order,
½ ∂²<i>d</i><sub>1</sub>/∂<i>α</i><sub>2</sub>² σ². Bars at the edge are values beyond the axes.
{% if lost %}In {{ lost }} combinations some rays no longer meet; they are not drawn.{% endif %}
"""
_TABLE = """
Geometry alone: measured over predicted for the smallest error of the angle (at most {{ small | figure(".1f") }} % of
the range), over all ranges and directions. The last column is where the linearisation breaks down: the smallest
predicted spread for which the measured one differs by more than 5 %.
"""


@section_of(About.ALL_TRIALS, "law-geometry", "The law: geometry alone")
def section(context: Context) -> Iterator[Block]:
    """Exact angles with known noise: measured over predicted."""
    if not context.law:
        return
    check = _geometry()
    relative = check.relative_spread.ravel()
    kinds = _ratio_kinds(check)
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
    data = Data(
        "law-geometry",
        ["relative_spread", "spread_over_exact", "spread_over_paper", "bias_over_second_order"],
        [list(each) for each in zip(relative, *kinds.values(), strict=True)],
    )
    yield Paragraph(html(_WORDS))
    lost = int(np.isnan(kinds["spread / exact law"]).sum())
    yield Figure("figure-law-geometry", pictures, html(_RATIOS, points=relative.size, lost=lost), data=data)
    small = 100 * float(check.relative_spread[..., 0].max())
    yield TableBlock("table-law-geometry", _table(check), html(_TABLE, small=small))


def _ratio_kinds(check: GeometryCheck) -> dict[str, Array]:
    """Measured over predicted, one value for each combination."""
    return {
        "spread / exact law": check.spread_over_exact.ravel(),
        "spread / short form d²/|t|": check.spread_over_paper.ravel(),
        "bias / second-order bias": check.bias_over_second_order.ravel(),
    }


@lru_cache(maxsize=1)
def _geometry() -> GeometryCheck:
    return check_geometry()


def _table(check: GeometryCheck) -> Table:
    """Median, smallest and largest for the smallest error of the angle, and where the linearisation ends."""
    relative, kinds = check.relative_spread.ravel(), _ratio_kinds(check)
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
    return Table(
        [
            Heading("Measured over predicted", text=True),
            Heading("Median"),
            Heading("Smallest"),
            Heading("Largest"),
            Heading(f"First off by {100 * LINEAR:.0f}\u00a0%", "spread, % of the range"),
        ],
        rows,
    )


@theme.panel
def _ratios(
    relative: Array, drawn: dict[str, str], kinds: dict[str, Array], title: str, span: tuple[float, float]
) -> Picture:
    fig = theme.figure(HALF, 300)
    ax = theme.axes(fig, 56, 30, HALF - 70, 224)
    ax.axhline(1, color=FAINT, linewidth=0.8)
    described = []
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
        described.append(f"{name} median {np.nanmedian(values):.3f}, largest {np.nanmax(values):.2f}")
    theme.logarithmic(ax, "x", 100 * float(relative.min()) / 1.2, 100 * float(relative.max()) * 1.2)
    ax.set_ylim(*span)
    ax.set_xlabel("predicted spread, law × σ / d (% of the range)")
    ax.set_ylabel("measured over predicted")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncol=2, borderaxespad=0.2, handletextpad=0.3)
    return theme.picture(
        fig,
        f"{title[4:].capitalize()} of the range measured over predicted, against the predicted relative spread: "
        f"{'; '.join(described)}.",
        title,
    )
