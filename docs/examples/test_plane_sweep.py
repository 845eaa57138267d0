"""Every check for matchers, a test for each."""


def test_plane_sweep(omnirange_check):
    omnirange_check("plane_sweep:match", window=5)
