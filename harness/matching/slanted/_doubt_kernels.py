"""Compiled loops over what lies around a mirror pixel. `doubt` prepares their arguments."""

import math

import numpy as np

from harness.compiled import kernel

AGREEING = 3
"""So many of eight planes around a pixel have to agree with its own: those on the far side of a border need not."""
TILE = 64
"""Columns side by side."""


@kernel
def surroundings_rows(
    first, end, reach, x, first_image, known, value, plane, chosen, gain, offset, w, square, disagreement
):  # fmt: skip
    """How well every pixel's plane explains it, and what the planes around say of it.

    reach : how far off the eight pixels are whose planes are asked, along rows, columns and diagonals.
    square : written; (I_1 - a I_2 - b)², grey levels squared, 0 where there is no plane.
    disagreement : written; 1/m, by how much the third best of the eight planes differs from the own one here; infinite
    where fewer than three are there.
    """
    height, width = w.shape
    planes, apart = np.empty((3, TILE + 2 * reach)), np.empty((AGREEING, TILE))
    here, own = np.empty((3, TILE)), np.empty(TILE)
    for i in range(first, end):
        for begin in range(0, width, TILE):
            n = min(TILE, width - begin)
            for j in range(n):
                here[0, j], here[1, j], here[2, j] = x[i, begin + j, 0], x[i, begin + j, 1], x[i, begin + j, 2]
                own[j] = w[i, begin + j]
            apart[:] = math.inf
            for down in range(-1, 2):
                row = i + down * reach
                if 0 <= row < height:
                    _gather(row, begin - reach, plane, chosen, planes)
                    for right in range(3):
                        if down != 0 or right != 1:
                            _compare(planes, right * reach, here, own, apart)
            for j in range(n):
                at = begin + j
                taken = chosen[i, at]
                square[i, at], disagreement[i, at] = 0.0, math.inf if taken < 0 else apart[AGREEING - 1, j]
                if taken >= 0 and known[i, at]:
                    row, column = taken // width, taken % width
                    difference = first_image[i, at] - gain[row, column] * value[i, at] - offset[row, column]
                    square[i, at] = difference * difference


@kernel
def _gather(row, begin, plane, chosen, planes):
    """Write the planes that some pixels of a row take, from `begin` on; NaN where there is none."""
    width = chosen.shape[1]
    for j in range(planes.shape[1]):
        taken = chosen[row, begin + j] if 0 <= begin + j < width else -1
        if taken < 0:
            planes[0, j] = math.nan
        else:
            m = plane[taken // width, taken % width]
            planes[0, j], planes[1, j], planes[2, j] = m[0], m[1], m[2]


@kernel
def _compare(planes, shift, here, own, apart):
    """Keep the least differences from pixels' own inverse ranges, in ascending order; NaN is none."""
    m_x, m_y, m_z = planes[0, shift:], planes[1, shift:], planes[2, shift:]
    x, y, z = here[0], here[1], here[2]
    least, second, third = apart[0], apart[1], apart[2]
    for j in range(TILE):
        there = abs(m_x[j] * x[j] + m_y[j] * y[j] + m_z[j] * z[j] - own[j])
        there = min(math.inf, there)
        a, b, c = least[j], second[j], third[j]
        least[j] = min(a, there)
        there = max(a, there)
        second[j] = min(b, there)
        third[j] = min(c, max(b, there))


# -- Before and after means over squares -------------------------------------------------------------------------------


@kernel
def texture_rows(first, end, known, slope, motion, texture, moved):
    """Write g² and (du/dw)² + (dv/dw)², 0 where they are not known."""
    for i in range(first, end):
        for j in range(known.shape[1]):
            g = float(slope[i, j])
            texture[i, j] = g * g if known[i, j] else 0.0
            moved[i, j] = motion[i, j] if known[i, j] else 0.0


@kernel
def divide_rows(first, end, divisor, values):
    """Divide values in place."""
    for i in range(first, end):
        for j in range(values.shape[1]):
            values[i, j] /= divisor[i, j]


@kernel
def variance_rows(first, end, level, count, floor, variance):
    """Turn means of squares into variances, in place, plus a least one.

    level, count : means of what was squared, and of how many there are.
    """
    for i in range(first, end):
        for j in range(variance.shape[1]):
            variance[i, j] = max(variance[i, j] - level[i, j] * level[i, j] / count[i, j], 0.0) + count[i, j] * floor


@kernel
def unexplained_rows(first, end, count, variance, square, residual, unexplained):
    """Write the mean square of what remains, and its share of the variance.

    square : mean of the squares over all pixels, there or not.
    """
    for i in range(first, end):
        for j in range(count.shape[1]):
            unexplained[i, j] = square[i, j] / variance[i, j]
            residual[i, j] = square[i, j] / count[i, j]
