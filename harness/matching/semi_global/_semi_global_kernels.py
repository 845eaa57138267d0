"""Compiled loops of semi-global matching. `match` prepares their arguments.

Everything is a whole number, so that sums come out the same in any order. Labels run along memory, in whole blocks of
`BLOCK`: the innermost loops then have a length that the compiler knows, and become a few instructions each. Path costs
fit into 8 bits, 64 labels into one register of the widest kind. Indices of those loops are unsigned: numba would
otherwise ask of each whether it counts from the end. Parts of arrays are named by indices beside the array: to slice
one counts references, atomically, and the threads would queue for that.
"""

import numpy as np

from harness.compiled import kernel
from harness.matching._matching_kernels import bits_set

BLOCK = 32
"""Labels come in multiples of this."""
REACH = 2
"""A census looks at neighbours up to so many pixels away: 5 x 5, less the middle one."""
ABSENT = np.uint32(1 << 31)
"""Bit of a census code: the pixel is missing."""
UNRELATED_BITS = np.uint8(12)
"""How many bits a missing pixel differs by: as many as chance gives."""
MAX_LAPS = 16


# -- Images ------------------------------------------------------------------------------------------------------------


@kernel
def census(image, valid, blur, margin, first, end, blurred, codes):
    """Census codes of rows first .. end of the blurred image, a bit for each neighbour that is below the pixel.

    image, valid : `[around, along]`; the rows are a circle, the first and last column go on outwards.
    blur : whether to take (1 2 1)/4 along rows and columns first.
    blurred : written, `[around, along]`, sixteenths of the image's unit.
    codes : written, `[around, along + 2 margin]`; `ABSENT` where the pixel is not valid, and in the margins.
    """
    rows, columns = np.uint64(image.shape[0]), np.uint64(image.shape[1])
    reach, one, two = np.uint64(REACH), np.uint64(1), np.uint64(2)
    count = np.uint64(end - first)
    # The rows at hand and REACH more on both sides, with as many columns beside them.
    near = np.empty((count + two * reach, columns + two * reach), image.dtype)
    above_and_below = np.empty(columns + two, image.dtype)
    for i in range(count + two * reach):
        row = (np.uint64(first) + rows - reach + i) % rows
        above, below = (row + rows - one) % rows, (row + one) % rows
        for j in range(columns):
            if blur:
                above_and_below[j + one] = image[above, j] + 2 * image[row, j] + image[below, j]
            else:
                above_and_below[j + one] = 4 * image[row, j]
        above_and_below[0] = above_and_below[1]
        above_and_below[columns + one] = above_and_below[columns]
        for j in range(columns):
            middle = 2 * above_and_below[j + one]
            if blur:
                near[i, j + reach] = above_and_below[j] + middle + above_and_below[j + two]
            else:
                near[i, j + reach] = 2 * middle
        for j in range(reach):
            near[i, j] = near[i, reach]
            near[i, columns + reach + j] = near[i, columns + reach - one]
    for i in range(count):
        row = np.uint64(first) + i
        codes[row, :] = ABSENT
        for j in range(columns):
            blurred[row, j] = near[i + reach, j + reach]
            codes[row, j + np.uint64(margin)] = np.uint32(0) if valid[row, j] else ABSENT
        bit = np.uint32(1)
        for y in range(two * reach + one):
            for x in range(two * reach + one):
                if y == reach and x == reach:
                    continue
                for j in range(columns):
                    darker = near[i + y, j + x] < near[i + reach, j + reach]
                    codes[row, j + np.uint64(margin)] |= bit if darker else np.uint32(0)
                bit = np.uint32(bit << np.uint32(1))


# -- Costs -------------------------------------------------------------------------------------------------------------


@kernel
def _bits_of_row(codes_1, codes_2, around, along, margin, k_0, row, bits, slot):
    """Differing bits of each pixel of a row and its samples. bits : written at `slot`, `[slots, width, labels]`."""
    labels = np.uint64(bits.shape[2])
    for column in range(np.uint64(bits.shape[1])):
        b = np.uint64(around[row, column])
        a = np.uint64(along[row, column] + margin)
        code = codes_1[b, a]
        start = np.uint64(np.int64(a) + k_0)
        for k in range(labels):
            x = np.uint32(code ^ codes_2[b, start + k])
            there = x < ABSENT
            bits[slot, column, k] = np.uint8(bits_set(x)) if there else UNRELATED_BITS
        if code >= ABSENT:
            for k in range(labels):
                bits[slot, column, k] = UNRELATED_BITS


