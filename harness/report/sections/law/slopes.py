"""The slopes on both laws: over all directions, by direction and by condition."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from harness.evaluation.law_images import LAWS, fit_laws
from harness.evaluation.regions import ALPHA_1_EDGES_DEG
from harness.report import theme
from harness.report.data import Cell, Heading, Table, count, number, words
from harness.report.sections.error_curves import SURFACES
from harness.report.sections.law.part import LAW_NAMES, PLAIN_NAMES, Fit, is_of
from harness.report.sweep import MethodStyle, Sweep, in_words
from harness.report.theme import Picture
from harness.report.typography import figure


@theme.panel
def by_direction(sweep: Sweep, fits: list[Fit], surface: str, letter: str) -> Picture:
    """Slopes within each sixth of the directions."""
    fig, panels = theme.pair()
    middle = np.array([(low + high) / 2 for low, high in pairwise(ALPHA_1_EDGES_DEG)])
    described = []
    drawn = [1.0]
    for ax, law in zip(panels, LAWS, strict=True):
        ax.axhline(1, color=theme.TRUTH, linestyle=(0, (4, 2.5)), linewidth=0.9)
        ax.set_title(LAW_NAMES[law])
        ax.set_xlim(ALPHA_1_EDGES_DEG[0], ALPHA_1_EDGES_DEG[-1])
        ax.set_xticks(ALPHA_1_EDGES_DEG[1:-1])
        ax.set_xlabel(r"angle to the baseline $\alpha_1$ (°)")
        for index, method in enumerate(sweep.methods):
            fit = next((each for each in fits if is_of(each, method, surface) and each["law"] == law), None)
            if fit is None:
                continue
            x = middle + 3.0 * (index - (len(sweep.methods) - 1) / 2)
            slopes = np.array([np.nan if each["slope"] is None else each["slope"] for each in fit["by_alpha_1"]])
            bounds = np.array([each["slope_ci95"] or (np.nan, np.nan) for each in fit["by_alpha_1"]]).T
            ax.vlines(x, *bounds, color=method.colour, linewidth=1.3)
            ax.plot(x, slopes, method.marker, color=method.colour, markersize=4.6, markerfacecolor=method.face)
            known = slopes[np.isfinite(slopes)]
            if known.size:
                drawn += [float(known.min()), float(known.max())]
                described.append(
                    f"{method.label} {PLAIN_NAMES[law]} {figure(float(known.min()), '.2f')} to "
                    f"{figure(float(known.max()), '.2f')}"
                )
    low, high = min(0.0, *drawn), max(drawn)
    for ax in panels:
        ax.set_ylim(low - 0.12 * (high - low), high + 0.2 * (high - low))
    panels[0].set_ylabel("slope")
    name = SURFACES[surface]
    return theme.picture(
        fig, f"Slopes on both laws by direction, {name}: {'; '.join(described)}.", f"({letter}) {name}"
    )


_SURFACE_AND_METHOD = (Heading("Surface", text=True), Heading("Method", text=True))
_SLOPE = (Heading("Slope"), Heading("95 % low"), Heading("95 % high"), Heading("R²"))


def slope_table(sweep: Sweep, fits: list[Fit]) -> Table:
    """Slopes over all directions."""
    return _table(sweep, fits, Heading("Law", text=True), lambda fit: words(PLAIN_NAMES[fit["law"]]))


def noise_table(sweep: Sweep, fits: list[Fit]) -> Table:
    """Slopes on the exact law for each noise level separately."""
    return _table(sweep, fits, Heading("Noise", "grey"), lambda fit: number(fit["sigma_grey"], "g"))


def _table(sweep: Sweep, fits: list[Fit], heading: Heading, cell: Callable[[Fit], Cell]) -> Table:
    """A row for each fit, with a column for what distinguishes the fits of one method and surface."""
    rows = [
        [*_who(surface, method), cell(fit), *_slope_cells(fit), count(fit["cells"])]
        for surface in sweep.surfaces
        for method in sweep.methods
        for fit in fits
        if is_of(fit, method, surface)
    ]
    return Table([*_SURFACE_AND_METHOD, heading, *_SLOPE, Heading("Cells")], rows)


def _who(surface: str, method: MethodStyle) -> list[Cell]:
    return [words(SURFACES[surface]), words(method.label, method.colour)]


def _slope_cells(fit: Fit) -> list[Cell]:
    low, high = fit["slope_ci95"] or (None, None)
    return [number(fit["slope"], ".3f"), number(low, ".3f"), number(high, ".3f"), number(fit["r2"], ".2f")]


def condition_table(sweep: Sweep) -> Table:
    """Slopes on the exact law within each condition; nothing when there is one only."""
    headings = [
        Heading("Condition", text=True),
        *_SURFACE_AND_METHOD,
        *_SLOPE,
        Heading("Off by over 1 px", "%"),
    ]
    rows: list[list[Cell]] = []
    if sweep.cells["condition"].nunique() < 2:
        return Table(headings, rows)
    for condition, cells in sweep.cells.groupby("condition", sort=False):
        fits = fit_laws(cells.assign(alpha_bin=-1), ["exact"])  # over all directions: parts of each would take long
        for surface in sweep.surfaces:
            for method in sweep.methods:
                part = method.of(cells[cells["surface"] == surface])
                rows += [
                    [
                        words(in_words(sweep.conditions[str(condition)])),
                        *_who(surface, method),
                        *_slope_cells(fit),
                        number(float((part["gross"] * part["pixels"]).sum() / part["pixels"].sum()), ".0f", 100),
                    ]
                    for fit in fits
                    if is_of(fit, method, surface) and fit["law"] == "exact"
                ]
    return Table(headings, rows)


def coefficient_table(sweep: Sweep, fits: list[Fit]) -> Table:
    """The coefficients of the law and of the bound, each by itself; see `law_images.fit_law_and_bound`."""
    headings = [
        *_SURFACE_AND_METHOD,
        Heading("Law"),
        Heading("95 % low"),
        Heading("95 % high"),
        Heading("Bound"),
        Heading("95 % low"),
        Heading("95 % high"),
        Heading("R²"),
        Heading("Cells"),
    ]
    rows = []
    for surface in sweep.surfaces:
        for method in sweep.methods:
            for fit in fits:
                if is_of(fit, method, surface):
                    law, bound = (fit[f"{name}_ci95"] or (None, None) for name in ("law", "bound"))
                    values = (fit["law"], *law, fit["bound"], *bound)
                    rows.append(
                        [
                            *_who(surface, method),
                            *(number(value, ".3f") for value in values),
                            number(fit["r2"], ".2f"),
                            count(fit["cells"]),
                        ]
                    )
    return Table(headings, rows)
