"""The premise of the law: how the angle's own error, mismatches and losses grow."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.evaluation.statistics import mean_over_seeds
from harness.report import theme
from harness.report.data import Data, Heading, Table, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Figure, LineKey, Paragraph, TableBlock, section_of
from harness.report.sections.error_curves import SURFACES, draw_line, key_picture
from harness.report.sections.law.part import is_of
from harness.report.sweep import Sweep
from harness.report.theme import Picture

_WORDS = """
<p>The geometry of a pair of views depends on |<b>t</b>|/<i>d</i> alone: the larger it is, the less the law amplifies an
error of the angle, but the more differently the two views see a surface: windows are deformed, and parts are hidden
from one view. The law contains only the first effect. The disparity panels of the <a href="#sweeps">sweeps</a> show how
σ({{ alpha(2) }}) depends on window and noise.</p>
"""
_SIGMA = """
The premise of the law: (a) the spread of the angle, in pixels of {{ "%.4g" | format(column_deg) }}°, against the
baseline over the range; a constant σ(<i>α</i><sub>2</sub>) would be a level line. (b) Share of the estimates that are
off by more than a pixel. (c) The spread by direction. (d) Share of the pixels that both views see but that have no
estimate. Means over conditions and seeds (geometric for spreads), with 95 % intervals as bands. Different
|<b>t</b>|/<i>d</i> come from partly different cells.
"""
_POWERS = """
Power of |<b>t</b>|/<i>d</i> with which σ(<i>α</i><sub>2</sub>) grows, all conditions and directions together; 0 if it
does not depend on baseline and range. This power and the slope on the law belong together: where the error of the angle
grows with |<b>t</b>|/<i>d</i>, the error of the range cannot fall as the law says.
"""


@section_of(About.ALL_TRIALS, "law-decomposition", "The law: decomposition")
def section(context: Context) -> Iterator[Block]:
    """The dependence of σ(alpha_2) on |t|/d and direction."""
    sweep, law = context.sweep, context.law
    if not law:
        return
    yield Paragraph(html(_WORDS))
    yield LineKey(key_picture(sweep, laws=False))
    yield _angle_spread(sweep, context.column_deg)
    yield TableBlock("table-law-sigma", _sigma_table(sweep, law), html(_POWERS), full=False)


def _angle_spread(sweep: Sweep, column_deg: float) -> Figure:
    """The angle's own error, mismatches and losses against |t|/d and direction."""
    rows: list[list[Any]] = []
    cells = sweep.cells
    step = math.log(RANGE_RATIO)
    ratio_bin = np.round(np.log(cells["baseline_m"] / cells["range_m"]) / step)
    near = (RANGE_RATIO**ratio_bin).rename("x")
    middles = np.array([(low + high) / 2 for low, high in pairwise(ALPHA_1_EDGES_DEG)])
    direction = pd.Series(middles[cells["alpha_bin"].to_numpy()], index=cells.index)
    sigma_px = np.degrees(cells["sigma_alpha"]) / column_deg
    ratio_label = r"$|t|\,/\,d$"
    alpha_label = r"angle to the baseline $\alpha_1$ (°)"
    pictures = [
        _against(
            sweep,
            near,
            sigma_px,
            ratio_label,
            "$\\sigma(\\alpha_2)$ (px)",
            "(a) the angle’s spread",
            rows,
            "sigma_px",
            log_y=True,
        ),
        _against(
            sweep,
            near,
            cells["gross"],
            ratio_label,
            "off by over 1 px (% of estimates)",
            "(b) mismatches",
            rows,
            "gross",
            scale=100,
        ),
        _against(
            sweep,
            direction,
            sigma_px,
            alpha_label,
            "$\\sigma(\\alpha_2)$ (px)",
            "(c) by direction",
            rows,
            "sigma_px",
            log_y=True,
            log_x=False,
        ),
        _against(
            sweep,
            near,
            cells["missing"],
            ratio_label,
            "without an estimate (% of pixels)",
            "(d) lost",
            rows,
            "missing",
            scale=100,
        ),
    ]
    headings = ["matcher", "subpixel", "surface", "measure", "against", "at", "mean", "ci95_low", "ci95_high"]
    caption = html(_SIGMA, column_deg=column_deg)
    return Figure("figure-law-sigma", pictures, caption, data=Data("law-decomposition", headings, rows))


@theme.panel
def _against(
    sweep: Sweep,
    x: "pd.Series[float]",
    y: "pd.Series[float]",
    label: str,
    ordinate: str,
    title: str,
    rows: list[list[Any]],
    name: str,
    *,
    log_x: bool = True,
    log_y: bool = False,
    scale: float = 1.0,
) -> Picture:
    fig, panels = theme.pair()
    described, drawn = [], []
    for ax, (surface, surface_words) in zip(panels, SURFACES.items(), strict=True):
        ax.set_title(surface_words)
        for method in sweep.methods:
            cells = sweep.cells_of(method, surface)
            if cells.empty:
                continue
            values = np.log(y[cells.index]) if log_y else y[cells.index]
            table = cells.assign(x=x[cells.index], value=values).pivot_table(
                index=["seed", "condition"], columns="x", values="value", aggfunc="mean"
            )
            table = np.exp(table) if log_y else table
            curve = mean_over_seeds(table, logarithmic=log_y)
            at = [float(value) for value in table.columns]
            draw_line(ax, method, at, curve, scale)
            drawn += [scale * curve.mean, scale * curve.low, scale * curve.high]
            described.append(
                f"{method.label} on {surface_words} from {scale * curve.mean[0]:.3g} to {scale * curve.mean[-1]:.3g}"
            )
            against = "t_over_d" if log_x else "alpha_1_deg"
            rows += [
                [method.matcher, method.subpixel, surface, name, against, *each]
                for each in zip(at, curve.mean, curve.low, curve.high, strict=True)
            ]
    known = np.concatenate(drawn)
    known = known[np.isfinite(known)]
    for ax in panels:
        if log_x:
            theme.logarithmic(ax, "x", float(x.min()) / 1.15, float(x.max()) * 1.15, most=5)
        else:
            ax.set_xlim(ALPHA_1_EDGES_DEG[0], ALPHA_1_EDGES_DEG[-1])
            ax.set_xticks(ALPHA_1_EDGES_DEG[1:-1])
        if log_y:
            theme.logarithmic(ax, "y", float(known.min()) / 1.25, float(known.max()) * 1.25)
        else:
            ax.set_ylim(0, max(1.08 * float(known.max()), 1.0))
        ax.set_xlabel(label)
    panels[0].set_ylabel(ordinate)
    plain = ordinate.replace("$\\sigma(\\alpha_2)$", "sigma of alpha 2")
    return theme.picture(fig, f"{plain} against {'|t|/d' if log_x else 'alpha 1'}: {'; '.join(described)}.", title)


def _sigma_table(sweep: Sweep, law: dict[str, Any]) -> Table:
    headings = [
        Heading("Surface", text=True),
        Heading("Method", text=True),
        Heading("σ(α₂) on |t|/d", "power"),
        Heading("95 % low"),
        Heading("95 % high"),
    ]
    rows = []
    for surface in sweep.surfaces:
        for method in sweep.methods:
            for each in law["sigma_alpha"]:
                if is_of(each, method, surface):
                    low, high = each["slope_ci95"] or (None, None)
                    rows.append(
                        [
                            words(SURFACES[surface]),
                            words(method.label, method.colour),
                            number(each["slope_on_t_over_d"], "+.3f"),
                            number(low, "+.3f"),
                            number(high, "+.3f"),
                        ]
                    )
    return Table(headings, rows)
