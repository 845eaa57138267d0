"""Distance of matches from the epipolar curves of a motion that was fitted to them, beyond their noise.

A wrong calibration is mostly absorbed by the motion; what is left lies across the curves and is larger than the noise
of the tiles. It is a lower limit of what was absorbed, and counts as the calibration's standard deviation.
"""

import numpy as np

from harness.camera.sensor import Sensor, pixel_directions
from harness.motion.across import fit_across
from harness.motion.direct import DirectFit
from harness.motion.scatter import common_scatter
from harness.motion.tiles import SIDE_PX, Image

_LEAST_TILES = 30
_LEAST_PX = 0.05
"""Below it, interpolation and surfaces that are not planar are as large."""


def misfit_px(images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], direct: DirectFit) -> float:
    """Robust standard deviation of the tiles' offsets across their curves, without the noise, pixels of view 2; 0 where
    the noise may explain them or too few tiles match.
    """
    x = pixel_directions(sensors[0])[0]
    w = np.full(x.shape[:2], np.nan)
    for (row, column), plane in zip(direct.tiles.tolist(), direct.planes, strict=True):
        tile = slice(row, row + SIDE_PX), slice(column, column + SIDE_PX)
        w[tile] = x[tile] @ plane
    across = fit_across(images, sensors, direct.turn, w)[0]
    if len(across) < _LEAST_TILES:
        return 0.0
    common_px = common_scatter(across.delta * across.px_per_rad, across.sigma * across.px_per_rad)
    return common_px if common_px > _LEAST_PX else 0.0
