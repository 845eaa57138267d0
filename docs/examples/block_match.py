"""Block matching on the rectified pair: rows are epipolar curves, as a stereo network or OpenCV expects them."""

import numpy as np
from scipy import ndimage


def match(pair, limits, *, around=360, block=7):
    """Disparities in pixels with the least sum of absolute differences over a block, refined by a parabola."""
    views = pair.rectified(around)
    left, right = views.images
    px = np.degrees(views.projection.step)
    far, near = views.disparity_deg(limits.d_max_m) / px, views.disparity_deg(limits.d_min_m) / px
    costs = []
    for shift in range(int(near.max()) + 2):
        seen = np.roll(views.valid[1], shift, axis=1)
        seen[:, :shift] = False
        difference = np.where(seen, np.abs(left - np.roll(right, shift, axis=1)), 255)
        cost = ndimage.uniform_filter(difference, block, mode=("wrap", "nearest"))  # half planes go around
        costs.append(np.where((shift > far - 1) & (shift < near + 1), cost, 1000))
    costs = np.pad(costs, ((1, 1), (0, 0), (0, 0)), constant_values=1000)
    best = costs[1:-1].argmin(axis=0)
    before, least, after = (np.take_along_axis(costs, best[None] + i, axis=0)[0] for i in range(3))
    bend = before - 2 * least + after
    disparity = best + np.where(bend > 0, (before - after) / (2 * np.maximum(bend, 1e-9)), 0).clip(-0.5, 0.5)
    known = views.valid[0] & (disparity >= far) & (disparity <= near)
    return views.answer(disparity_px=np.where(known, disparity, np.nan), confidence=np.where(known, -least, np.nan))
