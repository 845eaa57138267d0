"""SIFT keypoints of omnidirectional images as bearing vectors, and their putative matches.

Keypoints are detected in the original image, which is nearly conformal: unwrapping it first gains nothing. By default
OpenCV's SIFT has a bias of a quarter of a pixel to the right and down, which biases the motion when view 2 is rotated;
`enable_precise_upscale` removes it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from harness.camera.fill import nearest_known, without_gaps
from harness.camera.sensor import Sensor, jacobian, pixel_directions, pixels_seen, unproject
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.opencv import opencv

Image = NDArray[np.float32]

MOST = 4000
"""Most keypoints of an image; those of the highest contrast are used."""
RATIO = 0.8
"""Largest ratio of the distances to the nearest and the second nearest descriptor (Lowe, 2004)."""
_CONTRAST = 0.02
"""Least contrast of a keypoint; half of OpenCV's default, for slightly blurred photographs."""
_CONTRAST_OF_ONE = 0.04
"""Contrast at which a keypoint has unit standard deviation. It is proportional to 1/contrast at any scale, as noise
shifts a flatter extremum farther; on rendered pairs the product is constant within 10 %."""
_SIGMAS = 0.4, 3.0
"""Least and largest standard deviation, in that unit."""
_BORDER = 3.0
"""Least distance to the border of the field, in units of the keypoint's scale: beyond it the image is extrapolated."""
_LARGE_PX = 2_000_000
"""Pixels of an image from which only the part that the sensor sees is searched, as SIFT takes 230 bytes for each. The
coarsest keypoints depend a little on how far an image goes on beyond."""
_HALVED_PX = 3_000_000
"""Pixels of an image from which it is searched at half the size: SIFT doubles what it is given. Motions of keypoints
alone become 10 to 25 % less certain; those that are then fitted to the grey levels are as good."""
_OCTAVES_PX = 64
"""That part begins at a multiple of this: the pixels of all octaves but the coarsest then lie where they do on the
whole image."""
_ROWS = 512
"""Number of descriptors that are compared with all others at a time."""


@dataclass(frozen=True, repr=False)
class Features(OneLine):
    """Keypoints of one view."""

    pixels: Array
    """`[n, 2]`, (u, v)."""
    sigma_px: Array
    """`[n]`, standard deviation of a keypoint's coordinates, in units of that at contrast 0.04."""
    descriptors: NDArray[np.float32]
    """`[n, 128]`, of unit length."""
    bearings: Array
    """`[n, 3]`, unit directions in the sensor's frame."""
    spreads: Array
    """`[n, 3, 2]`, S: derivative of the bearing by the pixel, times `sigma_px`, radians; `S S^T` is the bearing's
    covariance, up to the variance of a coordinate at contrast 0.04."""


@dataclass(frozen=True, repr=False)
class Correspondences(OneLine):
    """Putative matches of keypoints, inliers and outliers."""

    x_1: Array
    x_2: Array
    """`[n, 3]`, unit directions in the frames of view 1 and view 2."""
    spreads_1: Array
    spreads_2: Array
    """`[n, 3, 2]`, see `Features.spreads`."""
    pixels_1: Array
    pixels_2: Array
    """`[n, 2]`, (u, v)."""

    def __len__(self) -> int:
        return len(self.x_1)

    def at(self, where: Any) -> "Correspondences":
        """The pairs selected by an index or a mask."""
        return Correspondences(
            self.x_1[where],
            self.x_2[where],
            self.spreads_1[where],
            self.spreads_2[where],
            self.pixels_1[where],
            self.pixels_2[where],
        )


