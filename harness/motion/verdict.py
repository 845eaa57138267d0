"""Whether an estimated motion can be trusted, and the reasons if not."""

import math
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from harness.geometry.angles import Array
from harness.motion.direct import DirectFit
from harness.motion.features import Correspondences
from harness.motion.residuals import sampson
from harness.motion.robust import Consensus, alike
from harness.motion.sparse import CAUCHY, Fit, Freedom, fit

LEAST_PAIRS = 30
"""Least number of pairs for an estimate."""
LEAST_AGREEING = 15
"""Least number of inliers: with a wrong motion one pair in fifty lies near its epipolar line, and all of its sample."""
LEAST_SHARE = 0.08
"""Least share of inliers, for the same reason."""
SURE_AGREEING = 60
"""With fewer inliers, one motion in seven is off by more than 2 degrees, without a larger sigma."""
PARALLAX = 3.0
"""Least ratio of the residual of a pure rotation to that of the motion."""
LEAST_TILES = 100
"""Least number of correlated tiles for the direct fit; a wall or a floor alone has fewer."""
MOST_APART = 5.0
"""Largest difference of the fits to keypoints and to grey levels, in standard deviations."""
MOST_SIGMA_T_DEG = 0.25
MOST_SIGMA_R_DEG = 0.05
"""Largest standard deviations of a trusted motion."""


_ALIKE_DEG = 0.002
"""Motions closer than this are the same, however small their standard deviations."""


class Status(StrEnum):
    """The verdict on an estimated motion."""

    FAILED = "failed"
    """There is no motion."""
    NO_PARALLAX = "no parallax"
    """A pure rotation explains the images: there is no direction of t, and no range."""
    WEAK = "weak"
    """There is a motion, but there are reasons not to trust it."""
    OK = "ok"


def why_failed(pairs: int, agreeing: int | None) -> str | None:
    """The reason why there is no motion; None when there is one.

    Parameters
    ----------
    pairs
        Number of putative matches.
    agreeing
        Number of inliers; None before it is known.
    """
    if pairs < LEAST_PAIRS:
        return f"only {pairs} keypoints match between the images; at least {LEAST_PAIRS} are needed"
    least = max(LEAST_AGREEING, math.ceil(LEAST_SHARE * pairs))
    if agreeing is not None and agreeing < least:
        return f"only {agreeing} of {pairs} pairs agree on a motion, no more than by chance; {least} are needed"
    return None


def why_no_parallax(fit: Fit, rotation_px: float) -> str | None:
    """The reason why the motion cannot be told from a pure rotation; None when it can."""
    if rotation_px >= PARALLAX * fit.scale_px:
        return None
    return (
        f"a rotation alone leaves {rotation_px:.2g} px, the motion {fit.scale_px:.2g} px: the baseline is too "
        "short, or the scene too far away, to determine the direction of t"
    )


def why_weak(
    fit: Fit, rival: Fit | None, direct: DirectFit | None, covariance: Array, *, direct_wanted: bool
) -> list[str]:
    """Reasons not to trust a motion; none when it can be trusted.

    Parameters
    ----------
    fit
        The motion fitted to keypoints.
    rival
        An alternative motion that explains the pairs equally well.
    direct
        The motion fitted to grey levels; None when that failed or was not requested.
    covariance
        `[6, 6]`, of the answer, the calibration's share included.
    """
    reasons = []
    agreeing = int(fit.inlier.sum())
    if agreeing < SURE_AGREEING:
        reasons.append(f"only {agreeing} pairs agree on it; below {SURE_AGREEING} the sigmas are unreliable")
    reasons += too_uncertain(*(math.sqrt(np.trace(covariance[part, part])) for part in (slice(3), slice(3, 6))))
    if direct is not None and len(direct.tiles) < LEAST_TILES:
        reasons.append(
            f"only {len(direct.tiles)} tiles match between the images; {LEAST_TILES} are needed to trust them"
        )
    if direct is not None and (apart := sigmas_apart(fit, direct)) > MOST_APART:
        reasons.append(f"keypoints and grey levels give motions that are {apart:.0f} standard deviations apart")
    if direct is None and direct_wanted:
        reasons.append("the images differ too much to fit their grey levels; the motion is that of the keypoints alone")
    if rival is not None:
        x, y, z = rival.turn.t
        azimuth, elevation = math.degrees(math.atan2(y, x)), math.degrees(math.asin(z))
        reasons.append(
            "two motions explain the pairs equally well, as for a planar scene: the other one has t at azimuth "
            f"{azimuth:.1f}, elevation {elevation:.1f} degrees"
        )
    return reasons


def sigmas_apart(fit: Fit, direct: DirectFit) -> float:
    """The largest difference of two fits along any axis of rotation or t, in its standard deviations."""
    omega = Rotation.from_matrix(fit.turn.R.T @ direct.turn.R).as_rotvec()
    difference = np.concatenate([omega, direct.turn.t - fit.turn.t])
    variance = np.diag(fit.covariance) + np.diag(direct.covariance) + math.radians(_ALIKE_DEG) ** 2
    return float(np.max(np.abs(difference) / np.sqrt(variance)))


def too_uncertain(sigma_rotation: float, sigma_direction: float) -> list[str]:
    """Reasons when a standard deviation, radians, is too large or unknown."""
    reasons = []
    for name, sigma, most in (
        ("the direction of t", sigma_direction, MOST_SIGMA_T_DEG),
        ("the rotation", sigma_rotation, MOST_SIGMA_R_DEG),
    ):
        degrees = math.degrees(sigma)
        if not degrees <= most:
            figure = f"{degrees:.2g} degrees" if math.isfinite(degrees) else "not known"
            reasons.append(f"the sigma of {name} is {figure}; up to {most:g} is trusted")
    return reasons


def rival_of(pairs: Correspondences, consensus: Consensus, best: Fit, freedom: Freedom) -> Fit | None:
    """An alternative motion that explains the pairs as well as the best one, if there is any."""
    least = _loss(pairs, best, best.scale_px)
    for _, turn in consensus.rivals:
        other = fit(pairs, turn, freedom)
        # Twice the difference of log-likelihoods is a chi square: 25 is beyond doubt, but neighbours share noise.
        if not alike(other.turn, best.turn) and _loss(pairs, other, best.scale_px) < 1.05 * least + 25:
            return other
    return None


def _loss(pairs: Correspondences, fit: Fit, scale: float) -> float:
    e = sampson(pairs, fit.turn)
    behind = ~fit.inlier & (np.abs(e) < 3 * scale)  # near its epipolar line, but behind a view
    ratio = np.where(behind, 10 * scale, e) / (CAUCHY * scale)
    return float(CAUCHY**2 * np.sum(np.log1p(np.minimum(ratio, 20.0) ** 2)))
