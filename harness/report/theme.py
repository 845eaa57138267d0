"""The style of figures, and their conversion to parts of a page.

Everything is drawn on `Figure` objects, never through pyplot, and in sizes of CSS pixels: one is 1/96 inch.
"""

import io
import re
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import Any, ParamSpec
from urllib.parse import unquote

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FixedLocator, FuncFormatter, MultipleLocator, NullLocator
from numpy.typing import NDArray
from PIL import Image

from harness import interrupts

PIXEL, SUBPIXEL, TRUTH = "#D55E00", "#0072B2", "#000000"
"""Colours after Okabe and Ito, which colour-blind readers can distinguish too."""
SPARE = ("#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#882255")
OCHRE = "#7A5C00"
"""One more, as dark as none of the others, for the eighth cause of an error budget."""
INK, FAINT, PAPER = "#222222", "#8A8A8A", "#FFFFFF"
OUTSIDE, UNMATCHED = "#DEDEDE", "#F1F1F1"
"""Greys behind samples outside the domain, and behind samples without an estimate."""

WIDE, HALF = 1040, 510
"""Widths of a figure and of one of two beside each other, CSS pixels."""

_DPI = 96
_STYLE: dict[str, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "axes.titley": 1.0,  # else matplotlib lays all ticks out to see whether a title is in their way
    "axes.labelsize": 10.5,
    "axes.labelpad": 3,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "xtick.minor.visible": False,
    "ytick.minor.visible": False,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.5,
    "image.interpolation": "none",
    "image.composite_image": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "omnirange",  # for the ids inside an SVG; a random salt would make every report different
    "svg.image_inline": True,
    "path.simplify": True,
    "path.simplify_threshold": 0.1,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "savefig.facecolor": PAPER,
}


@dataclass(frozen=True)
class Picture:
    """A figure, or a panel of one, ready for an `<img>`."""

    source: Markup
    """A data URI, ready for an attribute in double quotes."""
    width: int
    height: int
    """CSS pixels."""
    alt: str
    """Alternative text."""
    title: str = ""
    """The panel's own line under it, such as `(a) environment`."""
    failure: str = ""
    """The error with which drawing failed; the page shows it in place of the picture."""
    pdf: bytes = b""
    """The picture as a PDF file; only under `with_pdf`."""

    @property
    def svg(self) -> str:
        """The drawing, as a file of its own."""
        return unquote(self.source.removeprefix(_SVG))


_P = ParamSpec("_P")
_failures: ContextVar[list[str] | None] = ContextVar("failures", default=None)
_with_pdf: ContextVar[bool] = ContextVar("with_pdf", default=False)
_SVG = "data:image/svg+xml,"


@contextmanager
def style() -> Iterator[list[str]]:
    """Draw in the report's style, whatever matplotlib's settings are, and leave those as they were.

    Settings come from the user's `matplotlibrc`, the environment or a plug-in. Yields the list that `panel` adds to:
    a line for each panel that could not be drawn.
    """
    failures: list[str] = []
    token = _failures.set(failures)
    try:
        with mpl.rc_context():
            # Not rcdefaults(), which warns about some of the settings that it resets.
            settings: Any = mpl.rcParams
            settings.update({key: mpl.rcParamsDefault[key] for key in _RESET})
            settings.update(_STYLE)
            yield failures
    finally:
        _failures.reset(token)


@contextmanager
def with_pdf() -> Iterator[None]:
    """Draw each picture as PDF too."""
    token = _with_pdf.set(True)
    try:
        yield
    finally:
        _with_pdf.reset(token)


_NOT_FOR_FIGURES = ("backend", "interactive", "toolbar", "webagg.", "tk.", "keymap.", "docstring.", "date.epoch")
_RESET = [key for key in mpl.rcParamsDefault if not key.startswith(_NOT_FOR_FIGURES)]


