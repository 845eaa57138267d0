"""How long our matchers take, beside OpenCV's StereoSGBM and StereoBM on the same pair of views: columns, semi-global
matching, and slanted windows.

Prints ratios: the median over interleaved repetitions, so that a busy machine slows all down alike; of time on the
clock, and of CPU time, which does not depend on whether the second core is free. All use the same number of threads
(StereoSGBM's default mode works on one, whatever it is given; its three-way mode on all). What depends on the geometry
alone is made beforehand: epipolar tables for ours, rectification maps for OpenCV. The column matcher is timed from the
filtered panoramas to the best sample of every pixel, moved to the minimum of the parabola; semi-global matching from
the views resampled about the baseline to `Matches`, the check of consistency included; slanted windows from the mirror
images and the answer of semi-global matching to `Matches`, and again with all that semi-global matching does before;
OpenCV's from the rectified 8-bit images to disparities, which are sub-pixel as well.

The rectification is OpenCV's LONGLATI: columns are angles to the baseline, 0 to 180 degrees, rows half planes around
it, 0 to 360 degrees, both in steps of a panorama's column. No smaller rectangle holds the panorama, for every such half
plane crosses it; the panorama itself covers 57 % of it. `a pixel` divides both times by the number of pixels, which
takes that advantage away again.

    pip install 'omnirange[peers]'
    python benchmarks/matching.py [repetitions]
"""

import dataclasses
import statistics
import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy import ndimage

from harness.camera.sensor import project
from harness.geometry.angles import normalise
from harness.geometry.panorama import cylinder
from harness.matching.opencv.settings import StereoSGBM
from harness.matching.semi_global import match as semi_global
from harness.matching.semi_global.match import Geometry, SemiGlobal, View
from harness.matching.slanted.match import Slanted
from harness.matching.slanted.refine import refine_slanted
from harness.matching.window.match import WindowMatcher, match_whole_pixels
from harness.matching.window.subpixel import refine
from harness.pipeline.trial import Outcome, run_trial
from harness.runs.load import load_experiment

THREADS = 2
WINDOWS = (7, 9, 11, 13, 15)
DISPARITIES = 64
"""1 m to infinity half a metre apart is 0 to 30 degrees, 60 steps; OpenCV takes multiples of 16."""


BEST_OF_PEERS = tuple(
    StereoSGBM(mode="hh", rectified_scale=2.0, pre_filter_cap=15, block_px=block, p1_per_px=p_1, p2_per_px=4 * p_1)
    for block, p_1 in ((5, 2.0), (5, 8.0), (7, 8.0))
)
"""The settings with the smallest median errors, at full density, of the grid in `experiments/peers.toml`."""


