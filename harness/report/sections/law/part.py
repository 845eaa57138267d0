"""Shared by the sections on the law: names, symbols and the law itself."""

from typing import Any

from harness.report.sweep import MethodStyle

LAW_NAMES = {"exact": "exact law", "paper": "$d^2/|t|$"}
PLAIN_NAMES = {"exact": "exact law", "paper": "d²/|t|", "bound": "exact law × bound"}

Fit = dict[str, Any]
"""An entry of the summary's `law`."""

INTRO = """
<p>An error of the angle <i>α</i><sub>2</sub>, under which the second view sees a point, shifts the estimated range
by</p>
<div class="equation">
<math display="block" alttext="∂d1/∂α2 = −d2² / (|t| sin α1)">
  <mfrac><mrow><mo>∂</mo><msub><mi>d</mi><mn>1</mn></msub></mrow><mrow><mo>∂</mo><msub><mi>α</mi><mn>2</mn></msub></mrow></mfrac>
  <mo>=</mo><mo>−</mo>
  <mfrac><msubsup><mi>d</mi><mn>2</mn><mn>2</mn></msubsup><mrow><mi>|</mi><mi>𝐭</mi><mi>|</mi><mspace width="0.2em"></mspace><mi>sin</mi><mspace width="0.2em"></mspace><msub><mi>α</mi><mn>1</mn></msub></mrow></mfrac>
  <mspace width="1em"></mspace><mo>≈</mo><mspace width="0.5em"></mspace><mo>−</mo>
  <mfrac><msubsup><mi>d</mi><mn>1</mn><mn>2</mn></msubsup><mrow><mi>|</mi><mi>𝐭</mi><mi>|</mi></mrow></mfrac>
</math>
</div>
<p>that is, minus {{ d(2) }} squared over |<b>t</b>| sin {{ alpha(1) }}, exactly; the paper shortens it to {{ d(1) }}
squared over |<b>t</b>|, for {{ alpha(1) }} = 90° and a baseline that is short beside the range.</p>
"""  # noqa: E501
"""The law itself, as HTML."""


def is_of(entry: dict[str, Any], method: MethodStyle, surface: str) -> bool:
    """Whether an entry of the summary is about this method and surface."""
    return (entry["matcher"], entry["subpixel"], entry["surface"]) == (method.matcher, method.subpixel, surface)
