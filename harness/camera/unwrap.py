"""Mirror images re-projected onto the unit cylinder (section 2 of the paper)."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera import _sampling_kernels
from harness.camera.fill import across_seam, closed_image, nearest_known, touches
from harness.camera.sensor import Sensor, pixels_seen, project, seam_px
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, Panorama, cylinder

Interpolation = Literal["bilinear", "cubic"]
_ORDERS: dict[Interpolation, int] = {"bilinear": 1, "cubic": 3}


def unwrap(
    image: NDArray[np.float32],
    sensor: Sensor,
    grid: Grid,
    *,
    R_sensor_from_panorama: Array | None = None,
    interpolation: Interpolation = "bilinear",
) -> Panorama:
    """Sample a mirror image on the unit cylinder.

    Parameters
    ----------
    image
        `[sensor height, sensor width]`, grey levels. Samples that depend on a pixel that is not finite, or masked, are
        not valid.
    R_sensor_from_panorama
        `[3, 3]`; turns directions of the cylinder's frame into the sensor's. With the rotation between the views, the
        second panorama has the orientation of the first one, and what remains between them is a pure translation.
    interpolation
        `bilinear`, or `cubic`: the interpolating cubic B-spline.

    Raises
    ------
    ValueError
        When the image has not the sensor's size.
    """
    rotation = np.eye(3) if R_sensor_from_panorama is None else np.asarray(R_sensor_from_panorama, dtype=np.float64)
    order = _ORDERS[interpolation]
    _check_size(image, sensor)
    values, valid = _sampled(image, sensor, *_sampling_table(sensor, grid, rotation.tobytes(), order), order)
    values.flags.writeable = False
    valid.flags.writeable = False
    return Panorama(grid, values, valid)


def sample(
    image: NDArray[np.float32], sensor: Sensor, directions: Array, interpolation: Interpolation = "cubic"
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Grey levels of a mirror image in directions `[rows, columns, 3]` of the sensor's frame, and whether they are
    valid; as `unwrap`.

    Raises
    ------
    ValueError
        When the image has not the sensor's size.
    """
    (values,), valid = sample_bands((image,), sensor, directions, interpolation)
    return values, valid


def sample_bands(
    images: Sequence[NDArray[np.float32]], sensor: Sensor, directions: Array, interpolation: Interpolation = "cubic"
) -> tuple[list[NDArray[np.float32]], NDArray[np.bool_]]:
    """`sample` of several images of one sensor, such as red, green and blue; valid where all of them are.

    Raises
    ------
    ValueError
        When an image has not the sensor's size.
    """
    order = _ORDERS[interpolation]
    coordinates, in_view = _coordinates(sensor, directions)
    valid = in_view & _all_taps_visible(sensor, coordinates, order)
    values = []
    for image in images:
        _check_size(image, sensor)
        sampled, valid = _sampled(image, sensor, coordinates, valid, order)
        values.append(sampled)
    return values, valid


def _check_size(image: NDArray[np.float32], sensor: Sensor) -> None:
    camera = sensor.camera
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"the image is {image.shape}, the sensor {(camera.height_px, camera.width_px)} (rows, columns)"
        )


