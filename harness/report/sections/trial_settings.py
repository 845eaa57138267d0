"""All settings of the trial that is shown in detail, and the experiment as TOML."""

from collections.abc import Iterator

from harness.report import words
from harness.report.markup import html
from harness.report.section import About, Block, Context, Paragraph, section_of
from harness.report.sweep import texts_of, values_of
from harness.spec import dump_toml

_SETTINGS = """
<p>All settings of the trial that the figures are about, defaults included.
{%- if varied %} Those that vary between trials:
{% for axis, values in varied.items() %}<code>{{ axis }}</code> ({{ values | join(", ") }})
{{- "; " if not loop.last else "." }}{% endfor %}{% endif %}</p>
<div class="settings">
{% for section, rows in settings %}
<table>
  <caption><code>{{ section }}</code></caption>
  <tbody>
  {% for name, value, unit in rows %}
    <tr><th scope="row"><code{% if section ~ "." ~ name in varied %} class="varied"{% endif %}>{{ name }}</code></th>
    {#- #}<td>{{ value }}{{ " " if unit and unit != "°" }}{{ unit }}</td></tr>
  {% endfor %}
  </tbody>
</table>
{% endfor %}
</div>
<details>
  <summary>The whole experiment as TOML, with the scene’s objects</summary>
  <pre tabindex="0" role="region" aria-label="The experiment as TOML">{{ toml }}</pre>
</details>
"""


@section_of(About.THE_RUN, "settings", "Settings")
def section(context: Context) -> Iterator[Block]:
    """The settings of the base trial, those that vary between trials marked."""
    varied = {key: texts_of(values) for key, values in values_of(context.result.rows).items()}
    toml = dump_toml(context.result.experiment, given=True)
    yield Paragraph(html(_SETTINGS, varied=varied, settings=words.settings(context.trial), toml=toml))
