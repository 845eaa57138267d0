"""A sensor's image on axes of pixels, with its mask."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from scipy import ndimage

from harness.camera.sensor import Sensor, masked_pixels, pixel_directions
from harness.report import theme
from harness.report.theme import HALF

_DIMMED = 0.6
"""Opacity of the shade over masked pixels."""


def image_axes(rows: int, columns: int) -> tuple[Figure, Axes, tuple[float, float, float, float]]:
    """A panel of half the page's width with axes for an image, and the image's extent on them."""
    scale = min((HALF - 60) / columns, 350 / rows)
    w, h = columns * scale, rows * scale
    fig = theme.figure(HALF, 400)
    ax = theme.axes(fig, 50 + (HALF - 60 - w) / 2, 6, w, h)
    ax.set_xlabel("$u$ (px)")
    ax.set_ylabel("$v$ (px)")
    return fig, ax, (-0.5, columns - 0.5, rows - 0.5, -0.5)


def draw_mask(ax: Axes, sensor: Sensor) -> None:
    """Dim the masked pixels, and draw the mask's outline; nothing without a mask."""
    hidden = masked_pixels(sensor)
    if hidden is None:
        return
    rows, columns = hidden.shape
    shade = np.zeros((rows, columns, 4), dtype=np.float32)
    shade[hidden] = (0, 0, 0, _DIMMED)
    line = max(1, round(max(rows, columns) / 320))
    shade[hidden & ~ndimage.binary_erosion(hidden, iterations=line)] = (*to_rgb(theme.PIXEL), 1)
    ax.imshow(shade, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), aspect="auto")


def mask_words(sensor: Sensor) -> str:
    """The share of the field that is masked, for a caption; empty without a mask."""
    hidden = masked_pixels(sensor)
    if hidden is None:
        return ""
    share = hidden.sum() / max(1, hidden.sum() + pixel_directions(sensor)[1].sum())
    return f"{100 * share:.1f} % of what the camera sees is masked (dimmed and outlined)"
