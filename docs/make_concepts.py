"""Draw the picture of the concepts page: `python docs/make_concepts.py` writes `docs/images/concepts.svg`.

Everything is placed in three dimensions and projected, so that angles and curves are where they really are. The
magnified part shows the epipolar plane face on.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon

PICTURE = Path(__file__).parent / "images" / "concepts.svg"

ALPHA_1, ALPHA_2, ERROR = np.radians([52.0, 78.0, 3.6])
TILT = np.radians(20.0)  # of the epipolar plane about t, from the horizontal
ELEVATION, AZIMUTH = np.radians([30.0, 14.0])  # of whoever looks at the picture
RADIUS, HEIGHT = 0.27, 0.29  # of the cylinders, and half their height, in baselines
RANGE_1 = np.sin(ALPHA_2) / np.sin(ALPHA_2 - ALPHA_1)
RANGE_1_OFF = np.sin(ALPHA_2 - ERROR) / np.sin(ALPHA_2 - ERROR - ALPHA_1)
RANGE_2 = np.sin(ALPHA_1) / np.sin(ALPHA_2 - ALPHA_1)

# Okabe and Ito's colours, which those with any colour vision tell apart.
VIEW_1, VIEW_2, OFF, PLANE, INK = "#0072B2", "#00795A", "#D55E00", "#56B4E9", "#222222"
V1, V2 = np.zeros(3), np.array([1.0, 0.0, 0.0])


def in_plane(along: np.ndarray | float, across: np.ndarray | float) -> np.ndarray:
    """`[..., 3]`: points of the epipolar plane, by coordinates along t and across it."""
    along, across = np.broadcast_arrays(along, across)
    return np.stack([along, across * np.cos(TILT), across * np.sin(TILT)], axis=-1)


def towards(angle: float, distance: np.ndarray | float) -> np.ndarray:
    """Points of the epipolar plane at an angle to t, seen from viewpoint 1."""
    return in_plane(distance * np.cos(angle), distance * np.sin(angle))


def flat(points: np.ndarray) -> np.ndarray:
    """`[..., 2]`: where a point of space is in the picture (a parallel projection)."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    right = x * np.cos(AZIMUTH) + y * np.sin(AZIMUTH)
    away = -x * np.sin(AZIMUTH) + y * np.cos(AZIMUTH)
    return np.stack([right, away * np.sin(ELEVATION) + z * np.cos(ELEVATION)], axis=-1)


def line(axes: Axes, points: np.ndarray, color: str, **style: object) -> None:
    """A line through points of space."""
    axes.plot(*flat(points).T, color=color, solid_capstyle="round", **{"linewidth": 1.6, **style})


def label(axes: Axes, at: tuple[float, float], text: str, color: str = INK, size: float = 26) -> None:
    """Text in the middle of a place, with a margin that keeps lines away from it."""
    written = axes.text(*at, text, color=color, fontsize=size, ha="center", va="center", zorder=30)
    written.set_path_effects([patheffects.withStroke(linewidth=4, foreground="white")])


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, color: str, width: float = 2.2) -> None:
    """An arrow between two points of the picture."""
    style = {"arrowstyle": "-|>,head_length=7,head_width=3.2", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 1}
    axes.add_patch(FancyArrowPatch(start, end, color=color, linewidth=width, zorder=12, **style))


def cylinder(axes: Axes, centre: np.ndarray, color: str) -> None:
    """A view's cylinder, and the epipolar curve on it: the hidden parts are thin."""
    turn = np.linspace(0, np.pi, 181)  # half a turn, from the right edge as seen, on the far side
    far, near = (ring(AZIMUTH + turn * side) for side in (1, -1))
    up = np.array([0, 0, HEIGHT])
    for rim, hidden in ((up, False), (-up, True)):
        line(axes, centre + near + rim, color, linewidth=1.0, alpha=0.65, zorder=3)
        faint = {"linewidth": 0.7, "alpha": 0.3} if hidden else {"linewidth": 1.0, "alpha": 0.65}
        line(axes, centre + far + rim, color, zorder=3, **faint)
    for edge in (near[0], near[-1]):
        line(axes, np.array([centre + edge - up, centre + edge + up]), color, linewidth=1.0, alpha=0.65, zorder=3)
    outline = np.concatenate([centre + far + up, centre + near[::-1] - up])
    axes.add_patch(Polygon(flat(outline), facecolor=color, alpha=0.09, linewidth=0, zorder=2))
    for half, width, alpha in ((near, 2.2, 1.0), (far, 1.3, 0.7)):
        lifted = half + np.stack([0 * turn, 0 * turn, half[:, 1] * np.tan(TILT)], axis=-1)
        line(axes, centre + lifted, color, linewidth=width, alpha=alpha, zorder=6)


