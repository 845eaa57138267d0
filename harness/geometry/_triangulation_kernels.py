"""Compiled loops over pixels. Called through the modules beside this one, which prepare the arguments."""

import math

from harness.compiled import kernel

PI_TAIL = 1.2246467991473532e-16
"""pi minus the double nearest to it."""


@kernel(inline=True)
def _sine(x):
    """sin(x) for 0 <= x <= pi, within two units in the last place; without a branch, so that loops become vectors.

    Taylor's series about the nearer one of 0 and pi, where the sine is small and has to keep its digits: up to pi/2 the
    first term left out is below 1e-18.
    """
    z = x if x <= 0.5 * math.pi else (math.pi - x) + PI_TAIL
    q = z * z
    p = 1.0 / 51090942171709440000.0
    p = p * q - 1.0 / 121645100408832000.0
    p = p * q + 1.0 / 355687428096000.0
    p = p * q - 1.0 / 1307674368000.0
    p = p * q + 1.0 / 6227020800.0
    p = p * q - 1.0 / 39916800.0
    p = p * q + 1.0 / 362880.0
    p = p * q - 1.0 / 5040.0
    p = p * q + 1.0 / 120.0
    p = p * q - 1.0 / 6.0
    return z + z * (q * p)


@kernel
def sines(x, out):
    """Write the sines of angles from 0 to pi."""
    for i in range(x.size):
        out[i] = _sine(x[i])


@kernel
def sine_rule(alpha_1, alpha_2, baseline, d_1, d_2):
    """Ranges by `ranging.triangulate`; all `[n]`, d_1 and d_2 written."""
    for i in range(alpha_1.size):
        a_1, a_2 = alpha_1[i], alpha_2[i]
        meets = (a_1 > 0.0) & (a_2 > a_1) & (a_2 < math.pi)
        scale = baseline / _sine(a_2 - a_1)
        d_1[i] = scale * _sine(a_2) if meets else math.nan
        d_2[i] = scale * _sine(a_1) if meets else math.nan


@kernel
def sine_rule_1(alpha_1, alpha_2, baseline, d_1):
    """Write `d_1` alone, as `sine_rule` does."""
    for i in range(alpha_1.size):
        a_1, a_2 = alpha_1[i], alpha_2[i]
        meets = (a_1 > 0.0) & (a_2 > a_1) & (a_2 < math.pi)
        d_1[i] = (baseline / _sine(a_2 - a_1)) * _sine(a_2) if meets else math.nan
