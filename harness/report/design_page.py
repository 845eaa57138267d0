"""A page on a rig: its expected errors by cause and by direction, and its sensor's field of view."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter

from harness.camera.coverage import Coverage
from harness.design.answers import Answer, answers, rim_m
from harness.design.budget import CAUSES, budget
from harness.design.ellipsoid import Ellipsoid, level_elevation_deg
from harness.design.rig import RigDesign
from harness.report import theme
from harness.report.markup import template
from harness.report.sensor_page import image_panel, resolution_panel
from harness.report.theme import FAINT, HALF, INK, SPARE, Picture
from harness.spec import dump_toml

_OF_CAUSES = (theme.SUBPIXEL, SPARE[2], theme.PIXEL, SPARE[3], SPARE[1], theme.OCHRE, SPARE[0], FAINT)
_COLOURS = dict(zip(CAUSES, _OF_CAUSES, strict=True))
_STROKES = dict(zip(CAUSES, ("-", "-", "--", "--", "--", (0, (1, 1)), "-.", ":"), strict=True))
_HEIGHT = 400
_PLAN_M = 8.0


def build_page(
    rig: RigDesign,
    facts: dict[str, str],
    expected: Sequence[Answer],
    covered: Coverage,
    chosen: Sequence[Ellipsoid] = (),
) -> str:
    """The page, one self-contained HTML file.

    Parameters
    ----------
    facts
        The description of its sensor, by name.
    expected
        The expected errors at some ranges.
    covered
        Its sensor's field of view, in figures.
    chosen
        The uncertainty of the positions of some points.
    """
    magnified = magnification(chosen)
    with theme.style():
        errors = [_by_cause(rig), _plan(rig, chosen, magnified)]
        sensor = [*([_profile(rig)] if rig.has_mirror else []), image_panel(covered), resolution_panel(covered)]
    return template("design.html.j2").render(
        rig=rig,
        facts=facts,
        answers=expected,
        causes=[name for name in CAUSES if any(each.by_cause_m[name] > 0 for each in expected)],
        errors=errors,
        sensor=sensor,
        settings=dump_toml(rig),
        chosen=chosen,
        magnified=magnified,
    )


@theme.panel
def _by_cause(rig: RigDesign) -> Picture:
    fig = theme.figure(HALF, _HEIGHT)
    ax = theme.axes(fig, 64, 64, HALF - 80, _HEIGHT - 116)
    ranges = np.geomspace(0.5, 16, 11)
    expected = answers(rig, ranges.tolist())
    total = np.array([1000 * each.error_m for each in expected])
    ax.plot(ranges, total, color=INK, linewidth=2.2, label="all together")
    values = [total[np.isfinite(total)]]
    for name in CAUSES:
        line = np.array([1000 * each.by_cause_m[name] for each in expected])
        if np.any(line > 0):
            ax.plot(ranges, line, color=_COLOURS[name], linestyle=_STROKES[name], label=name)
            values.append(line[np.isfinite(line) & (line > 0)])
    ax.set_xscale("log")
    shown = np.concatenate(values)
    if shown.size:
        theme.logarithmic(ax, "y", max(0.8 * shown.min(), shown.max() / 1e5), 1.3 * shown.max())
    ax.set_xticks([0.5, 1, 2, 4, 8, 16], ["0.5", "1", "2", "4", "8", "16"])
    ax.minorticks_off()
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_xlabel("range (m)")
    ax.set_ylabel("range error, 68 % within (mm)")
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=4)
    middle = expected[len(expected) // 2]
    alt = (
        f"Range error against range, by cause; at {middle.range_m:.1f} m {1000 * middle.error_m:.1f} mm, most of it by "
        f"{middle.leading}."
    )
    return theme.picture(fig, alt, "(a) by cause, directions within 30° of the baseline left out")


def magnification(chosen: Sequence[Ellipsoid]) -> int:
    """The scale at which ellipsoids are drawn: 1, 2 or 5 times a power of ten, so that the semi-axis of the largest is
    about a sixth of the plan's half; 1 where no point is seen.
    """
    sizes = [float(each.semi_axes_m[0]) for each in chosen if each.is_seen]
    if not sizes or max(sizes) <= 0:
        return 1
    most = _half_of_plan(chosen) / 6 / max(sizes)
    decade = 10 ** np.floor(np.log10(most))
    return max(1, int(max(step for step in (1, 2, 5) if step * decade <= most) * decade))


def _half_of_plan(chosen: Sequence[Ellipsoid]) -> float:
    """Half the side of the plan, metres: enough for all points and their ellipses."""
    farthest = max((float(np.abs(each.point_m[:2]).max()) for each in chosen), default=0.0)
    return max(_PLAN_M, 1.2 * farthest)


@theme.panel
def _plan(rig: RigDesign, chosen: Sequence[Ellipsoid], magnified: int) -> Picture:
    """Standard deviation of the range in the horizontal plane through the viewpoint, and ellipsoids seen from above."""
    fig = theme.figure(HALF, _HEIGHT)
    side = min(HALF - 150, _HEIGHT - 70)
    ax = theme.axes(fig, 54, 16, side, side)
    half = _half_of_plan(chosen)
    axis = np.linspace(-half, half, 81)
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x, y, np.full_like(x, _height_of_plan(rig, x, y))], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = 1000 * budget(rig, points).total_m
    sigma[~np.isfinite(sigma)] = np.nan
    low, high = (
        10 ** np.floor(np.log10(np.nanpercentile(sigma, 5))),
        10 ** np.ceil(np.log10(np.nanpercentile(sigma, 95))),
    )
    image = ax.imshow(
        np.clip(sigma, low, high),
        origin="lower",
        extent=(-half, half, -half, half),
        norm=LogNorm(low, high),
        cmap="cividis",
    )
    steps = [m * 10.0**e for e in range(int(np.log10(low)), int(np.log10(high)) + 1) for m in (1, 3)]
    lines = ax.contour(axis, axis, sigma, levels=steps, colors=theme.PAPER, linewidths=0.8)
    ax.clabel(lines, fmt=lambda value: f"{value:g}", fontsize=8.5)
    t = rig.believed.motion.t_v1
    ax.plot([0, t[0]], [0, t[1]], "o-", color=theme.PIXEL, markersize=4, markerfacecolor=theme.PAPER, linewidth=1.2)
    for each in chosen:
        if each.is_seen:
            _draw_from_above(ax, each, magnified)
    ax.set_xlim(-half, half)
    ax.set_ylim(-half, half)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    bar = fig.colorbar(image, cax=theme.axes(fig, 54 + side + 14, 16, 12, side))
    bar.set_label("standard deviation of the range (mm)")
    bar.outline.set_visible(False)
    alt = (
        f"Standard deviation of the range in the plane around the rig: {np.nanmin(sigma):.2g} mm at its smallest, and "
        f"largest along the baseline and far away. {_alternative_text(chosen, magnified)}"
    )
    title = "(b) seen from above: both viewpoints, and lines of equal standard deviation (mm)"
    if any(each.is_seen for each in chosen):
        title += f"; ellipses {magnified:,} times as large".replace(",", "\u202f")
    return theme.picture(fig, alt, title)


def _alternative_text(chosen: Sequence[Ellipsoid], magnified: int) -> str:
    """A description of the ellipses, as alternative text."""
    descriptions = [
        f"at ({', '.join(f'{value + 0.0:.3g}' for value in each.point_m)}) m {1000 * each.semi_axes_m[0]:.3g} mm by "
        f"{1000 * each.semi_axes_m[1]:.3g} by {1000 * each.semi_axes_m[2]:.3g}"
        for each in chosen
        if each.is_seen
    ]
    return (
        f"Ellipsoids of one standard deviation, {magnified} times as large: {'; '.join(descriptions)}."
        if descriptions
        else ""
    )


def _draw_from_above(ax: Axes, ellipsoid: Ellipsoid, magnified: int) -> None:
    """An ellipsoid's shadow on the plane: the ellipse of the horizontal part of its covariance."""
    variances, columns = np.linalg.eigh(ellipsoid.covariance_m2[:2, :2])
    angle = np.linspace(0, 2 * np.pi, 73)
    semi_axes = magnified * np.sqrt(np.maximum(variances, 0.0))
    outline = ellipsoid.point_m[:2] + (np.stack([np.cos(angle), np.sin(angle)], axis=-1) * semi_axes) @ columns.T
    ax.fill(*outline.T, facecolor=theme.PAPER, alpha=0.55, linewidth=0)
    ax.plot(*outline.T, color=theme.PIXEL, linewidth=1.3)
    ax.plot(*ellipsoid.point_m[:2], "+", color=INK, markersize=4, markeredgewidth=0.8)


