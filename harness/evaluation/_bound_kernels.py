"""Compiled loops over raw pixels and windows. Called through `bound`, which prepares and checks the arguments."""

import math

import numpy as np

from harness.camera._spline_kernels import QUINTIC_TAPS, quintic_weights
from harness.compiled import kernel

PRODUCTS = 16
"""Different entries of a symmetric 5 x 5 matrix, and the count of pixels."""

_NOTHING = 1e-10
"""A pivot below this share of its diagonal is rounding: sums of 10⁴ products, parted into three directions of which two
differ by a window's half angle (0.01 rad or more), keep twelve digits."""


@kernel
def add_raw_pixels(
    spline_1,
    spline_2,
    pixel,
    cell,
    omega,
    omega_u,
    omega_v,
    plane,
    R,
    t,
    pixel_2,
    weight_1,
    weight_2,
    ray,
    ray_u,
    ray_v,
    cells_1,
    cells_2,
):
    """Add the products of each raw pixel's derivatives (slope x, slope y, slope z, grey, 1) to its cell, both images.

    The slope, grey levels times metres, is by the inverse range. A pixel of view 1 stands for kappa pixels of view 2.
    Each pixel is the mean of four points in its quarters: at the very centre, a spline's derivative has lost much of
    what is finer than three pixels.

    pixel : `[n, 2]`, (row, column) in image 1. cell : `[n]`, index into the cells. omega, omega_u, omega_v : `[n, 3]`,
    the pixel's unit direction and that direction's derivatives by u and v. plane : `[n, 3]`, m. pixel_2 : `[n, 2]`,
    (u, v) in image 2, NaN for a pixel that is left out; weight_1, weight_2 : `[n]`, inverse variance of the noise there
    in either image; ray, ray_u, ray_v : `[3, n]`, its ray, of any length, and the ray's derivatives. cells_1, cells_2 :
    added to, `[cells, 16]`, lower triangles row by row, and the count of pixels.
    """
    shift = np.empty(3)
    by_u = np.empty(3)
    by_v = np.empty(3)
    weights = np.empty((4, QUINTIC_TAPS))
    sampled = np.empty(3)
    towards = np.empty(3)
    room = np.empty(3)
    for i in range(pixel.shape[0]):
        if math.isnan(pixel_2[i, 0]):
            continue
        xi = m_u = m_v = 0.0
        for c in range(3):
            xi += plane[i, c] * omega[i, c]
            m_u += plane[i, c] * omega_u[i, c]
            m_v += plane[i, c] * omega_v[i, c]
        x_ray = ray_ray = 0.0
        for r in range(3):
            x = shift[r] = by_u[r] = by_v[r] = 0.0
            for c in range(3):
                x += R[r, c] * (omega[i, c] - xi * t[c])
                shift[r] -= R[r, c] * t[c]
                by_u[r] += R[r, c] * (omega_u[i, c] - m_u * t[c])
                by_v[r] += R[r, c] * (omega_v[i, c] - m_v * t[c])
            x_ray += x * ray[r, i]
            ray_ray += ray[r, i] * ray[r, i]
        # With X = l ray, dX/l = ray_u du + ray_v dv + (any) ray: times ray_v × ray it leaves du, times ray × ray_u dv.
        length = x_ray / ray_ray
        nu_0 = ray_v[1, i] * ray[2, i] - ray_v[2, i] * ray[1, i]
        nu_1 = ray_v[2, i] * ray[0, i] - ray_v[0, i] * ray[2, i]
        nu_2 = ray_v[0, i] * ray[1, i] - ray_v[1, i] * ray[0, i]
        nv_0 = ray[1, i] * ray_u[2, i] - ray[2, i] * ray_u[1, i]
        nv_1 = ray[2, i] * ray_u[0, i] - ray[0, i] * ray_u[2, i]
        nv_2 = ray[0, i] * ray_u[1, i] - ray[1, i] * ray_u[0, i]
        volume = length * (ray_u[0, i] * nu_0 + ray_u[1, i] * nu_1 + ray_u[2, i] * nu_2)
        u_u = (by_u[0] * nu_0 + by_u[1] * nu_1 + by_u[2] * nu_2) / volume
        v_u = (by_u[0] * nv_0 + by_u[1] * nv_1 + by_u[2] * nv_2) / volume
        u_v = (by_v[0] * nu_0 + by_v[1] * nu_1 + by_v[2] * nu_2) / volume
        v_v = (by_v[0] * nv_0 + by_v[1] * nv_1 + by_v[2] * nv_2) / volume
        # How the point moves in image 2 while its pixel in image 1 is held; and, but for the sign, the other way round.
        u_2 = (shift[0] * nu_0 + shift[1] * nu_1 + shift[2] * nu_2) / volume
        v_2 = (shift[0] * nv_0 + shift[1] * nv_1 + shift[2] * nv_2) / volume
        determinant = u_u * v_v - u_v * v_u
        u_1 = (v_v * u_2 - u_v * v_2) / determinant
        v_1 = (u_u * v_2 - v_u * u_2) / determinant
        cells_1[cell[i], PRODUCTS - 1] += 1.0
        cells_2[cell[i], PRODUCTS - 1] += abs(determinant)
        quarter_1, quarter_2 = 0.25 * weight_1[i], 0.25 * abs(determinant) * weight_2[i]
        for part in range(4):
            u = 0.25 if part % 2 else -0.25
            v = 0.25 if part // 2 else -0.25
            for c in range(3):
                towards[c] = omega[i, c] + omega_u[i, c] * u + omega_v[i, c] * v
            _spline_at(spline_1, pixel[i, 1] + u, pixel[i, 0] + v, weights, sampled)
            _add_products(cells_1[cell[i]], quarter_1, sampled[1] * u_1 + sampled[2] * v_1, sampled[0], towards, room)
            _spline_at(spline_2, pixel_2[i, 0] + u_u * u + u_v * v, pixel_2[i, 1] + v_u * u + v_v * v, weights, sampled)
            _add_products(cells_2[cell[i]], quarter_2, sampled[1] * u_2 + sampled[2] * v_2, sampled[0], towards, room)