@kernel
def matching_costs(codes_1, codes_2, around, along, margin, k_0, half, multiplier, first, end, top, costs):
    """Matching costs of rows first .. end: the mean of a box of differing bits.

    codes_1, codes_2 : `[around, along + 2 margin]`, from `census`.
    around, along : `[height, width]`, the pixel's row and column in the codes.
    k_0 : offset of the first label from that column.
    half : the box has 2 half + 1 pixels a side; around the seam, the first and last row going on outwards.
    multiplier : cost of a bit in 2^-16, over the pixels of a box.
    top : the panorama's row that is the first of `costs`.
    costs : written, `[rows, width, labels]`.
    """
    height, width, labels = around.shape[0], costs.shape[1], costs.shape[2]
    size = 2 * half + 1
    bits = np.empty((size, width, labels), np.uint8)
    columns = np.zeros((width, labels), np.uint16)  # sums of the box's rows
    total = np.empty(labels, np.uint16)
    for row in range(first - half, first + half + 1):
        inside = min(max(row, 0), height - 1)
        if row == first - half or 0 < row < height:
            _bits_of_row(codes_1, codes_2, around, along, margin, k_0, inside, bits, inside % size)
        _add_bits(columns, bits, inside % size)
    for row in range(first, end):
        if row > first:
            _subtract_bits(columns, bits, max(row - 1 - half, 0) % size)
            if row + half < height:
                _bits_of_row(codes_1, codes_2, around, along, margin, k_0, row + half, bits, (row + half) % size)
            _add_bits(columns, bits, min(row + half, height - 1) % size)
        total[:] = 0
        for offset in range(-half, half):
            for k in range(labels):
                total[k] = np.uint16(total[k] + columns[offset % width, k])
        for column in range(width):
            ahead = np.uint64((column + half) % width)
            behind = np.uint64((column - half) % width)
            for k in range(np.uint64(labels)):
                value = np.uint16(total[k] + columns[ahead, k])
                total[k] = np.uint16(value - columns[behind, k])
                scaled = np.uint32(np.uint32(value) * np.uint32(multiplier) + np.uint32(1 << 15))
                costs[row - top, column, k] = np.uint8(scaled >> np.uint32(16))


@kernel
def _add_bits(columns, bits, slot):
    for column in range(np.uint64(columns.shape[0])):
        for k in range(np.uint64(columns.shape[1])):
            columns[column, k] = np.uint16(columns[column, k] + bits[slot, column, k])


@kernel
def _subtract_bits(columns, bits, slot):
    for column in range(np.uint64(columns.shape[0])):
        for k in range(np.uint64(columns.shape[1])):
            columns[column, k] = np.uint16(columns[column, k] - bits[slot, column, k])


# -- Paths -------------------------------------------------------------------------------------------------------------
#
# The path cost of label k at a pixel p, with q the pixel before it on the path, is
# L(p, k) = C(p, k) + min(L(q, k), L(q, k - 1) + P1, L(q, k + 1) + P1, min L(q) + P2) - min L(q).
# Path costs of a row are `[width, labels + 2]`: the guards at both ends never win.


@kernel(inline=True)
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


@kernel
def _begin(costs, row, column, after, slot, a):
    """The first pixel of a path: its matching costs; the least of them."""
    least = np.uint8(255)
    for k in range(np.uint64(costs.shape[2])):
        value = costs[row, column, k]
        after[slot, a, k + np.uint64(1)] = value
        least = min(least, value)
    return least


