"""Compiled loops over directions in which a field's planes are read. `field` and `sigma` prepare their arguments."""

import math

import numpy as np

from harness.compiled import kernel


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