def ring(phi: np.ndarray) -> np.ndarray:
    """Points of the cylinder at z = 0, from its middle."""
    return RADIUS * np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=-1)


def arc(axes: Axes, centre: np.ndarray, radius: float, span: tuple[float, float], color: str) -> None:
    """An angle of the epipolar plane, as an arc about a viewpoint."""
    angles = np.linspace(*span, 80)
    line(axes, centre + in_plane(radius * np.cos(angles), radius * np.sin(angles)), color, linewidth=1.8, zorder=10)


def on_cylinder(angle: float) -> np.ndarray:
    """The point of the cylinder in a direction of the epipolar plane, from its middle."""
    direction = towards(angle, 1.0)
    return RADIUS * direction / np.hypot(direction[0], direction[1])


def scene(axes: Axes) -> None:
    """Both viewpoints, the plane through them and the point, and where the point is put when alpha_2 is off."""
    point, off = towards(ALPHA_1, RANGE_1), towards(ALPHA_1, RANGE_1_OFF)
    corners = in_plane(np.array([-0.5, 2.05, 2.05, -0.5]), np.array([-0.4, -0.4, 2.2, 2.2]))
    axes.add_patch(Polygon(flat(corners), facecolor=PLANE, alpha=0.13, linewidth=0, zorder=0))
    for centre, color in ((V1, VIEW_1), (V2, VIEW_2)):
        cylinder(axes, centre, color)
    axes.add_patch(Polygon(flat(np.array([V2, point, off])), facecolor=OFF, alpha=0.25, linewidth=0, zorder=5))
    line(axes, np.array([V2, 1.95 * V2]), INK, linewidth=1.1, linestyle=(0, (5, 4)), zorder=5)
    line(axes, np.array([V1, off + 0.07 * off / RANGE_1_OFF]), VIEW_1, linewidth=1.8, zorder=8)
    line(axes, np.array([V2, point]), VIEW_2, linewidth=1.8, zorder=8)
    line(axes, np.array([V2, off]), OFF, linewidth=1.6, zorder=8)
    line(axes, np.array([point, off]), OFF, linewidth=4.2, zorder=9)
    arrow(axes, flat(V1), flat(0.985 * V2), INK)
    arc(axes, V1, 0.47, (0, ALPHA_1), VIEW_1)
    arc(axes, V2, 0.47, (0, ALPHA_2), VIEW_2)
    arc(axes, V2, 0.86, (ALPHA_2 - ERROR, ALPHA_2), OFF)
    marks = [(V1, VIEW_1, 6), (V2, VIEW_2, 6), (point, INK, 7), (off, OFF, 7)]
    marks += [(on_cylinder(ALPHA_1), VIEW_1, 6), (V2 + on_cylinder(ALPHA_2), VIEW_2, 6)]
    for at, color, size in marks:
        axes.plot(*flat(at), "o", color=color, markersize=size, markeredgecolor="white", zorder=20)


def words(axes: Axes) -> None:
    """The symbols of the scene, each beside what it names."""

    def beside(at: np.ndarray, right: float, up: float) -> tuple[float, float]:
        x, y = flat(at)
        return float(x + right), float(y + up)

    point = towards(ALPHA_1, RANGE_1)
    label(axes, beside(V1, -0.08, -0.09), r"$v_1$", VIEW_1)
    label(axes, beside(V2, -0.03, -0.11), r"$v_2$", VIEW_2)
    label(axes, beside((V1 + V2) / 2, 0.0, -0.09), r"$t$")
    label(axes, beside(on_cylinder(ALPHA_1), -0.11, 0.03), r"$x_1$", VIEW_1)
    label(axes, beside(V2 + on_cylinder(ALPHA_2), -0.12, 0.01), r"$x_2$", VIEW_2)
    label(axes, beside(in_plane(0.58 * np.cos(ALPHA_1 / 2), 0.58 * np.sin(ALPHA_1 / 2)), 0, 0), r"$\alpha_1$", VIEW_1)
    half = ALPHA_2 / 2
    label(axes, beside(V2 + in_plane(0.58 * np.cos(half), 0.58 * np.sin(half)), 0, 0), r"$\alpha_2$", VIEW_2)
    label(axes, beside(towards(ALPHA_1, 0.62 * RANGE_1), -0.09, 0.05), r"$d_1$", VIEW_1)
    label(axes, beside(V2 + towards(ALPHA_2, 0.62 * RANGE_2), -0.09, 0.02), r"$d_2$", VIEW_2)
    label(axes, beside(point, -0.04, 0.085), "$p$")
    middle = ALPHA_2 - ERROR / 2
    label(axes, beside(V2 + towards(middle, 0.86), 0.17, -0.01), r"$\delta\alpha_2$", OFF)
    label(axes, beside(in_plane(1.7, -0.29), 0, 0), "epipolar plane", "#2b6c94", 20)


