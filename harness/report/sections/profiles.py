"""Range along rows of the panorama (the paper's figure 5)."""

from collections.abc import Iterator
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.epipolar import alpha_2_at
from harness.geometry.triangulation import triangulate
from harness.matching.registry import method_of
from harness.pipeline.trial import Outcome
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.method_styles import Method, common
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.theme import HALF, WIDE, Picture

_PROFILE = """
Range from <i>v</i><sub>1</sub> estimated for one row of the panorama (row {{ row.index }}, elevation
{{ row.elevation_deg | figure("+.1f") }}°), beside the truth; {{ row.matched }} of the {{ row.domain }} pixels of the
domain have an estimate by every method.
{% if toward is not none %}The second viewpoint lies at azimuth {{ toward | figure(".0f") }}°. {% endif %}
{% if stepped %}The grey curves in (a) are the ranges at which whole samples of the epipolar curves lie, computed from
the geometry alone: estimates at whole pixels lie on them, so the steps are discretisation.{% endif %}
 Ticks at the upper and lower edge are estimates beyond the axes. Behind grey, and paler, lies what is within 30° of the
baseline: {{ (100 * left_out) | figure(".0f") }} % of the row, where one degree costs twice as much and more, and which
no figure counts.
"""
_ROWS = """
Other rows, walls and floor:
{% for method in methods %}{{ key(method.label, method.colour) }}{{ ", " if not loop.last }}{% endfor %}
 and truth (black line); grey curves and ticks as in the figure above. Medians are over pixels of the domain with an
estimate by every method. The paper says that other rows give similar estimates. Compare the medians under the panels:
where rows show the floor, a window of fixed shape covers points of different disparity, because the floor is slanted
towards the viewer, and matching may fail altogether.
"""


