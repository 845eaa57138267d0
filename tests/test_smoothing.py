"""Smoothing of noisy images before slanted windows: what it does to noise, and to what is found in it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import integrate, ndimage
from slanted_floor import errors_px, motion, pair, refine, start, steep

from harness.camera.spline_noise import noise_through_spline
from harness.matching.slanted import refine as slanted
from harness.matching.slanted import sigma
from harness.matching.slanted.field import Samples
from harness.matching.slanted.smoothing import blur_for, noise_left, smoothed


@pytest.mark.parametrize("blur", [0.0, 0.04, 0.15])
def test_noise_of_interpolation(blur):
    """Against white noise itself, smoothed, and interpolated by scipy."""
    noise = np.random.default_rng(6).standard_normal(200_000)
    noise = ndimage.correlate1d(noise, (blur, 1 - 2 * blur, blur))
    noise /= noise.std()
    spline = ndimage.spline_filter1d(noise, 3, mode="mirror")
    at = np.random.default_rng(7).uniform(10, len(noise) - 11, 200_000)
    h = 1e-4
    value, ahead, behind = (
        ndimage.map_coordinates(spline, [at + d], order=3, prefilter=False, mode="mirror") for d in (0, h, -h)
    )
    # Variances from 2e5 samples of correlated noise: 0.5 %.
    expected = noise_through_spline((1 - 2 * blur, blur))
    assert (np.var(value), np.var((ahead - behind) / (2 * h))) == pytest.approx(expected, rel=0.02)


def test_white_noise_by_another_quadrature():
    def power(w, slope):
        return (w**slope * 3 * np.sinc(w / (2 * np.pi)) ** 4 / (2 + np.cos(w))) ** 2 / np.pi

    expected = [integrate.quad(power, 0, 8 * np.pi, args=(slope,), limit=200)[0] for slope in (0, 1)]
    assert noise_through_spline() == pytest.approx(expected, rel=1e-6)  # beyond 8 pi lie 1e-8
    assert noise_through_spline((1.0, 0.0)) == noise_through_spline()


def test_smoothing_leaves_so_much_noise():
    noise = np.random.default_rng(1).standard_normal((700, 700)).astype(np.float32)
    # The variance of half a million pixels is known to 0.2 % of itself.
    assert np.var(smoothed(noise, 0.1)[1:-1, 1:-1]) == pytest.approx(noise_left(0.1), rel=0.01)
    assert smoothed(np.full((5, 6), 7, np.float32), 0.1) == pytest.approx(np.full((5, 6), 7))


@pytest.mark.parametrize("wavelength_px", [5.0, 20.0])
def test_sums_of_smoothed_noise_vary_so_much_more(wavelength_px):
    """Sums of g n over a window, over many draws of noise, for gradients of one wavelength."""
    draws, blur, side = np.random.default_rng(2), 0.1, 33
    rows, columns = np.mgrid[:side, :side]
    g = np.sin(2 * np.pi * (0.8 * rows + 0.6 * columns) / wavelength_px).astype(np.float32)
    noise = draws.standard_normal((6000, side + 2, side + 2)).astype(np.float32)
    for axis in (1, 2):
        noise = ndimage.correlate1d(noise, (blur, 1 - 2 * blur, blur), axis)
    sums = np.einsum("nij,ij->n", noise[:, 1:-1, 1:-1], g)
    white = noise_left(blur) * np.sum(g * g)
    wide = np.pad(g, side, mode="wrap")
    samples = Samples(np.ones(wide.shape, bool), np.zeros_like(wide), wide, np.zeros_like(wide))
    with ThreadPoolExecutor(2) as pool:
        ratio = sigma._through_smoothing(samples, blur, pool)[side + side // 2, side + side // 2]
    assert ratio > 1.1
    # A variance from 6,000 draws is known to 1.8 % of itself; at a window's rim a wave goes on for the ratio alone, and
    # waves around it do not join: 3 % more.
    assert np.var(sums) / white == pytest.approx(ratio, rel=0.07)


def test_how_much_goes_with_the_noise():
    residual = np.array([1.0, 1.0, 1.0, np.inf, 1.0])
    assert blur_for(np.array([0.02, 0.03, 0.04, 0.9, 1.0]), residual) == 0.0
    assert blur_for(np.array([0.2, 0.3, 0.4, 0.9, 1.0]), residual) == pytest.approx(0.05)
    assert blur_for(np.ones(5), residual) == 0.0
    assert 1 / 6 > blur_for(np.full(5, 0.999), residual) > 0.16  # never more than a binomial's 1/4


def test_noise_of_view_1_counts_half_where_it_is_more():
    residual, share = np.ones(5), np.full(5, 0.01)
    # Of view 1's squared gradients 0.99/(0.99 + 0.99) are noise.
    assert blur_for(share, residual, np.full(5, 99.0)) == pytest.approx(0.25 / 6)
    assert blur_for(np.full(5, 0.3), residual, np.full(5, 0.1)) == pytest.approx(0.05)
    assert blur_for(share, np.full(5, np.inf), np.ones(5)) == 0


@pytest.mark.slow
def test_noisy_images_leave_less_of_the_start(monkeypatch):
    """A start that is off by a third of a pixel everywhere, as semi-global matching is on some walls in noise."""
    there, draws = motion(), np.random.default_rng(4)
    faint = [0.12 * (image - 128) + 128 for image in pair()]
    images = tuple((image + draws.normal(0, 8, image.shape)).astype(np.float32) for image in faint)
    seen = steep(there)

    def bias(matches):
        return np.nanmedian(errors_px(matches, there)[seen])

    begin = start(there) + 0.3 * (2 * np.pi / 360)
    with_smoothing = refine(images, there, begin)
    monkeypatch.setattr(slanted, "blur_for", lambda *_: 0.0)
    without = refine(images, there, begin)
    assert abs(bias(with_smoothing)) < 0.8 * abs(bias(without))
    error, before = (np.nanmedian(np.abs(errors_px(each, there)[seen])) for each in (with_smoothing, without))
    assert error < before
