"""Compiled loop that fits planes to matches; `planes` prepares its arguments."""

import math

import numpy as np

from harness.compiled import kernel


@kernel
def fit_rows(first, end, w, slope, offsets, taps, fitted):
    """Fit a plane, 1/d = m · x, to the matches around every match, and evaluate it there.

    A match counts if it differs by no more than a pixel, and half a pixel more for each pixel that it is away. Its
    weight makes an error of a pixel the same everywhere. Where fewer than half of the taps count there is no fit.

    w : `[height, width + 2 margin]`, inverse range in units of 1/|t|, continued across the seam.
    slope : the same shape; d (pixels of parallax)/dw, 0 where there is no match.
    offsets : `[n, 2]`, rows and columns from a pixel to its taps.
    taps : `[height, n, 3]`, directions of the taps of a pixel of each row: along its own, along its parallel, and along
    its meridian.
    fitted : `[height, width]`, written; NaN where there is no fit.
    """
    height, width = fitted.shape
    margin = (w.shape[1] - width) // 2
    # Sums of a row of pixels side by side, so that the innermost loop has no branch and runs on vectors.
    sums = np.empty((10, width))
    for i in range(first, end):
        sums[:] = 0.0
        own_w, own_slope = w[i, margin : margin + width], slope[i, margin : margin + width]
        inside = 0.0
        for k in range(len(offsets)):
            row, begin = i + offsets[k, 0], margin + offsets[k, 1]
            if not 0 <= row < height:
                continue
            inside += 1.0
            x_0, x_1, x_2 = taps[i, k]
            most = 1.0 + 0.5 * max(abs(offsets[k, 0]), abs(offsets[k, 1]))
            there_w, there_slope = w[row, begin : begin + width], slope[row, begin : begin + width]
            for j in range(width):
                value, steep = there_w[j], there_slope[j]
                near = abs(value - own_w[j]) * own_slope[j] <= most
                weight = steep * steep if near else 0.0
                sums[0, j] += 1.0 if weight > 0.0 else 0.0
                g_0, g_1, g_2 = weight * x_0, weight * x_1, weight * x_2
                sums[1, j] += g_0 * x_0
                sums[2, j] += g_0 * x_1
                sums[3, j] += g_0 * x_2
                sums[4, j] += g_1 * x_1
                sums[5, j] += g_1 * x_2
                sums[6, j] += g_2 * x_2
                sums[7, j] += g_0 * value
                sums[8, j] += g_1 * value
                sums[9, j] += g_2 * value
        for j in range(width):
            n, a00, a01, a02, a11, a12, a22, y0, y1, y2 = sums[:, j]
            # The value of the plane in the pixel's own direction is the first of the three unknowns (Cramer's rule).
            c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
            determinant = a00 * c00 + a01 * c01 + a02 * c02
            fits = own_slope[j] > 0.0 and 2.0 * n >= inside and determinant > 1e-9 * a00 * a11 * a22
            fitted[i, j] = (c00 * y0 + c01 * y1 + c02 * y2) / determinant if fits else math.nan
