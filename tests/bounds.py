"""The error bounds that hold for wall pixels of the paper's experiment without noise, as checks on any outcome.

Every limit is a consequence of geometry with room for what geometry does not say; the reason stands beside it.
"""

import numpy as np

from harness.evaluation.metrics import measure


def check_pixel_level(outcome):
    """Whole-pixel matches are off by what sampling the curve makes them, and not to one side."""
    truth, found = outcome.reference, outcome.errors
    domain = truth.domain & truth.wall
    scored = domain & outcome.valid
    # Windows reach over the first and last rows and curves leave the image near the baseline: a tenth of the walls.
    density = scored.sum() / domain.sum()
    assert density >= 0.8, f"density {density:.3f}"
    error = np.abs(found.range_m[scored])
    half = (truth.law * truth.half_step)[scored]
    # A perfect whole-pixel matcher is within half a step always. Windows straddling edges, the nearest row and the
    # second order of the law cost some; a chain shifted by half a column leaves 50 %.
    within = np.mean(error <= half)
    assert within >= 0.80, f"only {within:.3f} within law x half a step"
    within = np.mean(error <= 3 * half)
    assert within >= 0.95, f"only {within:.3f} within law x 1.5 steps"
    for side, sign in (("left", 1), ("right", -1)):
        pixels = scored & (np.sign(outcome.trial.panorama.phi)[None, :] == sign)
        bias = np.median(found.disparity_px[pixels])
        # Fractions of a column are spread evenly over +-0.5 px on these walls: their median is 0 to within 0.05.
        assert abs(bias) <= 0.05, f"median signed error {bias:+.3f} px on the {side} side"


def check_subpixel_helps(pixel, subpixel):
    """The sub-pixel median is at most 0.85 times that of whole pixels, on the same pixels."""
    domain = pixel.reference.domain & pixel.reference.wall
    valid = pixel.valid & subpixel.valid
    medians = [measure(domain, valid, outcome.errors) for outcome in (pixel, subpixel)]
    for figure in ("disparity_median_abs_px", "range_median_abs_m"):
        ratio = medians[1][figure] / medians[0][figure]
        # Evenly spread fractions have a median of a quarter step; a parabola that follows them at all beats that.
        assert ratio <= 0.85, f"{figure}: sub-pixel over pixel {ratio:.2f}"


def check_all(pixel, subpixel):
    """All of the bounds."""
    check_pixel_level(pixel)
    check_subpixel_helps(pixel, subpixel)
