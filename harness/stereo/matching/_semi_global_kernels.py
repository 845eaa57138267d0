"""Compiled loops of semi-global matching. `semi_global` lays out their arguments.

Everything is a whole number, so that sums come out the same in any order. Labels run along memory, in whole blocks of
`BLOCK`: the innermost loops then have a length that the compiler knows, and become a few instructions each. Path costs
fit into 8 bits, 64 labels into one register of the widest kind. Indices of those loops are unsigned: numba would
otherwise ask of each whether it counts from the end. Parts of arrays are named by indices beside the array: to slice
one counts references, atomically, and the threads would queue for that.
"""
# ruff: noqa: ANN001, ANN202, C901
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

import numpy as np
from numba import njit

BLOCK = 32
"""Labels come in multiples of this."""
REACH = 2
"""A census looks at neighbours up to so many pixels away: 5 x 5, less the middle one."""
ABSENT = np.uint32(1 << 31)
"""Bit of a census code: there is no pixel."""
BITS_APART = np.uint8(12)
"""What a pixel that is not there differs by: as much as chance."""
MAX_LAPS = 16
OK, LEAVES_IMAGE = 0, 1


# -- Images ------------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def smooth(image, passes, first, end, out):
    """Rows first .. end of the image after `passes` of (1 2 1)/4 along rows and columns, not divided.

    image, out : `[around, along]`; the rows are a circle, the first and last column go on outwards.
    passes : 0 or 1; an unsmoothed image is multiplied alike.
    """
    rows, columns = image.shape
    for row in range(first, end):
        above, below = (row - 1) % rows, (row + 1) % rows
        for column in range(columns):
            if passes:
                left, right = max(column - 1, 0), min(column + 1, columns - 1)
                middle = image[above, column] + 2 * image[row, column] + image[below, column]
                before = image[above, left] + 2 * image[row, left] + image[below, left]
                after = image[above, right] + 2 * image[row, right] + image[below, right]
                out[row, column] = before + 2 * middle + after
            else:
                out[row, column] = 16 * image[row, column]


@njit(cache=True, nogil=True)
def census(image, seen, margin, first, end, codes):
    """Census codes of rows first .. end, a bit for each neighbour that is below the pixel.

    image, seen : `[around, along]`.
    codes : written, `[around, along + 2 margin]`; `ABSENT` where the pixel is not seen, and in the margins.
    """
    rows, columns = image.shape
    for row in range(first, end):
        codes[row, :margin] = ABSENT
        codes[row, margin + columns :] = ABSENT
        for column in range(columns):
            codes[row, margin + column] = np.uint32(0) if seen[row, column] else ABSENT
        bit = np.uint32(1)
        for y in range(-REACH, REACH + 1):
            other = (row + y) % rows
            for x in range(-REACH, REACH + 1):
                if y == 0 and x == 0:
                    continue
                # Columns beyond the first and last are those.
                for column in range(max(-x, 0)):
                    if image[other, 0] < image[row, column]:
                        codes[row, margin + column] |= bit
                for column in range(columns - max(x, 0), columns):
                    if image[other, columns - 1] < image[row, column]:
                        codes[row, margin + column] |= bit
                for column in range(np.uint64(max(-x, 0)), np.uint64(columns - max(x, 0))):
                    darker = image[other, np.uint64(column + np.uint64(x))] < image[row, column]
                    codes[row, np.uint64(margin) + column] |= bit if darker else np.uint32(0)
                bit = np.uint32(bit << np.uint32(1))


# -- Costs -------------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _bits_of_row(codes_1, codes_2, around, along, margin, k_0, row, bits, slot):
    """Different bits of every pixel of a row and its samples. bits : written at `slot`, `[slots, width, labels]`."""
    labels = np.uint64(bits.shape[2])
    for column in range(np.uint64(bits.shape[1])):
        b = np.uint64(around[row, column])
        a = np.uint64(along[row, column] + margin)
        code = codes_1[b, a]
        start = np.uint64(np.int64(a) + k_0)
        for k in range(labels):
            x = np.uint32(code ^ codes_2[b, start + k])
            there = x < ABSENT
            # The number of bits that are set: of pairs, of fours, of bytes, and of all four bytes.
            x = np.uint32(x - ((x >> np.uint32(1)) & np.uint32(0x55555555)))
            x = np.uint32((x & np.uint32(0x33333333)) + ((x >> np.uint32(2)) & np.uint32(0x33333333)))
            x = np.uint32((x + (x >> np.uint32(4))) & np.uint32(0x0F0F0F0F))
            x = np.uint32(np.uint32(x * np.uint32(0x01010101)) >> np.uint32(24))
            bits[slot, column, k] = np.uint8(x) if there else BITS_APART
        if code >= ABSENT:
            for k in range(labels):
                bits[slot, column, k] = BITS_APART


