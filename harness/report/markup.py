"""Jinja for the pages: templates of whole pages, and fragments of HTML that live beside the code they describe."""

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from harness.display import unbroken
from harness.report import typography


def html(text: str, **values: Any) -> Markup:
    """A fragment of HTML: a caption or a paragraph, with the `values` put in and escaped.

    Parameters
    ----------
    text
        Jinja source. It has the filters `figure` (a number with a true minus sign), `symbols` (plain text with its
        symbols typeset), `typeset` (plain text with true minus signs) and `sentence` (with a capital), and the
        functions `d(n)` and `alpha(n)` (the symbols with their index) and `key(label, colour)` (a method's name beside
        its colour).
    """
    # Safe: the source is this program's, and Jinja escapes the values.
    return Markup(_fragment(text).render(values))  # noqa: S704


@cache
def _fragment(text: str) -> Template:
    return _of_fragments().from_string(text)


def template(name: str) -> Template:
    """A template of a whole page; its figures and tables are numbered from 1, once: take a new one for each page."""
    return _environment().get_template(name)


@cache
def _of_fragments() -> Environment:
    return _environment()


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("harness.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = typography.figure
    environment.filters["unbroken"] = unbroken
    environment.filters["symbols"] = typography.symbols
    environment.filters["typeset"] = typography.typeset
    environment.filters["sentence"] = lambda text: f"{text[:1].upper()}{text[1:]}"
    environment.globals["d"] = lambda n: Markup("<i>d</i><sub>{}</sub>").format(n)
    environment.globals["alpha"] = lambda n: Markup("<i>α</i><sub>{}</sub>").format(n)
    environment.globals["key"] = lambda label, colour: Markup('<span class="key" style="--key: {}">{}</span>').format(
        colour, label
    )
    return environment
