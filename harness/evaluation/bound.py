"""The Cramér-Rao bound on the errors of any unbiased window matcher in alpha_2 and in the range, pixel by pixel.

Data: all raw pixels of mirror image 1 whose centres lie in the window's footprint, `y_1 = K_1 T + n_1`, and those of
mirror image 2 that the same piece of surface covers, `y_2 = K_2 (T ∘ W_θ) + n_2`, with white Gaussian noise of one
sigma on both. T is the texture, unknown; W_θ maps image 2 to image 1; K_1 and K_2 are what a camera makes of it (the
footprints of its pixels, their density), whatever that is. θ is, for the two models,

- `slanted`: the window's plane, `1/d = m · x̂` (three numbers), gain and offset of image 2 against image 1;
- `frontal`: one number, the inverse range at the window's middle p, by which the true plane moves along `δm ∝ x̂_p`.
  Slant, gain and offset are known.

Let s dθ be what dθ changes in the picture of T. The information on θ that is left when T is unknown is the least of
`|K_1 dT|² + |K_2 (dT + s dθ)|²` over dT, divided by sigma². Whatever the texture may be, moved, stretched over
the plane or with other grey levels it is a texture too, so `dT = -s Λ dθ` is among the choices for any matrix Λ, and
the least over Λ alone is the parallel sum of `J_k = Σ s_k s_kᵀ` over the raw pixels of image k:

    cov(θ) >= sigma² (J_1⁻¹ + J_2⁻¹),      s_k = (∂I_k/∂ξ x̂, I_k, 1),    ξ = 1/d.

In words: to know how far something has moved one has to know where it was and where it is, each no better than with
its texture given. Where both images are alike, J_1 = J_2 = Σ g², the variance is at least the well-known
`2 sigma²/Σ g²`. Where image 2 has kappa pixels for one of image 1, J_2 = kappa J_1, and every pixel counts
`kappa/(1 + kappa)`: noise sigma² (1/δ_1 + 1/δ_2) for densities δ of pixels on the surface. `docs/bound.md` has
the derivation in full, when the bound is sharp, and who may be below it: matchers with priors or a wider support, and
biased ones.

Then `var(ξ) = x̂ᵀ cov(m) x̂`, and by the exact sensitivity `std(d) = d² std(ξ)`, `std(alpha_2) = std(d)/law`.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.fill import across_seam, nearest_known
from harness.camera.sensor import Sensor, pixel_directions, project, rays_of, seam_px, unproject
from harness.display import OneLine
from harness.evaluation import _bound_kernels
from harness.geometry.angles import Array, angle_between
from harness.geometry.panorama import Grid, directions, pixel_that_holds
from harness.geometry.pose import Motion
from harness.geometry.triangulation import exact_alpha_2, sensitivity_to_alpha_2
from harness.simulation.truth import Truth

Model = Literal["slanted", "frontal"]
Frame = Literal["panorama", "mirror"]
Mask = NDArray[np.bool_]
Image = NDArray[np.float32] | Array

PLANE_TOLERANCE = 1e-4
"""Two pixels are on one plane when their m differ by less than this share of |m|: 0.002 px in a disparity of 20."""

_STEP_PX = 1e-3
"""Step of the central differences of rays: a share of 1e-10 is lost to rounding, and less to the third derivative."""


@dataclass(frozen=True, repr=False)
class Bound(OneLine):
    """The smallest standard deviation that an unbiased matcher of this window can have; read-only, `[height, width]`.

    NaN outside `pixels`; infinite where the texture is so weak that the range would be uncertain by more than itself:
    there a bound to first order says nothing, and sums over no texture at all are zero but for rounding.
    """

    alpha_2: Array
    """Radians."""
    disparity_px: Array
    """The bound of the disparity, pixels of `2 pi / width`."""
    range_m: Array
    """To first order in the noise."""
    pixels: Mask
    """The window is whole, sees one plane, no discontinuity, and every pixel's point is seen by both views."""
    count_1: Array
    """Raw pixels of image 1 in the window's footprint."""
    count_2: Array
    """Raw pixels of image 2 on the same piece of surface, by area: a fraction."""


