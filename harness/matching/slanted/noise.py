"""How much noisier one view is than the other, and how large a grey level is.

What least squares leaves is the noise of both views. Which of them it belongs to the residual does not say, and it
matters: a step goes by the gradient of one view, which holds that view's noise alone, and the gain between the views
follows from their variances, each of which holds its own. So each image's noise is measured by itself, by its finest
differences, where white noise is as strong as anywhere and texture nearly gone (Immerkær 1996 has second differences;
these are fourth). What is left of the texture there the two views have in common, so that it falls out of the
difference between them. (`harness.camera.image_noise` measures the noise itself, where an image has least texture.)

Grey levels have no unit: images times a number have the same matches. What has to be compared with a grey level, such
as the rounding of one, is compared with `Noise.grey_level_squared` instead.
"""

from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from harness.geometry.angles import Array
from harness.matching.grey_levels import Moments, grey_level_squared
from harness.matching.slanted._fit_kernels import SCATTERED, FitNoise
from harness.matching.slanted.smoothing import noise_left

_ORDER = 4
"""The order n of the differences, along rows and columns. Those of white noise have C(2n, n)² times its variance."""

_SQUARE = 8
"""Side of the squares over which squared differences are averaged, pixels. The median of the squares' means is not
moved by edges, and yet noise and texture add up in it, as they do not in a median of single differences. In white noise
it is 7 % below the variance, as means of so few correlated squares are skewed."""

_BANDS = 16
"""At least so many rows of squares are looked at, where there are as many: in an image of 640 x 480 pixels their median
has a standard deviation of 1.3 % of itself."""

_FEWEST = 32
"""The fewest squares that count: their median has a standard deviation of a tenth of itself."""

_ALIKE = 1.25
"""Up to this ratio, views count as equally noisy, or as equally rich in contrast. Two views of one scene show its parts
at different sizes: without noise the variances of their finest differences are as 1 to 0.97, 1.16, 0.88 and 1.05 in the
box, the room, the corridor and among the poles."""

_LEAST_VARIANCE = 1e-3
"""A window whose variance, in square grey levels, is less has no texture; rounding to 8 bits alone makes it 1/12."""


@dataclass(frozen=True)
class Noise:
    """The noise of an explained view, 1, against that of the view that explains it, 2; both white."""

    grey_level_squared: float
    """In the square of the images' unit; see `grey_levels`."""
    rounding: float
    """Variance of both images' rounding to single precision, at most; in the same."""
    gain_squared: float = 1.0
    """Square of the gain between the whole images: what is I in view 2 varies so much more in view 1."""
    ratio: float = 1.0
    """Variance of view 1's noise per variance of view 2's."""
    excess: float = 0.0
    """Variance of view 1's noise beyond `gain_squared` times that of view 2's, in the same; negative if it is less."""

    @property
    def excess_1(self) -> float:
        """By how much view 1's noise is more, or 0."""
        return max(self.excess, 0.0)

    @property
    def excess_2(self) -> float:
        """By how much view 2's noise is more, or 0, as view 1 would show it."""
        return max(-self.excess, 0.0)

    def turned(self) -> "Noise":
        """The same where view 2 is explained by view 1."""
        return replace(
            self, gain_squared=1 / self.gain_squared, ratio=1 / self.ratio, excess=-self.excess / self.gain_squared
        )

    def smoothed(self, blur: float) -> "Noise":
        """The same in images that were smoothed."""
        return replace(self, excess=self.excess * noise_left(blur))

    def odds_of_1(self, residual: NDArray[np.float32], of_value: float) -> Array | float:
        """Variance of view 1's noise per that of view 2's as view 1 would show it, of windows; see `_fit_kernels`.

        Parameters
        ----------
        residual
            `[height, width]`: the windows' residual variances, infinite where there is no window.
        of_value
            Variance of noise of variance 1 along an axis, once view 2 is interpolated.

        Returns
        -------
        odds
            `[height, width]`; 1 for all of them where the views count as equally noisy.
        """
        if not self.excess:
            return 1.0
        interpolated = self.gain_squared * of_value**2
        with np.errstate(invalid="ignore", divide="ignore"):
            # Variances of view 2's noise, in units of the residual.
            alike = SCATTERED * np.array([-self.excess_1, self.excess_2])[:, None, None] / residual + 1
            alike /= self.gain_squared + interpolated
            of_2 = np.clip(1 / (self.ratio + interpolated), *alike)
            return np.asarray((1 / of_2 - interpolated) / self.gain_squared)

    def for_fit(self, through_spline: tuple[float, float]) -> FitNoise:
        """What fits take.

        Parameters
        ----------
        through_spline
            Of view 2; see `View.noise`.
        """
        of_value, of_slope = through_spline
        return FitNoise(
            of_value=of_value,
            of_slope=of_slope,
            ratio=self.ratio,
            gain_squared=self.gain_squared,
            excess_1=self.excess_1,
            excess_2=self.excess_2,
            # Of images without contrast rounding is left, ten times as large once a spline has gone through it.
            least_variance=_LEAST_VARIANCE * self.grey_level_squared + 100 * self.rounding,
        )


