"""Formulas as SVG, made while the site is built: they show without a script, a web font or the network."""

import re
from html import escape
from typing import Any

import ziafont
import ziamath
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

SIZE_PX = 18.0
"""Size in which a formula is drawn; on the page it goes with the text around it."""
EM_PX = 16.6
"""What counts as one em of that size: STIX Two's letters are a little smaller than those of the page."""


def svg(tex: str, *, inline: bool) -> str:
    """An `<svg>` of a formula, on the baseline of its line, with its TeX for those who cannot see it."""
    formula = ziamath.Latex(_split(tex), size=SIZE_PX, inline=inline)
    text = formula.svg()
    _, y, width, height = (float(each) for each in re.search(r'viewBox="([^"]*)"', text).group(1).split())
    style = f"width:{width / EM_PX:.3f}em;height:{height / EM_PX:.3f}em;vertical-align:{-(y + height) / EM_PX:.3f}em"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{escape(tex, quote=True)}" style="{style}"'
    return re.sub(r"<svg [^>]*?viewBox", f"{head.replace(chr(92), chr(92) * 2)} viewBox", text, count=1)


def _split(tex: str) -> str:
    """Several lines of a display as an aligned block, as Sphinx's own renderers take them."""
    return rf"\begin{{aligned}}{tex}\end{{aligned}}" if r"\\" in tex and r"\begin" not in tex else tex


def visit_math(writer: Any, node: nodes.math) -> None:
    """Write an inline formula."""
    writer.body.append(f'<span class="formula">{svg(node.astext(), inline=True)}</span>')
    raise nodes.SkipNode


def visit_math_block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own, and its number."""
    number = ""
    identity = ""
    if node["number"]:
        number = f'<span class="eqno">({get_node_equation_number(writer, node)})</span>'
        identity = f' id="{node["ids"][0]}"' if node["ids"] else ""
    drawn = svg(node.astext().strip(), inline=False)
    writer.body.append(
        f'<div class="formula-block"{identity}><div class="formula-scroll">{drawn}</div>{number}</div>\n'
    )
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer `svg`."""
    ziafont.config.svg2 = False  # paths in place: symbols of several formulas on a page would share their ids
    ziamath.config.math.color = "currentColor"
    app.add_html_math_renderer("svg", (visit_math, None), (visit_math_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