def cramer_rao(
    images: tuple[Image, Image],
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    grid: Grid,
    truth: Truth,
    *,
    R_world_from_v1: Array,
    window_px: int,
    sigma_grey: float | tuple[Array, Array],
    model: Model = "slanted",
    frame: Frame = "panorama",
) -> Bound:
    """The bound for every pixel of view 1's panorama.

    Parameters
    ----------
    images
        Mirror images 1 and 2 without noise, `[sensor height, sensor width]`, grey levels; each with its own exposure.
    sensors
        The sensor of each view.
    truth
        On `grid`, with the second view.
    R_world_from_v1
        `[3, 3]`, view 1's orientation: the truth's normals are in the world's frame.
    window_px
        Side of the window in pixels of its frame, odd. A filter before the matcher widens its support.
    sigma_grey
        Standard deviation of the noise in grey levels, above zero: one number, or `[sensor height, sensor width]` for
        each image where it differs from pixel to pixel, as shot noise does.
    frame
        Whose pixels the window is a square of: view 1's panorama, around the pixel itself, or mirror image 1, around
        the mirror pixel nearest to where the panorama's looks.

    Raises
    ------
    ValueError
        When sizes do not fit, the window is even or less than 3, or sigma is not above zero.
    """
    _check(grid, truth, window_px, model)
    information, unit_grey = _information(sigma_grey, sensors)
    x = directions(grid)
    planes = _planes(truth, x, np.asarray(R_world_from_v1, dtype=np.float64))
    visible = truth.visible & ~truth.discontinuity & np.all(np.isfinite(planes), axis=-1)
    raw = _raw_pixels(sensors[0], grid)
    if frame == "panorama":
        towards, cell = x, raw.cell
    else:
        # Raw pixels stand for the panorama's, with the plane of the panorama's pixel that each falls on.
        towards, _ = pixel_directions(sensors[0])
        cell = np.ravel_multi_index((raw.pixel[:, 0], raw.pixel[:, 1]), towards.shape[:2])
        planes, visible = (_scattered(each, raw, cell, towards.shape[:2]) for each in (planes, visible))
    goes_round = frame == "panorama" or seam_px(sensors[0]) > 0
    pixels = _on_one_plane(visible, planes, window_px, goes_round=goes_round)
    cells = _cells(images, information, sensors, motion, raw, cell, planes)
    informations, counts = np.zeros((2, *pixels.shape)), np.full((2, *pixels.shape), np.nan)
    for view in range(2):
        _bound_kernels.window_information(
            cells[view], pixels, window_px // 2, towards, model == "slanted", informations[view], counts[view]
        )
    if frame == "mirror":
        nearest, valid_1 = project(sensors[0], x)
        column, row = np.moveaxis(np.rint(np.where(valid_1[..., None], nearest, 0)).astype(np.intp), -1, 0)
        # The border itself is half a pixel from the last centre, and rounds to one beyond.
        row, column = np.minimum(row, towards.shape[0] - 1), np.minimum(column, towards.shape[1] - 1)
        pixels = pixels[row, column] & valid_1
        informations, counts = informations[:, row, column], np.where(pixels, counts[:, row, column], np.nan)
    with np.errstate(divide="ignore"):
        std_xi = np.where(pixels, unit_grey * np.sqrt(1 / informations[0] + 1 / informations[1]), np.nan)
    range_m = truth.range_m**2 * std_xi
    range_m[range_m > truth.range_m] = np.inf
    alpha_2 = exact_alpha_2(truth.range_m[..., None] * x, motion.t_v1)
    alpha_1 = angle_between(x, motion.t_v1)
    with np.errstate(invalid="ignore"):
        std = range_m / np.abs(sensitivity_to_alpha_2(alpha_1, alpha_2, motion.baseline_m))
    bound = Bound(std, std / grid.phi_pitch, range_m, pixels, counts[0], counts[1])
    for array in vars(bound).values():
        array.flags.writeable = False
    return bound


def _check(grid: Grid, truth: Truth, window_px: int, model: str) -> None:
    if truth.range_m.shape != grid.shape:
        raise ValueError(f"the truth is {truth.range_m.shape}, the panorama {grid.shape} (rows, columns)")
    if window_px < 3 or window_px % 2 == 0 or window_px > min(grid.shape):
        raise ValueError(f"window_px must be odd, at least 3, within the panorama; found {window_px}")
    if model not in {"slanted", "frontal"}:
        raise ValueError(f"model must be slanted or frontal; found {model!r}")


