"""Filling the pixels of an image that are not known."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from harness.camera import fill
from harness.camera.fill import nearest_known


@pytest.mark.parametrize("largest_kept", [0, 2**20])
def test_the_nearest_known_pixel(largest_kept, monkeypatch):
    monkeypatch.setattr(fill, "_LARGEST_KEPT", largest_kept)
    for seed in range(3):
        known = np.random.default_rng(seed).random((23, 31)) < 0.1
        row, column = nearest_known(known)
        assert known[row, column].all()
        pixels = np.stack(np.indices(known.shape), axis=-1)
        nearest, _ = cKDTree(pixels[known]).query(pixels)
        # Of several as near any may be taken; distances are square roots of whole numbers, to the last bit.
        assert np.hypot(pixels[..., 0] - row, pixels[..., 1] - column) == pytest.approx(nearest, rel=1e-15)


def test_nothing_known_leaves_the_image_as_it_is():
    row, column = nearest_known(np.zeros((4, 5), bool))
    assert np.array_equal(np.stack([row, column]), np.indices((4, 5)))


def test_what_all_images_of_a_sensor_share_is_kept_and_read_only():
    known = np.eye(9, dtype=bool)
    row, column = nearest_known(known)
    again = nearest_known(known.copy())
    assert again[0] is row
    assert again[1] is column
    for each in (row, column):
        with pytest.raises(ValueError, match="read-only"):
            each[0, 0] = 1
