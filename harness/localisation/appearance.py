"""Descriptors of whole panoramas that do not change when the robot turns on the spot.

`pca`: principal components of panoramas. A turn shifts a panorama's columns, which changes the phases of its rows'
Fourier coefficients alone: what is described are their magnitudes (T. Pajdla and V. Hlavac, Zero phase representation
of panoramic images for image based localization, CAIP 1999, take the phase out, too), of the image less its mean and
over its norm, so that exposure does not count.

`vlad`: dense local descriptors (DAISY, scikit-image's), each the square root of its normalised self as in RootSIFT
(R. Arandjelovic and A. Zisserman, CVPR 2012), gathered by visual word as the sum of their differences from it (VLAD:
H. Jegou et al., CVPR 2010), each word's sum normalised by itself (Arandjelovic and Zisserman, CVPR 2013), in bands of
elevation. The words are trained on the images that are learned from: nothing is downloaded.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.geometry.angles import Array

KINDS = ("pca", "vlad")

_FREQUENCIES = 24
"""Coefficients of a row that are kept: 15 degrees and coarser, which also survive warping."""
_STEP, _RADIUS, _RINGS, _SECTORS, _ORIENTATIONS = 4, 9, 2, 6, 8
_BLURRED = 20
"""Columns, in whole steps: four standard deviations of the widest Gaussian, 4.5 pixels, and more."""
_BANDS = 3
_MOST_TRAINED = 4_000
"""Local descriptors that words are trained on."""

Panoramas = Sequence[NDArray[np.floating]]
"""`[rows, columns]` each, grey levels, all alike in shape; finite."""


@dataclass(frozen=True, repr=False, eq=False)
class Pca(OneLine):
    """A mean and principal axes of the magnitudes of panoramas."""

    mean: Array
    """`[features]`."""
    axes: Array
    """`[components, features]`."""

    def describe(self, panoramas: Panoramas) -> Array:
        """`[panoramas, components]`."""
        return np.asarray((magnitudes(panoramas) - self.mean) @ self.axes.T)


@dataclass(frozen=True, repr=False, eq=False)
class Vlad(OneLine):
    """Visual words."""

    words: Array
    """`[words, local descriptor]`."""

    def describe(self, locals_of: Sequence[Array]) -> Array:
        """`[panoramas, bands x words x local descriptor]`, unit length each, from `local_descriptors` of each."""
        return np.array([self._of(each) for each in locals_of])

    def _of(self, local: Array) -> Array:
        rows, columns, length = local.shape
        flat, count = local.reshape(-1, length), len(self.words)
        word = np.argmin(np.square(self.words).sum(axis=1) - 2 * flat @ self.words.T, axis=1)
        band = np.repeat(np.arange(rows) * _BANDS // rows, columns)
        belongs = (band * count + word == np.arange(_BANDS * count)[:, None]).astype(np.float64)
        total = belongs @ flat - belongs.sum(axis=1, keepdims=True) * np.tile(self.words, (_BANDS, 1))
        norms = np.linalg.norm(total, axis=1, keepdims=True)
        total = np.divide(total, norms, out=np.zeros_like(total), where=norms > 0).ravel()
        norm = float(np.linalg.norm(total))
        return total / norm if norm else total


def train_pca(panoramas: Panoramas, components: int) -> Pca:
    """The principal axes of some panoramas; fewer than asked for where these span no more."""
    features = magnitudes(panoramas)
    mean = features.mean(axis=0)
    _, size, axes = np.linalg.svd(features - mean, full_matrices=False)
    spanned = int((size > 1e-9 * max(float(size[0]), 1e-300)).sum()) if size.size else 0
    return Pca(mean, axes[: max(1, min(components, spanned))])


def magnitudes(panoramas: Panoramas) -> Array:
    """`[panoramas, features]`: magnitudes of the rows' coarse Fourier coefficients, of images of unit norm."""
    grey = np.array(panoramas, dtype=np.float64)
    grey = grey - grey.mean(axis=(1, 2), keepdims=True)
    norm = np.sqrt(np.square(grey).sum(axis=(1, 2), keepdims=True))
    grey = np.divide(grey, norm, out=np.zeros_like(grey), where=norm > 0)
    spectrum = np.abs(np.fft.rfft(grey, axis=2))[:, :, :_FREQUENCIES]
    return np.asarray(spectrum.reshape(len(grey), -1))


def local_descriptors(panorama: NDArray[np.floating]) -> Array:
    """`[rows, columns, length]`: local descriptors on a lattice of 4 pixels, all around the panorama; unit length."""
    from skimage.feature import daisy  # loading it takes long, and few runs need it

    grey = np.asarray(panorama, dtype=np.float64) / 255
    columns = grey.shape[1] - grey.shape[1] % _STEP
    # The padding exceeds the blur's reach, so that border effects stay within the columns that are cut off.
    wrapped = np.pad(grey[:, :columns], ((_RADIUS, _RADIUS), (0, 0)), mode="edge")
    wrapped = np.pad(wrapped, ((0, 0), (_RADIUS + _BLURRED, _RADIUS + _BLURRED)), mode="wrap")
    descriptors = daisy(  # type: ignore[no-untyped-call]
        wrapped, step=_STEP, radius=_RADIUS, rings=_RINGS, histograms=_SECTORS, orientations=_ORIENTATIONS,
        normalization="l1",
    )[:, _BLURRED // _STEP : _BLURRED // _STEP + columns // _STEP]  # fmt: skip
    positive = np.maximum(descriptors, 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    return np.sqrt(np.divide(positive, total, out=np.zeros_like(positive), where=total > 0))


def train_vlad(locals_of: Sequence[Array], words: int, rng: np.random.Generator) -> Vlad:
    """Visual words of some panoramas' local descriptors, by k-means."""
    from scipy.cluster.vq import kmeans2

    every = np.concatenate([each.reshape(-1, each.shape[-1]) for each in locals_of])
    if len(every) > _MOST_TRAINED:
        every = every[rng.choice(len(every), _MOST_TRAINED, replace=False)]
    begin = every[rng.choice(len(every), min(words, len(every)), replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a word that nothing belongs to stays where it is
        centres, _ = kmeans2(every, begin, iter=20, minit="matrix")
    return Vlad(centres)
