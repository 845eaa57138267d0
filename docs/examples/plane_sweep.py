"""A plane sweep: of many ranges, which makes view 2 look like view 1 around each pixel?"""

import numpy as np
from scipy import ndimage

from harness.geometry.angles import angle_between


def match(pair, limits, *, window=7, steps=64):
    """Angles alpha_2 of the range with the least sum of absolute differences over a window."""
    first, second = pair.filtered()
    grid = pair.grid
    least = np.full(grid.shape, np.inf)
    alpha_2 = np.full(grid.shape, np.nan)
    for inverse in np.linspace(1 / limits.d_max_m, 1 / limits.d_min_m, steps):
        seen = pair.directions - inverse * pair.t_v1  # from viewpoint 2 to the point, in ranges from viewpoint 1
        x, y, z = np.moveaxis(seen, -1, 0)
        row = (grid.z_max - z / np.hypot(x, y)) / grid.z_pitch - 0.5
        column = (np.arctan2(y, x) + np.pi) / grid.phi_pitch - 0.5
        warped = ndimage.map_coordinates(second.values, [row, column], order=1, mode="grid-wrap")
        inside = (row >= 0) & (row <= grid.height_px - 1)
        difference = np.where(inside, np.abs(warped - first.values), 255)
        cost = ndimage.uniform_filter(difference, window, mode=("nearest", "wrap"))
        better = cost < least
        least[better] = cost[better]
        alpha_2[better] = angle_between(seen, pair.t_v1)[better]
    alpha_2[~first.valid] = np.nan
    return alpha_2, np.where(np.isnan(alpha_2), np.nan, -least)