def _information(
    sigma_grey: float | tuple[Array, Array], sensors: tuple[Sensor, Sensor]
) -> tuple[tuple[Array, Array], float]:
    """The inverse variance of each pixel of both images, and the noise that is its unit."""
    shapes = [(each.camera.height_px, each.camera.width_px) for each in sensors]
    if not isinstance(sigma_grey, tuple):
        if not sigma_grey > 0:
            raise ValueError(f"sigma_grey must be above zero; found {sigma_grey}")
        return (np.ones(shapes[0]), np.ones(shapes[1])), sigma_grey
    for sigma, shape in zip(sigma_grey, shapes, strict=True):
        if sigma.shape != shape:
            raise ValueError(f"sigma_grey is {sigma.shape}, the sensor {shape} (rows, columns)")
        if not np.all(sigma > 0):
            raise ValueError("sigma_grey must be above zero in every pixel")
    first, second = (1 / np.asarray(sigma, dtype=np.float64) ** 2 for sigma in sigma_grey)
    return (first, second), 1.0


def least_std(s_1: Array, s_2: Array, towards: Array, sigma_grey: float) -> float:
    """The bound for one window, from its raw pixels' derivatives: the formula itself, and the reference of the kernels.

    Parameters
    ----------
    s_1, s_2
        `[pixels of image k, parameters]`: derivative of each raw pixel by each parameter.
    towards
        `[parameters]`: the combination of parameters that is asked for.

    Returns
    -------
    float
        `sigma sqrt(cᵀ (J_1⁻¹ + J_2⁻¹) c)`, in the parameters' units.
    """
    variance = sum(float(towards @ np.linalg.solve(s.T @ s, towards)) for s in (s_1, s_2))
    return sigma_grey * float(np.sqrt(variance))


