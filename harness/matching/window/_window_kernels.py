"""Compiled loops over pixels that all window matchers share: census transforms, sub-pixel fits, angles."""

import math

import numpy as np

from harness.compiled import kernel
from harness.matching._matching_kernels import ALPHA, census_code

MATCHED = 0
PARABOLA, EQUIANGULAR = 0, 1


@kernel
def census(values, reach, parts, codes):
    """One bit a neighbour, set where it is below the pixel; neighbours are `parts` columns apart, around the seam.

    codes : written, but for the first and last `reach` rows.
    """
    height, width = values.shape
    for row in range(reach, height - reach):
        for column in range(width):
            codes[row, column] = census_code(values, row, column, reach, parts)


# -- Sub-pixel fits ----------------------------------------------------------------------------------------------------


@kernel
def parabola_minima(costs, offset, refined):
    """The least-squares parabola a x² + b x + c through the finite samples of each row, x = 0 in the middle.

    Where its minimum lies among those samples, its position and True go to `offset` and `refined`, both `[rows]`.
    The 3x3 normal equations are solved by Cramer's rule. Of whole numbers, or of parts of a power of two, all sums are
    exact, and so a row of equal costs has no curvature at all.
    """
    rows, samples = costs.shape
    reach = samples // 2
    all_s2, all_s4 = 0.0, 0.0
    for x in range(-reach, reach + 1):
        all_s2 += x**2
        all_s4 += x**4
    for row in range(rows):
        s0, s1, s2, s3, s4 = float(samples), 0.0, all_s2, 0.0, all_s4
        first, last = -reach, reach
        t0, t1, t2 = 0.0, 0.0, 0.0
        for i in range(samples):
            x, y = i - reach, costs[row, i]
            t0 += y
            t1 += x * y
            t2 += x * x * y
        if not math.isfinite(t0):
            s0, s1, s2, s3, s4, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            first, last = reach, -reach
            for i in range(samples):
                x, y = i - reach, costs[row, i]
                if math.isfinite(y):
                    first, last = min(first, x), x
                    s0, s1, s2, s3, s4 = s0 + 1, s1 + x, s2 + x**2, s3 + x**3, s4 + x**4
                    t0, t1, t2 = t0 + y, t1 + x * y, t2 + x * x * y
            if s0 < 3:
                continue
        # The determinant that a and b share is positive, and cancels in -b / 2a.
        a = t2 * (s2 * s0 - s1 * s1) - s3 * (t1 * s0 - s1 * t0) + s2 * (t1 * s1 - s2 * t0)
        b = s4 * (t1 * s0 - s1 * t0) - t2 * (s3 * s0 - s1 * s2) + s2 * (s3 * t0 - s2 * t1)
        if a > 0 and first <= -b / (2 * a) <= last:
            offset[row], refined[row] = -b / (2 * a), True


@kernel(inline=True)
def _least_of_three(shape, before, middle, after):
    """The minimum of the curve through three costs, in samples from the middle one, and whether it is valid.

    A parabola, or two lines of opposite slopes of which the steeper pair of neighbours gives the slope (the equiangular
    fit). It is valid if the costs bend upwards and the minimum lies among the samples: never with NaN.
    """
    bend = before - 2 * middle + after
    if shape == EQUIANGULAR:
        bend = bend if bend <= 0 else 2 * (max(before, after) - middle)
        minimum = (before - after) / bend
    else:
        minimum = (before - after) / (2 * bend)
    return minimum, bend > 0 and abs(minimum) <= 1


@kernel
def three_point_minima(shape, costs, offset, refined):
    """The fit through the three costs in the middle of each row; see `parabola_minima` for what is written."""
    rows, samples = costs.shape
    i = samples // 2
    for row in range(rows):
        minimum, good = _least_of_three(shape, costs[row, i - 1], costs[row, i], costs[row, i + 1])
        if good:
            offset[row], refined[row] = minimum, True


@kernel
def cancelled_minima(shape, costs, offset, refined):
    """Mean of a fit to whole samples and one to half samples, whose errors have opposite signs.

    costs : `[rows, 7]`, at -1.5, -1, ... 1.5 samples. The three half samples are those around the one that is on the
        side of the first estimate.
    """
    for row in range(costs.shape[0]):
        whole, good = _least_of_three(shape, costs[row, 1], costs[row, 3], costs[row, 5])
        if not good:
            continue
        i, side = (4, 0.5) if whole >= 0 else (2, -0.5)
        half, good = _least_of_three(shape, costs[row, i - 2], costs[row, i], costs[row, i + 2])
        minimum = (whole + half + side) / 2
        if good and abs(minimum) <= 1:
            offset[row], refined[row] = minimum, True


# -- From samples to angles --------------------------------------------------------------------------------------------


@kernel
def matches(
    mode, costs, reason, k_best, offset, refined, phi, step, alpha_1, m, n, t_hat, k_far, k_near, k, alpha_2, confidence
):
    """Position on the curve, angle and confidence of every match.

    refined : in: where `offset` counts; out: without those that it would move out of the interval k_far .. k_near.
    k, alpha_2, confidence : written, `[height, width]`; NaN where there is no match.

    The angle is that of `epipolar.alpha_2_at`, which says where the formula is from.
    """
    height, width, samples = costs.shape
    middle = samples // 2
    # Of the latest angle in each column: whole samples often are those of the row above.
    known, cosine, sine = np.full((3, width), math.nan)
    for row in range(height):
        for column in range(width):
            if reason[row, column] != MATCHED:
                refined[row, column] = False
                k[row, column] = alpha_2[row, column] = confidence[row, column] = math.nan
                continue
            position = float(k_best[row, column])
            if refined[row, column]:
                moved = position + offset[row, column]
                if k_far[row, column] <= moved <= k_near[row, column]:
                    position = moved
                else:
                    refined[row, column] = False
            k[row, column] = position
            a = alpha_1[row, column]
            if mode == ALPHA:
                a += position * step[row, column]
            elif position != 0:  # sample 0 is infinity, and exactly there
                angle = phi[column] + position * step[row, column]
                if angle != known[column]:
                    known[column], cosine[column], sine[column] = angle, math.cos(angle), math.sin(angle)
                c, s = cosine[column], sine[column]
                y = t_hat[0] * s - t_hat[1] * c
                x = m[row, column, 1] * c - m[row, column, 0] * s
                a = math.atan2(y, x) if n[row, column, 2] > 0 else math.atan2(-y, -x)
            alpha_2[row, column] = a

            least, beside, neighbours = costs[row, column, middle], 0.0, 0
            for i in (middle - 1, middle + 1):
                if math.isfinite(costs[row, column, i]):
                    beside, neighbours = beside + costs[row, column, i], neighbours + 1
            contrast = 1 - neighbours * least / beside if beside > 0 else 0.0
            confidence[row, column] = min(max(contrast, 0.0), 1.0)
