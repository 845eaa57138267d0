"""Error bounds to assert in a test, on any outcome of a trial.

Each takes the reason why its bound should hold, which is not optional: a number without a reason is not a bound.
Where one fails, the message says by how much, where it is worst (direction and range), and for which trial.
"""

import numpy as np
from numpy.typing import NDArray

from harness.evaluation.metrics import measure
from harness.evaluation.regions import ALPHA_1_EDGES_DEG, RANGE_RATIO
from harness.geometry.angles import Array
from harness.matching.registry import method_of
from harness.pipeline.trial import Outcome

Mask = NDArray[np.bool_]

FEWEST = 100
"""Pixels that a cell must have to be named as the worst one."""


def assert_within_law(outcome: Outcome, *, half_steps: float, share: float, surface: str = "all", reason: str) -> None:
    """At least a share of the range errors lies within `law × half_steps × half the curve's own angular step`.

    Parameters
    ----------
    half_steps
        1 is what rounding to whole samples makes; 3 is a sample and a half.
    surface
        `wall`, `floor` (ceilings too) or `all`.

    Raises
    ------
    AssertionError
    """
    truth = outcome.reference
    pixels = _domain(outcome, surface) & outcome.valid
    within = np.abs(outcome.errors.range_m) <= half_steps * truth.law * truth.half_step
    measured = _mean(within, pixels)
    if not measured >= share:
        claim = f"{measured:.3f} of the {surface} pixels are within law x {half_steps:g} half steps, required {share:g}"
        _fail(outcome, claim, share - measured, reason, _worst(outcome, pixels, ~within))


def assert_density(outcome: Outcome, *, at_least: float, surface: str = "all", reason: str) -> None:
    """At least a share of the domain's pixels has an estimate of the range.

    Raises
    ------
    AssertionError
    """
    domain = _domain(outcome, surface)
    measured = _mean(outcome.valid, domain)
    if not measured >= at_least:
        claim = f"the density on {surface} pixels is {measured:.3f}, required {at_least:g}"
        _fail(outcome, claim, at_least - measured, reason, _worst(outcome, domain, ~outcome.valid))


def assert_unbiased(outcome: Outcome, *, at_most_px: float, surface: str = "all", reason: str) -> None:
    """The median signed error of alpha_2 is small, on each side of the panorama (phi above and below 0) apart.

    A shift of the columns has opposite signs on the two sides of the baseline, and cancels over both.

    Raises
    ------
    AssertionError
    """
    for side, sign in (("phi > 0", 1), ("phi < 0", -1)):
        pixels = _domain(outcome, surface) & outcome.valid & (np.sign(outcome.trial.panorama.phi)[None, :] == sign)
        measured = _median(outcome.errors.disparity_px, pixels)
        if not abs(measured) <= at_most_px:
            claim = f"the median signed error at {side} is {measured:+.3f} px, allowed {at_most_px:g}"
            off = np.abs(outcome.errors.disparity_px) > at_most_px
            _fail(outcome, claim, abs(measured) - at_most_px, reason, _worst(outcome, pixels, off))


def assert_median_error(outcome: Outcome, *, at_most_px: float, surface: str = "all", reason: str) -> None:
    """The median absolute error of alpha_2, in pixels, has a limit.

    Raises
    ------
    AssertionError
    """
    pixels = _domain(outcome, surface) & outcome.valid
    absolute = np.abs(outcome.errors.disparity_px)
    measured = _median(absolute, pixels)
    if not measured <= at_most_px:
        claim = f"the median disparity error on {surface} pixels is {measured:.3f} px, allowed {at_most_px:g}"
        _fail(outcome, claim, measured - at_most_px, reason, _worst(outcome, pixels, absolute > at_most_px))


def assert_improves(outcome: Outcome, over: Outcome, *, ratio: float, surface: str = "all", reason: str) -> None:
    """The median errors of disparity and range are at most `ratio` times another outcome's, on the same pixels.

    Raises
    ------
    AssertionError
    """
    domain, valid = _domain(outcome, surface), outcome.valid & over.valid
    ours, theirs = (measure(domain, valid, each.errors) for each in (outcome, over))
    for figure in ("disparity_median_abs_px", "range_median_abs_m"):
        mine, yours = ours[figure], theirs[figure]
        measured = np.nan if mine is None or not yours else mine / yours
        if not measured <= ratio:
            claim = f"{figure} on {surface} pixels is {measured:.3f} times trial {over.trial.key}'s, allowed {ratio:g}"
            worse = np.abs(outcome.errors.disparity_px) > np.abs(over.errors.disparity_px)
            _fail(outcome, claim, measured - ratio, reason, _worst(outcome, domain & valid, worse))


def _domain(outcome: Outcome, surface: str) -> Mask:
    truth = outcome.reference
    parts = {"all": truth.domain, "wall": truth.domain & truth.wall, "floor": truth.domain & ~truth.wall}
    if surface not in parts:
        raise ValueError(f"surface must be one of {', '.join(parts)}; found {surface!r}")
    return parts[surface]


def _mean(part: Mask, pixels: Mask) -> float:
    return float(np.mean(part[pixels])) if pixels.any() else float("nan")


def _median(values: Array, pixels: Mask) -> float:
    return float(np.median(values[pixels])) if pixels.any() else float("nan")


def _worst(outcome: Outcome, pixels: Mask, failing: Mask) -> str:
    """The cell of direction and range in which the largest share of pixels fails."""
    flat, bad = pixels.ravel(), failing.ravel()
    shares = []
    for cell in outcome.cells:
        members = cell.pixels[flat[cell.pixels]]
        if members.size >= FEWEST:
            shares.append((float(np.mean(bad[members])), cell, members.size))
    if not shares:
        return "no cell of direction and range has enough pixels to name"
    share, cell, count = max(shares, key=lambda entry: entry[0])
    low, high = ALPHA_1_EDGES_DEG[cell.alpha_bin : cell.alpha_bin + 2]
    near, far = (RANGE_RATIO ** (cell.range_bin + i) for i in (0, 1))
    return (
        f"worst on the {cell.surface} at alpha_1 {low:g} to {high:g} deg, range {near:.2f} to {far:.2f} m: "
        f"{share:.2f} of {count} pixels fail"
    )


def _fail(outcome: Outcome, claim: str, by: float, reason: str, worst: str) -> None:
    trial = outcome.trial
    matcher, subpixel = method_of(trial.matching)
    support = trial.matching.support(trial.filter.log_sigma_px)
    name = (
        f"trial {trial.key} (scene {trial.scene.name}, baseline {trial.view_2.baseline_m:g} m, matcher {matcher}, "
        f"{f'window {support.window_px} px, ' if support else ''}sub-pixel {subpixel}, "
        f"noise {trial.noise.sigma_grey:g}, "
        f"seed {trial.seed})"
    )
    raise AssertionError(f"{claim}: missed by {by:.3f}; {worst}; {name}; the bound holds because {reason}")
