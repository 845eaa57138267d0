"""Numbers and symbols as they are set on a page."""

import re

from markupsafe import Markup, escape


def figure(value: float, form: str) -> str:
    """A number with a true minus sign; one that rounds to zero has no sign."""
    text = format(value, form)
    if not text.strip("+-0."):
        text = text.lstrip("+-")
    return text.replace("-", "−")


def typeset(text: str) -> str:
    """Plain text with true minus signs, and a space before each percent sign."""
    return re.sub(r"(?<=\d)%", "\u00a0%", re.sub(r"(?<![\w.])-(?=[\d.])", "−", text))


_SYMBOLS = {
    "α₁": "<i>α</i><sub>1</sub>",
    "α₂": "<i>α</i><sub>2</sub>",
    "|t|": "|<b>t</b>|",
    "d²/": "<i>d</i>²/",
    "/d": "/<i>d</i>",
}


def symbols(text: str) -> Markup:
    """Plain text as HTML, its symbols set as in the captions."""
    pattern = r"α[₁₂]|\|t\||\bd²/(?=\|t\|)|(?<=\|t\|)/d\b"
    return Markup(re.sub(pattern, lambda match: _SYMBOLS[match[0]], escape(text)))  # noqa: S704  # escaped before