def _height_of_plan(rig: RigDesign, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of points so that the sensor sees them: the horizon, or the elevation in its field that is nearest."""
    return np.asarray(np.hypot(x, y) * np.tan(np.radians(level_elevation_deg(rig))))


@theme.panel
def _profile(rig: RigDesign) -> Picture:
    """The mirror cut through its axis, and rays that the camera sees."""
    from harness.camera.models.hyperboloid import Mirror

    model = rig.sensor.model
    assert isinstance(model, Mirror)
    fig = theme.figure(HALF, _HEIGHT)
    radius, top = rim_m(rig.sensor)
    e = model.e_m
    ax = theme.axes(fig, 54, 16, HALF - 72, _HEIGHT - 66)
    r = np.linspace(-radius, radius, 201)
    z = -e + model.a_m * np.sqrt(1 + (r / model.b_m) ** 2)
    ax.plot(1000 * r, 1000 * z, color=INK, linewidth=2)
    field = rig.sensor.field
    for elevation in np.arange(np.ceil(field.elevation_min_deg / 15) * 15, field.elevation_max_deg + 0.1, 15):
        angle = np.radians(elevation)
        distance = model.b_m**2 / (model.a_m - e * np.sin(angle))
        at = distance * np.array([np.cos(angle), np.sin(angle)])
        end = at + 0.9 * radius * np.array([np.cos(angle), np.sin(angle)])
        for sign in (-1, 1):
            colour = theme.SUBPIXEL if elevation else theme.PIXEL
            ax.plot(
                1000 * sign * np.array([0, at[0], end[0]]),
                1000 * np.array([-2 * e, at[1], end[1]]),
                color=colour,
                linewidth=0.8,
            )
        ax.text(1000 * end[0] + 1, 1000 * end[1], f"{elevation:.0f}°".replace("-", "−"), fontsize=8.5, va="center")
    for height, name in ((0.0, "$F_0$"), (-2 * e, "$F_1$, the camera")):
        ax.plot(0, 1000 * height, "o", color=theme.PIXEL, markersize=4)
        ax.annotate(name, (0, 1000 * height), xytext=(6, -3), textcoords="offset points", fontsize=9)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("mm")
    ax.set_ylabel("mm")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    alt = f"The mirror's profile, {2000 * radius:.0f} mm across and its rim {1000 * top:.0f} mm above F0, with rays."
    return theme.picture(fig, alt, "the mirror, and rays every 15° of elevation")
