"""The software and the machine of a run, and its wall times."""

import json
from collections.abc import Iterator

import numpy as np

from harness.report.data import Heading, Table, number, words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Paragraph, TableBlock, section_of
from harness.runs.remarks import remarks
from harness.runs.run import Result

_ENVIRONMENT = """
<div class="settings">
<table>
  <caption>Environment</caption>
  <tbody>
  {% for name, value in environment.items() if name != "packages" %}
    <tr><th scope="row">{{ name | replace("_", " ") }}</th><td class="text">{{ value }}</td></tr>
  {% endfor %}
  </tbody>
</table>
<table>
  <caption>Packages</caption>
  <tbody>
  {% for name, value in environment.packages.items() %}
    <tr><th scope="row">{{ name }}</th><td>{{ value }}</td></tr>
  {% endfor %}
  </tbody>
</table>
</div>
"""
_REMARKS = """
<p>What matchers say of how they made their matches:</p>
<ul>{% for remark in remarks %}<li>{{ remark }}.</li>{% endfor %}</ul>
"""
_DURATIONS = """
Wall time of each stage{% if rows > 4 %} over the {{ done }} trials that are done{% endif %}. A result that
trials share is counted for the first of them.
"""


@section_of(About.THE_RUN, "environment", "Provenance and durations")
def section(context: Context) -> Iterator[Block]:
    """Versions, machine, and wall time by stage."""
    result = context.result
    yield Paragraph(html(_ENVIRONMENT, environment=result.environment))
    if lines := remarks(result.rows):
        yield Paragraph(html(_REMARKS, remarks=lines))
    caption = html(_DURATIONS, rows=len(result.rows), done=context.summary["trials"]["done"])
    yield TableBlock("durations", durations(result), caption, full=False)


def durations(result: Result) -> Table:
    """Wall time by stage: of each trial when they are few, else over all of them."""
    done = [row for row in result.rows if row.state == "done"]
    seconds = [json.loads(row.finished.seconds) for row in done]
    stages = list(dict.fromkeys(stage for each in seconds for stage in each))
    if len(done) <= 4:
        head = [Heading("Stage", text=True), *(Heading(f"Trial {row.planned.key}", "s") for row in done)]
        rows = [[words(stage), *(number(each.get(stage), ".3f") for each in seconds)] for stage in stages]
        rows.append([words("total"), *(number(sum(each.values()), ".3f") for each in seconds)])
        return Table(head, rows)
    head = [Heading("Stage", text=True), Heading("Median", "ms a trial"), Heading("Longest", "ms"), Heading("Sum", "s")]
    rows = []
    for stage in [*stages, "total"]:
        values = np.array([sum(each.values()) if stage == "total" else each.get(stage, 0.0) for each in seconds])
        rows.append(
            [
                words(stage),
                number(float(np.median(values)), ".1f", 1000),
                number(float(values.max()), ".0f", 1000),
                number(float(values.sum()), ".1f"),
            ]
        )
    return Table(head, rows)
