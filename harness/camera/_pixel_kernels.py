"""From the image plane of focal length 1 to pixels, and back: the camera matrix with its skew.

`camera` is any model's named tuple that has `fu`, `fv`, `skew`, `cu` and `cv`.
"""

from harness.compiled import kernel


@kernel(inline=True)
def to_pixel(m, n, camera):
    """The pixel (u, v) of a point of the plane."""
    return camera.fu * m + camera.skew * n + camera.cu, camera.fv * n + camera.cv


@kernel(inline=True)
def moved_pixel(m, n, m_d, n_d, camera):
    """The pixel of a point, and its derivative for the derivative (m_d, n_d) of the point."""
    u, v = to_pixel(m, n, camera)
    return u, v, camera.fu * m_d + camera.skew * n_d, camera.fv * n_d


@kernel(inline=True)
def from_pixel(u, v, camera):
    """The point (m, n) of the plane at a pixel."""
    n = (v - camera.cv) / camera.fv
    return (u - camera.cu - camera.skew * n) / camera.fu, n