def noise_between(*views: tuple[NDArray[np.float32], NDArray[np.bool_]]) -> Noise:
    """The noise of view 1 against that of view 2; as equal where it cannot be measured.

    Parameters
    ----------
    views
        Of both: grey levels with gaps filled, and the pixels that are known and no gaps.
    """
    moments = [Moments.of(*each) for each in views]
    noise = Noise(grey_level_squared(moments), 2**-48 * sum(each.square for each in moments))
    finest = [finest_variance(*each) for each in views]
    if min(finest) <= 0:
        return noise
    # In an image that is nearly all noise the contrast is hardly known.
    first, second = (max(each.variance - fine, 0.1 * fine) for each, fine in zip(moments, finest, strict=True))
    gain_squared = _unless_alike(first / second)
    one, other = finest[0], gain_squared * finest[1]
    ratio = _unless_alike(one / other)
    excess = other * (ratio - 1) if ratio > 1 else one * (1 - 1 / ratio)
    return replace(noise, gain_squared=gain_squared, ratio=gain_squared * ratio, excess=excess)


def _unless_alike(ratio: float) -> float:
    """A ratio of two views, or 1 if they count as equal; from `_ALIKE` to its square it goes over into itself."""
    larger = max(ratio, 1 / ratio)
    counted = min(larger, max(larger / _ALIKE, 1.0) ** 2)
    return counted if ratio > 1 else 1 / counted


def finest_variance(image: NDArray[np.float32], known: NDArray[np.bool_]) -> float:
    """Variance of an image's noise, and of a little of its texture; 0 where too little is known.

    Squares without any differences do not count: they are blank, or saturated, and noise does not show.
    """
    side = _SQUARE + _ORDER
    if min(image.shape) < side:
        return 0.0
    first = np.arange(0, image.shape[0] - side + 1, _SQUARE)
    rows = first[:: max(len(first) // _BANDS, 1), None] + np.arange(side)
    columns = (image.shape[1] - _ORDER) // _SQUARE
    differences = np.diff(np.diff(image[rows], _ORDER, axis=1), _ORDER, axis=2)[..., : columns * _SQUARE]
    squares = np.square(differences, dtype=np.float64).reshape(len(rows), _SQUARE, columns, _SQUARE)
    means = squares.mean(axis=(1, 3)) / comb(2 * _ORDER, _ORDER) ** 2
    there = sliding_window_view(known[rows].all(axis=1), side, axis=1)[:, ::_SQUARE].all(axis=2)
    found = means[there & (means > 0)]
    return float(np.median(found)) if found.size >= _FEWEST else 0.0