def rectified(outcome: Outcome) -> list[np.ndarray]:
    """Both views on the LONGLATI rectangle, 8 bits; the baseline is along x, and both views have one orientation."""
    steps = outcome.trial.panorama.width_px
    alpha, around = (np.arange(steps // 2) + 0.5) * 2 * np.pi / steps, (np.arange(steps) + 0.5) * 2 * np.pi / steps
    sine = np.sin(alpha)
    # Angles to -t: a nearer point then moves to the left from the first image to the second, as OpenCV has it.
    directions = np.stack(
        np.broadcast_arrays(-np.cos(alpha), sine * np.cos(around)[:, None], sine * np.sin(around)[:, None]), axis=-1
    )
    pixels, visible = project(outcome.trial.sensor, directions)
    places = np.nan_to_num(pixels[..., ::-1], nan=-1.0).transpose(2, 0, 1)
    return [
        np.where(visible, ndimage.map_coordinates(image, places, order=1, mode="nearest"), 0).astype(np.uint8)
        for image in outcome.images
    ]


def opencv_matchers(window: int) -> dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]:
    """The penalties are those of OpenCV's own sample, 8 and 32 times the window's area."""
    area = window**2
    semi = {
        name: cv2.StereoSGBM.create(0, DISPARITIES, window, 8 * area, 32 * area, mode=mode)
        for name, mode in (
            ("SGBM", cv2.StereoSGBM_MODE_SGBM),
            ("SGBM 3-way", cv2.StereoSGBM_MODE_SGBM_3WAY),
            ("SGBM 8 paths", cv2.StereoSGBM_MODE_HH),
        )
    }
    return {name: matcher.compute for name, matcher in {**semi, "BM": cv2.StereoBM.create(DISPARITIES, window)}.items()}


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Time on the clock, and CPU time of all threads."""
    start, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - cpu


def main() -> None:
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 25
    cv2.setNumThreads(THREADS)
    trial = load_experiment("paper").trial
    outcome = run_trial(trial)
    pair = rectified(outcome)
    first, second = outcome.filtered
    share = first.values.size / pair[0].size
    print(f"panorama {first.values.shape[1]} x {first.values.shape[0]}, 1 m to infinity in steps of a column")
    print(
        f"LONGLATI {pair[0].shape[1]} x {pair[0].shape[0]}, {DISPARITIES} disparities of the same step;"
        f" StereoSGBM's median error on walls {median_error_px(pair, outcome):.2f} px"
    )
    print(f"{THREADS} threads, {repetitions} interleaved repetitions; time of ours over OpenCV's, and the same a pixel")
    print(heading("window"))
    for window in WINDOWS:
        matcher = WindowMatcher(kind="column", window_px=window, d_min_m=1.0, d_max_m=np.inf)

        def ours(matcher: WindowMatcher = matcher) -> None:
            whole = match_whole_pixels(first, second, trial.true_motion.t_v1, matcher, threads=THREADS)
            refine(whole.costs, "parabola")

        print(f"{window:>16}" + compared(ours, opencv_matchers(window), pair, repetitions, share))

    print(heading("semi-global"))
    for matcher in (SemiGlobal(d_max_m=np.inf), SemiGlobal(), SemiGlobal(paths=8, d_max_m=np.inf)):
        geometry = semi_global.geometry_for(outcome.pair, matcher)
        views = semi_global.views_about_the_baseline(outcome.pair, geometry)

        def ours(
            matcher: SemiGlobal = matcher, views: tuple[View, View] = views, geometry: Geometry = geometry
        ) -> None:
            semi_global.match(semi_global.search(views, geometry, matcher, THREADS), geometry, matcher, THREADS)

        name = f"{matcher.paths} paths, {matcher.d_max_m:g} m"
        print(f"{name:>16}" + compared(ours, opencv_matchers(7), pair, repetitions, share))
    print(heading("slanted"))
    slanted, start = Slanted(), SemiGlobal()
    coarse = start.match(outcome.pair).alpha_2
    # A pair shares what was made of it; every repetition has to make all of it.
    two = dataclasses.replace(outcome.pair, threads=THREADS, share=lambda _stage, _key, make: make())

    def refined() -> None:
        refine_slanted(two.images, two.sensors, two.motion, two.grid, coarse, settings=slanted, threads=THREADS)

    for name, work in (("refinement", refined), ("all of it", lambda: slanted.match(two))):
        print(f"{name:>16}" + compared(work, opencv_matchers(7), pair, max(3, repetitions // 3), share))

    print(f"{'':24} {'matched %':>10} {'bad-1 %':>8} {'median px':>10}   all of the domain, floor and walls")
    for matcher in (Slanted(), SemiGlobal(), SemiGlobal(paths=8), StereoSGBM(), StereoSGBM(mode="hh"), *BEST_OF_PEERS):
        error = outcome.pair.grid.phi_pitch**-1 * np.abs(
            (matcher.match(outcome.pair).alpha_2 - outcome.reference.alpha_2)[outcome.reference.domain]
        )
        best = " best" if matcher in BEST_OF_PEERS else ""
        name = f"{matcher.kind} {getattr(matcher, 'mode', getattr(matcher, 'paths', ''))}{best}"
        matched = np.isfinite(error)
        print(
            f"{name:>24} {100 * matched.mean():10.1f} {100 * np.mean(error[matched] > 1):8.2f}"
            f" {np.median(error[matched]):10.3f}"
        )


def heading(first: str) -> str:
    ratios = "".join(f"{'/ ' + name:>15} {'CPU':>6} {'a pixel':>8}" for name in opencv_matchers(7))
    return f"{first:>16} {'ours ms':>8} {'CPU ms':>8}" + ratios


def compared(
    ours: Callable[[], None],
    opencv: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]],
    pair: list[np.ndarray],
    repetitions: int,
    share: float,
) -> str:
    """A line of the table: the median time of ours, and its ratios to OpenCV's."""
    theirs = [lambda f=compute: f(*pair) for compute in opencv.values()]
    ours()
    times = [(seconds(ours), *map(seconds, theirs)) for _ in range(repetitions)]
    ratios = [
        [statistics.median(row[0][clock] / row[i + 1][clock] for row in times) for clock in (0, 1)]
        for i in range(len(theirs))
    ]
    mine = "".join(f" {1e3 * statistics.median(row[0][clock] for row in times):8.1f}" for clock in (0, 1))
    return mine + "".join(f"{wall:15.2f} {cpu:6.2f} {wall / share:8.2f}" for wall, cpu in ratios)


def median_error_px(pair: list[np.ndarray], outcome: Outcome) -> float:
    """Median error of StereoSGBM on walls: shows that it was given what it is made for."""
    truth, steps = outcome.reference, outcome.trial.panorama.width_px
    x, y, z = np.moveaxis(normalise(cylinder(outcome.trial.panorama)), -1, 0)
    column = (np.arccos(-x) / (2 * np.pi) * steps).astype(int)
    row = (np.arctan2(z, y) % (2 * np.pi) / (2 * np.pi) * steps).astype(int)
    disparity = opencv_matchers(7)["SGBM"](*pair)[row, column] / 16  # fixed point; negative where there is none
    error = disparity - (truth.alpha_2 - truth.alpha_1) / (2 * np.pi) * steps
    return float(np.median(np.abs(error[truth.domain & truth.wall & (disparity > 0)])))


if __name__ == "__main__":
    main()