def magnified(axes: Axes, centre: np.ndarray, radius: float) -> None:
    """The sliver at the point, the epipolar plane seen face on: a right triangle of two lengths and an angle."""
    ring = Circle(centre, radius, facecolor="white", edgecolor="#999999", linewidth=1.1, zorder=15)
    axes.add_patch(ring)
    one, two = (np.array([np.cos(a), np.sin(a)]) for a in (ALPHA_1, ALPHA_2 - ERROR))
    across = np.array([two[1], -two[0]])
    length = 1.22 * radius  # of delta d_1 in the magnified part
    parallax = ALPHA_2 - ERROR - ALPHA_1
    start = centre - 0.5 * length * one + [-0.09, 0.01]
    end = start + length * one
    foot = end - length * np.cos(parallax) * two

    def stroke(*points: np.ndarray, color: str, width: float) -> None:
        (drawn,) = axes.plot(*np.array(points).T, color=color, linewidth=width, zorder=17, solid_capstyle="round")
        drawn.set_clip_path(ring)

    filled = Polygon([start, end, end - 9 * two, start - 9 * two], facecolor=OFF, alpha=0.16, linewidth=0, zorder=16)
    axes.add_patch(filled)
    filled.set_clip_path(ring)
    stroke(start - 9 * one, end + 9 * one, color=VIEW_1, width=1.8)
    stroke(start - 9 * two, start, color=VIEW_2, width=1.8)
    stroke(end - 9 * two, end, color=OFF, width=1.6)
    stroke(start, end, color=OFF, width=4.2)
    stroke(start, foot, color=OFF, width=1.6)
    side = 0.045
    stroke(foot - side * across, foot - side * across + side * two, foot + side * two, color=OFF, width=1.0)
    angles = np.pi + np.linspace(ALPHA_1, ALPHA_2 - ERROR, 40)
    bend = end + 0.2 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    stroke(*bend, color=INK, width=1.4)
    for at, color in ((start, INK), (end, OFF)):
        axes.plot(*at, "o", color=color, markersize=7, markeredgecolor="white", zorder=20)
    label(axes, tuple(np.add(start, [-0.075, 0.045])), "$p$")
    label(axes, tuple(np.add((start + end) / 2, [-0.09, 0.06])), r"$\delta d_1$", OFF)
    label(axes, tuple(np.add(foot, [0.185, -0.01])), r"$d_2\,\delta\alpha_2$", OFF, 22)
    label(axes, tuple(np.add(bend[-1], [0.19, 0.0])), r"$\alpha_2-\alpha_1$", INK, 22)


def lens(axes: Axes, at: np.ndarray, radius: float, shown_at: np.ndarray, shown_radius: float) -> None:
    """Which part is magnified: a circle around it, and the lines that touch both circles."""
    axes.add_patch(Circle(at, radius, fill=False, edgecolor="#999999", linewidth=1.1, zorder=11))
    apart = shown_at - at
    lean = np.arccos((radius - shown_radius) / np.hypot(*apart))
    for side in (1, -1):
        angle = np.arctan2(apart[1], apart[0]) + side * lean
        outwards = np.array([np.cos(angle), np.sin(angle)])
        ends = np.array([at + radius * outwards, shown_at + shown_radius * outwards])
        axes.plot(*ends.T, color="#999999", linewidth=0.8, zorder=1)


def main() -> None:
    """Draw it, and write it with outlines for letters: it looks the same wherever it is opened."""
    settings = {"mathtext.fontset": "stix", "font.family": "STIXGeneral", "svg.fonttype": "path", "svg.hashsalt": "c"}
    with mpl.rc_context(settings):
        figure = Figure(figsize=(9.0, 6.78))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(aspect="equal", xlim=(-0.64, 2.5), ylim=(-0.60, 1.766))
        scene(axes)
        words(axes)
        middle = np.array([-0.06, 1.17])
        at = flat((towards(ALPHA_1, RANGE_1) + towards(ALPHA_1, RANGE_1_OFF)) / 2)
        lens(axes, at, 0.2, middle, 0.48)
        magnified(axes, middle, 0.48)
        figure.savefig(PICTURE, facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    main()
