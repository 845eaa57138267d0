"""The error bounds that hold for wall pixels of the paper's experiment without noise.

Every limit is a consequence of geometry, with room for what geometry does not say.
"""

from harness.testing.assertions import assert_density, assert_improves, assert_unbiased, assert_within_law


def check_pixel_level(outcome):
    """Whole-pixel matches are off by what sampling the curve makes them, and not to one side."""
    assert_density(
        outcome,
        at_least=0.8,
        surface="wall",
        reason="windows reach over the first and last rows, and curves leave the image, on a tenth of the walls",
    )
    assert_within_law(
        outcome,
        half_steps=1,
        share=0.80,
        surface="wall",
        reason="whole samples are right to half a step; windows across edges, the nearest row and the second order "
        "of the law cost some, and a chain shifted by half a column leaves 50 %",
    )
    assert_within_law(
        outcome, half_steps=3, share=0.95, surface="wall", reason="few windows on a wall prefer a sample not next to it"
    )
    assert_unbiased(
        outcome,
        at_most_px=0.05,
        surface="wall",
        reason="fractions of a column are spread evenly over half a pixel to both sides on these walls",
    )


def check_subpixel_helps(pixel, subpixel):
    """The sub-pixel median is at most 0.85 times that of whole pixels, on the same pixels."""
    assert_improves(
        subpixel,
        pixel,
        ratio=0.85,
        surface="wall",
        reason="evenly spread fractions have a median of a quarter step, which any parabola that follows them beats",
    )


def check_all(pixel, subpixel):
    """All of the bounds."""
    check_pixel_level(pixel)
    check_subpixel_helps(pixel, subpixel)
