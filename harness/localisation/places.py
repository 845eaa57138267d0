"""A density over positions for a new image, and the estimated position.

Images that were learned from, i = 1 ... n, are at x_i and have the descriptor y_i. With Gaussian kernels of widths h
and s (Parzen, as B. Krose, N. Vlassis, R. Bunschoten and Y. Motomura, A probabilistic model for appearance-based robot
localization, Image and Vision Computing 2001, have them),

    p(x | y) = sum w_i N(x; x_i, s^2),   w_i ~ exp(-|y - y_i|^2 / (2 h^2)).

Both widths are those under which the real images are likeliest where they are, each predicted from the others but those
of its own group, which a pair and what was made of it are: a neighbour of 30 cm would say that all is easy.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine
from harness.geometry.angles import Array

_WIDTHS_M = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0])
_SHARES = np.array([0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2])
"""Widths h that are tried, in units of the median distance between descriptors of different groups."""
_BACKGROUND = 0.01
"""Share of the probability that is spread over the area: no place is impossible."""


@dataclass(frozen=True, repr=False, eq=False)
class Places(OneLine):
    """The learned model: positions, descriptors, and the widths of both kernels."""

    at_m: Array
    """`[n, 2]`: positions of the learned images, metres."""
    described: Array
    """`[n, features]`: descriptors of the learned images."""
    h: float
    """Width of the kernel over descriptors."""
    s_m: float
    """Width of the kernel over places, metres."""
    area_m2: float

    def weights(self, described: Array) -> Array:
        """`[queries, n]`: the weight of each learned image for each new one; a row sums to 1."""
        return _weights(_squared(described, self.described), self.h)

    def density(self, described: Array, at_m: Array) -> Array:
        """`[queries]`: p(x | y) of each new image at a place `[queries, 2]`, per square metre."""
        weights = self.weights(described)
        return _density(weights, np.square(at_m[:, None] - self.at_m).sum(axis=-1), self.s_m, self.area_m2)

    def estimate(self, described: Array) -> Array:
        """`[queries, 2]`: the place of each new image: the mean of the learned places around the likeliest one."""
        weights = self.weights(described)
        near = np.exp(-0.5 * np.square(self.at_m[:, None] - self.at_m).sum(axis=-1) / self.s_m**2)
        peak = np.argmax(weights @ near, axis=1)
        own = weights * near[peak]
        total = own.sum(axis=1, keepdims=True)
        return np.asarray(np.divide(own @ self.at_m, total, out=self.at_m[peak], where=total > 0))


def learn(at_m: Array, described: Array, group: NDArray[np.integer], real: NDArray[np.bool_], area_m2: float) -> Places:
    """Choose the widths of both kernels.

    Parameters
    ----------
    at_m, described
        `[n, 2]` and `[n, features]`.
    group
        `[n]`: images of one group do not predict each other.
    real
        `[n]`: the images that are predicted. At least one has another group to be predicted from, or the widths are in
        the middle of the widths that are tried.
    """
    squared = _squared(described[real], described)
    other = group[real][:, None] != group
    usual = float(np.sqrt(np.median(squared[other]))) if other.any() else 1.0
    usual = usual if usual > 0 else 1.0
    distance = np.square(at_m[real][:, None] - at_m).sum(axis=-1)
    best, chosen = -np.inf, (usual * float(_SHARES[3]), float(_WIDTHS_M[3]))
    if not other.any(axis=1).all():
        return Places(at_m, described, *chosen, area_m2)
    for share in _SHARES:
        h = float(usual * share)
        weights = _weights(np.where(other, squared, np.inf), h)
        for s_m in _WIDTHS_M:
            likelihood = float(np.log(_density(weights, distance, float(s_m), area_m2)).sum())
            if likelihood > best:
                best, chosen = likelihood, (h, float(s_m))
    return Places(at_m, described, *chosen, area_m2)


def _squared(first: Array, second: Array) -> Array:
    """`[n, m]`: squared distances, not below 0 by rounding."""
    squares = np.square(first).sum(axis=1)[:, None] + np.square(second).sum(axis=1) - 2 * first @ second.T
    return np.asarray(np.maximum(squares, 0.0))


def _weights(squared: Array, h: float) -> Array:
    exponent = -0.5 * squared / h**2
    weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _density(weights: Array, squared_m2: Array, s_m: float, area_m2: float) -> Array:
    kernel = np.exp(-0.5 * squared_m2 / s_m**2) / (2 * np.pi * s_m**2)
    return np.asarray((1 - _BACKGROUND) * (weights * kernel).sum(axis=1) + _BACKGROUND / area_m2)