def _sampled(
    image: NDArray[np.float32], sensor: Sensor, coordinates: Array, valid: NDArray[np.bool_], order: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Samples at `coordinates` of an image that is continued across its seam, and which of them are valid."""
    image, known, gaps = closed_image(image, sensor, seam_px(sensor))
    if gaps is not None:
        valid = valid & ~touches(gaps, coordinates, order)
    if order == 1:
        values = np.empty(valid.shape, dtype=np.float32)
        _sampling_kernels.bilinear(image, coordinates[0].reshape(-1), coordinates[1].reshape(-1), values.reshape(-1))
    else:
        # The B-spline's prefilter reaches beyond its 4x4 taps.
        extended = image[nearest_known(known)]
        values = ndimage.map_coordinates(extended, coordinates, order=order, mode="nearest", output=np.float32)
    return values, valid


def can_be_sampled(sensor: Sensor, directions: Array, order: int = 3) -> NDArray[np.bool_]:
    """Whether an image can be sampled in directions `[rows, columns, 3]` of the sensor's frame.

    The sensor must see them, and all pixels that an interpolation of this order takes.
    """
    coordinates, in_view = _coordinates(sensor, directions)
    return in_view & _all_taps_visible(sensor, coordinates, order)


def _coordinates(sensor: Sensor, directions: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Sample positions of directions on the mirror image, continued across its seam if it has one, (rows, columns); and
    whether the sensor sees them.
    """
    pixels, in_view = project(sensor, directions)
    coordinates = np.ascontiguousarray(np.nan_to_num(pixels[..., ::-1], nan=-1.0).transpose(2, 0, 1))
    coordinates[1] += seam_px(sensor)
    return coordinates, in_view


@lru_cache(maxsize=8)
def _sampling_table(sensor: Sensor, grid: Grid, rotation: bytes, order: int) -> tuple[Array, NDArray[np.bool_]]:
    """Sample position of each panorama pixel on the mirror image, continued across its seam if it has one, (rows,
    columns); and whether it can be.
    """
    R = np.frombuffer(rotation).reshape(3, 3)
    coordinates, in_view = _coordinates(sensor, cylinder(grid) @ R.T)
    valid = in_view & _all_taps_visible(sensor, coordinates, order)
    coordinates.flags.writeable = False
    valid.flags.writeable = False
    return coordinates, valid


@lru_cache(maxsize=8)
def _visible_pixels(sensor: Sensor) -> NDArray[np.bool_]:
    """The pixels that the sensor sees, continued across the image's seam if it has one."""
    return across_seam(pixels_seen(sensor), seam_px(sensor))


def _all_taps_visible(sensor: Sensor, coordinates: Array, order: int) -> NDArray[np.bool_]:
    """Whether every pixel that an interpolation at `coordinates` (rows, columns) touches is seen by the sensor."""
    # Clipped: coordinates far off the image may be too large for an integer.
    first = np.floor(np.clip(coordinates, -1e6, 1e6)).astype(np.intp) - (order // 2)
    if order == 1:
        return _both_taps_visible(_visible_pixels(sensor), coordinates, first)
    whole = _whole_windows(sensor, order + 1)
    inside = (first[0] >= 0) & (first[0] < whole.shape[0]) & (first[1] >= 0) & (first[1] < whole.shape[1])
    return np.asarray(inside & whole[np.where(inside, first[0], 0), np.where(inside, first[1], 0)])


@lru_cache(maxsize=8)
def _whole_windows(sensor: Sensor, side: int) -> NDArray[np.bool_]:
    """Whether all pixels of the window that begins at each pixel are seen."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(_visible_pixels(sensor), (side, side)).all(axis=(2, 3)))


def _both_taps_visible(visible: NDArray[np.bool_], coordinates: Array, first: NDArray[np.intp]) -> NDArray[np.bool_]:
    """`_all_taps_visible` for bilinear samples, which at whole coordinates have taps of weight zero."""
    result = np.ones(coordinates.shape[1:], dtype=bool)
    for row in range(2):
        for column in range(2):
            v, u = first[0] + row, first[1] + column
            inside = (v >= 0) & (v < visible.shape[0]) & (u >= 0) & (u < visible.shape[1])
            # A tap with weight zero may lie outside: the last row and column of a bilinear sample at an integer.
            weightless = ((coordinates[0] == v - 1) & (row == 1)) | ((coordinates[1] == u - 1) & (column == 1))
            result &= weightless | (
                inside & visible[np.clip(v, 0, visible.shape[0] - 1), np.clip(u, 0, visible.shape[1] - 1)]
            )
    return result
