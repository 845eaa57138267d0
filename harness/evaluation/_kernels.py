"""Compiled loops over pixels and groups. Called through `groups`, which prepares the arguments."""

from numba import njit


@njit(cache=True, nogil=True)
def count(labels, seen, counts):
    """How many seen pixels each group has. labels : `[layers, pixels]`, group or -1; counts : written, `[groups]`."""
    for layer in range(labels.shape[0]):
        for pixel in range(labels.shape[1]):
            if seen[pixel] and labels[layer, pixel] >= 0:
                counts[labels[layer, pixel]] += 1


@njit(cache=True, nogil=True)
def add(labels, seen, values, sums):
    """Sums over the seen pixels of each group. values : `[pixels, kinds]`; sums : written, `[groups, kinds]`."""
    for layer in range(labels.shape[0]):
        for pixel in range(labels.shape[1]):
            group = labels[layer, pixel]
            if seen[pixel] and group >= 0:
                for kind in range(values.shape[1]):
                    sums[group, kind] += values[pixel, kind]


@njit(cache=True, nogil=True)
def medians(labels, seen, order, values, counts, passed, low, high):
    """Both middle values (one, where the count is odd) of each group, in one walk over the pixels in ascending order.

    order : pixels by ascending value; passed : `[groups]`, zeros; low, high : written, `[groups]`.
    """
    for layer in range(labels.shape[0]):
        for i in range(order.size):
            pixel = order[i]
            group = labels[layer, pixel]
            if group < 0 or not seen[pixel]:
                continue
            if passed[group] == (counts[group] - 1) // 2:
                low[group] = values[pixel]
            if passed[group] == counts[group] // 2:
                high[group] = values[pixel]
            passed[group] += 1