@kernel
def _circles(costs, row, p1, jumps, laps, spare):
    """The two paths around the row. laps : written, `[2, width, labels + 2]`, of the one to the right and to the left.

    Each begins in the first column, with no pixel before it, and goes on for another lap until it meets what it left
    there a lap ago: from then on it repeats itself, and every pixel has the one before it that it would have on an
    endless path. Both go through their first lap together: each pixel waits for the one before it, and so the processor
    has two to work on.
    """
    width = np.uint64(costs.shape[1])
    right, left, one = np.uint64(0), np.uint64(1), np.uint64(1)
    least_right = _begin(costs, row, np.uint64(0), laps, right, np.uint64(0))
    least_left = _begin(costs, row, np.uint64(0), laps, left, np.uint64(0))
    b = np.uint64(0)  # the column before, of the path to the left
    for a in range(one, width):
        least_right = _step(
            costs, row, a, laps, right, a - one, least_right, p1, jumps[0, row, a], laps, right, a
        )  # fmt: skip
        c = width - a
        least_left = _step(costs, row, c, laps, left, b, least_left, p1, jumps[0, row, b], laps, left, c)
        b = c
    _close(costs, row, right, width - one, least_right, p1, jumps, laps, spare)
    _close(costs, row, left, one % width, least_left, p1, jumps, laps, spare)


@kernel
def _close(costs, row, slot, last, least, p1, jumps, laps, spare):
    """Go on from the last column of a path's first lap until it repeats itself."""
    width, labels = np.uint64(costs.shape[1]), np.uint64(costs.shape[2])
    b, one = last, np.uint64(1)
    for _ in range(width * np.uint64(MAX_LAPS - 1)):
        if slot == 0:
            a = b + one if b + one < width else np.uint64(0)
            p2 = jumps[0, row, a]
        else:
            a = b - one if b > 0 else width - one
            p2 = jumps[0, row, b]
        least = _step(costs, row, a, laps, slot, b, least, p1, p2, spare, np.uint64(0), np.uint64(0))
        changed = 0
        for k in range(one, labels + one):
            changed |= laps[slot, a, k] ^ spare[0, 0, k]
            laps[slot, a, k] = spare[0, 0, k]
        if changed == 0:
            return
        b = a


@kernel
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


@kernel
def _put(paths, row, sums):
    """Sums of the path costs of one pixel row, `[paths, width, labels + 2]`, to a row of `sums`."""
    for column in range(np.uint64(sums.shape[1])):
        for k in range(np.uint64(sums.shape[2])):
            sums[row, column, k] = paths[0, column, k + np.uint64(1)]
    for path in range(np.uint64(1), np.uint64(paths.shape[0])):
        _add(paths, path, sums, row)


@kernel
def _add(paths, path, sums, row):
    for column in range(np.uint64(sums.shape[1])):
        for k in range(np.uint64(sums.shape[2])):
            sums[row, column, k] = sums.dtype.type(sums[row, column, k] + paths[path, column, k + np.uint64(1)])


@kernel
def first_half(costs, start, count, done, downwards, sideways, p1, jumps, state, least, half_sums):
    """The paths that come from above, or from below, for `count` rows from `start` on.

    costs : `[height, width, labels]`.
    done : how many rows the paths have covered before; they begin where there are none.
    sideways : `[paths]`, how many columns each path moves with every row: 0, and then 1 and -1 or nothing.
    jumps : `[4, height, width]`, P2 between the pixel and the one to the left of it, above it, to the upper left
        and to the upper right.
    state, least : written, `[2, paths, width, labels + 2]` and `[2, paths, width]`; the last row's at `done + count`
        modulo 2.
    half_sums : written, `[height, width, labels]`; the sums of their costs.
    """
    for number in range(count):
        row = start + number if downwards else start - number
        old, new = (done + number) % 2, (done + number + 1) % 2
        before, after, old_least, new_least = state[old], state[new], least[old], least[new]
        for path in range(sideways.size):
            _descend(
                costs, row, done + number == 0, downwards, sideways[path], p1, jumps, before, after, old_least,
                new_least, np.uint64(path),
            )  # fmt: skip
        _put(after, np.uint64(row), half_sums)


