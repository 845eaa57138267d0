"""Compiled loops over what lies around a mirror pixel. `doubt` prepares their arguments."""

import math

import numpy as np

from harness.compiled import kernel

AGREEING = 3
"""So many of eight planes around a pixel have to agree with its own: those on the far side of a border need not."""


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
    apart = np.empty(AGREEING)
    for i in range(first, end):
        for j in range(width):
            square[i, j], disagreement[i, j] = 0.0, math.inf
            if chosen[i, j] < 0:
                continue
            if known[i, j]:
                row, column = chosen[i, j] // width, chosen[i, j] % width
                difference = first_image[i, j] - gain[row, column] * value[i, j] - offset[row, column]
                square[i, j] = difference * difference
            apart[:] = math.inf
            for k in range(9):
                row, column = i + (k // 3 - 1) * reach, j + (k % 3 - 1) * reach
                if k == 4 or not (0 <= row < height and 0 <= column < width) or chosen[row, column] < 0:
                    continue
                m = plane[chosen[row, column] // width, chosen[row, column] % width]
                there = abs(m[0] * x[i, j, 0] + m[1] * x[i, j, 1] + m[2] * x[i, j, 2] - w[i, j])
                for n in range(AGREEING):
                    if there < apart[n]:
                        there, apart[n] = apart[n], there
            disagreement[i, j] = apart[AGREEING - 1]
