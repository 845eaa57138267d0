"""From two images to a motion: keypoints, robust estimation, least squares, and a verdict."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from harness.camera.sensor import Sensor, pixel_directions
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.motion.calibration_error import calibration_effects
from harness.motion.direct import DirectFit, fit_direct
from harness.motion.features import Correspondences, find_features, is_mirrored, match_features
from harness.motion.misfit import misfit_px
from harness.motion.robust import agree
from harness.motion.sparse import Fit, Freedom, fit, fit_rotation
from harness.motion.tiles import SIDE_PX, inverse_ranges
from harness.motion.verdict import Status, rival_of, why_failed, why_no_parallax, why_weak

Image = NDArray[np.float32]


@dataclass(frozen=True, repr=False)
class EstimatedMotion(OneLine):
    """A motion up to the length of t, its covariance and a verdict."""

    status: Status
    reasons: tuple[str, ...]
    """The reasons why the status is not `ok`."""
    R_v2_from_v1: Array | None
    """`[3, 3]`; None when the estimation failed."""
    direction_v1: Array | None
    """`[3]`, unit direction of t_v1; None without parallax."""
    covariance: Array | None
    """`[6, 6]`, radians squared: covariance of omega in `R exp([omega]×)` and of the change of the unit t, both in v1's
    frame; singular along t. Includes the error of the calibration if that was given. None without a direction."""
    calibration_effects: Array | None
    """`[6, k]`, radians per pixel: derivatives of omega and t by errors of the calibration; see
    `harness.motion.calibration_error`. None without a direction."""
    pairs: Correspondences
    """Putative matches of keypoints."""
    sparse: Fit | None
    """The motion fitted to the pairs; None when the estimation failed."""
    direct: DirectFit | None
    """The motion fitted to the grey levels, which is the result if there is one."""
    rotation_px: float
    """Median residual of a pure rotation, pixels; NaN when the estimation failed."""
    iterations: int
    """Number of samples drawn."""


def estimate(
    images: tuple[Image, Image],
    sensors: tuple[Sensor, Sensor],
    *,
    freedom: Freedom = "free",
    direct: bool = True,
    calibration_px: float = 0.0,
    seed: int = 0,
) -> EstimatedMotion:
    """Estimate the motion from view 1 to view 2 from two images.

    Parameters
    ----------
    images
        `[sensor height, sensor width]` each, grey levels of 0 .. 255.
    freedom
        `upright`: the rotation is about z; `planar`: and t is perpendicular to z.
    direct
        Also fit the motion to the grey levels.
    calibration_px
        Standard deviation of the calibration's parameters, pixels on the image; 0 for an exact one.
    seed
        Seed of the random samples; results are reproducible to the bit.

    Raises
    ------
    InputError
        When the extra `motion` is not installed.
    """
    mirrored = [is_mirrored(each) for each in sensors]
    first = find_features(images[0], sensors[0])
    second = find_features(images[1], sensors[1], flip=mirrored[0] != mirrored[1])
    pairs = match_features(first, second)
    return estimate_from_pairs(
        pairs,
        sensors,
        freedom=freedom,
        calibration_px=calibration_px,
        seed=seed,
        refine=(lambda start: _refined(images, sensors, start, pairs, freedom)) if direct else None,
    )


def estimate_from_pairs(
    pairs: Correspondences,
    sensors: tuple[Sensor, Sensor],
    *,
    freedom: Freedom = "free",
    calibration_px: float = 0.0,
    seed: int = 0,
    refine: Callable[[Fit], DirectFit | None] | None = None,
) -> EstimatedMotion:
    """Estimate the motion from view 1 to view 2 from pairs of bearing vectors.

    Parameters
    ----------
    refine
        Called with the motion of the pairs to fit one to the images.

    Raises
    ------
    InputError
        When PoseLib is not installed.
    """
    if reason := why_failed(len(pairs), None):
        return _failed(pairs, reason, 0)
    consensus = agree(pairs, freedom=freedom, seed=seed)
    if consensus is None:
        return _failed(pairs, "no sample of pairs yields a motion", 0)
    fitted = fit(pairs, consensus.turn, freedom)
    if reason := why_failed(len(pairs), int(fitted.inlier.sum())):
        return _failed(pairs, reason, consensus.iterations)
    R_alone, rotation_px = fit_rotation(pairs.at(fitted.inlier), fitted.turn.R)
    if reason := why_no_parallax(fitted, rotation_px):
        return EstimatedMotion(
            Status.NO_PARALLAX, (reason,), R_alone, None, None, None, pairs, fitted, None, rotation_px,
            consensus.iterations,
        )  # fmt: skip
    direct = refine(fitted) if refine is not None else None
    rival = rival_of(pairs, consensus, fitted, freedom)
    best = direct or fitted
    effects = calibration_effects(pairs, sensors, fitted, best.turn, freedom)
    # The calibration is as wrong as was said, or as the images show.
    off_px = max(calibration_px, 0.0 if direct is None else direct.misfit_px)
    covariance = best.covariance + off_px**2 * effects @ effects.T
    reasons = why_weak(fitted, rival, direct, covariance, direct_wanted=refine is not None)
    return EstimatedMotion(
        status=Status.WEAK if reasons else Status.OK,
        reasons=tuple(reasons),
        R_v2_from_v1=best.turn.R,
        direction_v1=best.turn.t,
        covariance=covariance,
        calibration_effects=effects,
        pairs=pairs,
        sparse=fitted,
        direct=direct,
        rotation_px=rotation_px,
        iterations=consensus.iterations,
    )


def _refined(
    images: tuple[Image, Image], sensors: tuple[Sensor, Sensor], start: Fit, pairs: Correspondences, freedom: Freedom
) -> DirectFit | None:
    direct = fit_direct(images, sensors, start, pairs, freedom)
    return None if direct is None else replace(direct, misfit_px=misfit_px(images, sensors, direct))


def scene_points(estimated: EstimatedMotion, sensor: Sensor) -> tuple[Array, Array]:
    """Unit directions of view 1 `[n, 3]`, and inverse ranges in them `[n]`, 1/|t|, of a motion that was found: those of
    the tiles' centres, or of the keypoints that agree where there are no tiles.
    """
    direct, sparse = estimated.direct, estimated.sparse
    if direct is not None:
        row, column = (direct.tiles + SIDE_PX // 2).T
        x = pixel_directions(sensor)[0][row, column]
        return x, np.einsum("ti,ti->t", x, direct.planes)
    assert sparse is not None
    true = estimated.pairs.at(sparse.inlier)
    return true.x_1, inverse_ranges(true, sparse.turn)


def _failed(pairs: Correspondences, reason: str, iterations: int) -> EstimatedMotion:
    return EstimatedMotion(Status.FAILED, (reason,), None, None, None, None, pairs, None, None, np.nan, iterations)
