r"""
For authors of matchers: plug it in, see where it fails
=======================================================

A matcher is a function from a pair of views to angles. This tutorial writes one, has it checked, scores it beside two
matchers of omnirange on the same images, and looks at where its errors are. :doc:`/matchers` is the full guide: what
a matcher gets and gives, matchers as programs in any language, matchers that others install.
"""

import matplotlib.pyplot as plt
import numpy as np

import harness

# %%
# The matcher
# -----------
#
# A plane sweep: for many ranges, look up where view 2 would see every pixel's point, and keep the range at which both
# views look most alike. The answer is :math:`\alpha_2` in radians, and NaN where there is no match. This is the file
# ``plane_sweep.py``; to run this script elsewhere, put the file beside it.
#
# .. literalinclude:: /examples/plane_sweep.py
#    :lines: 3-
#
# Before anything else, ``omnirange check plane_sweep:match`` tries a matcher out on small scenes and says what it
# does that no matcher should (:doc:`/matchers` shows its output).
#
# Score it beside others
# ----------------------
#
# Wherever an experiment names a matcher, ``module:function`` is one. The keys below are the small images that the
# guides use.

small = {
    "scene": "room",
    "noise": {"sigma_grey": 2.0},
    "render": {"samples": 4},
    "sensor": {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5}},
    "panorama": {"width_px": 360, "height_px": 100},
}
beside = harness.run(
    {"name": "beside", "trial": small, "axes": {"matching.kind": ["window", "sgm", "plane_sweep:match"]}}, workers=1
)
columns = ["density", "disparity_median_abs_px", "bad_1px", "bad_4px", "range_median_abs_m"]
beside.trials.set_index("matching.kind")[columns].round(3)

# %%
# All three were given the same images with the same noise, and their angles were triangulated and scored by the same
# code. Density is part of every claim: a matcher may leave a pixel out, but that is counted.
#
# Where are the errors?
# ---------------------
#
# Every trial has its maps. An error of :math:`\alpha_2`, in pixels of disparity:

figure, axes = plt.subplots(3, 1, figsize=(8, 6.6), layout="constrained", sharex=True)
for axis, kind in zip(axes, ("window", "sgm", "plane_sweep:match"), strict=True):
    maps = beside.outcome({"matching.kind": kind})
    error = np.where(maps.domain, np.abs(maps.disparity_error_px), np.nan)
    extent = (180, -180, maps.grid.z_min, maps.grid.z_max)
    shown = axis.imshow(error[:, ::-1], cmap="magma", vmin=0, vmax=3, extent=extent, aspect=40)
    axis.set(title=kind, ylabel="z")
axes[-1].set_xlabel("azimuth φ, degrees; white: no estimate, or not counted")
figure.colorbar(shown, ax=axes, label="absolute error, px", shrink=0.6)
plt.show()

# %%
# The plane sweep matches every pixel, and pays for it: its bright patches are mismatches.
#
# The sweep's steps are equal in inverse range, 64 of them; more of them, or a larger window, are one axis away:

tuned = harness.run(
    {"name": "tuned", "trial": small | {"matching": {"kind": "plane_sweep:match"}}},
    axes={"matching.parameters.steps": [32, 128], "matching.parameters.window": [5, 9]},
    workers=1,
)
tuned.trials[["matching.parameters.steps", "matching.parameters.window", *columns]].reset_index(drop=True).round(3)

# %%
# Keep it tested
# --------------
#
# With omnirange installed, pytest has a fixture ``omnirange_check``: one line makes every check a test of your own
# suite (:doc:`/matchers`). :doc:`/how-to/error-bounds` holds the figures above as bounds.
