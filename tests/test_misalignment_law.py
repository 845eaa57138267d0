"""How the errors that a misaligned mirror makes grow with range and baseline: docs/how-to/error-budget.md quotes it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from harness.camera.misalignment import Misalignment
from harness.camera.sensor import Sensor
from harness.evaluation.propagation import Rig, range_errors
from harness.evaluation.statistics import between, resampled
from harness.geometry.pose import Motion

RANGES_M = np.array([1.0, 2.0, 4.0, 8.0])
BASELINES_M = np.array([0.125, 0.25, 0.5, 1.0])
SEEDS = 12


def directions_all_around():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 7.5)), np.radians([-20.0, -10.0, 0.0, 8.0]))
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)


def shares(misalignment, turn_deg, seed):
    """Errors that 68 % of surfaces facing view 1 stay within, as shares of the range, `[baselines, ranges]`."""
    believed = Sensor()
    true = believed.model_copy(update={"misalignment": misalignment})
    azimuth = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    t_hat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    x_1 = directions_all_around()
    x_1 = x_1[np.abs(x_1 @ t_hat) < np.cos(np.radians(30))]
    errors = np.empty((len(BASELINES_M), len(RANGES_M)))
    for i, baseline_m in enumerate(BASELINES_M):
        motion = Motion(turn, baseline_m * t_hat)
        for j, range_m in enumerate(RANGES_M):
            error_m = range_errors(range_m * x_1, Rig((true, true), motion), Rig((believed, believed), motion))
            errors[i, j] = np.nanquantile(np.abs(error_m), 0.68) / range_m
    return errors


def exponents(share):
    """Exponents of the range and of the baseline in the error, where the range is four baselines or more."""
    log_range, log_baseline = np.meshgrid(np.log(RANGES_M), np.log(BASELINES_M))
    far = log_range - log_baseline > np.log(3.99)
    columns = np.stack([log_range[far], log_baseline[far], np.ones(far.sum())], axis=-1)
    of_share = np.linalg.lstsq(columns, np.log(share[far]), rcond=None)[0]
    return of_share[:2] + np.array([1.0, 0.0])


@pytest.mark.parametrize(
    "misalignment", [Misalignment(x_mm=0.1), Misalignment(rotation_y_deg=0.05)], ids=["displaced", "tilted"]
)
@pytest.mark.parametrize(
    ("turn_deg", "of_range", "of_baseline"),
    [(0.0, 1.0, 0.0), (70.0, 2.0, -1.0)],
    ids=["oriented alike", "turned"],
)
def test_errors_grow_with_range_and_baseline_as_the_how_to_says(misalignment, turn_deg, of_range, of_baseline):
    """Views oriented alike have the same errors of direction, which nearly cancel; those of turned views do not.

    At four baselines' range errors of the next order are left, of a twentieth in an exponent.
    """
    found = np.array([exponents(shares(misalignment, turn_deg, seed)) for seed in range(SEEDS)])
    assert found.mean(axis=0) == pytest.approx([of_range, of_baseline], abs=0.05)


@pytest.mark.parametrize(
    ("misalignment", "alike_percent", "turned_percent"),
    [
        (Misalignment(x_mm=0.1), (0.23, 0.38), (1.8, 2.2)),
        (Misalignment(rotation_y_deg=0.05), (0.20, 0.32), (1.4, 1.8)),
        (Misalignment(z_mm=0.1), (0.0395, 0.0400), (0.0395, 0.0400)),
    ],
    ids=["across", "tilt", "along"],
)
def test_a_small_misalignment_costs_what_the_how_to_says(misalignment, alike_percent, turned_percent):
    """At 2 m on half a metre of baseline; the how-to's intervals, to its two digits."""
    for turn_deg, quoted in ((0.0, alike_percent), (70.0, turned_percent)):
        percent = 100 * np.array([shares(misalignment, turn_deg, seed)[2, 1] for seed in range(SEEDS)])
        means = resampled(SEEDS) @ percent / SEEDS
        assert np.array(between(means, SEEDS)) == pytest.approx(np.array(quoted), rel=0.05)
