"""Compiled weights and samples of B-splines, and their derivatives."""

import math

from harness.compiled import kernel

QUINTIC_TAPS = 6
"""Number of coefficients of a quintic B-spline along each axis."""


@kernel(inline=True)
def cubic_weights(f):
    """Weights of the cubic B-spline's four coefficients, at a fraction f after the second one."""
    g = 1.0 - f
    return g * g * g * (1 / 6), 2 / 3 - f * f * (2 - f) / 2, 2 / 3 - g * g * (2 - g) / 2, f * f * f * (1 / 6)


@kernel(inline=True)
def cubic_slopes(f):
    """Derivatives of the weights."""
    g = 1.0 - f
    return -g * g / 2, f * (3 * f - 4) / 2, -g * (3 * g - 4) / 2, f * f / 2


@kernel(inline=True)
def cubic_spline(coefficients, u, v):
    """The cubic B-spline at (u, v), and its derivatives along u and v; NaN unless all its taps are there."""
    i, j = math.floor(v), math.floor(u)
    if not (1 <= i < coefficients.shape[0] - 2 and 1 <= j < coefficients.shape[1] - 2):
        return math.nan, math.nan, math.nan
    a0, a1, a2, a3 = cubic_weights(u - j)
    d0, d1, d2, d3 = cubic_slopes(u - j)
    b0, b1, b2, b3 = cubic_weights(v - i)
    e0, e1, e2, e3 = cubic_slopes(v - i)
    value = along_u = along_v = 0.0
    for k in range(4):
        if k == 0:
            weight, change = b0, e0
        elif k == 1:
            weight, change = b1, e1
        elif k == 2:
            weight, change = b2, e2
        else:
            weight, change = b3, e3
        row = i - 1 + k
        c0, c1, c2, c3 = (
            coefficients[row, j - 1],
            coefficients[row, j],
            coefficients[row, j + 1],
            coefficients[row, j + 2],
        )
        line = c0 * a0 + c1 * a1 + c2 * a2 + c3 * a3
        value += weight * line
        along_u += weight * (c0 * d0 + c1 * d1 + c2 * d2 + c3 * d3)
        along_v += change * line
    return value, along_u, along_v


@kernel
def quintic_weights(x, value, slope):
    """Weights of the six taps of the quintic B-spline at a fraction x after the third, and their derivatives by x."""
    for side in range(2):
        # The second half mirrors the first one.
        a = 1.0 - x if side == 0 else x
        b, c = a + 1.0, a + 2.0
        a4, b4, c4 = a * a * a * a, b * b * b * b, c * c * c * c
        sign = -1.0 if side == 0 else 1.0
        for k in range(3):
            tap = k if side == 0 else QUINTIC_TAPS - 1 - k
            if k == 0:
                value[tap] = a4 * a / 120.0
                slope[tap] = sign * a4 / 24.0
            elif k == 1:
                value[tap] = (b4 * b - 6.0 * a4 * a) / 120.0
                slope[tap] = sign * (b4 - 6.0 * a4) / 24.0
            else:
                value[tap] = (c4 * c - 6.0 * b4 * b + 15.0 * a4 * a) / 120.0
                slope[tap] = sign * (c4 - 6.0 * b4 + 15.0 * a4) / 24.0
