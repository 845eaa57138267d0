"""How far off estimated motions are, and whether their standard deviations say so.

Fresh pairs are drawn: a shipped scene, a baseline of 0.1 to 1 m, level or nearly vertical, any yaw, a tilt of up to 5
degrees; each at a noise of 0, 4 and 10 grey levels. For the motion of the keypoints and for the direct one it prints
the median errors of rotation and of the direction of t, the shares of the five errors that one and two predicted
standard deviations cover, the root of their mean square in those units, and how many motions called `ok` are off by
more than 2 degrees.

    pip install 'omnirange[motion]'
    python benchmarks/motion.py [pairs] [seed]
"""

import sys
from collections import Counter
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

import harness
from harness.geometry.angles import angle_between
from harness.motion.residuals import Turn
from harness.motion.sparse import tangents

SCENES = ("box", "corridor", "room")
BASELINES_M = (0.1, 0.25, 0.5, 1.0)
NOISES = (0.0, 4.0, 10.0)
VERTICAL_SHARE = 0.2
TARGETS_DEG = {"sparse": (0.02, 0.06), "direct": (0.006, 0.03)}
"""Median errors of rotation and direction at a noise of 10."""


def pairs(count: int, seed: int) -> Iterator[tuple[str, harness.RenderedView, harness.RenderedView]]:
    for i in range(count):
        draws = np.random.default_rng([seed, i])
        scene, baseline = SCENES[i % 3], BASELINES_M[i // 3 % 4]
        elevation = 0.45 * np.pi if draws.random() < VERTICAL_SHARE else draws.uniform(-0.05, 0.05)
        while True:
            first = np.array([0, 0, 1]) + draws.uniform(-0.3, 0.3, 3) * [1, 1, 0.3]
            azimuth = draws.uniform(-np.pi, np.pi)
            level = np.cos(elevation)
            step = baseline * np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
            yaws, (pitch, roll) = draws.uniform(-180, 180, 2), draws.uniform(-5, 5, 2)
            try:
                views = (
                    harness.render(scene, position_m=first, yaw_deg=yaws[0]),
                    harness.render(scene, position_m=first + step, yaw_deg=yaws[1], pitch_deg=pitch, roll_deg=roll),
                )
            except harness.InputError:  # inside of something
                continue
            yield f"{scene}, {baseline:g} m", *views
            break


def errors(turn: Turn, covariance: np.ndarray, truth: Turn) -> tuple[float, float, np.ndarray]:
    """Angles in degrees, and the five errors in standard deviations."""
    held = np.vstack(tangents(turn, "free"))
    omega = Rotation.from_matrix(turn.R.T @ truth.R).as_rotvec()
    off = held.T @ np.concatenate([omega, truth.t - turn.t])
    sigma = np.sqrt(np.diag(held.T @ covariance @ held))
    return np.degrees(np.linalg.norm(omega)), np.degrees(float(angle_between(turn.t, truth.t))), off / sigma


def main() -> None:
    given = [int(each) for each in sys.argv[1:]]
    count, seed = [*given, *(12, 1)[len(given) :]]
    errors_of: dict[tuple[str, float], list[tuple[float, float, np.ndarray]]] = {}
    statuses: Counter[str] = Counter()
    wrong = 0
    for i, (name, first, second) in enumerate(pairs(count, seed)):
        motion = harness.relative_motion(first.pose, second.pose)
        truth = Turn(motion.R_v2_from_v1, motion.t_v1 / motion.baseline_m)
        for noise in NOISES:
            draws = np.random.default_rng([seed, i, int(noise)])
            images = [
                np.clip(view.image + noise * draws.normal(size=view.image.shape), 0, 255) for view in (first, second)
            ]
            estimate = harness.estimate_motion(*images, first.sensor)
            statuses[str(estimate.status)] += 1
            print(f"{name}, noise {noise:g}: {estimate}; {'; '.join(estimate.reasons)}", flush=True)
            for stage in ("sparse", "direct"):
                fit = getattr(estimate, stage)
                if fit is not None and estimate.direction_v1 is not None:
                    errors_of.setdefault((stage, noise), []).append(errors(fit.turn, fit.covariance, truth))
            if estimate.status == harness.Status.OK:
                turn = Turn(estimate.R_v2_from_v1, estimate.direction_v1)
                wrong += max(errors(turn, estimate.covariance, truth)[:2]) > 2
    print("\nstage   noise  rotation  direction  1 sigma  2 sigma  rms")
    for (stage, noise), rows in sorted(errors_of.items()):
        rotation, direction = (np.median([row[k] for row in rows]) for k in (0, 1))
        off = np.abs([row[2] for row in rows])
        print(
            f"{stage:7} {noise:5g}  {rotation:8.4f}  {direction:9.4f}  {np.mean(off < 1):7.1%}  {np.mean(off < 2):7.1%}"
            f"  {np.sqrt(np.mean(off**2)):.2f}"
        )
    for stage, (rotation, direction) in TARGETS_DEG.items():
        print(f"target at noise 10, {stage}: {rotation:g}, {direction:g} degrees")
    print(f"{dict(statuses)}; called ok and off by more than 2 degrees: {wrong}")


if __name__ == "__main__":
    main()
