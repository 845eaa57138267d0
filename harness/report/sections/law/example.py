"""The law of the range error: the paper's worked example, and measured errors."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.geometry.triangulation import exact_alpha_2, paper_law, sensitivity_to_alpha_2
from harness.pipeline.trial import Outcome
from harness.report import theme
from harness.report.data import Data
from harness.report.markup import html
from harness.report.method_styles import Method
from harness.report.section import About, Block, Context, Figure, FixedTable, Paragraph, section_of
from harness.report.sections.law.part import INTRO
from harness.report.theme import FAINT, HALF, INK, Picture

BASELINE_M, RANGE_M, ERROR_DEG = 0.5, 3.0, 1.0
"""The paper's worked example (section 6): half a metre of baseline, a wall 3 m away, one degree."""


EDGES_DEG = np.arange(30.0, 151.0, 10.0)
"""Edges of the bins of alpha_1."""
_BESIDE_DEG = (np.arange(0.0, 31.0, 10.0), np.arange(150.0, 181.0, 10.0))
"""Bins within 30° of the baseline, which no figure counts."""


_ELSEWHERE = """
<p>The formulas are in the <a href="#verdict">section on the test of the law</a>; here they are evaluated for the
paper’s example and compared with the base trial.</p>
"""
_EXAMPLE = """
<p>The paper’s worked example is a baseline of {{ "%g" | format(baseline_m) }} m, a wall
{{ "%g" | format(range_m) }} m away and an error of {{ "%g" | format(error_deg) }}°, for which it says about 0.3 m.</p>
"""
_EXAMPLE_CAPTION = """
The worked example: error of the range for {{ "%g" | format(error_deg) }}° of <i>α</i><sub>2</sub>, |<b>t</b>| =
{{ "%g" | format(baseline_m) }} m, <i>d</i><sub>1</sub> = {{ "%g" | format(range_m) }} m.
"""
_EXAMPLE_TABLE = """
<thead><tr><th scope="col" class="text">Angle to the baseline, <i>α</i><sub>1</sub></th>
<th scope="col">Exact law <span class="unit">m</span></th>
<th scope="col">Short form, <i>d</i><sub>1</sub>²/|<b>t</b>| <span class="unit">m</span></th>
<th scope="col">Exact / short</th></tr></thead>
<tbody>
{% for each in example %}
  <tr><th scope="row">{{ "%g" | format(each.alpha_1_deg) }}°</th><td>{{ each.exact_m | figure(".3f") }}</td>
  <td>{{ each.short_m | figure(".3f") }}</td><td>{{ (each.exact_m / each.short_m) | figure(".2f") }}</td></tr>
{% endfor %}
</tbody>
"""
_CHARTS = """
(a) Both forms of the law for the worked example. (b) Measured on walls of this experiment, in bins of 10°: the median
absolute range error of each method, and the law times a quarter of the distance between samples of the curve, which is
the median that rounding to the nearest sample alone would give. Behind grey and paler: within 30° of the baseline,
which no figure counts.
"""
_ROUNDING = """
<p>If rounding to whole samples were the only source of error, every error at whole pixels would lie within the law
times half a step.</p>
"""
_WITHIN_CAPTION = """
Share of wall pixels of the domain whose absolute range error is at most the law times a number of steps; a step is the
distance in <i>α</i><sub>2</sub> between neighbouring samples of the pixel’s curve at the true match.
"""
_WITHIN_TABLE = """
<thead><tr><th scope="col" class="text">Method</th><th scope="col">Pixels</th>
{% for steps in all_steps %}<th scope="col">Within {{ "%g" | format(steps) }} step{{ "s" if steps > 1 }}
 <span class="unit">%</span></th>{% endfor %}</tr></thead>
<tbody>
{% for each in within %}
  <tr><th scope="row" class="nowrap">{{ each.label }}</th><td>{{ each.pixels }}</td>
  {% for steps in all_steps %}<td>{{ (100 * each.shares[loop.index0]) | figure(".1f") if each.shares else "–" }}</td>
  {% endfor %}</tr>
{% endfor %}
</tbody>
"""


def _title(context: Context) -> str:
    return "The law of the range error: worked example" if context.law else "The law of the range error"


