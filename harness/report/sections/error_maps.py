"""Errors of the range over the whole panorama, and why pixels have no range."""

from collections.abc import Iterator
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from harness.geometry.panorama import Grid
from harness.matching.interface import Reason
from harness.report import theme
from harness.report.blocks import Fields, in_blocks
from harness.report.data import Data
from harness.report.markup import html
from harness.report.method_styles import Method, common
from harness.report.panoramas import extent_of, panorama_axes, unmirrored
from harness.report.section import About, Block, Context, Figure, section_of
from harness.report.theme import Picture

REASONS = {
    Reason.MATCHED: ("matched", "#E8EEF3"),
    Reason.CURVE_LEAVES_IMAGE: ("the curve leaves the second panorama", "#E69F00"),
    Reason.WINDOW_LEAVES_IMAGE: ("the window leaves the first panorama", "#56B4E9"),
    Reason.NO_EPIPOLAR_PLANE: ("no epipolar plane", "#000000"),
    Reason.NO_SAMPLE: ("no sample in the search interval", "#009E73"),
    Reason.BEYOND_INFINITY: ("the rays do not meet", "#CC79A7"),
    Reason.NO_MATCH: ("no match found", "#F0E442"),
    Reason.INCONSISTENT: ("inconsistent with view 2", "#0072B2"),
    Reason.OFF_CURVE: ("off its epipolar curve: it has moved", "#D55E00"),
    Reason.OCCLUDED: ("perhaps hidden from view 2", "#6F7D8C"),
    Reason.REPEATED: ("texture that repeats", "#882255"),
}
"""The reasons in words, and their colours on the map."""
_A_LINE = 4
"""Entries that fit side by side in a legend."""


_ERRORS = """
Signed range error, estimate minus truth, of every pixel of the panorama that has both. The scale is the same for all
maps and is clipped at ±{{ "%g" | format(limit_mm) }} mm; the arrows of the colour bar stand for larger errors. The
upright bands of the map at whole pixels, on walls, are the steps of the range profile.
"""
_REASONS = """
Why pixels have no range, with shares of the whole panorama. An epipolar curve is searched only if the windows
all along it are whole in the second panorama.
"""