def find_features(image: Image, sensor: Sensor, *, flip: bool = False) -> Features:
    """SIFT keypoints of an omnidirectional image, within the sensor's field.

    Parameters
    ----------
    image
        `[sensor height, sensor width]`, grey levels of 0 .. 255.
    flip
        Reverse the image left to right: descriptors are not invariant to reflection, and so match those of a view that
        is mirrored relative to this one.

    Raises
    ------
    InputError
        When OpenCV is not installed.
    """
    cv2 = opencv("motion", "motion")
    image, known = without_gaps(image, pixels_seen(sensor))
    filled = image[nearest_known(known)]  # black beyond the rim would make keypoints of its own
    levels = np.clip(np.rint(filled[:, ::-1] if flip else filled), 0, 255).astype(np.uint8)
    del filled
    rows, columns = _seen_part(known[:, ::-1] if flip else known)
    side = 2 if known.size > _HALVED_PX else 1
    levels = _means(levels[rows, columns], side)
    sift = cv2.SIFT_create(nfeatures=MOST, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(levels, None)
    pixels = np.array([each.pt for each in keypoints], dtype=np.float64).reshape(-1, 2) * side + (side - 1) / 2
    pixels += columns.start, rows.start
    scale = np.array([each.size / 2 * side for each in keypoints])
    contrast = np.array([each.response for each in keypoints])
    if flip:
        pixels[:, 0] = image.shape[1] - 1 - pixels[:, 0]
    descriptors = np.zeros((0, 128), np.float32) if descriptors is None else descriptors
    bearings, visible = unproject(sensor, pixels)
    inside = ndimage.distance_transform_edt(known)
    row, column = (np.clip(np.rint(pixels[:, i]), 0, image.shape[1 - i] - 1).astype(np.intp) for i in (1, 0))
    usable = visible & (inside[row, column] >= _BORDER * scale)
    sigma = np.clip(_CONTRAST_OF_ONE / np.maximum(contrast[usable], 1e-6), *_SIGMAS)
    return Features(
        pixels=pixels[usable],
        sigma_px=sigma,
        descriptors=_root(descriptors[usable]),
        bearings=bearings[usable],
        spreads=spreads(sensor, bearings[usable]) * sigma[:, None, None],
    )


def _means(levels: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Means over squares of pixels; rows and columns that are left over at the right and below are dropped."""
    height, width = (size // side for size in levels.shape)
    squares = levels[: height * side, : width * side].reshape(height, side, width, side)
    return np.rint(squares.mean(axis=(1, 3), dtype=np.float32)).astype(np.uint8)


def _seen_part(known: NDArray[np.bool_]) -> tuple[slice, slice]:
    """The rows and columns of an image that are searched: all, or of a large one those with known pixels."""
    if known.size <= _LARGE_PX or not known.any():
        return slice(0, known.shape[0]), slice(0, known.shape[1])
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    first = (int(each[0]) // _OCTAVES_PX * _OCTAVES_PX for each in (rows, columns))
    return slice(next(first), int(rows[-1]) + 1), slice(next(first), int(columns[-1]) + 1)


def spreads(sensor: Sensor, bearings: Array) -> Array:
    """Derivatives of unit bearings `[n, 3]` by their pixels, `[n, 3, 2]`, radians per pixel.

    The inverse of the projection's Jacobian J on the tangent plane: with B = (b_1, b_2) spanning it, `B (J B)^-1`.
    """
    # Whichever of z and x is farther from the bearing gives a basis.
    other = np.where(np.abs(bearings[:, 2:]) < 0.8, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    b_1 = np.cross(bearings, other)
    b_1 /= np.linalg.norm(b_1, axis=1, keepdims=True)
    basis = np.stack([b_1, np.cross(bearings, b_1)], axis=-1)
    return np.asarray(basis @ np.linalg.inv(jacobian(sensor, bearings) @ basis))


def is_mirrored(sensor: Sensor) -> bool:
    """Whether the sensor's image is a mirror image."""
    directions, visible = pixel_directions(sensor)
    some = directions[visible][:: max(1, int(visible.sum()) // 100)]
    J = jacobian(sensor, some)
    # From inside, u to the right and v down turn clockwise about the line of sight as x and y of a camera do.
    return bool(np.nanmedian(np.einsum("ni,ni->n", np.cross(J[:, 0], J[:, 1]), some)) < 0)


def match_features(first: Features, second: Features) -> Correspondences:
    """Pairs of mutually nearest descriptors that pass the ratio test in both directions."""
    forth, sure_1 = _nearest(first.descriptors, second.descriptors)
    back, sure_2 = _nearest(second.descriptors, first.descriptors)
    i = np.flatnonzero(sure_1)
    i = i[sure_2[forth[i]] & (back[forth[i]] == i)]
    j = forth[i]
    # A keypoint with two orientations occurs twice.
    _, unique = np.unique(np.hstack([first.pixels[i], second.pixels[j]]), axis=0, return_index=True)
    i, j = i[np.sort(unique)], j[np.sort(unique)]
    return Correspondences(
        x_1=first.bearings[i],
        x_2=second.bearings[j],
        spreads_1=first.spreads[i],
        spreads_2=second.spreads[j],
        pixels_1=first.pixels[i],
        pixels_2=second.pixels[j],
    )


def _nearest(some: NDArray[np.float32], others: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each descriptor the index of the nearest one of the others, and whether it passes the ratio test."""
    index, sure = np.zeros(len(some), np.intp), np.zeros(len(some), bool)
    if len(others) < 2:
        return index, sure
    for start in range(0, len(some), _ROWS):
        rows = slice(start, start + _ROWS)
        cosine = some[rows] @ others.T
        best = np.argmax(cosine, axis=1)
        line = np.arange(len(best))
        nearest = 2 - 2 * cosine[line, best]
        cosine[line, best] = -np.inf
        index[rows], sure[rows] = best, nearest < RATIO**2 * (2 - 2 * cosine.max(axis=1))
    return index, sure


def _root(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """RootSIFT descriptors, whose Euclidean distance is the Hellinger distance (Arandjelović and Zisserman, 2012)."""
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), np.float32(1e-6))
    return np.asarray(np.sqrt(descriptors / total), dtype=np.float32)
