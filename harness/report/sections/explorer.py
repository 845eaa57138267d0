"""The explorer: any pixel of the base trial with its epipolar curve, its cost, its numbers and its point in space."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from markupsafe import Markup

from harness.display import listed
from harness.report.explorer import contents
from harness.report.explorer.contents import Contents, contents_of
from harness.report.markup import html, template
from harness.report.method_styles import Method, common
from harness.report.section import About, Block, Context, Interactive, Paragraph, section_of
from harness.report.sections.error_maps import REASONS, common_limit_mm

_SCRIPTS = Path(contents.__file__).parent / "scripts"
_ORDER = ("arrays", "geometry", "pixels", "costs", "layers", "pictures", "nearest", "chart", "cloud", "explorer")
_OWN_BYTES = 150_000
"""Bytes of the scripts, the style, the words and the scene's edges, generously."""
_LAYERS = {
    "picture": "picture",
    "range": "range",
    "trueRange": "true range",
    "error": "error",
    "sigma": "σ",
    "reason": "reason",
    "occlusion": "occlusion",
}
_NOTES = """
<p class="explorer-notes">
{% if every > 1 %}
To save room, {{ every }} × {{ every }} pixels of the panorama are one here, of which the first is shown.
{% endif %}
True ranges are rounded to {{ "%g" | format(1000 * steps.trueRange) }} mm here, those of
{% for method in methods %}
{{ method.label }} to {{ "%g" | format(1000 * method.step) }} mm{{ "," if loop.last else ";" }}
{% endfor %}
and predicted standard deviations to 2 %.
{% if own %}
The cost is that of {{ own }}
{%- if cost.kind == "column" %}, at every whole column{% else %}, of filtered images rounded to
{{ "%.3g" | format(steps.grey) }} grey levels{% endif %}.
{% else %}
The cost is for comparison, {{ cost.window }} × {{ cost.window }} px squares on the filtered panoramas: no method here
has made its choice by it alone.
{% endif %}
Dashed lines and white dots are the truth.
{% if left_out %}
There is no room for {{ left_out }}; the other sections have {{ "it" if alone else "them" }}.
{% endif %}
</p>
"""
_TOO_LARGE = """
<p class="missing">Left out: the maps of {{ columns }} × {{ rows }} pixels would make this page too large.
<code>omnirange run --keep-arrays</code> keeps them as files.</p>
"""


@section_of(About.BASE_TRIAL, "explorer", "Explorer", needs_pixels=True, takes_the_rest=True)
def section(context: Context) -> Iterator[Block]:
    """The explorer, or a sentence if the maps are too large for the page."""
    methods = context.methods
    contents = contents_of(methods, common_limit_mm(methods), _start(methods), context.room - _OWN_BYTES)
    if contents is None:
        grid = context.trial.panorama
        yield Paragraph(html(_TOO_LARGE, columns=grid.width_px, rows=grid.height_px))
    else:
        yield Interactive(_body(contents), scripts())


def _start(methods: list[Method]) -> tuple[int, int] | None:
    """The pixel shown first: the middle one of the domain's pixels that all methods matched; None without any."""
    rows, columns = (common(methods) & methods[0].outcome.reference.domain).nonzero()
    middle = rows.size // 2
    return (int(rows[middle]), int(columns[middle])) if rows.size else None


def _body(made: Contents) -> Markup:
    facts = made.facts | {"reasons": [[int(each), list(words)] for each, words in REASONS.items()]}
    own = [made.shown[i].label for i in facts["cost"]["own"]]
    notes = html(
        _NOTES,
        steps=facts["steps"],
        every=facts["every"],
        methods=facts["methods"],
        cost=facts["cost"],
        own=listed(own) if own else "",
        left_out=listed(each.label for each in made.left_out) if made.left_out else "",
        alone=len(made.left_out) == 1,
    )
    text = template("explorer.html.j2").render(
        facts=json.dumps(facts, separators=(",", ":")),
        arrays=made.arrays,
        methods=made.shown,
        layers=_LAYERS,
        views=facts["views"],
        notes=notes,
    )
    return Markup(text)  # noqa: S704 - the template has escaped what is put in


@cache
def scripts() -> Markup:
    """The explorer's scripts as one, in a scope of their own."""
    parts = [(_SCRIPTS / f"{name}.js").read_text(encoding="utf-8") for name in _ORDER]
    return Markup("(() => {\n" + "\n".join(parts) + "})();\n")  # noqa: S704 - they are ours