@section_of(About.BASE_TRIAL, "maps", "Range-error maps", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """Maps of the range errors, and of the reasons for missing ranges."""
    methods = context.methods
    first = methods[0].outcome
    limit_mm = common_limit_mm(methods)
    fields: Fields = {
        f"{method.key}_range_error_median_m": (
            method.outcome.errors.range_m,
            np.isfinite(method.outcome.errors.range_m),
            np.median,
        )
        for method in methods
    }
    yield Figure(
        "figure-errors",
        [error_map(method, limit_mm, letter) for method, letter in zip(methods, ascii_lowercase, strict=False)],
        html(_ERRORS, limit_mm=limit_mm),
        "wide",
        in_blocks("range-error-blocks", context.trial.panorama, fields),
    )
    shares = [
        [reason.name.lower(), int(pixels.sum()), float(pixels.mean())]
        for reason in Reason
        for pixels in [first.reason == reason]
        if pixels.any()
    ]
    yield Figure(
        "figure-reasons",
        [reason_map(methods[0])],
        html(_REASONS),
        "wide",
        Data("reasons", ["reason", "pixels", "share"], shares),
    )


def common_limit_mm(methods: list[Method]) -> float:
    """Symmetric limit for all maps: three quarters of the domain's absolute errors by the worst method fit, rounded."""
    errors = [np.abs(m.outcome.errors.range_m[m.outcome.reference.domain & common(methods)]) for m in methods]
    limit = max((1000 * float(np.nanpercentile(each, 75)) for each in errors if each.size), default=100.0)
    size = 10.0 ** np.floor(np.log10(max(limit, 1e-3)))
    return float(size * next(step for step in (1, 2, 3, 5, 10) if limit <= step * size * (1 + 1e-9)))


@theme.panel
def error_map(method: Method, limit_mm: float, letter: str) -> Picture:
    """Signed range error of every pixel with an estimate and a truth."""
    outcome, grid = method.outcome, method.outcome.trial.panorama
    error = 1000 * outcome.errors.range_m
    fig, ax, bar = panorama_axes(grid, top=28)
    ax.patch.set(facecolor="#D4D4D4", edgecolor="#A8A8A8", hatch="/////")
    drawn = ax.imshow(
        unmirrored(error), cmap=_diverging(), vmin=-limit_mm, vmax=limit_mm, extent=extent_of(grid), aspect="auto"
    )
    fig.colorbar(drawn, cax=bar, label="range error (mm)", extend="both")
    outline_domain(ax, method)
    _legend(
        ax,
        [
            Patch(facecolor="#D4D4D4", edgecolor="#A8A8A8", hatch="/////", linewidth=0),
            Patch(facecolor="none", edgecolor="black", linewidth=0.9, linestyle="--"),
        ],
        ["no estimate or no truth", r"inside the dashed lines $\sin\,\alpha_1 < 0.5$: outside the domain"],
    )
    known = error[outcome.reference.domain & np.isfinite(error)]
    beyond = f"{100 * np.mean(np.abs(known) > limit_mm):.0f} %" if known.size else "none"
    alt = (
        f"Map of the signed range error over the panorama, {method.label}, clipped at ±{limit_mm:g} mm; {beyond} of "
        "the estimates in the domain are clipped."
    )
    return theme.picture(fig, alt, f"({letter}) {method.label}")


@theme.panel
def reason_map(method: Method) -> Picture:
    """A map of the reasons for missing ranges, with the domain's outline."""
    return reasons_picture(method.outcome.reason, method.outcome.trial.panorama, method)


@theme.panel
def reasons_picture(why: NDArray[np.uint8], grid: Grid, method: Method | None = None) -> Picture:
    """A map of `Reason` over a panorama."""
    present = [reason for reason in Reason if (why == reason).any()]
    number = np.zeros(why.shape)
    for index, reason in enumerate(present):
        number[why == reason] = index
    names, colours = zip(*(REASONS[reason] for reason in present), strict=True)
    fig, ax, _ = panorama_axes(grid, top=28 if len(present) <= _A_LINE else 46, bar=False)
    ax.imshow(
        unmirrored(number),
        cmap=ListedColormap(list(colours)),
        vmin=-0.5,
        vmax=len(present) - 0.5,
        extent=extent_of(grid),
        aspect="auto",
    )
    if method is not None:
        outline_domain(ax, method)
    shares = [100 * float((why == reason).mean()) for reason in present]
    labels = [f"{name} ({share:.1f} %)" for name, share in zip(names, shares, strict=True)]
    _legend(ax, [Patch(facecolor=colour, edgecolor="#999999", linewidth=0.4) for colour in colours], labels)
    return theme.picture(fig, f"Map of the reasons why pixels have no range: {'; '.join(labels)}.", "")


def outline_domain(ax: Axes, method: Method) -> None:
    """Dashed lines where sin(alpha_1) = 0.5."""
    outcome, grid = method.outcome, method.outcome.trial.panorama
    sine = np.sin(outcome.reference.alpha_1)
    if np.nanmin(sine) < 0.5 < np.nanmax(sine):
        ax.contour(np.degrees(grid.phi), grid.z, sine, levels=[0.5], colors="black", linewidths=0.9, linestyles="--")


def _legend(ax: Axes, handles: list[Patch], labels: list[str]) -> None:
    theme.legend_above(ax, handles, labels, gap=0.3, most=_A_LINE)


def _diverging() -> ListedColormap:
    """Blue over white to red in few enough steps to be read off a colour bar, safe for colour-blind readers."""
    from matplotlib import colormaps

    return ListedColormap(colormaps["RdBu_r"](np.linspace(0.02, 0.98, 41)))
