"""Compiled loops over pixels and groups. Called through `groups`, which prepares the arguments."""

import math

import numpy as np

from harness.compiled import kernel

DIGITS = 1 << 11

COUNT, NEGATIVE, SQUARE_PX, GROSS, OFF_M, SQUARE_M, BIAS_M = range(7)
"""Columns of the sums of a class; there is one more, so that a row is a power of two."""
KINDS = 8

BLOCK = 1024
"""Entries of an order that are counted together before testing whether a middle lies among them."""


@kernel
def true_angles(
    range_m, directions, alpha_1, step, n_z, baseline, phi_sampled, least_sine, sideways, alpha_2, law, half_step
):
    """Write the fields of `pixel_errors.Reference`, `[n]`; NaN where the range is.

    directions : `[n, 3]`, unit vectors; baseline : `[3]`, t.
    phi_sampled : whether `step` is one of phi.
    """
    tx, ty, tz = baseline
    length = math.sqrt(tx * tx + ty * ty + tz * tz)
    for i in range(range_m.size):
        sine = math.sin(alpha_1[i])
        sideways[i] = sine >= least_sine
        d_1 = range_m[i]
        if math.isnan(d_1):
            alpha_2[i] = law[i] = half_step[i] = math.nan
            continue
        # From viewpoint 2 to the point.
        x, y, z = d_1 * directions[i, 0] - tx, d_1 * directions[i, 1] - ty, d_1 * directions[i, 2] - tz
        cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
        square = x * x + y * y + z * z
        alpha_2[i] = math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), x * tx + y * ty + z * tz)
        law[i] = square / (length * sine)
        half_step[i] = abs(step[i]) / 2.0
        if phi_sampled:
            half_step[i] *= (x * x + y * y) / square / abs(n_z[i])


@kernel
def bins(values, edges, out):
    """Write the bin of ascending edges that each value is in; -1 for none."""
    last = edges.size - 1
    for i in range(values.size):
        value = values[i]
        number = -1
        if edges[0] <= value < edges[last]:
            number = 0
            while value >= edges[number + 1]:
                number += 1
        out[i] = number


@kernel
def gather_members(labels, position, out):
    """Write the indices of each label from 0 on, label after label. position : where each begins; is advanced."""
    for i in range(labels.size):
        label = labels[i]
        if label >= 0:
            out[position[label]] = i
            position[label] += 1


@kernel
def classes(labels, groups, out):
    """Number the different rows of labels `[n, layers]`, each -1 .. groups - 1; return how many there are.

    out : written, `[n]`, every row's number.
    """
    number = 1
    out[:] = 0
    for layer in range(labels.shape[1]):
        known = np.full((number, groups + 1), -1, dtype=np.int32)
        number = 0
        for i in range(out.size):
            label = labels[i, layer] + 1
            if known[out[i], label] < 0:
                known[out[i], label] = number
                number += 1
            out[i] = known[out[i], label]
    return number


@kernel
def add_errors(
    pixels, classes, surface, weight, range_m, disparity, distance, valid, limits_px, limits_ratio,
    scored, strata, absolute_px, off_m, logarithm, sums, domain, weighted, above, within,
):  # fmt: skip
    """All sums of errors, in one pass over the pixels.

    pixels, classes, surface, weight, range_m : of the grouped pixels, `[n]`; see `groups.Groups` and `regions.Layout`.
    disparity, distance, valid : of the whole picture, flat.
    limits_px, limits_ratio : ascending.
    scored, absolute_px, off_m : written, `[n]`; whether the pixel has an error, which takes an estimate and a truth;
        and absolute errors, infinite where there is none.
    strata : written, `[n]`: twice the class, and one more where the disparity's error is negative.
    logarithm : written, `[n]`; its first entries, for the domain's scored pixels.
    sums : written, `[classes, KINDS]`.
    domain : written: scored pixels; sums of absolute disparity errors and of absolute relative errors.
    weighted : written, as sums, with each of the domain's pixels counted by its weight; COUNT is that of the scored
        ones, NEGATIVE that of all.
    above : written, absolute disparity errors of the domain above each of `limits_px`.
    within : written, logarithms of the domain nearer to zero than each of `limits_ratio`.
    """
    number = 0
    for i in range(pixels.size):
        pixel = pixels[i]
        inside = surface[i] >= 0
        if inside:
            weighted[NEGATIVE] += weight[i]
        d, r = disparity[pixel], distance[pixel]
        scored[i] = valid[pixel] and math.isfinite(d)
        if not scored[i]:
            absolute_px[i], off_m[i] = math.inf, math.inf
            continue
        absolute, off = abs(d), abs(r)
        absolute_px[i], off_m[i] = absolute, off
        negative, gross = 1 if d < 0.0 else 0, 1.0 if absolute > 1.0 else 0.0
        square_px, square_m = d * d, r * r
        class_number = classes[i]
        strata[i] = 2 * class_number + negative
        sums[class_number, COUNT] += 1.0
        sums[class_number, NEGATIVE] += negative
        sums[class_number, SQUARE_PX] += square_px
        sums[class_number, GROSS] += gross
        sums[class_number, OFF_M] += off
        sums[class_number, SQUARE_M] += square_m
        sums[class_number, BIAS_M] += r
        if inside:
            w = weight[i]
            weighted[COUNT] += w
            weighted[SQUARE_PX] += w * square_px
            weighted[GROSS] += w * gross
            weighted[OFF_M] += w * off
            weighted[SQUARE_M] += w * square_m
            weighted[BIAS_M] += w * r
            for j in range(limits_px.size):
                if absolute <= limits_px[j]:
                    break
                above[j] += 1
            relative = r / range_m[i]
            domain[1] += absolute
            domain[2] += abs(relative)
            logarithm[number] = math.log1p(relative)
            ratio = abs(logarithm[number])
            for j in range(limits_ratio.size - 1, -1, -1):
                if not ratio < limits_ratio[j]:
                    break
                within[j] += 1
            number += 1
    domain[0] = number