@kernel
def _add_products(products, weight, slope, grey, omega, s):
    """Add the products of (slope omega, grey, 1) to a lower triangle; s : room to work."""
    for c in range(3):
        s[c] = slope * omega[c]
    k = 0
    for a in range(3):
        for b in range(a + 1):
            products[k] += weight * s[a] * s[b]
            k += 1
    for b in range(3):
        products[6 + b] += weight * grey * s[b]
        products[10 + b] += weight * s[b]
    products[9] += weight * grey * grey
    products[13] += weight * grey
    products[14] += weight


@kernel
def _spline_at(spline, u, v, weights, sampled):
    """Value of a quintic B-spline and its derivatives by u and v, written to `sampled`; weights : room to work."""
    column, row = math.floor(u), math.floor(v)
    quintic_weights(u - column, weights[0], weights[1])
    quintic_weights(v - row, weights[2], weights[3])
    sampled[:] = 0.0
    inside = 2 <= row < spline.shape[0] - 3 and 2 <= column < spline.shape[1] - 3
    for j in range(QUINTIC_TAPS):
        line = along = 0.0
        if inside:
            for i in range(QUINTIC_TAPS):
                coefficient = spline[row + j - 2, column + i - 2]
                line += weights[0, i] * coefficient
                along += weights[1, i] * coefficient
        else:
            r = _mirrored(row + j - 2, spline.shape[0])
            for i in range(QUINTIC_TAPS):
                coefficient = spline[r, _mirrored(column + i - 2, spline.shape[1])]
                line += weights[0, i] * coefficient
                along += weights[1, i] * coefficient
        sampled[0] += weights[2, j] * line
        sampled[1] += weights[2, j] * along
        sampled[2] += weights[3, j] * line


@kernel
def _mirrored(index, size):
    if index < 0:
        index = -index
    if index >= size:
        index = 2 * (size - 1) - index
    return index


@kernel
def window_information(cells, pixels, half, directions, slanted, information, count):
    """Write the information on the inverse range at each window's middle from one image's raw pixels in the window.

    cells : `[height, width, 16]`. pixels : `[height, width]`, where it is wanted; windows there are whole. directions :
    `[height, width, 3]`. information : written, in (grey levels times metres)²; 0 where there is none. count : written,
    raw pixels. Every window is summed from its own cells: running sums would leave rounding where there is no texture.
    """
    height, width = pixels.shape
    columns = np.empty((width, PRODUCTS))
    total = np.empty(PRODUCTS)
    matrix = np.empty((5, 5))
    basis = np.empty((3, 3))
    for row in range(half, height - half):
        columns[:] = 0.0
        for r in range(row - half, row + half + 1):
            for column in range(width):
                for k in range(PRODUCTS):
                    columns[column, k] += cells[r, column, k]
        for column in range(width):
            if not pixels[row, column]:
                continue
            total[:] = 0.0
            for offset in range(-half, half + 1):
                c = (column + offset) % width
                for k in range(PRODUCTS):
                    total[k] += columns[c, k]
            count[row, column] = total[PRODUCTS - 1]
            _basis_about(directions[row, column], basis)
            _in_basis(total, basis, matrix)
            if slanted:
                information[row, column] = _last_pivot(matrix)
            else:
                information[row, column] = matrix[4, 4]


@kernel
def _basis_about(direction, basis):
    """Two unit vectors at right angles to a unit direction, and the direction."""
    x, y, z = direction
    across = math.hypot(x, y)
    cosine, sine = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
    basis[0, 0], basis[0, 1], basis[0, 2] = -sine, cosine, 0.0
    basis[1, 0], basis[1, 1], basis[1, 2] = -z * cosine, -z * sine, across
    basis[2, 0], basis[2, 1], basis[2, 2] = x, y, z


@kernel
def _in_basis(total, basis, matrix):
    """Unpack the lower triangle of sums, ordered (offset, gain, two slants, inverse range at the middle)."""
    matrix[0, 0] = total[14]
    matrix[1, 0] = total[13]
    matrix[1, 1] = total[9]
    for a in range(3):
        matrix[2 + a, 0] = matrix[2 + a, 1] = 0.0
        for c in range(3):
            matrix[2 + a, 0] += basis[a, c] * total[10 + c]
            matrix[2 + a, 1] += basis[a, c] * total[6 + c]
        for b in range(a + 1):
            entry = 0.0
            for c in range(3):
                for d in range(3):
                    low, high = min(c, d), max(c, d)
                    entry += basis[a, c] * basis[b, d] * total[high * (high + 1) // 2 + low]
            matrix[2 + a, 2 + b] = entry


@kernel
def _last_pivot(matrix):
    """The last parameter's information when the others are unknown: the Schur complement, by L D Lᵀ in place.

    A parameter on which the data do not depend, but through those before it, is left out.
    """
    diagonal = np.empty(5)
    for k in range(5):
        diagonal[k] = matrix[k, k]
    for k in range(4):
        pivot = matrix[k, k]
        if not pivot > _NOTHING * diagonal[k]:
            continue
        for row in range(k + 1, 5):
            factor = matrix[row, k] / pivot
            for column in range(k + 1, row + 1):
                matrix[row, column] -= factor * matrix[column, k]
    return matrix[4, 4] if matrix[4, 4] > _NOTHING * diagonal[4] else 0.0
