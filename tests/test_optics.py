"""The lens's effects on the image: point spread functions by their moments, vignetting by its formula."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.camera.sensor import Sensor, pixel_directions
from harness.simulation.optics import Optics, with_optics

SENSOR = Sensor()
HEIGHT, WIDTH = SENSOR.camera.height_px, SENSOR.camera.width_px
V, U = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
KNOWN = pixel_directions(SENSOR)[1]


def point(row, column):
    image = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
    image[row, column] = 1000.0
    return image


def moments(image):
    """Sum, centroid (u, v) and covariance of (u, v) of a point's image."""
    weight = image.astype(np.float64)
    total = weight.sum()
    mean = np.array([(weight * U).sum(), (weight * V).sum()]) / total
    du, dv = U - mean[0], V - mean[1]
    cov = np.array([[(weight * du * du).sum(), (weight * du * dv).sum()], [0, (weight * dv * dv).sum()]]) / total
    cov[1, 0] = cov[0, 1]
    return total, mean, cov


def radius_2(row, column):
    """Squared distance from the principal point as a share of the largest in use."""
    all_of_it = (U - SENSOR.camera.cx_px) ** 2 + (V - SENSOR.camera.cy_px) ** 2
    return all_of_it[row, column] / all_of_it[KNOWN].max()


def test_an_ideal_lens_returns_the_image_itself():
    image = point(100, 300)
    assert with_optics(image, SENSOR, Optics()) is image
    assert Optics(motion_deg=30.0).is_ideal


@pytest.mark.parametrize(("row", "column"), [(130, 320), (180, 420), (240, 500)])
def test_defocus_has_its_variance_everywhere(row, column):
    """From 1 px² at the centre to 9 px² at the edge, with the squared distance."""
    total, mean, cov = moments(with_optics(point(row, column), SENSOR, Optics(defocus_px=1.0, defocus_edge_px=3.0)))
    expected = 1 + 8 * radius_2(row, column)
    # Cut off at four standard deviations, 1e-3 of the variance is lost. What grows towards the edge leans outwards.
    assert cov[0, 0] == pytest.approx(expected, rel=0.02)
    assert cov[1, 1] == pytest.approx(expected, rel=0.02)
    assert total == pytest.approx(1000, rel=0.01)
    assert mean == pytest.approx([column, row], abs=0.1)


def test_a_path_has_its_length_and_direction():
    """A straight path of length L adds the variance L²/12 along it, and none across."""
    for length, degrees in ((7.0, 0.0), (12.5, 90.0), (9.3, 35.0)):
        optics = Optics(defocus_px=1.5, motion_px=length, motion_deg=degrees)
        total, mean, cov = moments(with_optics(point(150, 330), SENSOR, optics))
        along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        across = np.array([-along[1], along[0]])
        # The Gaussian keeps it band-limited; cut off at four standard deviations, it has 1e-3 less variance.
        assert along @ cov @ along == pytest.approx(1.5**2 + length**2 / 12, rel=5e-3)
        assert across @ cov @ across == pytest.approx(1.5**2, rel=5e-3)
        assert total == pytest.approx(1000, rel=0.01)
        assert mean == pytest.approx([330, 150], abs=0.05)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(
    st.builds(
        Optics,
        defocus_px=st.floats(0, 5),
        defocus_edge_px=st.floats(0, 5),
        motion_px=st.floats(0, 20),
        motion_deg=st.floats(-180, 180),
    )
)
def test_an_even_image_stays_even_and_black_beyond_does_not_bleed_in(optics):
    image = np.where(KNOWN, np.float32(90), np.float32(0))
    # Rounded to float32: one part in 10^7 of 90, and what FFTs leave of it.
    np.testing.assert_allclose(with_optics(image, SENSOR, optics), image, rtol=0, atol=1e-4)


def test_vignetting():
    image = np.where(KNOWN, np.float32(200), np.float32(0))
    dimmed = with_optics(image, SENSOR, Optics(vignetting=0.4))
    expected = np.where(KNOWN, 200 * (1 - 0.4 * radius_2(slice(None), slice(None))), 0)
    np.testing.assert_allclose(dimmed, expected, rtol=0, atol=1e-4)
    assert dimmed[KNOWN].min() == pytest.approx(120, abs=1e-3)
    assert dimmed[KNOWN].max() <= 200