@kernel
def ascending(bits, scored, number, order, other):
    """Sort the scored ones of the 32-bit keys, `number` of them, each in the bits above its index: key << 32 | index.

    A radix sort: three passes of eleven bits, each of them stable; the sign bit is ignored.
    order, other : `[number]`; the result is what is returned, one of the two.
    """
    digits = np.zeros((3, DIGITS), dtype=np.int64)
    mask = np.uint64(DIGITS - 1)
    last = 0
    for i in range(bits.size):
        if scored[i]:
            key = np.uint64(bits[i])
            other[last] = key << np.uint64(32) | np.uint64(i)
            last += 1
            digits[0, key & mask] += 1
            digits[1, (key >> np.uint64(11)) & mask] += 1
            digits[2, (key >> np.uint64(22)) & mask] += 1
    for turn in range(3):
        position = digits[turn]
        before = 0
        for digit in range(DIGITS):
            count = position[digit]
            position[digit] = before
            before += count
        shift = np.uint64(32 + 11 * turn)
        for i in range(number):
            digit = (other[i] >> shift) & mask
            order[position[digit]] = other[i]
            position[digit] += 1
        order, other = other, order
    return other


@kernel
def add_classes(labels, of_class, of_group):
    """Add up sums of classes to sums of groups.

    labels : `[classes, layers]`; of_class, of_group : `[classes, kinds]` and, written, `[groups, kinds]`.
    """
    for class_number in range(labels.shape[0]):
        for layer in range(labels.shape[1]):
            group = np.intp(labels[class_number, layer])
            if group >= 0:
                for kind in range(of_class.shape[1]):
                    of_group[group, kind] += of_class[class_number, kind]


@kernel
def find_ranks(order, strata, labels, layer_of_group, ranks, index):
    """The indices of the values with some ranks in each group.

    Blocks of the order are counted by class, which is one step a pixel whatever the number of layers. Only a block in
    which a rank must lie is searched.

    order : as from `ascending`.
    strata : `[n]`, twice the class of each pixel, plus its sign, 0 or 1.
    labels : `[classes, layers]`, a class's group in each layer, or -1.
    layer_of_group : `[groups]`.
    ranks : `[groups, 6]`: two among all pixels of the group, two among those of sign 0, two of sign 1; -1 for none.
    index : written, `[groups, 6]`.
    """
    groups = ranks.shape[0]
    passed, here = np.zeros((groups, 2), dtype=np.int64), np.zeros((groups, 2), dtype=np.int64)
    counts = np.zeros((labels.shape[0], 2), dtype=np.int32)
    block = np.empty(BLOCK, dtype=np.int32)  # strata lie anywhere, and are searched once for each of the block's ranks
    low = np.uint64(0xFFFFFFFF)
    for start in range(0, order.size, BLOCK):
        size = min(BLOCK, order.size - start)
        counts[:] = 0
        here[:] = 0
        for j in range(size):
            stratum = strata[order[start + j] & low]
            block[j] = stratum
            counts[stratum >> 1, stratum & 1] += 1
        for class_number in range(labels.shape[0]):
            if counts[class_number, 0] + counts[class_number, 1] > 0:
                for layer in range(labels.shape[1]):
                    member_of = np.intp(labels[class_number, layer])
                    if member_of >= 0:
                        here[member_of, 0] += counts[class_number, 0]
                        here[member_of, 1] += counts[class_number, 1]
        for group in range(groups):
            wanted = False
            for query in range(6):
                kind = query // 2
                if kind == 0:
                    before, number = passed[group, 0] + passed[group, 1], here[group, 0] + here[group, 1]
                else:
                    before, number = passed[group, kind - 1], here[group, kind - 1]
                wanted |= before <= ranks[group, query] < before + number
            if wanted:
                zeros, ones, layer = passed[group, 0], passed[group, 1], layer_of_group[group]
                for j in range(size):
                    stratum = block[j]
                    if labels[stratum >> 1, layer] != group:
                        continue
                    i, sign = order[start + j] & low, stratum & 1
                    among = ones if sign else zeros
                    for query in range(2):
                        if ranks[group, query] == zeros + ones:
                            index[group, query] = i
                        if ranks[group, 2 + 2 * sign + query] == among:
                            index[group, 2 + 2 * sign + query] = i
                    ones += sign
                    zeros += 1 - sign
            passed[group, 0] += here[group, 0]
            passed[group, 1] += here[group, 1]


