r"""
For researchers: reproduce the paper, test its law
==================================================

This tutorial repeats the experiment of Bunschoten and Kröse (ICRA 2001), and then asks whether the errors that come
out of it follow the law that theory predicts. It takes a few seconds.
"""

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np

import harness

# %%
# The paper's experiment
# ----------------------
#
# The experiment ``paper`` is shipped: a box of 6 m, two viewpoints half a metre apart, and two methods, which differ
# in the sub-pixel step alone. On the command line it judges the paper's claims over 12 pairs of views; one of these,
# beside the paper's own, is enough here.

paper = harness.run("paper", axes={"seed": [1]})
paper

# %%
# The summary compares both methods over the same pixels. The sub-pixel step halves the median error on the walls;
# over all pixels, where the floor is most of the picture, it helps little.

paper.summary[["density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m"]].round(3)

# %%
# Along one row of the panorama, just below the horizon, whole pixels make steps; the parabola removes most of them.

whole, refined = (paper.outcome({"matching.subpixel": step}) for step in ("none", "parabola"))
row = int(np.argmin(np.abs(whole.grid.z + 0.1)))
azimuth = np.degrees(whole.grid.phi)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(azimuth, whole.range_m[row], ".", markersize=3, color="#E69F00", label="whole pixels")
axes.plot(azimuth, refined.range_m[row], ".", markersize=3, color="#0072B2", label="sub-pixel")
axes.plot(azimuth, whole.true_range_m[row], color="black", linewidth=1, label="truth")
axes.set(xlabel="azimuth φ, degrees", ylabel="range, m", ylim=(2.4, 5.2), xticks=range(-180, 181, 60))
axes.legend(ncols=3)
plt.show()

# %%
# Near 0° and ±180° the pixels look along the baseline. There the range is poorly determined, as the law says.
#
# Does the error follow the law?
# ------------------------------
#
# The law says that an error of :math:`\alpha_2` shifts the range by :math:`d_2^2/(|t|\sin\alpha_1)`. If the standard
# deviation of :math:`\alpha_2` is the same everywhere, errors of the range are proportional to the law, whatever
# makes the law large: a far wall, a short baseline, or a direction near :math:`t`.
#
# To test that, vary all of them: baselines, the size of the box, and viewpoints that the seed draws. Small images keep
# it quick.

small = {
    "sensor.camera.width_px": 320,
    "sensor.camera.height_px": 240,
    "sensor.camera.focal_px": 307.06,
    "sensor.camera.cx_px": 159.5,
    "sensor.camera.cy_px": 119.5,
    "panorama.width_px": 360,
    "panorama.height_px": 100,
    "render.samples": 4,
    "noise.sigma_grey": 4.0,
    "matching.subpixel": "parabola",
    "matching.window_px": 11,
}
sweep = harness.run(
    "law",
    sets=small,
    axes={
        "seed": [1, 2, 3],
        "view_2.baseline_m": [0.25, 0.35355, 0.5, 0.70711],
        "scene.objects.0.size_m": [[4.0, 4.0, 6.0], [8.0, 8.0, 6.0]],
    },
)
sweep

# %%
# ``sweep.law`` holds what the program makes of the sweep: a slope of log(error/range) on log(law/range) for walls and
# for floors, with an interval from resampling the seeds, and a verdict in words. A slope of 1 would be the law.

for fit in sweep.law["images"]:
    if fit["surface"] == "wall":
        low, high = fit["slope_ci95"]
        print(f"walls, {fit['law']} law: slope {fit['slope']:.2f}, 95 % interval {low:.2f} .. {high:.2f}")

# %%
# The same by hand, pixel by pixel: pool the walls of all trials into classes of law/range, and take the median of the
# absolute error in each class.

ratios, errors = [], []
for key in sweep.trials.index:
    maps = sweep.outcome(key)
    baseline_m = maps.trial.true_motion.baseline_m
    to_2 = baseline_m * np.sin(maps.alpha_1) / np.sin(maps.true_alpha_2 - maps.alpha_1)  # d_2
    law = to_2**2 / (baseline_m * np.sin(maps.alpha_1))
    above = (maps.grid.z > -0.3)[:, None]  # rows that show walls only
    pixels = maps.domain & maps.valid & above
    ratios.append((law / maps.true_range_m)[pixels])
    errors.append((np.abs(maps.range_error_m) / maps.true_range_m)[pixels])
ratio, error = np.concatenate(ratios), np.concatenate(errors)
edges = np.geomspace(*np.quantile(ratio, [0.01, 0.99]), 13)
middle = np.sqrt(edges[:-1] * edges[1:])
median = np.array([np.median(error[(ratio >= a) & (ratio < b)]) for a, b in pairwise(edges)])

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
axes.loglog(middle, median, "o", color="#0072B2", label="median error, walls")
axes.loglog(middle, middle * np.median(median / middle), color="black", linewidth=1, label="slope 1: the law")
axes.set(xlabel="law / range, per radian", ylabel="error / range")
axes.legend()
plt.show()

# %%
# The points keep close to the line, but not on it. Such a small sweep cannot tell more; the shipped experiments can.
# ``omnirange run law`` and ``omnirange run law_best`` run thousands of trials, and their reports say what follows.
#
# Where to go from here
# ---------------------
#
# - :doc:`/theory` derives the law, and says which test of it would be a tautology.
# - :doc:`/how-to/sweep-an-axis` varies anything else.
# - ``result.report("report.html")`` writes every figure and table into one file.
