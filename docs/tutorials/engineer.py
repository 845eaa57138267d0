r"""
For engineers: choose a rig, measure with it
============================================

Which baseline, which resolution? And once the rig is there: how far is that wall, and how sure is the answer? This
tutorial compares rigs in a furnished room, and then measures range with two photographs.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import harness

# %%
# Compare rigs
# ------------
#
# A rig is a few keys of an experiment. Here are two resolutions as named *cases* and four baselines as an *axis*, all
# with 3 grey levels of noise and the ``column`` matcher. (See :doc:`/reference/settings` for what else can vary: the
# mirror, the lens, the field of view.)


def camera(width_px: int, height_px: int) -> dict[str, float]:
    """A camera whose image of the mirror fills its height."""
    return {
        "sensor.camera.width_px": width_px,
        "sensor.camera.height_px": height_px,
        "sensor.camera.focal_px": 614.12 * height_px / 480,
        "sensor.camera.cx_px": (width_px - 1) / 2,
        "sensor.camera.cy_px": (height_px - 1) / 2,
        "panorama.width_px": 720 * height_px // 480,
        "panorama.height_px": 200 * height_px // 480,
    }


rigs = harness.run(
    {
        "name": "rigs",
        "trial": {
            "scene": "room",
            "noise": {"sigma_grey": 3.0},
            "render": {"samples": 4},
            "matching": {"kind": "column", "d_min_m": 0.8},
        },
        "axes": {"view_2.baseline_m": [0.1, 0.2, 0.4, 0.8]},
    },
    cases={"320x240": camera(320, 240), "640x480": camera(640, 480)},
)
table = rigs.trials[["case", "view_2.baseline_m", "density", "range_median_abs_m", "bad_1px"]]
table.reset_index(drop=True).round(3)

# %%
# A longer baseline makes the law smaller, but the two views then differ more, and more of the room is seen by one of
# them only. The figures say where the balance is, for this room and this matcher. Density says what an error figure
# is about: compare both.

figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
for (name, rows), color, marker in zip(table.groupby("case"), ("#E69F00", "#0072B2"), ("o", "s"), strict=True):
    style = {"color": color, "marker": marker, "label": name}
    axes[0].plot(rows["view_2.baseline_m"], 1000 * rows["range_median_abs_m"], **style)
    axes[1].plot(rows["view_2.baseline_m"], 100 * rows["density"], **style)
axes[0].set(xlabel="baseline, m", ylabel="median error of the range, mm", yscale="log", xscale="log")
axes[1].set(xlabel="baseline, m", ylabel="density, %", xscale="log", ylim=(0, 100))
for each in axes:
    each.set_xticks([0.1, 0.2, 0.4, 0.8], ["0.1", "0.2", "0.4", "0.8"])
    each.minorticks_off()
axes[0].legend()
plt.show()

# %%
# Range from two photographs
# --------------------------
#
# Your own rig gives two image files, and you know the sensor and how the second view stands to the first. For this
# page, both photographs are rendered: the second one is 0.3 m further along x, and turned by 20°.

folder = Path(tempfile.mkdtemp())
poses = harness.Pose(position_m=(0, 0, 1)), harness.Pose(position_m=(0.3, 0, 1), yaw_deg=20)
views = [harness.render("room", position_m=pose.position_m, yaw_deg=pose.yaw_deg, samples=4) for pose in poses]
for name, view in zip(("left", "right"), views, strict=True):
    Image.fromarray(np.rint(view.image).astype(np.uint8)).save(folder / f"{name}.png")

# %%
# From here on, no scene and no truth is needed. ``sensor`` may also be the path of a TOML file, and ``motion`` the
# position of viewpoint 2 if both views are turned alike. The matcher is ``slanted`` unless you name another.

sensor = harness.Sensor()
motion = harness.relative_motion(*poses)
estimate = harness.estimate_range(folder / "left.png", folder / "right.png", sensor, motion)
estimate

# %%
# ``estimate.write("range")`` would write the range of every pixel, a coloured point cloud and a page; ``omnirange
# range`` does the same on the command line. As a picture, with azimuth descending to the right, as one sees it from
# inside:

figure, axes = plt.subplots(2, 1, figsize=(8, 4.6), layout="constrained")
extent = (180, -180, estimate.pair.grid.z_min, estimate.pair.grid.z_max)
axes[0].imshow(estimate.pair.panoramas()[0].values[:, ::-1], cmap="gray", extent=extent, aspect=40)
shown = axes[1].imshow(estimate.range_m[:, ::-1], cmap="viridis", vmin=1, vmax=5, extent=extent, aspect=40)
figure.colorbar(shown, ax=axes[1], label="range, m", pad=0.01)
axes[0].set(ylabel="z", title="view 1")
axes[1].set(ylabel="z", xlabel="azimuth φ, degrees", title="estimated range")
plt.show()

# %%
# How far to trust it
# -------------------
#
# ``sigma_m`` is a predicted standard deviation. Since these photographs were rendered, the truth is there to compare
# with:

error_m = np.abs(estimate.range_m - views[0].panorama_range_m)
known = np.isfinite(error_m) & np.isfinite(estimate.sigma_m)
for most in (1, 2, 3):
    print(f"within {most} sigma: {np.mean(error_m[known] <= most * estimate.sigma_m[known]):.0%}")
print(f"median error {1000 * np.median(error_m[known]):.0f} mm; density {np.mean(estimate.valid):.0%}")

# %%
# A normal distribution would give 68 %, 95 % and 99.7 %. The prediction knows about noise and texture. It knows
# nothing of mismatches, of surfaces that one view does not see, or of a wrong calibration: a sensor or a motion that
# is a little off shifts all ranges together, and sigma does not show it. Check a rig against a few distances that you
# have measured by hand.
