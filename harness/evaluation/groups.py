"""Statistics of many overlapping groups of pixels at once.

A median needs its values in order. Sorting once for all groups, and counting by classes of pixels that are in the same
groups, is some thirty times as fast as a median for each group. Trials of one geometry differ only in the values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.evaluation import _grouping_kernels as _kernels
from harness.geometry.angles import Array

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Order = NDArray[np.uint64]
"""Indices in ascending order of some values: the value's bits in single precision << 32 | its index."""


@dataclass(frozen=True)
class Groups:
    """Groups of the pixels of a picture, in layers within which they do not overlap."""

    pixels: Indices
    """`[n]`: the pixels that are in any group, as ascending flat indices. Arrays `[n]` are about these."""
    classes: NDArray[np.int32]
    """`[n]`: pixels of one class are in the same groups."""
    labels: NDArray[np.int16]
    """`[classes, layers]`: the groups of a class, -1 for none. Those of one layer do not overlap."""
    layers: NDArray[np.int64]
    """`[groups]`: the layer that each is in."""
    sizes: NDArray[np.int64]
    """`[groups]`: pixels in each."""


def grouped(layers: Sequence[NDArray[np.int16]], groups: int) -> Groups:
    """Groups, numbered from 0, made of layers of labels `[size]`: a pixel's group, -1 for none."""
    size = layers[0].size if layers else 0
    pixels = np.flatnonzero(np.max(layers, axis=0) >= 0) if layers else np.empty(0, dtype=np.intp)
    whole = pixels.size == size
    labels = np.stack([layer if whole else layer[pixels] for layer in layers] or [np.empty(0, np.int16)], axis=1)
    classes = np.zeros(pixels.size, dtype=np.int32)
    count = _kernels.classes(labels, groups, classes) if pixels.size else 0
    one_of_each = np.zeros(count, dtype=np.intp)
    one_of_each[classes] = np.arange(pixels.size)
    of_classes, in_class = labels[one_of_each], np.bincount(classes, minlength=count)
    layer_of_group, sizes = np.zeros((2, groups), dtype=np.int64)
    for i, column in enumerate(of_classes.T):
        labelled = column >= 0
        layer_of_group[column[labelled]] = i
        np.add.at(sizes, column[labelled], in_class[labelled])
    return Groups(pixels, classes, of_classes, layer_of_group, sizes)


def members(labels: NDArray[np.int16], groups: int) -> list[Indices]:
    """The ascending flat indices of each of the groups 0, 1, ... in labels of any shape, -1 for none."""
    flat = labels.reshape(-1)
    starts = np.cumsum(np.bincount(flat + 1, minlength=groups + 1))
    out = np.empty(int(starts[-1] - starts[0]), dtype=np.intp)
    _kernels.gather_members(flat, starts[:-1] - starts[0], out)
    return np.split(out, (starts[1:-1] - starts[0]).astype(np.intp)) if groups else []


def bins(values: Array, edges: Sequence[float]) -> NDArray[np.int16]:
    """The index of the bin `[i, i + 1)` of ascending edges that holds each value, in the values' shape; -1 for none."""
    out = np.empty(values.shape, dtype=np.int16)
    _kernels.bins(np.ascontiguousarray(values).reshape(-1), np.asarray(edges), out.reshape(-1))
    return out


def ascending(chosen: Mask, values: Array, number: int | None = None) -> Order:
    """The indices of chosen values by ascending value, to single precision; no value is negative.

    The bits of floats that are not negative are in the order of the floats. Values that are one in single precision
    keep the order of their indices, so that a median may be its neighbour within 6e-8 of it.

    Parameters
    ----------
    chosen, values
        `[n]`.
    number
        How many are chosen, if that is known.
    """
    number = int(np.count_nonzero(chosen)) if number is None else number
    with np.errstate(over="ignore"):
        bits = values.astype(np.float32).view(np.uint32)
    order, other = np.empty((2, number), dtype=np.uint64)
    return np.asarray(_kernels.ascending(bits, chosen, number, order, other))


def indices_of(order: Order) -> Indices:
    """The indices of an order, without the values."""
    return (order & np.uint64(0xFFFFFFFF)).astype(np.intp)


def medians(
    groups: Groups, strata: NDArray[np.int32], count: NDArray[np.int64], negative: NDArray[np.int64], order: Order
) -> tuple[Indices, Indices]:
    """The indices of the middles of each group's absolute values, and of its signed ones.

    In ascending order come the negative values, from the largest absolute one down, and then all others: which one
    has a rank among signed values follows from the order of the absolute ones.

    Parameters
    ----------
    strata
        `[n]`: twice the class, and one more where the value is negative.
    count, negative
        `[groups]`: pixels of each group that are in the order, and how many of them have a negative value.
    order
        The order of the absolute values.

    Returns
    -------
    absolute, signed
        `[groups, 2]`: indices of both middles (twice the same, where the count is odd); -1 for an empty group.
    """
    middle = np.stack([(count - 1) // 2, count // 2], axis=1)
    below, above = negative[:, None] - 1 - middle, middle - negative[:, None]
    empty = (count == 0)[:, None]
    ranks = np.where(np.tile(empty, 6), -1, np.concatenate([middle, above, below], axis=1))
    index = np.full(ranks.shape, -1, dtype=np.intp)
    _kernels.find_ranks(order, strata, groups.labels, groups.layers, ranks, index)
    signed = np.where(below >= 0, index[:, 4:], index[:, 2:4])
    return index[:, :2], np.where(empty, -1, signed)


def mean_of_middles(middles: Indices, values: Array) -> Array:
    """Medians `[groups]` from the indices of both middles; NaN for an empty group. values : `[n]`."""
    if not values.size:
        return np.full(len(middles), np.nan)
    return np.where(middles[:, 0] < 0, np.nan, values[middles].mean(axis=1))


@dataclass(frozen=True)
class Sorted:
    """Values of parts that do not overlap, sorted within each, for medians over any choice of them."""

    values: Array
    """`[n]`."""
    indices: Indices
    """Part by part, in ascending order of value."""
    starts: NDArray[np.int64]
    """`[parts + 1]`, into `indices`."""


def sorted_parts(parts: NDArray[np.int64], number: int, values: Array) -> Sorted:
    """Sort values part by part.

    Parameters
    ----------
    parts
        `[n]`: the part of each value, -1 for none.
    number
        Number of parts.
    values
        `[n]`; not negative.
    """
    order = ascending(parts >= 0, values)
    sizes = np.bincount(parts[parts >= 0], minlength=number)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    out = np.empty(order.size, dtype=np.intp)
    _kernels.split_order(order, parts, starts[:-1].copy(), out)
    return Sorted(values, out, starts)


def medians_of_scored(parts: Sorted, scored: Mask, count: NDArray[np.int64]) -> Array:
    """Median of the scored values of each part, `[parts]`; `count` is their number; NaN for none."""
    out = np.full(count.size, np.nan)
    _kernels.medians_of_parts(parts.indices, parts.starts, scored, count, parts.values, out)
    return out