@section_of(About.BASE_TRIAL, "profiles", "Range profiles", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """The row of the horizon by each method, and other rows."""
    methods = context.methods
    row, others = row_at(methods, main_row(methods)), other_rows(methods)
    span = limits(methods, row.index)
    yield Figure(
        "figure-profile",
        [profile(method, row, span, letter) for method, letter in zip(methods, ascii_lowercase, strict=False)],
        html(
            _PROFILE,
            row=row,
            toward=_azimuth_of_t(methods[0].outcome),
            stepped=context.trial.matching.whole_samples,
            left_out=float(np.mean(~methods[0].outcome.reference.sideways[row.index])),
        ),
        "wide",
        _numbers("profile", methods, [row.index]),
        paper="fig. 5(a) and (b)",
    )
    yield Figure(
        "figure-rows",
        [small_profile(methods, row_at(methods, index)) for index in others],
        html(_ROWS, methods=methods),
        data=_numbers("profiles-other-rows", methods, others, every=2),
        missing="Not drawn: no other row has enough estimates.",
    )


def _azimuth_of_t(outcome: Outcome) -> float | None:
    """The azimuth of the second viewpoint on view 1's panorama, degrees; None straight above or below."""
    x, y, _ = outcome.curves.t
    level = np.hypot(x, y) > 1e-9 * np.linalg.norm(outcome.curves.t)
    return float(np.degrees(np.arctan2(y, x))) if level else None


def _numbers(name: str, methods: list[Method], rows: list[int], every: int = 1) -> Data:
    """Range over azimuth, of every column or of every so many."""
    outcome = methods[0].outcome
    phi = np.degrees(outcome.trial.panorama.phi)
    every *= max(1, -(-phi.size // 720))
    lines: list[list[Any]] = []
    for index in rows:
        described = row_at(methods, index)
        for column in range(0, phi.size, every):
            estimates = [float(method.outcome.range_m[index, column]) for method in methods]
            lines.append(
                [
                    index,
                    described.elevation_deg,
                    phi[column],
                    float(outcome.reference.range_m[index, column]),
                    *estimates,
                ]
            )
    return Data(
        name, ["row", "elevation_deg", "azimuth_deg", "true_m", *(f"{method.key}_m" for method in methods)], lines
    )


@dataclass(frozen=True)
class Row:
    """A row of the panorama, and the surfaces that it shows."""

    index: int
    elevation_deg: float
    domain: int
    """Pixels of the domain in it."""
    matched: int
    """Pixels of these for which every method has an estimate."""
    wall: float
    """The share of the domain that lies on walls."""

    @property
    def surface(self) -> str:
        """The row in a word or two."""
        if self.wall >= 0.99:
            return "wall"
        return "floor or ceiling" if self.wall <= 0.01 else "walls and floor"


def row_at(methods: list[Method], index: int) -> Row:
    """Describe one row."""
    outcome = methods[0].outcome
    domain = outcome.reference.domain[index]
    size = int(domain.sum())
    return Row(
        index=index,
        elevation_deg=float(np.degrees(np.arctan(outcome.trial.panorama.z[index]))),
        domain=size,
        matched=int((domain & common(methods)[index]).sum()),
        wall=float((domain & outcome.reference.wall[index]).sum() / size) if size else 0.0,
    )


def main_row(methods: list[Method]) -> int:
    """The row nearest to the horizon in which every method has an estimate somewhere in the domain."""
    outcome = methods[0].outcome
    height = np.abs(outcome.trial.panorama.z)
    matched = (common(methods) & outcome.reference.domain).any(axis=1)
    return int(np.argmin(np.where(matched, height, np.inf))) if matched.any() else int(np.argmin(height))


def other_rows(methods: list[Method], count: int = 6) -> list[int]:
    """Rows spread evenly over the wall rows and over the other rows that have estimates, from the top down.

    Rows close to the main one are left out.
    """
    outcome = methods[0].outcome
    domain, usable = outcome.reference.domain, common(methods) & outcome.reference.domain
    matched = np.flatnonzero(usable.sum(axis=1) >= 0.25 * np.maximum(domain.sum(axis=1), 1))
    matched = matched[np.abs(matched - main_row(methods)) > outcome.trial.panorama.height_px // 20]
    share = (domain & outcome.reference.wall)[matched].sum(axis=1) / np.maximum(domain[matched].sum(axis=1), 1)
    walls, others = matched[share >= 0.5], matched[share < 0.5]
    half = count // 2
    from_walls = min(walls.size, max(half, count - others.size))
    return sorted({*_spread(walls, from_walls), *_spread(others, count - from_walls)})


def _spread(rows: NDArray[np.intp], count: int) -> list[int]:
    """Evenly spaced rows; the ends, where windows are cut, are left out if there are enough rows."""
    if rows.size <= count:
        return [int(row) for row in rows]
    return [int(rows[round((i + 0.5) * rows.size / count - 0.5)]) for i in range(count)]


def limits(methods: list[Method], row: int) -> tuple[float, float]:
    """Limits of a range axis, metres: around the truth of the row, so that gross errors do not hide the rest."""
    reference = methods[0].outcome.reference
    true = reference.range_m[row][reference.domain[row]]
    if not true.size:
        true = reference.range_m[row][np.isfinite(reference.range_m[row])]
    if not true.size:
        return 0.0, 1.0
    low, high = np.percentile(true, [0, 98])
    return max(0.0, float(0.72 * low)), float(1.3 * high)


@theme.panel
def profile(method: Method, row: Row, span: tuple[float, float], letter: str) -> Picture:
    """Range of one row by one method, with the ranges of whole samples of the curve."""
    outcome = method.outcome
    fig = theme.figure(WIDE, 300)
    ax = theme.axes(fig, 52, 30, WIDE - 72, 222)
    phi = np.degrees(outcome.trial.panorama.phi)
    stepped = method_of(outcome.trial.matching)[1] == "none"
    _background(ax, outcome, row.index, phi)
    if stepped:
        x, y = _levels(outcome, row.index, span)
        ax.plot(x, y, color="#B9B9B9", linewidth=0.55, zorder=1, label="ranges of whole samples")
    ax.plot(phi, outcome.reference.range_m[row.index], color=theme.TRUTH, linewidth=1.0, zorder=2, label="truth")
    beyond = _estimate(ax, method, row.index, span, size=2.3)
    theme.degrees(ax)
    ax.set_ylim(*span)
    ax.set_ylabel("range $d_1$ (m)")
    _key(ax, method)
    about = "the levels of whole samples are drawn too; " if stepped else ""
    alt = (
        f"Range over azimuth for row {row.index}, elevation {row.elevation_deg:.1f} degrees, {method.label}, against "
        f"the true range; {about}{beyond} of {row.matched} estimates in the domain lie outside the axes."
    )
    return theme.picture(fig, alt, f"({letter}) {method.label}")


@theme.panel
def small_profile(methods: list[Method], row: Row) -> Picture:
    """Range of one row by all methods, for one of several panels."""
    outcome = methods[0].outcome
    span = limits(methods, row.index)
    fig = theme.figure(HALF, 232)
    ax = theme.axes(fig, 46, 26, HALF - 64, 160)
    phi = np.degrees(outcome.trial.panorama.phi)
    _background(ax, outcome, row.index, phi)
    ax.plot(phi, outcome.reference.range_m[row.index], color=theme.TRUTH, linewidth=0.9, zorder=4)
    medians = []
    for method in methods:
        _estimate(ax, method, row.index, span, size=1.7)
        medians.append(f"{method.label} {_median_mm(method, methods, row.index)}")
    theme.degrees(ax, step=60)
    ax.set_ylim(*span)
    ax.set_ylabel("range $d_1$ (m)")
    ax.set_title(f"row {row.index}, elevation {row.elevation_deg:+.1f}°, {row.surface}".replace("-", "−"))
    alt = (
        f"Range over azimuth for row {row.index}, elevation {row.elevation_deg:.1f} degrees, {row.surface}. Median "
        f"absolute range error: {', '.join(medians)}."
    )
    return theme.picture(fig, alt, f"median |error|: {', '.join(medians)}; density {_share(row)}")


def _share(row: Row) -> str:
    return f"{100 * row.matched / row.domain:.0f}\u00a0%" if row.domain else "none"


def _median_mm(method: Method, methods: list[Method], row: int) -> str:
    compared = common(methods)[row] & method.outcome.reference.domain[row]
    error = np.abs(method.outcome.errors.range_m[row][compared])
    return f"{1000 * np.median(error):.0f}\u00a0mm" if error.size else "none"


def _background(ax: Axes, outcome: Outcome, row: int, phi: Array) -> None:
    domain, valid = outcome.reference.domain[row], outcome.valid[row]
    theme.shade(ax, phi, ~domain, theme.OUTSIDE)
    theme.shade(ax, phi, domain & ~valid, theme.UNMATCHED)


_PALE = 0.4
"""Opacity of pixels that no figure counts."""


def _estimate(ax: Axes, method: Method, row: int, span: tuple[float, float], size: float) -> int:
    """Dots, and strokes at the edge for those beyond it; how many of the latter lie in the domain."""
    outcome = method.outcome
    phi, range_m = np.degrees(outcome.trial.panorama.phi), outcome.range_m[row]
    low, high = span
    inside = (range_m >= low) & (range_m <= high)
    counted = outcome.reference.domain[row]
    for shown, alpha in ((inside & counted, 1.0), (inside & ~counted, _PALE)):
        theme.dots(ax, phi[shown], range_m[shown], method.colour, size, alpha=alpha)
    for clipped, edge, sign in ((range_m > high, high, -1), (range_m < low, low, 1)):
        theme.dots(
            ax, phi[clipped], np.full(clipped.sum(), edge), method.colour, 0.8, length=sign * 0.03 * (high - low)
        )
    return int((outcome.reference.domain[row] & np.isfinite(range_m) & ~inside).sum())


def _levels(outcome: Outcome, row: int, span: tuple[float, float]) -> tuple[Array, Array]:
    """The ranges of the whole samples of a row's curves, one line for each sample; NaN between lines."""
    curves = outcome.curves
    columns = np.arange(0, curves.grid.width_px, 2)
    first, last = curves.k_first[row, columns], curves.k_last[row, columns]
    samples = np.arange(max(int(first.min()), 0), int(last.max()) + 1)
    shape = (samples.size, columns.size)
    where = (np.full(shape, row), np.broadcast_to(columns, shape))
    k = np.broadcast_to(samples[:, None], shape).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        alpha_2 = alpha_2_at(curves, k, where)
    range_m, _ = triangulate(curves.alpha_1[where], alpha_2, float(np.linalg.norm(curves.t)))
    shown = (k >= first) & (k <= last) & outcome.reference.domain[row, columns] & (range_m < 1.3 * span[1])
    range_m = np.where(shown, range_m, np.nan)
    gap = np.full((samples.size, 1), np.nan)
    x = np.broadcast_to(np.degrees(curves.grid.phi[columns]), shape)
    return np.hstack([x, gap]).ravel(), np.hstack([range_m, gap]).ravel()


def _key(ax: Axes, method: Method) -> None:
    handles, labels = ax.get_legend_handles_labels()
    handles += [
        theme.dot_key(method.colour),
        Patch(facecolor=theme.OUTSIDE),
        Patch(facecolor=theme.UNMATCHED, edgecolor="#CCCCCC", linewidth=0.5),
    ]
    labels += [theme.plain(method.label), "not counted: within 30° of the baseline", "no estimate"]
    theme.legend_above(ax, handles, labels, gap=0.2)
