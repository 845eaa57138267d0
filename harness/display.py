"""The repr of payloads: one line, with the type and shape of arrays instead of their contents."""

import base64
import html
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

LONGEST = 160
"""Most characters of a repr; a longer one ends in dots."""


_NESTED = 60
"""Most characters of a value inside a repr; of a longer one only its type is shown, and its name if it has one."""


class OneLine:
    """Base of payloads: `Matches(alpha_2=float64[200, 720], confidence=float64[200, 720])`.

    For dataclasses declared with `repr=False`. What is None is left out.
    """

    def __repr__(self) -> str:
        parts = {each.name: getattr(self, each.name) for each in fields(self) if each.repr}  # type: ignore[arg-type]
        text = ", ".join(f"{name}={brief(value)}" for name, value in parts.items() if value is not None)
        return f"{type(self).__name__}({shortened(text)})"


def brief(value: Any) -> str:
    """A value in a few words: an array by its type and shape, a small one by its values, a collection by its size."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        if value.ndim == 1 and value.size <= 3:
            return "[" + ", ".join(f"{each:g}" for each in value) + "]"
        return f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    if isinstance(value, tuple) and len(value) <= 2:
        return f"({', '.join(map(brief, value))})"
    if isinstance(value, list | tuple | dict | set | frozenset):
        return f"{type(value).__name__} of {len(value)}"
    text = repr(value) if isinstance(value, OneLine) or not is_dataclass(value) else ""
    if not text or len(text) > _NESTED:
        name = getattr(value, "name", None)
        return f"{type(value).__name__}({f'{name!r}, ' if isinstance(name, str) else ''}...)"
    return text


def listed(words: Iterable[str], last: str = "and") -> str:
    """Words in a row: `a, b and c`; `none` for an empty list."""
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else "none"


def counted(number: int, noun: str) -> str:
    """A number with a noun that takes an s: `1 trial`, `2 trials`."""
    return f"{number} {noun}{'s' * (number != 1)}"


_KEPT_TOGETHER = re.compile(r"(?<=[\d\]]) (?=(?:%|dB|mm|m|px)(?!\w))|(?<=\d) (?=× \d)|(?<=\d ×) (?=\d)")


def unbroken(text: str) -> str:
    """Text in which no line ends between a number or its interval and its unit, nor within a size such as `4 × 6`."""
    return _KEPT_TOGETHER.sub("\u00a0", text)


def shortened(text: str) -> str:
    """A text in one line, no longer than `LONGEST`."""
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 4].rstrip(', ')} ..."


def shortened_labels(texts: Sequence[str], most: int = 60) -> list[str]:
    """Distinct short texts for different things: cut in the middle, or to where they differ, or else numbered.

    Parameters
    ----------
    texts
        The names of the things; two may be equal.
    most
        Characters of what comes back, at least 16.
    """
    short = [_cut(text, most) for text in texts]
    if len(set(short)) == len(short):
        return short
    groups: dict[str, list[int]] = {}
    for i, text in enumerate(short):
        groups.setdefault(text, []).append(i)
    for alike in (each for each in groups.values() if len(each) > 1):
        letters = zip(*(texts[i] for i in alike), strict=False)
        same = next((i for i, each in enumerate(letters) if len(set(each)) > 1), min(len(texts[i]) for i in alike))
        begin = max(0, same - most // 3)
        for i in alike:
            short[i] = _cut(("…" if begin else "") + texts[i][begin:], most)
    if len(set(short)) == len(short):
        return short
    return [f"{_cut(text, most - 8)} ({number})" for number, text in enumerate(short, 1)]


def _cut(text: str, most: int) -> str:
    """A text with its middle left out."""
    end = (most - 1) // 2
    return text if len(text) <= most else f"{text[: most - 1 - end]}…{text[-end:]}"


# --- Pictures in a notebook ---------------------------------------------------------------------------------------

_WIDTH_PX = 720
"""Width of a picture; larger arrays are thinned out, since a notebook keeps every picture that it shows."""


def grey(values: Any) -> bytes:
    """A PNG of grey levels 0 .. 255, `[height, width]`, or of colours `[height, width, 3]`."""
    import numpy as np

    return _png(np.clip(np.rint(np.nan_to_num(_thinned(values))), 0, 255).astype(np.uint8))


def coloured(values: Any, low: float, high: float) -> bytes:
    """A PNG of values `[height, width]`, dark at `low` and bright at `high`; missing values are light grey."""
    import matplotlib as mpl
    import numpy as np

    values = _thinned(values)
    share = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0, 1)
    colours = np.array(mpl.colormaps["viridis"](share)[..., :3])
    colours[~np.isfinite(values)] = 0.85
    return _png(np.rint(255 * colours).astype(np.uint8))


def html_figure(pictures: Mapping[str, bytes], caption: str) -> str:
    """PNG pictures one below the other, each with its title, and a caption above: HTML that needs no other file."""
    parts = [f"<div><b>{html.escape(caption)}</b></div>"]
    for title, data in pictures.items():
        source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
        parts.append(
            f'<div>{html.escape(title)}<br><img alt="{html.escape(title)}" src="{source}" '
            f'style="max-width:100%;image-rendering:pixelated"></div>'
        )
    return "\n".join(parts)


def _thinned(values: Any) -> Any:
    step = max(1, -(-values.shape[1] // _WIDTH_PX))
    return values[::step, ::step]


def _png(values: Any) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(values).save(stream, format="PNG")
    return stream.getvalue()