@njit(cache=True, nogil=True)
def matching_costs(
    codes_1, codes_2, around, along, margin, k_0, k_first, k_last, half, multiplier, worst, first, end, costs
):
    """Matching costs of rows first .. end: mean of a box of differing bits, and `worst` for labels not searched.

    codes_1, codes_2 : `[around, along + 2 margin]`, from `census`.
    around, along, k_first, k_last : `[height, width]`; the pixel's place in the codes, and its search interval.
    half : the box has 2 half + 1 pixels a side; around the seam, the first and last row going on outwards.
    multiplier : cost of a bit in 2^-16, over the pixels of a box.
    costs : written, `[height, width, labels]`.
    """
    height, width, labels = costs.shape
    size = 2 * half + 1
    bits = np.empty((size, width, labels), np.uint8)
    columns = np.zeros((width, labels), np.uint16)  # sums of the box's rows
    total = np.empty(labels, np.uint16)
    for row in range(first - half, first + half + 1):
        inside = min(max(row, 0), height - 1)
        if row == first - half or 0 < row < height:
            _bits_of_row(codes_1, codes_2, around, along, margin, k_0, inside, bits, inside % size)
        _add(columns, bits, inside % size)
    for row in range(first, end):
        if row > first:
            _take_off(columns, bits, max(row - 1 - half, 0) % size)
            if row + half < height:
                _bits_of_row(codes_1, codes_2, around, along, margin, k_0, row + half, bits, (row + half) % size)
            _add(columns, bits, min(row + half, height - 1) % size)
        total[:] = 0
        for offset in range(-half, half):
            for k in range(labels):
                total[k] = np.uint16(total[k] + columns[offset % width, k])
        for column in range(width):
            ahead = np.uint64((column + half) % width)
            behind = np.uint64((column - half) % width)
            low, high = k_first[row, column] - k_0 - 1, k_last[row, column] - k_0 + 1
            for k in range(np.uint64(labels)):
                value = np.uint16(total[k] + columns[ahead, k])
                total[k] = np.uint16(value - columns[behind, k])
                cost = np.uint8((np.uint32(value) * np.uint32(multiplier) + np.uint32(1 << 15)) >> np.uint32(16))
                number = np.int32(k)
                outside = (number < np.int32(low)) | (number > np.int32(high))
                costs[row, column, k] = worst if outside else cost


@njit(cache=True, nogil=True)
def _add(columns, bits, slot):
    for column in range(np.uint64(columns.shape[0])):
        for k in range(np.uint64(columns.shape[1])):
            columns[column, k] = np.uint16(columns[column, k] + bits[slot, column, k])


@njit(cache=True, nogil=True)
def _take_off(columns, bits, slot):
    for column in range(np.uint64(columns.shape[0])):
        for k in range(np.uint64(columns.shape[1])):
            columns[column, k] = np.uint16(columns[column, k] - bits[slot, column, k])


# -- Paths -------------------------------------------------------------------------------------------------------------
#
# The path cost of label k at a pixel p, with q the pixel before it on the path, is
# L(p, k) = C(p, k) + min(L(q, k), L(q, k - 1) + P1, L(q, k + 1) + P1, min L(q) + P2) - min L(q).
# Path costs of a row are `[width, labels + 2]`: the guards at both ends never win.


