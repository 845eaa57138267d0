"""The methods compared on the base trial, and what could not be shown."""

from collections.abc import Iterator
from typing import Any

from harness.evaluation.metric_table import METRICS, Metric
from harness.evaluation.pixel_errors import MIN_SINE_ALPHA_1, Reference
from harness.report import words
from harness.report.data import Cell, Heading, Table
from harness.report.markup import html
from harness.report.method_styles import Method, Named
from harness.report.section import About, Block, Context, FixedTable, Paragraph, section_of
from harness.runs.run import Result
from harness.runs.values import shown

_LEFT_OUT = """
<p class="missing">Left out of this page:</p>
<ul>
{% for each in left_out %}<li>{{ each.matcher }}: {{ each.reason }}.</li>
{% endfor %}
</ul>
"""
_CAPTION = """
Errors against exact truth. All methods are compared on the same pixels: those of the domain for which every method has
an estimate. The domain is where the true point is visible in both views and sin <i>α</i><sub>1</sub> ≥
{{ "%g" | format(min_sine) }}, that is, more than 30° away from the baseline
{%- if domain %} ({{ domain.pixels }} pixels, {{ (100 * domain.share) | figure(".1f") }} % of the panorama;
{{ domain.on_walls }} of them on walls){% endif %}. Density is the share of it with an
estimate; pixels without one count nowhere else. Disparity errors are errors of <i>α</i><sub>2</sub>, one pixel being
2π/{{ width_px }} rad = {{ "%.4g" | format(column_deg) }}°. Bias is the mean signed error, estimate minus truth.
One trial of each method: there is no interval.
"""
_TABLE = """
<thead><tr><th scope="col" class="text">Method</th>
{% for column in columns %}
<th scope="col">{{ column.heading }} <span class="unit">{{ column.unit }}</span></th>
{% endfor %}
</tr></thead>
<tbody>
{% for heading, group in groups %}
  <tr class="group"><th scope="rowgroup" colspan="{{ columns | length + 1 }}">{{ heading }}</th></tr>
  {% for method in compared %}
  <tr><th scope="row">{{ key(method.label, method.colour) }}</th>
    {% for column in columns %}
    <td data-measure="{{ column.name }}">{{ cell(column, group[method.key]) }}</td>
    {% endfor %}</tr>
  {% endfor %}
{% endfor %}
</tbody>
"""
_ALONE = "<p>This experiment has one method only, so there is nothing to compare it with.</p>"
_ONE_TRIAL_EACH = """
<p>This table and the figures of the sections that follow it are about one trial of each method, and so without an
interval:
{% for method, coordinates, _ in trials %}{{ method.label }} ({{ coordinates or "as the base trial" }})
{{- "; " if not loop.last else "." }}{% endfor %}{{ " " }}
The <a href="#measures">table of all figures</a> has all trials.</p>
"""


def _title(context: Context) -> str:
    return "The base trial: methods compared" if context.sweep.several else "Comparison of methods"


@section_of(About.BASE_TRIAL, "comparison", _title)
def section(context: Context) -> Iterator[Block]:
    """The methods that the page leaves out, and the figures of the base trial by each method."""
    methods, left_out, summary = context.methods, context.result.details.left_out, context.summary
    if left_out:
        yield Paragraph(html(_LEFT_OUT, left_out=left_out))
    if context.sweep.several:  # elsewhere the page opens with it
        abstract = " ".join(words.abstract(context.result, context.trial, context.compared))
        yield Paragraph(html("<p>{{ said }}</p>", said=abstract))
    if context.compared:
        columns = [METRICS[name] for name in words.COMPARED]
        groups = [("Walls", summary["comparison_wall"]), ("All: walls, floor and ceiling", summary["comparison"])]
        table = html(_TABLE, columns=columns, groups=groups, compared=context.compared, cell=words.cell)
        caption = html(
            _CAPTION,
            min_sine=MIN_SINE_ALPHA_1,
            domain=_domain(methods[0].outcome.reference) if methods else None,
            width_px=context.trial.panorama.width_px,
            column_deg=context.column_deg,
        )
        yield FixedTable(
            table, caption, full=True, id="table-comparison", table=_plain(columns, groups, context.compared)
        )
    if len(methods) == 1 and not left_out:
        yield Paragraph(html(_ALONE))
    if context.sweep.several and methods:
        yield Paragraph(html(_ONE_TRIAL_EACH, trials=coordinates_of(context.result, methods)))


def _plain(columns: list[Metric], groups: list[tuple[str, dict[str, Any]]], compared: list[Named]) -> Table:
    """The same table with its groups as a column."""
    headings = [Heading("Pixels", text=True), Heading("Method", text=True)]
    headings += [Heading(each.heading, each.unit) for each in columns]
    return Table(
        headings,
        [
            [Cell(heading), Cell(method.label), *(Cell(words.cell(column, group[method.key])) for column in columns)]
            for heading, group in groups
            for method in compared
        ],
    )


def _domain(reference: Reference) -> dict[str, float]:
    """The size of the domain, as the template takes it."""
    return {
        "pixels": int(reference.domain.sum()),
        "share": float(reference.domain.mean()),
        "on_walls": int((reference.domain & reference.wall).sum()),
    }


def coordinates_of(result: Result, methods: list[Method]) -> list[tuple[Method, str, str]]:
    """Each method with the coordinates of its trial, as text, and the trial's key."""
    return [
        (method, shown(coordinates) if coordinates else "", key_of_trial)
        for method in methods
        for coordinates, key_of_trial, outcome in zip(
            result.coordinates, result.details.keys, result.outcomes, strict=True
        )
        if outcome is method.outcome
    ]
