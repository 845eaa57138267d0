"""Shared by the compiled loops of several matchers: names of costs and results, and the distance of census codes."""

import numpy as np

from harness.compiled import kernel

PHI, ALPHA = 0, 1
"""Sampling of the curve: at equal steps of azimuth, or of alpha_2."""
SAMPLINGS = {"phi": PHI, "alpha": ALPHA}
"""The numbers by the names that users give."""
SAD, SSD, ZNCC, CENSUS = 0, 1, 2, 3
"""Matching costs."""
COSTS = {"sad": SAD, "ssd": SSD, "zncc": ZNCC, "census": CENSUS}
"""The numbers by the names that users give."""
OK, LEAVES_IMAGE = 0, 1
"""Whether a curve was searched, or leaves the image."""


@kernel(inline=True)
def census_code(values, row, column, reach, parts):
    """One bit for each neighbour that is below the pixel, the first one, up and to the left, in the lowest bit.

    Neighbours are `parts` columns apart, around the seam. Semi-global matching makes the same codes row by row.
    """
    width = values.shape[1]
    code, bit = np.int32(0), np.int32(1)
    middle = values[row, column]
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            if i == 0 and j == 0:
                continue
            neighbour = column + j * parts
            if neighbour < 0:
                neighbour += width
            elif neighbour >= width:
                neighbour -= width
            if values[row + i, neighbour] < middle:
                code |= bit
            bit <<= np.int32(1)
    return code


@kernel(inline=True)
def bits_set(x):
    """The number of bits that are set in a 32-bit code: of pairs, of fours, of bytes, and of all four bytes."""
    x = np.uint32(x - ((x >> np.uint32(1)) & np.uint32(0x55555555)))
    x = np.uint32((x & np.uint32(0x33333333)) + ((x >> np.uint32(2)) & np.uint32(0x33333333)))
    x = np.uint32((x + (x >> np.uint32(4))) & np.uint32(0x0F0F0F0F))
    return np.uint32(np.uint32(x * np.uint32(0x01010101)) >> np.uint32(24))