@njit(cache=True, nogil=True)
def _step(costs, row, column, before, slot, b, least, p1, p2, after, new_slot, a):
    """One pixel of a path: its costs are written to `after[new_slot, a]`, and the least of them is returned."""
    jump = np.uint8(least + p2)
    new_least = np.uint8(255)
    for block in range(np.uint64(costs.shape[2] // BLOCK)):
        start = np.uint64(block * np.uint64(BLOCK))
        for i in range(np.uint64(BLOCK)):
            k = start + i
            same = before[slot, b, k + np.uint64(1)]
            lower, upper = before[slot, b, k], before[slot, b, k + np.uint64(2)]
            beside = min(upper, lower)
            beside = np.uint8(beside + p1)
            best = min(beside, same)
            best = min(jump, best)
            value = np.uint8(costs[row, column, k] + np.uint8(best - least))
            after[new_slot, a, k + np.uint64(1)] = value
            new_least = min(new_least, value)
    return new_least


@njit(cache=True, nogil=True)
def _begin(costs, row, column, after, slot, a):
    """The first pixel of a path: its matching costs; the least of them."""
    least = np.uint8(255)
    for k in range(np.uint64(costs.shape[2])):
        value = costs[row, column, k]
        after[slot, a, k + np.uint64(1)] = value
        least = min(least, value)
    return least


@njit(cache=True, nogil=True)
def _circle(costs, row, forward, p1, jumps, laps, slot, spare):
    """The path around the row. laps : written at `slot`, `[slots, width, labels + 2]`.

    The path begins somewhere, with no pixel before it, and goes on for another lap until it meets what it left there a
    lap ago: from then on it repeats itself, and every pixel has the one before it that it would have on an endless
    path. Returns how many pixels that took beyond the first lap.
    """
    width, labels = np.uint64(costs.shape[1]), np.uint64(costs.shape[2])
    a = np.uint64(0)
    least = _begin(costs, row, a, laps, slot, a)
    for number in range(np.uint64(1), width * np.uint64(MAX_LAPS)):
        b = a
        if forward:
            a = b + np.uint64(1) if b + np.uint64(1) < width else np.uint64(0)
            p2 = jumps[0, row, a]
        else:
            a = b - np.uint64(1) if b > 0 else width - np.uint64(1)
            p2 = jumps[0, row, b]
        if number < width:
            least = _step(costs, row, a, laps, slot, b, least, p1, p2, laps, slot, a)
            continue
        least = _step(costs, row, a, laps, slot, b, least, p1, p2, spare, np.uint64(0), np.uint64(0))
        changed = 0
        for k in range(np.uint64(1), labels + np.uint64(1)):
            changed |= laps[slot, a, k] ^ spare[0, 0, k]
            laps[slot, a, k] = spare[0, 0, k]
        if changed == 0:
            return np.int64(number - width)
    return np.int64(width) * (MAX_LAPS - 1)


@njit(cache=True, nogil=True)
def _descend(costs, row, begins, downwards, sideways, p1, jumps, before, after, least, new_least, slot):
    """One row of the paths that come from the row before it; `sideways` columns on with every row."""
    width = costs.shape[1]
    other = row + 1  # the row of `jumps` between this row and the one before it
    if downwards:
        other = row
    for column in range(width):
        a = np.uint64(column)
        if begins:
            new_least[slot, a] = _begin(costs, row, a, after, slot, a)
            continue
        b = np.uint64((column - sideways) % width)
        # Jumps are kept at the lower of both pixels, by how many columns the upper one lies to the left of it.
        lower = a if downwards else b
        kind = 1 + (sideways if downwards else -sideways) % 3
        p2 = jumps[kind, other, lower]
        new_least[slot, a] = _step(costs, row, a, before, slot, b, least[slot, b], p1, p2, after, slot, a)


@njit(cache=True, nogil=True)
def _sum_of_three(paths, others, row, sums):
    for column in range(np.uint64(sums.shape[1])):
        for k in range(np.uint64(sums.shape[2])):
            at = k + np.uint64(1)
            sums[row, column, k] = np.uint16(
                np.uint16(paths[0, column, at]) + np.uint16(paths[1, column, at]) + np.uint16(others[0, column, at])
            )


@njit(cache=True, nogil=True)
def _add_path(paths, slot, row, sums):
    for column in range(np.uint64(sums.shape[1])):
        for k in range(np.uint64(sums.shape[2])):
            sums[row, column, k] = np.uint16(sums[row, column, k] + paths[slot, column, k + np.uint64(1)])


@njit(cache=True, nogil=True)
def first_half(costs, start, count, downwards, sideways, p1, jumps, state, least, laps, spare, sums):
    """Sums of the path costs along the rows and of those that come from one side, for `count` rows from `start` on.

    costs : `[height, width, labels]`.
    sideways : `[paths]`, how many columns each path from that side moves with every row: 0, then -1 and 1 or nothing.
    jumps : `[4, height, width]`, P2 between the pixel and the one to the left of it, above it, to the upper left
        and to the upper right.
    state, least : written, `[2, paths, width, labels + 2]` and `[2, paths, width]`; the last row's at `count` modulo 2.
    laps, spare : to work in; `[2, width, labels + 2]` and `[1, 1, labels + 2]`, guards set as those of `state`.
    sums : written, `[height, width, labels]`.
    """
    for number in range(count):
        row = start + number if downwards else start - number
        for slot in range(2):
            _circle(costs, row, slot == 0, p1, jumps, laps, np.uint64(slot), spare)
        old, new = number % 2, (number + 1) % 2
        before, after, old_least, new_least = state[old], state[new], least[old], least[new]
        for path in range(sideways.size):
            _descend(
                costs, row, number == 0, downwards, sideways[path], p1, jumps, before, after, old_least, new_least,
                np.uint64(path),
            )  # fmt: skip
        _sum_of_three(laps, after, row, sums)
        for path in range(1, sideways.size):
            _add_path(after, np.uint64(path), row, sums)


@njit(cache=True, nogil=True)
def second_half(
    costs,
    start,
    count,
    done,
    downwards,
    sideways,
    p1,
    jumps,
    state,
    least,
    sums,
    k_0,
    k_first,
    k_last,
    best,
    nearby,
    second,
):
    """Goes on where `first_half` stopped, through rows whose other sums are known, and takes the best label of each.

    done : how many rows the paths have behind them.
    sums : `[height, width, labels]`; the sums over all paths afterwards.
    best, nearby, second : written, `[height, width]`, `[height, width, 3]` and `[height, width]`; the best label of the
        search interval (the first of equals; -1 where there is none), the sums around it, and the least sum that is
        not next to it.
    """
    for number in range(count):
        row = start + number if downwards else start - number
        old, new = (done + number) % 2, (done + number + 1) % 2
        before, after, old_least, new_least = state[old], state[new], least[old], least[new]
        for path in range(sideways.size):
            _descend(
                costs, row, False, downwards, sideways[path], p1, jumps, before, after, old_least, new_least,
                np.uint64(path),
            )  # fmt: skip
            _add_path(after, np.uint64(path), row, sums)
        _choose(sums, row, k_0, k_first, k_last, best, nearby, second)


@njit(cache=True, nogil=True)
def _choose(sums, row, k_0, k_first, k_last, best, nearby, second):
    none = np.uint32(0xFFFFFFFF)
    for column in range(np.uint64(sums.shape[1])):
        first, last = np.int32(k_first[row, column] - k_0), np.int32(k_last[row, column] - k_0)
        found = none
        for k in range(np.uint64(sums.shape[2])):
            number = np.int32(k)
            key = np.uint32(np.uint32(sums[row, column, k]) << np.uint32(16)) | np.uint32(k)
            key = key if (number >= first) & (number <= last) else none
            found = min(found, key)
        if found == none:
            best[row, column] = -1
            continue
        middle = np.int32(found & np.uint32(0xFFFF))
        best[row, column] = middle
        for i in range(3):
            nearby[row, column, i] = sums[row, column, middle - 1 + i]
        other = np.uint16(0xFFFF)
        for k in range(np.uint64(sums.shape[2])):
            number = np.int32(k)
            value = sums[row, column, k]
            far = (number >= first) & (number <= last) & (abs(number - middle) > 1)
            value = value if far else np.uint16(0xFFFF)
            other = min(other, value)
        second[row, column] = other


# -- Uniqueness --------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def consistent(around, along, samples, cost, tolerance, rows, columns, keeps):
    """Whether the place of view 2 that a pixel is matched with is not a better match of another pixel.

    around, along : `[height, width]`; the pixel's place in view 1.
    samples : `[height, width]`, how far from there along the row its match is in view 2; negative for no match.
    cost : `[height, width]`; the better, the less. Of equals the one with more samples, which is nearer.
    keeps : written, `[height, width]`; False where the better match is more than `tolerance` samples from the pixel's.
    """
    height, width = around.shape
    least = np.full((rows, columns), np.int64(1) << 62)
    for row in range(height):
        for column in range(width):
            k = samples[row, column]
            if k >= 0:
                b, a = around[row, column], along[row, column] + k
                least[b, a] = min(least[b, a], (np.int64(cost[row, column]) << 16) - k)
    for row in range(height):
        for column in range(width):
            k = samples[row, column]
            if k >= 0:
                key = least[around[row, column], along[row, column] + k]
                winner = -key & 0xFFFF
                keeps[row, column] = abs(winner - k) <= tolerance