def panel(draw: Callable[_P, Picture]) -> Callable[_P, Picture]:
    """Draw a panel whose failure does not affect others: under `style` it becomes a panel that says why.

    Elsewhere the error is raised.
    """

    @wraps(draw)
    def guarded(*args: _P.args, **kwargs: _P.kwargs) -> Picture:
        failures = _failures.get()
        try:
            return draw(*args, **kwargs)
        except Exception as error:
            if failures is None:
                raise
            interrupts.check()  # Ctrl-C may come wrapped as another error
            name = f"{draw.__module__.rpartition('.')[2]}.{draw.__name__.strip('_')}"
            reason = reason_of(error)
            failures.append(f"a figure of the report could not be drawn: {name}: {reason}")
            return Picture(Markup(), HALF, HALF // 2, f"The panel {name}, not drawn.", failure=reason)

    return guarded


def reason_of(error: Exception) -> str:
    """An error in one line, for the page and for the terminal."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:500]


def plain(text: str) -> str:
    """Text from data for a figure, such that no part of it is read as mathematics."""
    return text.replace("$", r"\$")


def figure(width: int, height: int) -> Figure:
    """An empty figure, CSS pixels."""
    return Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)


def axes(fig: Figure, left: float, top: float, width: float, height: float, **options: Any) -> Axes:
    """Axes placed in CSS pixels from the figure's upper left corner.

    Fixed positions need no layout engine and make panels line up with each other.
    """
    w, h = fig.get_size_inches() * _DPI
    return fig.add_axes((left / w, 1 - (top + height) / h, width / w, height / h), **options)


def picture(fig: Figure, alt: str, title: str = "") -> Picture:
    """A figure as SVG, letters as outlines so that it looks the same everywhere, and images at their own resolution."""
    stream = io.StringIO()
    fig.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->\s*|<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = " ".join(filter(None, map(str.strip, text.split("\n")))).replace('"', "'")
    text = _shorter(text)
    text = re.sub(r"(?<=data:image/png;base64,)[^']*", lambda png: _few_colours(png[0]), text)
    width, height = (round(side * _DPI) for side in fig.get_size_inches())
    # Safe in an attribute: _escaped leaves no character that could end it or begin an entity.
    source = Markup(f"{_SVG}{_escaped(text)}")  # noqa: S704
    return Picture(source, width, height, " ".join(alt.split()), title, pdf=_pdf(fig) if _with_pdf.get() else b"")


def _pdf(fig: Figure) -> bytes:
    """A figure as PDF, with its letters as text; the same bytes each time."""
    stream = io.BytesIO()
    with mpl.rc_context({"pdf.fonttype": 42}):
        fig.savefig(stream, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})
    return stream.getvalue()


def _shorter(text: str) -> str:
    """The same drawing in two thirds of the bytes: coordinates as fine as can be seen, without useless attributes."""
    text = re.sub(r" d='([^']*)' transform='scale\(0\.015625\)'", lambda glyph: _glyph(glyph[1]), text)
    text = re.sub(r"(?<= d=')[^']*(?= ')", lambda d: _path(d[0]), text)
    text = re.sub(r"(?<=transform=')[^']*", lambda each: re.sub(r"(?<=\.\d{3})\d+", "", each[0]), text)
    text = re.sub(r" id='[A-Za-z_.]*[A-Za-z0-9]_\d+'", "", text)
    names = {name: f"g{i}" for i, name in enumerate(dict.fromkeys(re.findall(r"<path id='([A-Za-z]+-[^']*)'", text)))}
    text = re.sub(r"(?<=[#'])(?:STIX|DejaVu)[A-Za-z]*-[^']*(?=')", lambda name: names.get(name[0], name[0]), text)
    text = text.replace("xlink:href=", "href=").replace(" xmlns:xlink='http://www.w3.org/1999/xlink'", "")
    return text.replace("> <", "><").replace("; ", ";").replace(": ", ":")


@lru_cache(maxsize=1024)
def _glyph(path: str) -> str:
    """A letter, drawn in units of 1/64 at a tenth of its size: tens of them are finer than a hundredth of a point."""
    tens = re.sub(r"-?[0-9.]+", lambda number: f"{round(float(number[0]) / 10)}", path)
    return f" d='{_close(tens)}' transform='scale(.15625)'"


def _path(path: str) -> str:
    return _close(re.sub(r"(?<=\.\d\d)\d+", "", path))  # a group in what replaces it would be put in by Python code


def _close(path: str) -> str:
    return re.sub(r" (?=[A-Za-z])|(?<=[A-Za-z]) ", "", path)


def _few_colours(png: str) -> str:
    """The same PNG with a palette, in base64, where 256 colours suffice: a third to a half of the size."""
    image = Image.open(io.BytesIO(b64decode(png))).convert("RGBA")
    colours, index = np.unique(np.asarray(image).view(np.uint32)[..., 0], return_inverse=True)
    if colours.size > 256:
        return re.sub(r"\s", "", png)
    smaller = Image.fromarray(index.reshape(image.size[::-1]).astype(np.uint8), mode="P")
    rgba = colours.view(np.uint8).reshape(-1, 4)
    smaller.putpalette(rgba[:, :3].tobytes())
    stream = io.BytesIO()
    transparency = {} if (rgba[:, 3] == 255).all() else {"transparency": rgba[:, 3].tobytes()}
    smaller.save(stream, format="PNG", compress_level=7, **transparency)
    return b64encode(stream.getvalue()).decode()


def _escaped(text: str) -> str:
    """Text for a data URI: only what may not stand there as it is. Base64 would make it a third longer."""
    for character, code in (("%", "%25"), ("#", "%23"), ("<", "%3C"), (">", "%3E"), ("&", "%26"), ('"', "%22")):
        text = text.replace(character, code)
    return text


def degrees(ax: Axes, *, step: float = 45.0, label: str = r"azimuth $\varphi_1$ (°)") -> None:
    """A horizontal axis of azimuth, descending as in a panorama seen from inside."""
    ax.set_xlim(180, -180)
    ax.xaxis.set_major_locator(MultipleLocator(step))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0f}".replace("-", "−")))
    ax.set_xlabel(label)


def logarithmic(ax: Axes, side: str, low: float, high: float, *, most: int = 6) -> None:
    """A logarithmic axis from low to high with round numbers as ticks, at most so many."""
    if not (np.isfinite([low, high]).all() and 0 < low < high):
        return
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    for steps in ((1, 2, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [tick for tick in (step * 10.0**decade for decade in decades for step in steps) if low <= tick <= high]
        if len(ticks) <= most:
            break
    else:
        ticks = ticks[:: int(np.ceil(len(ticks) / most))]
    named = ax.xaxis if side == "x" else ax.yaxis
    getattr(ax, f"set_{side}scale")("log")
    getattr(ax, f"set_{side}lim")(low, high)
    named.set_major_locator(FixedLocator(ticks))
    named.set_minor_locator(NullLocator())
    named.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def pair(
    count: int = 2, *, height: int = 300, left: int = 56, top: int = 30, gap: int = 20
) -> tuple[Figure, list[Axes]]:
    """A figure of half the page's width with axes beside each other that share their ordinate."""
    fig = figure(HALF, height)
    width = (HALF - left - 12 - gap * (count - 1)) / count
    panels = [axes(fig, left + i * (width + gap), top, width, height - top - 46) for i in range(count)]
    for ax in panels:
        ax.grid(color="#E8E8E8", linewidth=0.5)
        ax.set_axisbelow(True)
    for ax in panels[1:]:
        ax.tick_params(labelleft=False)
    return fig, panels


def shade(ax: Axes, x: NDArray[np.floating], where: NDArray[np.bool_], colour: str) -> None:
    """Colour the background of the samples `where`."""
    if where.any():
        ax.fill_between(
            x,
            0,
            1,
            where=where,
            step="mid",
            transform=ax.get_xaxis_transform(),
            facecolor=colour,
            linewidth=0,
            zorder=0,
        )


def dots(
    ax: Axes,
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    colour: str,
    size: float,
    length: float = 0.0,
    *,
    alpha: float = 1.0,
) -> None:
    """Many dots as one path: a tenth of the bytes that as many markers take.

    Parameters
    ----------
    size
        Diameter in points.
    length
        In units of y; draws each as an upright stroke instead.
    alpha
        Opacity.
    """
    ends = np.stack([np.stack([x, y], axis=-1), np.stack([x, y + length], axis=-1)], axis=1).reshape(-1, 2)
    if not ends.size:
        return
    path = Path(ends, np.tile([Path.MOVETO, Path.LINETO], len(ends) // 2))
    path.should_simplify = False
    cap = "butt" if length else "round"
    patch = PathPatch(path, fill=False, edgecolor=colour, linewidth=size, capstyle=cap, zorder=3, alpha=alpha)
    patch.set_clip_path(ax.patch)
    # Not add_patch, which looks for the extrema of every segment to set the axes' limits.
    ax.add_artist(patch)


def legend_above(
    ax: Axes, handles: Sequence[Artist], labels: Sequence[str], *, gap: float, most: int | None = None
) -> None:
    """A legend above the axes, flush left, in one line or with at most so many entries in each.

    gap : in parts of the letters' height.
    """
    ax.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncol=min(len(labels), most or len(labels)) or 1,
        columnspacing=1.6,
        borderaxespad=gap,
    )


def dot_key(colour: str) -> Line2D:
    """The legend entry of `dots`."""
    return Line2D([], [], color=colour, marker="o", markersize=4, markeredgewidth=0, linestyle="none")


def note(ax: Axes, text: str) -> None:
    """Say in the middle of empty axes why they are empty."""
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color=FAINT, style="italic")
