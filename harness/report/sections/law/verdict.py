"""The verdict on the law, method by method, and where and why it fails."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from harness.evaluation.law import GROSS, verdicts
from harness.evaluation.law_images import SHORT
from harness.evaluation.statistics import FEW_SEEDS
from harness.report.data import interval
from harness.report.markup import html
from harness.report.section import About, Block, Context, InAbstract, Paragraph, section_of
from harness.report.sections.error_curves import SURFACES
from harness.report.sections.law.part import INTRO, Fit, is_of
from harness.report.sweep import MethodStyle, Sweep
from harness.report.typography import figure, typeset

_WORDS = """
<p>Plotting one against the other proves nothing: range is computed from {{ alpha(2) }}, so its error <em>is</em> the
law times the error of {{ alpha(2) }}, by calculus. What can fail is the premise that makes the law a prediction: that
the spread of that angle, σ({{ alpha(2) }}), is the same for all ranges and baselines. If it is, the relative error of
the range is proportional to the law over the range, and log(spread/<i>d</i>) against log(law/<i>d</i>) has slope 1.
That is tested in three steps: geometry alone checks the formulas, images test the premise, and a decomposition shows
what σ({{ alpha(2) }}) depends on.</p>
<p>Observations are cells of one trial: walls or floor, a sixth of the directions, a band of ranges, with at least 200
estimates. Spreads are 1.4826 times the median absolute error. Intervals hold 95 % and come from resampling the
{{ seeds }} seeds, never pixels{% if few_seeds %}; with so few seeds they are rather too short{% endif %}.
“Compatible” means only that the interval contains 1.</p>
<h3>Verdict</h3>
"""
_NOTE = """
<p class="note">Where a law of small errors must fail: on floors, which slant away from the viewer, so that a window
covers many disparities; for small windows in noise, which find wrong matches, whose errors depend on what else lies
in the search interval; and near the baseline’s direction, where {{ alpha(1) }} is small or close to 180° and
d²/|<b>t</b>| leaves out the factor 1/sin {{ alpha(1) }} and the difference between {{ d(1) }} and {{ d(2) }}. Which of
these occur in the present data is stated above; the figures below show how much.</p>
"""
_FINDINGS = """
<ul class="findings">
{% for each in findings %}
<li style="--key: {{ each.method.colour }}"><b>{{ surfaces[each.surface] | capitalize }}, {{ each.method.label }}.</b>
 {{ each.words | symbols }}
{% if each.reasons %}<ul>{% for reason in each.reasons %}<li>{{ reason | symbols }}</li>{% endfor %}</ul>
{% endif %}
</li>
{% endfor %}
</ul>
"""
_IN_ABSTRACT = '<p>The law method by method, and where it fails: <a href="#verdict">verdict and reasons</a>.</p>'


@section_of(About.ALL_TRIALS, "verdict", "The law of the range error, tested")
def section(context: Context) -> Iterator[Block]:
    """The law, its test, and the result."""
    if not context.law:
        return
    judged = findings(context.sweep, context.law)
    seeds = len(context.sweep.seeds)
    yield Paragraph(html(INTRO) + html(_WORDS, seeds=seeds, few_seeds=seeds < FEW_SEEDS))
    yield Paragraph(html(_FINDINGS, findings=judged, surfaces=SURFACES))
    yield Paragraph(html(_NOTE))
    yield InAbstract(html(_IN_ABSTRACT))


@dataclass(frozen=True)
class Finding:
    """The verdict on the law for one method and surface."""

    method: MethodStyle
    surface: str
    words: str
    """The verdict of the evaluation."""
    reasons: list[str]
    """Sentences on where and why the law fails, as far as the numbers show it."""


def findings(sweep: Sweep, law: dict[str, Any]) -> list[Finding]:
    """The verdict for every method and surface, with where the law fails."""
    listed = []
    for surface in sweep.surfaces:
        for method in sweep.methods:
            fits = [fit for fit in law["images"] if is_of(fit, method, surface)]
            exact = next((fit for fit in fits if fit["law"] == "exact" and fit["slope"] is not None), None)
            if exact is None:
                continue
            (judged,) = verdicts(fits, sweep.cells, directions=False)
            text = typeset(f"{judged.text[:1].upper()}{judged.text[1:]}.")
            listed.append(Finding(method, surface, text, list(_reasons(sweep, method, surface, exact, law))))
    return listed


def _reasons(sweep: Sweep, method: MethodStyle, surface: str, exact: Fit, law: dict[str, Any]) -> Iterator[str]:
    """Sentences on directions in which 1 lies outside the slope's interval, and on the growth of the angle's error."""
    known = [each for each in exact["by_alpha_1"] if each["slope_ci95"] is not None]
    off = [each for each in known if not each["slope_ci95"][0] <= 1 <= each["slope_ci95"][1]]
    if known and off:
        directions = ", ".join(
            f"{each['from_deg']:g}\u2060–\u2060{each['to_deg']:g}°\u00a0({figure(each['slope'], '.2f')})"
            for each in off
        )
        which = "all directions" if len(off) == len(known) else f"{len(off)} of {len(known)} directions"
        yield f"1 lies outside the interval in {which}: α₁ = {directions}."
        yield from _long_baselines(off)
    elif known:
        yield f"In each of the {len(known)} directions alone, the interval contains 1."
    grown = next((each for each in law["sigma_alpha"] if is_of(each, method, surface)), None)
    if grown and grown["slope_ci95"] is not None:
        slope, (low, high) = grown["slope_on_t_over_d"], grown["slope_ci95"]
        power = f"the power {figure(slope, '.2f')} {interval((low, high), '.2f')} of |t|/d"
        if low <= 0 <= high:
            yield f"σ(α₂) grows as {power}: no significant dependence on baseline and range."
        else:
            tail = (
                "the law’s one empirical premise, a constant σ(α₂), does not hold here"
                if abs(slope) > 0.3
                else "a small dependence, but a significant one"
            )
            yield f"σ(α₂) grows as {power}: {tail}."
    cells = sweep.cells_of(method, surface)
    low_half, high_half = _gross_halves(cells)
    if max(low_half, high_half) > GROSS:
        yield (
            f"Estimates off by over a pixel: {100 * low_half:.0f}\u00a0% in the half of the cells with the "
            f"smaller |t|/d, {100 * high_half:.0f}\u00a0% in the other half."
        )


def _long_baselines(off: list[Fit]) -> Iterator[str]:
    """A sentence on the direction with the lowest slope, if short baselines alone bring it near 1."""
    lowest = min(off, key=lambda each: float(each["slope"]))
    short = lowest.get("short")  # rows of earlier versions have none
    if not short or short["slope"] is None or short["slope_ci95"] is None:
        return
    if lowest["slope"] < 1 and abs(short["slope"] - 1) < 0.7 * abs(lowest["slope"] - 1):
        yield (
            f"Long baselines bend it: at {lowest['from_deg']:g}\u2060–\u2060{lowest['to_deg']:g}° the slope is "
            f"{figure(lowest['slope'], '.2f')} {interval(lowest['slope_ci95'], '.2f')} over all cells, and "
            f"{figure(short['slope'], '.2f')} {interval(short['slope_ci95'], '.2f')} over those with |t|/d below "
            f"{SHORT:g}. There view 2 sees walls beside the rig the most foreshortened, so that a window of fixed "
            "shape covers several disparities."
        )


def _gross_halves(cells: pd.DataFrame) -> tuple[float, float]:
    ratio = cells["baseline_m"] / cells["range_m"]
    halves = (cells[ratio <= ratio.median()], cells[ratio > ratio.median()])
    low, high = (
        float((half["gross"] * half["pixels"]).sum() / half["pixels"].sum()) if len(half) else 0.0 for half in halves
    )
    return low, high
