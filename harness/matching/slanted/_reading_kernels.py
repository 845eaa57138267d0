"""Compiled loops over directions in which a field's planes are read. `field` and `sigma` prepare their arguments."""

import math

import numpy as np

from harness.compiled import kernel

AT_ONCE = 64
"""Directions side by side."""


@kernel
def read(pixels, seen, x, first_row, first_column, plane, chosen, index, window, w):
    """Read the planes of the pixels nearest to n directions.

    pixels, seen : `[n, 2]` and `[n]`; where the sensor sees the directions, and whether it does.
    x : `[n, 3]`, the directions.
    first_row, first_column : of the field in the image of which `pixels` are.
    index, window, w : written, `[n]`; see `field.read_planes`.
    """
    height, width = chosen.shape
    for k in range(x.shape[0]):
        row = int(np.rint(pixels[k, 1])) if seen[k] else 0
        column = int(np.rint(pixels[k, 0])) if seen[k] else 0
        row, column = min(max(row - first_row, 0), height - 1), min(max(column - first_column, 0), width - 1)
        index[k], window[k] = row * width + column, chosen[row, column]
        if seen[k] and window[k] >= 0:
            m = plane[window[k] // width, window[k] % width]
            w[k] = m[0] * x[k, 0] + m[1] * x[k, 1] + m[2] * x[k, 2]
        else:
            w[k] = math.nan


@kernel
def cover(valid, row, column, inside, w, out):
    """Write the inverse range of the panorama's pixel that holds each mirror pixel, NaN where none does.

    valid, row, column, inside : of mirror pixels, `[rows, columns]`; rows are floats.
    """
    for i in range(valid.shape[0]):
        for j in range(valid.shape[1]):
            there = valid[i, j] and inside[i, j]
            out[i, j] = w[int(row[i, j]), column[i, j]] if there else math.nan


@kernel
def across_and_along(x, t, across, along):
    """Write |t × x| and t·x of n directions, `[n, 3]`."""
    t_x, t_y, t_z = t[0], t[1], t[2]
    for k in range(x.shape[0]):
        across[k], along[k] = _across_and_along(x[k, 0], x[k, 1], x[k, 2], t_x, t_y, t_z)


@kernel
def _across_and_along(x, y, z, t_x, t_y, t_z):
    a, b, c = y * t_z - z * t_y, z * t_x - x * t_z, x * t_y - y * t_x
    return math.sqrt(a * a + b * b + c * c), x * t_x + y * t_y + z * t_z


@kernel
def seen_from_2(x, w, t, R, there, length, across, along):
    """Write what viewpoint 2 sees of n points in unit directions x of view 1 at inverse ranges w.

    There q = x - w t is the point, in view 1's orientation and in units of the range from viewpoint 1.

    there : `[n, 3]`, written; R q/|q|. length, across, along : written; |q|, |t × q| and t·q.
    """
    t_x, t_y, t_z = t[0], t[1], t[2]
    for k in range(x.shape[0]):
        a, b, c = x[k, 0] - w[k] * t_x, x[k, 1] - w[k] * t_y, x[k, 2] - w[k] * t_z
        length[k] = math.sqrt(a * a + b * b + c * c)
        across[k], along[k] = _across_and_along(a, b, c, t_x, t_y, t_z)
        for row in range(3):
            there[k, row] = (R[row, 0] * a + R[row, 1] * b + R[row, 2] * c) / length[k]


@kernel
def spread(window, residual, share, inflation, smoothed, rounding, variance):
    """Multiply variances of n directions by those of their windows' residuals, and by what adds up in windows.

    residual, share, inflation : of all windows. smoothed : coefficients of a polynomial of the share.
    rounding : variance of the images' rounding to single precision, below which no residual is.
    variance : `[n]`, read, and overwritten by standard deviations.
    """
    shares, total = np.zeros(AT_ONCE), np.empty(AT_ONCE)
    for begin in range(0, window.shape[0], AT_ONCE):
        here, out = window[begin : begin + AT_ONCE], variance[begin : begin + AT_ONCE]
        for k in range(here.shape[0]):
            shares[k] = share[here[k]]
        total[:] = 0.0
        for power in range(smoothed.shape[0] - 1, -1, -1):
            _add_power(shares, smoothed[power], total)
        for k in range(here.shape[0]):
            out[k] = math.sqrt(out[k] * (residual[here[k]] + rounding) * total[k] * inflation[here[k]])


@kernel
def _add_power(x, coefficient, total):
    """A step of Horner's rule, for numbers side by side."""
    for k in range(AT_ONCE):
        total[k] = total[k] * x[k] + coefficient


@kernel
def variances(window, x, middle, covariance, out):
    """Write x^T C x for n directions, C being the inverse normal matrix of the window that each reads its plane from.

    window, x : `[n]`, flat indices, and `[n, 3]`.
    middle, covariance : `[windows, 3]` and `[windows, 6]`; the direction of each window's middle, and its C in tangents
    there, as `_fit_kernels` has it.
    """
    for k in range(window.shape[0]):
        c, middle_k = covariance[window[k]], middle[window[k]]
        c_x, c_y, c_z = middle_k[0], middle_k[1], middle_k[2]
        cosine = math.sqrt(c_x * c_x + c_y * c_y)
        e_x, e_y = (-c_y / cosine, c_x / cosine) if cosine > 1e-9 else (0.0, 1.0)
        one = x[k, 0] * c_x + x[k, 1] * c_y + x[k, 2] * c_z
        a = x[k, 0] * e_x + x[k, 1] * e_y
        b = c_z * (x[k, 1] * e_x - x[k, 0] * e_y) + x[k, 2] * (c_x * e_y - c_y * e_x)
        out[k] = one * (c[0] * one + 2 * (c[1] * a + c[2] * b)) + c[3] * a * a + 2 * c[4] * a * b + c[5] * b * b


@kernel
def farthest_beside(w, least):
    """Write the least of the nearest known values in either direction along row and column; NaN where there is none.

    Rows go round. w, least : `[height, width]`.
    """
    height, width = w.shape
    for i in range(height):
        least[i, :] = math.nan
        _carry_along(w[i], least[i])
        _carry_along(w[i, ::-1], least[i, ::-1])
    carried = np.full(width, math.nan)
    for i in range(height):
        _carry_down(w[i], carried, least[i])
    carried[:] = math.nan
    for i in range(height - 1, -1, -1):
        _carry_down(w[i], carried, least[i])


@kernel
def _carry_along(row, least):
    """Keep the lesser of what is there and of the last known value, up to each place of a row that goes round."""
    last = math.nan
    for j in range(row.shape[0]):
        last = row[j] if math.isfinite(row[j]) else last
    for j in range(row.shape[0]):
        last = row[j] if math.isfinite(row[j]) else last
        least[j] = least[j] if least[j] <= last or math.isnan(last) else last


@kernel
def _carry_down(row, carried, least):
    """The same for a row's columns, with what was carried into each."""
    for j in range(row.shape[0]):
        last = row[j] if abs(row[j]) < math.inf else carried[j]
        carried[j] = last
        least[j] = last if last < least[j] or math.isnan(least[j]) else least[j]
