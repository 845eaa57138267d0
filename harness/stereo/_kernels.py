"""Compiled loops over pixels. Called through the modules beside this one, which prepare the arguments."""

import math

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def sine_rule(alpha_1, alpha_2, baseline, d_1, d_2):
    """Ranges by `ranging.triangulate`. d_1, d_2 : written, `[n]`; d_2 may be empty, where nobody asks for it."""
    for i in range(alpha_1.size):
        a_1, a_2 = alpha_1[i], alpha_2[i]
        scale = math.nan
        if a_2 > a_1 > 0.0 and a_2 < math.pi:
            disparity = math.sin(a_2 - a_1)
            if disparity > 0.0:
                scale = baseline / disparity
        d_1[i] = scale * math.sin(a_2) if not math.isnan(scale) else math.nan
        if d_2.size:
            d_2[i] = scale * math.sin(a_1)
