"""A bounding volume hierarchy: which of many boxes intersect another box or a ray, without testing all of them.

Boxes are sorted by the Morton codes of their centres, so that neighbours in the list are neighbours in space, and
the tree over the list is a complete binary one, as in C. Lauterbach et al., "Fast BVH construction on GPUs", 2009.
Compiled loops traverse it; see `_coincident_kernels`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.geometry.angles import Array

LEAF = 4
"""Boxes in a leaf."""
_BITS = 21
"""Bits of each coordinate of a centre; three coordinates take 63."""


class BoxTree(NamedTuple):
    """Boxes and the tree over them. Node 1 is the root, node i has the children 2 i and 2 i + 1.

    The last half of the nodes are leaves: leaf j, counted from 0, holds the boxes `order[LEAF j : LEAF (j + 1)]`.
    """

    order: NDArray[np.int64]
    """`[boxes]`: indices of the boxes, along the Morton curve."""
    low: Array
    """`[nodes, 3]`: the least coordinates in a node; infinite in an empty node. Node 0 is not used."""
    high: Array
    """`[nodes, 3]`: the greatest coordinates in a node; minus infinity in an empty node."""


def box_tree(low: Array, high: Array) -> BoxTree:
    """The tree over one or more boxes.

    Parameters
    ----------
    low, high
        `[boxes, 3]`: least and greatest coordinates.
    """
    order = np.argsort(_morton((low + high) / 2), kind="stable")
    leaves = 1
    while leaves * LEAF < len(order):
        leaves *= 2
    node_low, node_high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    starts = np.arange(0, len(order), LEAF)
    node_low[leaves : leaves + len(starts)] = np.minimum.reduceat(low[order], starts)
    node_high[leaves : leaves + len(starts)] = np.maximum.reduceat(high[order], starts)
    while leaves > 1:
        leaves //= 2
        level, below = slice(leaves, 2 * leaves), slice(2 * leaves, 4 * leaves)
        node_low[level] = node_low[below].reshape(-1, 2, 3).min(axis=1)
        node_high[level] = node_high[below].reshape(-1, 2, 3).max(axis=1)
    return BoxTree(order, node_low, node_high)


def _morton(points: Array) -> NDArray[np.int64]:
    """The Morton codes: the bits of the three coordinates, interleaved."""
    size = np.ptp(points, axis=0).max() or 1.0
    cells = ((points - points.min(axis=0)) / size * (2**_BITS - 1)).astype(np.int64)
    return (_spread(cells[:, 0]) << 2) | (_spread(cells[:, 1]) << 1) | _spread(cells[:, 2])


def _spread(x: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number of 21 bits with two zeros after every bit."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | x << shift) & mask
    return x
