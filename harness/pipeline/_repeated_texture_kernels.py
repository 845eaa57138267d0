"""Compiled loop over windows and the ranges that they might have. `repeated_texture` lays out its arguments."""

import math

import numpy as np

from harness.compiled import kernel
from harness.motion._direct_kernels import added, sampled


@kernel
def correlations(first, end, x, w, scale, grey, R, t, camera, coefficients, share, correlation):
    """Write the correlation of windows in both views, with all their inverse ranges scaled by the same factors.

    x, w, grey : `[n, m, 3]`, `[n, m]` and `[n, m]`, directions of a window's samples from view 1, inverse ranges in
    units of 1/|t|, and view 1's grey levels; NaN for none. scale : `[n, k]`. share : the least share of samples
    that both views see.
    correlation : `[n, k]`, NaN where they see fewer, or where there is no texture.
    """
    for i in range(first, end):
        for k in range(scale.shape[1]):
            correlation[i, k] = math.nan
            n = s_1 = s_2 = s_11 = s_22 = s_12 = 0.0
            for j in range(x.shape[1]):
                value = grey[i, j]
                if math.isnan(value):
                    continue
                other = sampled(x[i, j], scale[i, k] * w[i, j], R, t, camera, coefficients)
                if math.isnan(other):
                    continue
                n, s_1, s_2, s_11, s_22, s_12 = added(n, s_1, s_2, s_11, s_22, s_12, value, other)
            if n < max(share * x.shape[1], 2.0):
                continue
            v_1, v_2 = s_11 - s_1 * s_1 / n, s_22 - s_2 * s_2 / n
            if v_1 > n and v_2 > n:  # a grey level squared: below, rounding to 8 bits is most of it
                correlation[i, k] = (s_12 - s_1 * s_2 / n) / np.sqrt(v_1 * v_2)
