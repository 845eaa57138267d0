"""The bound's formula for one window: by hand, and by the likelihood of an unknown texture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.evaluation.bound import least_std


@pytest.mark.slow
@given(
    samples=st.tuples(st.integers(20, 60), st.integers(20, 60)),
    waves=st.integers(1, 8),
    amplitude=st.floats(1.0, 100.0),
)
def test_a_wave_moved_along_itself(samples, waves, amplitude):
    # T = c sin(k x) over whole waves on N_1 and N_2 samples: Σ g² = N c² k²/2, var = 2 sigma² (1/N_1 + 1/N_2)/(c k)².
    # Gain and offset take nothing away, since cosines are at right angles to sines and to constants.
    k, sigma = 2 * np.pi * waves, 1.7
    s = []
    for n in samples:
        x = (np.arange(n) + 0.3) / n
        s.append(np.stack([amplitude * k * np.cos(k * x), amplitude * np.sin(k * x), np.ones(n)], axis=-1))
    expected = sigma * np.sqrt(2 / samples[0] + 2 / samples[1]) / (amplitude * k)
    assert least_std(s[0], s[1], np.array([1.0, 0, 0]), sigma) == pytest.approx(expected, rel=1e-9)
    assert least_std(s[0][:, :1], s[1][:, :1], np.ones(1), sigma) == pytest.approx(expected, rel=1e-9)


def test_alike_images_give_the_formula_of_the_books():
    g = np.random.default_rng(0).normal(size=(50, 1))
    assert least_std(g, g, np.ones(1), 3.0) == pytest.approx(np.sqrt(2 * 9 / np.sum(g**2)), rel=1e-12)


@pytest.mark.parametrize("samples", [(64, 64), (96, 48)])
def test_the_most_likely_shift_of_an_unknown_texture_attains_it(samples):
    # Periodic, band-limited to 8 waves, both images noisy. With T unknown the likelihood is greatest where the images'
    # correlation is: the sum over waves of Y_1* Y_2 exp(i k shift).
    draws, sigma, shift = 20_000, 1.0, 0.013
    rng = np.random.default_rng(1)
    waves = np.arange(1, 9)
    amplitudes = 30 * np.exp(1j * rng.uniform(0, 2 * np.pi, 8)) / waves

    def texture(x, derivative):
        terms = amplitudes * (2j * np.pi * waves) ** derivative * np.exp(2j * np.pi * np.multiply.outer(x, waves))
        return terms.real.sum(axis=-1)

    spectra, slopes = [], []
    for n, moved in zip(samples, (0.0, shift), strict=True):
        x = np.arange(n) / n
        noisy = texture(x - moved, 0) + sigma * rng.standard_normal((draws, n))
        spectra.append(np.fft.fft(noisy, axis=-1)[:, waves] / n)
        slopes.append(texture(x - moved, 1)[:, None])
    product = np.conj(spectra[0]) * spectra[1]
    result = np.full(draws, shift)
    for _ in range(5):
        turned = product * np.exp(2j * np.pi * waves * result[:, None])
        slope = -np.sum(2 * np.pi * waves * turned.imag, axis=-1)
        curvature = -np.sum((2 * np.pi * waves) ** 2 * turned.real, axis=-1)
        result -= slope / curvature
    bound = least_std(slopes[0], slopes[1], np.ones(1), sigma)
    # Four standard deviations of a standard deviation from 20,000 draws; noise times noise adds 0.1 %.
    assert np.std(result) / bound == pytest.approx(1, abs=4 / np.sqrt(2 * draws) + 0.002)
    assert np.mean(result) == pytest.approx(shift, abs=4 * bound / np.sqrt(draws))