def _planes(truth: Truth, x: Array, R_world_from_v1: Array) -> Array:
    """The tangent plane of each pixel, `1/d = m · x̂` in v1's frame, `[height, width, 3]`; NaN without truth."""
    normal = truth.normal @ R_world_from_v1
    distance = truth.range_m * np.sum(normal * x, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(normal / distance[..., None])


def _scattered(
    values: NDArray[Any], raw: "_RawPixels", cell: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[Any]:
    """Values of the panorama's pixels on the mirror image; NaN or False where none falls on the panorama."""
    nothing = False if values.dtype == bool else np.nan
    scattered = np.full((shape[0] * shape[1], *values.shape[2:]), nothing, dtype=values.dtype)
    scattered[cell] = values.reshape(-1, *values.shape[2:])[raw.cell]
    return scattered.reshape(*shape, *values.shape[2:])


def _on_one_plane(visible: Mask, planes: Array, window_px: int, *, goes_round: bool) -> Mask:
    """Pixels whose window is whole, sees one plane, no discontinuity, and is seen by view 2."""
    good = _smallest(visible.astype(np.float64), window_px) > 0
    half = window_px // 2
    good[:half] = good[good.shape[0] - half :] = False
    if not goes_round:
        good[:, :half] = good[:, good.shape[1] - half :] = False
    size = np.linalg.norm(planes, axis=-1)
    for component in np.moveaxis(planes, -1, 0):
        finite = np.where(visible, component, 0.0)
        spread = -_smallest(-finite, window_px) - _smallest(finite, window_px)
        with np.errstate(invalid="ignore"):
            good &= spread <= PLANE_TOLERANCE * size
    return np.asarray(good)


def _smallest(values: Array, window_px: int) -> Array:
    """The least value of each window; columns are periodic."""
    return np.asarray(ndimage.minimum_filter(values, size=window_px, mode=("nearest", "wrap")))


def _cells(
    images: tuple[Image, Image],
    information: tuple[Array, Array],
    sensors: tuple[Sensor, Sensor],
    motion: Motion,
    raw: "_RawPixels",
    cell: NDArray[np.int64],
    planes: Array,
) -> tuple[Array, Array]:
    """For each image the products of derivatives of all raw pixels of view 1 in each cell of a frame, `[h, w, 16]`.

    information : the inverse variance of each pixel, of both images. cell : `[n]`, of each raw pixel. planes :
    `[h, w, 3]`, of each cell.
    """
    plane = planes.reshape(-1, 3)[cell]
    omega = raw.omega
    R, t = (np.ascontiguousarray(a, dtype=np.float64) for a in (motion.R_v2_from_v1, motion.t_v1))
    xi = np.sum(plane * omega, axis=-1)
    first, second = sensors
    pixel_2, _ = project(second, (omega - xi[:, None] * t) @ R.T)
    # Behind a plane that a neighbour of another face has been given, or off image 2: in no window that counts.
    camera = second.camera
    with np.errstate(invalid="ignore"):
        usable = (xi > 0) & np.all(np.abs(pixel_2 + 0.5) < np.array([camera.width_px, camera.height_px]) + 1, axis=-1)
        usable &= np.all(pixel_2 > -1.5, axis=-1)
    pixel_2[~usable] = np.nan
    nearest = np.rint(np.where(usable[:, None], pixel_2, 0.0)).astype(np.intp)
    nearest = np.clip(nearest, 0, np.array([camera.width_px, camera.height_px]) - 1)
    u, v = np.ascontiguousarray(pixel_2[:, 0]), np.ascontiguousarray(pixel_2[:, 1])
    cells = np.zeros((2, planes.shape[0] * planes.shape[1], _bound_kernels.PRODUCTS))
    _bound_kernels.add_raw_pixels(
        _spline(images[0], first),
        _spline(images[1], second),
        raw.pixel + np.array([0, seam_px(first)]),
        cell,
        omega,
        raw.omega_u,
        raw.omega_v,
        plane,
        R,
        t,
        pixel_2 + np.array([seam_px(second), 0.0]),
        information[0][raw.pixel[:, 0], raw.pixel[:, 1]],
        information[1][nearest[:, 1], nearest[:, 0]],
        rays_of(second, u, v),
        (rays_of(second, u + _STEP_PX, v) - rays_of(second, u - _STEP_PX, v)) / (2 * _STEP_PX),
        (rays_of(second, u, v + _STEP_PX) - rays_of(second, u, v - _STEP_PX)) / (2 * _STEP_PX),
        cells[0],
        cells[1],
    )
    of_1, of_2 = cells.reshape(2, *planes.shape[:2], -1)
    return of_1, of_2


@dataclass(frozen=True)
class _RawPixels:
    """The pixels of a mirror image that fall on a panorama, in v1's frame; read-only."""

    pixel: NDArray[np.int64]
    """`[n, 2]`, (row, column)."""
    cell: NDArray[np.int64]
    """`[n]`: index of the panorama's pixel that its centre falls on."""
    omega: Array
    """`[n, 3]`, unit direction."""
    omega_u: Array
    omega_v: Array
    """`[n, 3]`: derivatives of the direction by the pixel's coordinates."""


@lru_cache(maxsize=4)
def _raw_pixels(sensor: Sensor, grid: Grid) -> _RawPixels:
    omega, valid = pixel_directions(sensor)
    pixel = np.argwhere(valid)
    chosen = omega[valid]
    # Rows span half-open intervals of z, columns of phi, as the pixels of the panorama do.
    row, column, inside = pixel_that_holds(grid, chosen)
    panorama_pixel = row[inside].astype(np.int64) * grid.width_px + column[inside]
    pixel, chosen = pixel[inside], chosen[inside]
    uv = pixel[:, ::-1].astype(np.float64)
    steps = np.array([[_STEP_PX, 0.0], [0.0, _STEP_PX]])
    omega_u, omega_v = (
        (unproject(sensor, uv + step)[0] - unproject(sensor, uv - step)[0]) / (2 * _STEP_PX) for step in steps
    )
    raw = _RawPixels(pixel, panorama_pixel, chosen, omega_u, omega_v)
    for array in vars(raw).values():
        array.flags.writeable = False
    return raw


def _spline(image: Image, sensor: Sensor) -> Array:
    """Coefficients of the quintic B-spline through an image, continued across its seam if it has one; pixels that the
    sensor does not see are filled in.

    Black beyond the rim would ring into the picture.
    """
    shape = (sensor.camera.height_px, sensor.camera.width_px)
    if image.shape != shape:
        raise ValueError(f"the image is {image.shape}, the sensor {shape} (rows, columns)")
    known = pixel_directions(sensor)[1]
    filled = across_seam(np.asarray(image, dtype=np.float64)[nearest_known(known)], seam_px(sensor))
    return np.asarray(ndimage.spline_filter(filled, order=5, mode="mirror"))