@kernel
def distribution(order, absolute, surface, weight, half, edges, edge_bits, ranks, histogram, quantiles):
    """Histograms of either surface, and quantiles of the domain, from one pass in ascending order.

    order : as from `ascending`.
    absolute : `[n]`, what it is the order of.
    half : half of the weight of all scored pixels of the domain.
    edges, edge_bits : of the histogram's bins, and the bits of the same in single precision.
    ranks : ascending, in the domain's order.
    histogram : written, `[2, bins]`, the last of which holds all that is above.
    quantiles : written: the value up to which half of the weight lies, and those with the ranks.
    """
    reached, number, wanted, current = 0.0, 0, 0, 0
    bins = histogram.shape[1]
    for j in range(order.size):
        i = order[j] & np.uint64(0xFFFFFFFF)
        if surface[i] < 0:
            continue
        key = np.uint32(order[j] >> np.uint64(32))
        while current + 1 < bins and key > edge_bits[current + 1]:
            current += 1
        # Equal in single precision: ask again.
        further = current + 1 < bins and key == edge_bits[current + 1] and absolute[i] >= edges[current + 1]
        histogram[surface[i], current + 1 if further else current] += 1
        before = reached
        reached += weight[i]
        if before < half <= reached:
            quantiles[0] = absolute[i]
        while wanted < ranks.size and ranks[wanted] == number:
            quantiles[1 + wanted] = absolute[i]
            wanted += 1
        number += 1


@kernel
def weighted_middle(order, absolute, surface, weight, half):
    """The value up to which half of the domain's weight lies."""
    reached = 0.0
    for j in range(order.size):
        i = order[j] & np.uint64(0xFFFFFFFF)
        if surface[i] >= 0:
            reached += weight[i]
            if reached >= half:
                return absolute[i]
    return math.nan


@kernel
def split_order(order, parts, position, out):
    """Write the indices of `order`, as from `ascending`, by part. parts : `[n]`, -1 for none; position : starts."""
    for j in range(order.size):
        i = order[j] & np.uint64(0xFFFFFFFF)
        if parts[i] >= 0:
            out[position[parts[i]]] = i
            position[parts[i]] += 1


@kernel
def medians_of_parts(indices, starts, scored, count, values, out):
    """The median of the scored ones of each part; parts lie one after the other, in ascending order.

    starts : `[parts + 1]`; count : scored ones of each part; out : written, `[parts]`, not where there are none.
    """
    for part in range(count.size):
        passed = 0
        if count[part] == 0:
            continue
        low = 0.0
        for j in range(starts[part], starts[part + 1]):
            i = indices[j]
            if scored[i]:
                if passed == (count[part] - 1) // 2:
                    low = values[i]
                if passed == count[part] // 2:
                    out[part] = (low + values[i]) / 2
                    break
                passed += 1


@kernel
def add_fractions(pixels, surface, scored, k, histogram):
    """Count positions between two samples of either surface. histogram : written, `[2, bins]`."""
    bins = histogram.shape[1]
    for i in range(pixels.size):
        position = k[pixels[i]] * bins + 0.5
        if scored[i] and surface[i] >= 0 and math.isfinite(position):
            histogram[surface[i], math.floor(position) % bins] += 1


@kernel
def count_flags(pixels, surface, scored, flags):
    """How many of the domain's scored pixels have a flag."""
    number = 0
    for i in range(pixels.size):
        if scored[i] and surface[i] >= 0 and flags[pixels[i]]:
            number += 1
    return number