@section_of(About.BASE_TRIAL, "law", _title, needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """The worked example, the errors by direction, and those that rounding explains."""
    methods = context.methods
    numbers_of = {"baseline_m": BASELINE_M, "range_m": RANGE_M, "error_deg": ERROR_DEG}
    yield Paragraph(html(_ELSEWHERE if context.law else INTRO) + html(_EXAMPLE, **numbers_of))
    yield FixedTable(html(_EXAMPLE_TABLE, example=worked_example()), html(_EXAMPLE_CAPTION, **numbers_of))
    yield Figure(
        "figure-law",
        [law_chart(), measured_chart(methods)],
        html(_CHARTS),
        data=Data("law-example-and-measured", ["what", "alpha_1_deg", "range_error_m"], list(numbers(methods))),
    )
    yield Paragraph(html(_ROUNDING))
    within = [within_steps(method.outcome, method.label) for method in methods]
    yield FixedTable(html(_WITHIN_TABLE, within=within, all_steps=STEPS), html(_WITHIN_CAPTION))


@dataclass(frozen=True)
class Example:
    """One row of the worked example."""

    alpha_1_deg: float
    exact_m: float
    short_m: float
    """The error of the range by the paper's short form, metres."""


def worked_example() -> list[Example]:
    """The error of the range for one degree of alpha_2, at three angles to the baseline."""
    return [
        Example(
            angle, float(_exact(np.array([angle]))[0]), float(paper_law(RANGE_M, BASELINE_M) * np.radians(ERROR_DEG))
        )
        for angle in (90.0, 30.0, 15.0)
    ]


@dataclass(frozen=True)
class Within:
    """The shares of one outcome's range errors within the errors that whole samples cause."""

    label: str
    pixels: int
    shares: tuple[float, ...]
    """Shares of the absolute range errors within law times `STEPS` of a whole step."""


STEPS = (0.5, 1.0, 1.5)
"""Whole steps between the samples of a curve."""


def within_steps(outcome: Outcome, label: str) -> Within:
    """Measured range errors beside the law times half a step, on wall pixels of the domain."""
    walls = _walls(outcome)
    predicted = 2 * outcome.reference.law[walls] * outcome.reference.half_step[walls]
    error = np.abs(outcome.errors.range_m[walls])
    shares = tuple(float(np.mean(error <= steps * predicted)) for steps in STEPS) if error.size else ()
    return Within(label, int(walls.sum()), shares)


@theme.panel
def law_chart() -> Picture:
    """Both forms of the law over alpha_1, for the worked example."""
    fig = theme.figure(HALF, 320)
    ax = theme.axes(fig, 58, 12, HALF - 70, 258)
    angle = np.linspace(10, 170, 161)
    ax.plot(angle, _exact(angle), color=INK, label=r"exact, $d_2^2\,/\,(|t|\,\sin\,\alpha_1)$")
    short = float(paper_law(RANGE_M, BASELINE_M) * np.radians(ERROR_DEG))
    ax.axhline(short, color=theme.PIXEL, linestyle=(0, (4, 2)), label="short form, $d_1^2\\,/\\,|t|$")
    for example in worked_example():
        ax.plot(example.alpha_1_deg, example.exact_m, "o", color=INK, markersize=4)
        ax.annotate(
            f"{example.exact_m:.3f} m",
            (example.alpha_1_deg, example.exact_m),
            (0, 9) if example.alpha_1_deg == 90 else (7, 3),
            textcoords="offset points",
            ha="center" if example.alpha_1_deg == 90 else "left",
            fontsize=9.5,
        )
    ax.set_xlim(0, 180)
    ax.set_xticks(range(0, 181, 30))
    ax.set_ylim(0, 1.3)
    ax.set_xlabel(r"angle to the baseline $\alpha_1$ (°)")
    ax.set_ylabel("range error for 1° (m)")
    ax.legend(loc="upper center")
    alt = (
        "Range error for one degree of alpha 2 over alpha 1, at 0.5 metres of baseline and 3 metres of range: the "
        "exact law is smallest near 71 degrees and grows without bound towards 0 and 180; the short form is constant "
        "at 0.314 metres."
    )
    return theme.picture(fig, alt, "(a) the worked example")


@theme.panel
def measured_chart(methods: list[Method]) -> Picture:
    """Measured errors over alpha_1 beside what rounding to whole samples predicts."""
    fig = theme.figure(HALF, 320)
    ax = theme.axes(fig, 58, 12, HALF - 70, 258)
    middle = (EDGES_DEG[:-1] + EDGES_DEG[1:]) / 2
    described = []
    for method in methods:
        median = _measured(method)
        ax.plot(middle, median, "o-", color=method.colour, markersize=4, label=theme.plain(f"measured, {method.label}"))
        if np.isfinite(median).any():
            described.append(f"{method.label} between {np.nanmin(median):.0f} and {np.nanmax(median):.0f} mm")
        _left_out(ax, method)
    ax.plot(middle, _expected(methods[0]), color=FAINT, linestyle=(0, (4, 2)), label=r"law $\times$ ¼ step")
    ax.set_xlim(0, 180)
    ax.set_xticks(range(0, 181, 30))
    for edges in _BESIDE_DEG:
        ax.axvspan(edges[0], edges[-1], color=theme.OUTSIDE, linewidth=0, zorder=0)
    ax.set_xlabel(r"angle to the baseline $\alpha_1$ (°)")
    ax.set_ylabel("median absolute range error, walls (mm)")
    if described:
        counted = [line.get_ydata() for line in ax.get_lines() if line.get_alpha() is None]
        ax.set_ylim(0, 1.3 * np.nanmax(np.concatenate(counted)))
        ax.legend(loc="upper center")
    else:
        theme.note(ax, "no wall pixel has an estimate")
    alt = (
        "Median absolute range error on walls in bins of 10 degrees of alpha 1: "
        f"{'; '.join(described) or 'no estimate'}; "
        "beside the median that rounding to the nearest whole sample alone would give."
    )
    return theme.picture(fig, alt, "(b) measured on walls")


def numbers(methods: list[Method]) -> Iterator[list[object]]:
    """The numbers of both charts: name of the curve, alpha_1 in degrees, metres."""
    angle = np.arange(10.0, 171.0, 2.0)
    short = float(paper_law(RANGE_M, BASELINE_M) * np.radians(ERROR_DEG))
    yield from (["example_exact", *each] for each in zip(angle, _exact(angle), strict=True))
    yield from (["example_short_form", each, short] for each in angle)
    middle = (EDGES_DEG[:-1] + EDGES_DEG[1:]) / 2
    for method in methods:
        yield from ([f"measured_{method.key}", *each] for each in zip(middle, _measured(method) / 1000, strict=True))
    yield from (["law_times_quarter_step", *each] for each in zip(middle, _expected(methods[0]) / 1000, strict=True))


def _measured(method: Method) -> Array:
    """Median absolute range error on walls in each bin of alpha_1, millimetres."""
    walls = _walls(method.outcome)
    angle = np.degrees(method.outcome.reference.alpha_1[walls])
    return _binned(angle, 1000 * np.abs(method.outcome.errors.range_m[walls]), EDGES_DEG)


def _left_out(ax: Axes, method: Method) -> None:
    """Draw the median errors on walls near the baseline's directions, as far as the axes reach."""
    outcome = method.outcome
    near_baseline = outcome.valid & outcome.truth.visible & ~outcome.reference.sideways & outcome.reference.wall
    angle = np.degrees(outcome.reference.alpha_1[near_baseline])
    for edges in _BESIDE_DEG:
        median = _binned(angle, 1000 * np.abs(outcome.errors.range_m[near_baseline]), edges)
        ax.plot((edges[:-1] + edges[1:]) / 2, median, "o-", color=method.colour, markersize=4, alpha=0.4)


def _expected(method: Method) -> Array:
    """The law times a quarter of a step on walls in each bin of alpha_1, millimetres."""
    walls, reference = _walls(method.outcome), method.outcome.reference
    expected = 500 * reference.law[walls] * reference.half_step[walls]
    return _binned(np.degrees(reference.alpha_1[walls]), expected, EDGES_DEG)


def _exact(alpha_1_deg: Array) -> Array:
    a_1 = np.radians(alpha_1_deg)
    points = RANGE_M * np.stack([np.cos(a_1), np.sin(a_1), np.zeros_like(a_1)], axis=-1)
    a_2 = exact_alpha_2(points, [BASELINE_M, 0.0, 0.0])
    return np.asarray(np.abs(sensitivity_to_alpha_2(a_1, a_2, BASELINE_M)) * np.radians(ERROR_DEG))


def _walls(outcome: Outcome) -> NDArray[np.bool_]:
    return outcome.valid & outcome.reference.domain & outcome.reference.wall


def _binned(angle: Array, values: Array, edges: Array) -> Array:
    """Median of the values in each bin; NaN where a bin has fewer than 20."""
    index = np.digitize(angle, edges) - 1
    return np.array(
        [np.median(values[index == i]) if np.count_nonzero(index == i) >= 20 else np.nan for i in range(edges.size - 1)]
    )