@kernel
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
    half_sums,
    laps,
    spare,
    sums,
    k_0,
    k_first,
    k_last,
    best,
    nearby,
    second,
):
    """Continue where `first_half` stopped, through the rows of the paths from the other side, and take the best labels.

    done : how many rows the paths have covered.
    half_sums : `[height, width, labels]`, the sums of the paths from the other side.
    laps, spare : to work in; `[2, width, labels + 2]` and `[1, 1, labels + 2]`, guards set as those of `state`.
    sums : written, `[height, width, labels]`, the sums of all paths; or `[1, width, labels]`, to work in.
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
        _circles(costs, row, p1, jumps, laps, spare)
        slot = np.uint64(row % sums.shape[0])
        _complete(after, laps, half_sums, np.uint64(row), sums, slot, k_0, k_first, k_last, best, nearby, second)


@kernel
def _complete(paths, laps, half_sums, row, sums, slot, k_0, k_first, k_last, best, nearby, second):
    """The sums of all path costs of a pixel row, to a row of `sums`, and the best labels; pixel by pixel, while its
    sums are at hand.
    """
    width, labels, one, none = np.uint64(sums.shape[1]), np.uint64(sums.shape[2]), np.uint64(1), np.uint16(0xFFFF)
    for column in range(width):
        for k in range(labels):
            at = k + one
            around = np.uint16(np.uint16(laps[0, column, at]) + np.uint16(laps[1, column, at]))
            others = np.uint16(np.uint16(paths[0, column, at]) + np.uint16(half_sums[row, column, k]))
            sums[slot, column, k] = np.uint16(around + others)
        for path in range(one, np.uint64(paths.shape[0])):
            for k in range(labels):
                sums[slot, column, k] = np.uint16(sums[slot, column, k] + paths[path, column, k + one])
        if k_last[row, column] < k_first[row, column]:
            best[row, column] = -1
            continue
        # Labels are searched where label - first, below 0 a large number, is at most this.
        first = np.uint16(k_first[row, column] - k_0)
        most = np.uint16(k_last[row, column] - k_first[row, column])
        least = none
        for k in range(labels):
            value = sums[slot, column, k] if np.uint16(np.uint16(k) - first) <= most else none
            least = min(least, value)
        middle = none
        for k in range(labels):
            is_least = (np.uint16(np.uint16(k) - first) <= most) & (sums[slot, column, k] == least)
            middle = min(middle, np.uint16(k) if is_least else none)
        other, before = none, np.uint16(middle - np.uint16(1))
        for k in range(labels):
            far = (np.uint16(np.uint16(k) - first) <= most) & (np.uint16(np.uint16(k) - before) > np.uint16(2))
            other = min(other, sums[slot, column, k] if far else none)
        best[row, column] = np.int32(middle)
        for i in range(3):
            nearby[row, column, i] = sums[slot, column, np.uint64(before) + np.uint64(i)]
        second[row, column] = other


# -- Matches -----------------------------------------------------------------------------------------------------------


@kernel
def valid_in_both(codes_1, codes_2, around, along, margin, samples, first, end, valid_1, valid_2):
    """Whether view 1 sees the pixel, and view 2 the sample that many columns on; all arrays `[height, width]`, of which
    rows first .. end are worked out.
    """
    for row in range(np.uint64(first), np.uint64(end)):
        for column in range(np.uint64(around.shape[1])):
            b, a = np.uint64(around[row, column]), np.int64(along[row, column]) + margin
            valid_1[row, column] = codes_1[b, np.uint64(a)] < ABSENT
            valid_2[row, column] = codes_2[b, np.uint64(a + samples[row, column])] < ABSENT


@kernel
def consistent(around, along, samples, cost, tolerance, rows, columns, is_best):
    """Whether a pixel's match in view 2 is not a better match of another pixel.

    around, along : `[height, width]`; the pixel's row and column in view 1. samples : `[height, width]`, how many
    columns further its match is in view 2; negative for no match. cost : `[height, width]`; the lower, the better.
    Among equals the one with more samples wins: it is nearer. is_best : written, `[height, width]`; False where the
    better match is more than `tolerance` samples from the pixel's.
    """
    height, width = np.uint64(around.shape[0]), np.uint64(around.shape[1])
    least = np.full((rows, columns), np.int64(1) << 62)
    for row in range(height):
        for column in range(width):
            k = samples[row, column]
            if k >= 0:
                b, a = np.uint64(around[row, column]), np.uint64(along[row, column] + k)
                least[b, a] = min(least[b, a], (np.int64(cost[row, column]) << 16) - k)
    for row in range(height):
        for column in range(width):
            k = samples[row, column]
            if k >= 0:
                key = least[np.uint64(around[row, column]), np.uint64(along[row, column] + k)]
                winner = -key & 0xFFFF
                is_best[row, column] = abs(winner - k) <= tolerance
