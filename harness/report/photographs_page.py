"""A page on the range from two photographs: the range, its predicted standard deviation, and the missing pixels."""

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from numpy.typing import NDArray

from harness.camera.sensor import Sensor
from harness.geometry.angles import Array
from harness.matching.registry import method_of
from harness.pipeline.geometry_check import errors_in_words
from harness.pipeline.photographs import Estimate
from harness.report import theme
from harness.report.markup import template
from harness.report.panoramas import extent_of, panorama_axes, unmirrored
from harness.report.photographs_cloud import cloud_pictures
from harness.report.photographs_geometry import across_picture, curve_pictures, draw_photograph
from harness.report.sections.error_maps import reasons_picture
from harness.report.sensor_images import draw_mask, image_axes, mask_words
from harness.report.theme import Picture
from harness.report.words import images_of, kind_of_image
from harness.spec import dump_toml

_NOTHING = "#D4D4D4"
"""The colour of pixels without an estimate."""


def build_page(estimate: Estimate) -> str:
    """The page, one self-contained HTML file."""
    predicted = estimate.sigma_m[np.isfinite(estimate.sigma_m)]
    share = estimate.sigma_m / estimate.range_m
    with theme.style():
        pictures = {
            "photographs": [_photograph(estimate, view) for view in range(2)],
            "panorama": [_panorama(estimate)],
            "range": [_map(estimate, estimate.range_m, "range (m)", "Range from view 1")],
            "sigma": [
                _map(estimate, estimate.sigma_m, "standard deviation (m)", "Predicted standard deviation of the range")
            ]
            if predicted.size
            else [],
            "reasons": [reasons_picture(estimate.reason, estimate.pair.grid)],
            "cloud": cloud_pictures(estimate),
            "across": [across_picture(estimate)],
            "curves": curve_pictures(estimate),
        }
    return template("photographs.html.j2").render(
        estimate=estimate,
        names=_names(estimate),
        pictures=pictures,
        matcher=" ".join(each for each in method_of(estimate.matcher) if each not in {"own", "none"}),
        density=float(estimate.valid.mean()),
        median_m=_median(estimate.range_m),
        span_m=_span(estimate.range_m),
        median_sigma_m=_median(estimate.sigma_m),
        median_share=_median(share),
        median_motion_m=_median(estimate.sigma_motion_m),
        at_limits=_at_limits(estimate),
        verdict=estimate.geometry.verdict,
        geometry=[_sentence(each) for each in estimate.geometry.lines()],
        causes=_causes(estimate),
        own_sigma=estimate.matches.sigma_alpha_2 is not None,
        settings=dump_toml(estimate.matcher),
        masked=_masked(estimate.pair.sensors),
        images=images_of(estimate.pair.sensors),
        kind=kind_of_image(estimate.pair.sensors),
        sensors=[dump_toml(each) for each in dict.fromkeys(estimate.pair.sensors)],
        grid=dump_toml(estimate.pair.grid),
        t=[float(each) for each in estimate.pair.t_v1],
        turned=not np.allclose(estimate.pair.motion.R_v2_from_v1, np.eye(3)),
    )


_AT_LIMIT = 0.05
"""Ranges within this share of a limit of the search lie at it."""


def _at_limits(estimate: Estimate) -> tuple[float, float] | None:
    """Shares of the ranges that lie at the shortest and at the longest range that was searched."""
    known = estimate.range_m[estimate.valid]
    if not known.size:
        return None
    near, far = estimate.matcher.d_min_m * (1 + _AT_LIMIT), estimate.matcher.d_max_m * (1 - _AT_LIMIT)
    return float(np.mean(known < near)), float(np.mean(known > far))


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _causes(estimate: Estimate) -> list[tuple[str, float, str]]:
    """Each kind of error, what share it explains alone, and its size in words."""
    causes = estimate.geometry.causes
    return [] if causes is None else [(each.name, each.explains, errors_in_words(each)) for each in causes.alone]


def _names(estimate: Estimate) -> tuple[str, str]:
    """The files' names, with their folders where they are alike."""
    first, second = (each.file for each in estimate.photographs)
    if first.name != second.name:
        return first.name, second.name
    return f"{first.parent.name}/{first.name}", f"{second.parent.name}/{second.name}"


def _masked(sensors: tuple[Sensor, Sensor]) -> list[str]:
    """A sentence on the mask of each view that has one, or of both."""
    first, second = map(mask_words, sensors)
    if first == second:
        return [f"In each view, {first}."] if first else []
    return [f"In view {view}, {words}." for view, words in ((1, first), (2, second)) if words]


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


def _span(values: Array) -> tuple[float, float] | None:
    """The 5th and 95th percentiles of the values."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, high = np.percentile(known, [5, 95])
    return float(low), float(high)


@theme.panel
def _photograph(estimate: Estimate, view: int) -> Picture:
    colour: NDArray[np.uint8] = estimate.photographs[view].colour
    rows, columns = colour.shape[:2]
    fig, ax, extent = image_axes(rows, columns)
    draw_photograph(ax, colour, extent)
    draw_mask(ax, estimate.pair.sensors[view])
    name = _names(estimate)[view]
    return theme.picture(fig, f"Mirror image of view {view + 1}, {name}.", f"({'ab'[view]}) view {view + 1}: {name}")


@theme.panel
def _panorama(estimate: Estimate) -> Picture:
    grid, view = estimate.pair.grid, estimate.pair.panoramas()[0]
    fig, ax, bar = panorama_axes(grid)
    values = np.where(view.valid, view.values, np.nan)
    drawn = ax.imshow(unmirrored(values), cmap="gray", vmin=0, vmax=255, extent=extent_of(grid), aspect="auto")
    fig.colorbar(drawn, cax=bar, label="grey level")
    return theme.picture(fig, "Panorama of view 1, azimuth descending from 180 to -180 degrees.")


@theme.panel
def _map(estimate: Estimate, values: Array, label: str, title: str) -> Picture:
    """Positive values over the panorama on a logarithmic scale of colours."""
    grid = estimate.pair.grid
    fig, ax, bar = panorama_axes(grid)
    ax.patch.set(facecolor=_NOTHING, edgecolor="#A8A8A8", hatch="/////")
    known = values[np.isfinite(values) & (values > 0)]
    low, high = np.percentile(known, [1, 99]) if known.size else (1.0, 10.0)
    if not high > low * 1.01:
        low, high = low / 1.01, high * 1.01
    steps = colormaps["viridis_r"].resampled(64)
    drawn = ax.imshow(unmirrored(values), cmap=steps, norm=LogNorm(low, high), extent=extent_of(grid), aspect="auto")
    fig.colorbar(drawn, cax=bar, label=label, extend="both")
    bar.minorticks_off()
    theme.logarithmic(bar, "y", float(low), float(high))
    alt = f"{title} over the panorama, from {low:.3g} to {high:.3g} metres; hatched where it is missing."
    return theme.picture(fig, alt)
