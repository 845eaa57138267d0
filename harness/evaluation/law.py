"""The test of the sensitivity law as a whole: geometry, images, decomposition, and a verdict in words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from harness.evaluation.law_geometry import check_geometry
from harness.evaluation.law_images import (
    best_baselines,
    fit_law_and_bound,
    fit_laws,
    noise_limited,
    sigma_alpha_slopes,
)

GROSS = 0.1
"""Share of estimates off by over a pixel above which errors count as mismatches, not as small errors."""
LEAST_R2 = 0.3
"""A slope off 1 that explains a smaller share of the variance than this is no law, however short its interval."""
NO_LAW = "no law to be seen"


def test_law(cells: pd.DataFrame) -> dict[str, Any]:
    """All parts of the `law` table of `summary.json`.

    Parameters
    ----------
    cells
        See `law_images`; may be empty, and then only geometry is reported.
    """
    images = fit_laws(cells) if len(cells) else []
    limited = noise_limited(cells) if len(cells) else cells
    return {
        "geometry": check_geometry().summary(),
        "images": images,
        "by_noise": _fit_by_noise(cells) if len(cells) else [],
        "noise_limited": _fit_limited(limited) if len(limited) else [],
        "law_and_bound": fit_law_and_bound(_bounded(limited)) if len(limited) else [],
        "sigma_alpha": sigma_alpha_slopes(cells) if len(cells) else [],
        "best_baseline": best_baselines(cells) if len(cells) else [],
        "verdict": verdict(images, cells),
    }


def _fit_by_noise(cells: pd.DataFrame) -> list[dict[str, Any]]:
    """Fits of the exact law for each noise level separately, with `sigma_grey`; none where the noise does not vary.

    Rounding to whole samples is an error constant in angle by construction. Where slopes do not depend on the noise, it
    is that error which follows the law, not the noise's.
    """
    if cells["sigma_grey"].nunique() < 2:
        return []
    return [
        {"sigma_grey": float(sigma_grey), **{name: value for name, value in fit.items() if name != "by_alpha_1"}}
        for sigma_grey, part in cells.groupby("sigma_grey", sort=True)
        for fit in fit_laws(part, ["exact"])
    ]


def _fit_limited(limited: pd.DataFrame) -> list[dict[str, Any]]:
    """Fits on both laws; and on the exact law with each cell's bound instead of a constant, where known."""
    bounded = _bounded(limited)
    fits = fit_laws(limited)
    if len(bounded):
        fits += fit_laws(bounded.assign(law_bound=bounded["law_exact"] * bounded["bound_alpha"]), ["bound"])
    return fits


def _bounded(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells whose Cramér-Rao bound is known."""
    return cells[cells["bound_alpha"].notna()] if "bound_alpha" in cells else cells.iloc[:0]


test_law.__test__ = False  # type: ignore[attr-defined]  # a test of physics, not one for pytest to collect


@dataclass(frozen=True)
class Verdict:
    """The verdict on one method and surface that its slopes allow."""

    matcher: str
    subpixel: str
    surface: str
    text: str
    """The verdict without the names of method and surface."""

    @property
    def sentence(self) -> str:
        """The verdict with the names of method and surface."""
        step = {"none": "whole pixels", "parabola": "parabola"}.get(self.subpixel, self.subpixel)
        return f"{self.surface.capitalize()}s, {self.matcher} matcher, {step}: {self.text}."


def verdicts(images: list[dict[str, Any]], cells: pd.DataFrame, *, directions: bool = True) -> Iterator[Verdict]:
    """The verdict for each method and surface; it never claims more than the intervals of the slopes allow.

    Parameters
    ----------
    images
        From `law_images.fit_laws`; fits without a slope are passed over.
    directions
        Also name the directions that by themselves exclude a slope of 1.
    """
    fitted = [fit for fit in images if fit["slope"] is not None]
    for fit in fitted:
        if fit["law"] != "exact":
            continue
        rival = next(
            other
            for other in fitted
            if other["law"] == "paper" and all(other[key] == fit[key] for key in ("matcher", "subpixel", "surface"))
        )
        where = _directions(fit) if directions else ""
        text = f"{_judged(fit)}{where}; {_rivalry(fit, rival)}{_gross(fit, cells)}"
        yield Verdict(fit["matcher"], fit["subpixel"], fit["surface"], text)


def verdict(images: list[dict[str, Any]], cells: pd.DataFrame) -> str:
    """All `verdicts` in sentences."""
    sentences = [each.sentence for each in verdicts(images, cells)]
    if not sentences:
        return "Images: not tested. The law needs cells that differ in |t|/d, from several baselines or ranges."
    return " ".join(sentences)


def _judged(fit: dict[str, Any]) -> str:
    slope, interval = fit["slope"], fit["slope_ci95"]
    if interval is None:
        return f"slope {slope:.2f} on the exact law without an interval (one seed), so nothing can be concluded"
    low, high = interval
    text = f"slope {slope:.2f} [{low:.2f}, {high:.2f}] on the exact law"
    if low <= 1 <= high:
        return f"{text}, which is compatible with 1" if high - low <= 0.3 else f"{text}, too wide to tell"
    if _explains_nothing(fit):
        return f"no law to be seen: {text}, which explains {fit['r2']:.0%} of the variance"
    return f"{text}, which excludes 1: the error grows {'faster' if low > 1 else 'more slowly'} than the law says"


def slope_verdict(fit: dict[str, Any]) -> str:
    """The conclusion that the slope of a fit on the exact law allows, in a few words."""
    if fit["slope_ci95"] is None:
        return "one seed: nothing can be concluded"
    low, high = fit["slope_ci95"]
    if low <= 1 <= high:
        return "compatible with the law" if high - low <= 0.3 else "too wide to tell"
    if _explains_nothing(fit):
        return NO_LAW
    return f"grows {'faster' if low > 1 else 'more slowly'} than the law"


def _explains_nothing(fit: dict[str, Any]) -> bool:
    return fit["r2"] is not None and fit["r2"] < LEAST_R2


def _directions(fit: dict[str, Any]) -> str:
    """Directions in which the law fails although it may hold overall: 1 is outside their own interval."""
    judged = [part for part in fit["by_alpha_1"] if part["slope_ci95"] is not None]
    outside = [part for part in judged if not part["slope_ci95"][0] <= 1 <= part["slope_ci95"][1]]
    if not outside:
        return ""
    named = ", ".join(f"{part['from_deg']:g} to {part['to_deg']:g} deg {part['slope']:.2f}" for part in outside)
    return f"; within single directions, {len(outside)} of {len(judged)} exclude 1 (alpha_1 {named})"


def _rivalry(fit: dict[str, Any], rival: dict[str, Any]) -> str:
    if rival["r2"] is None or fit["r2"] is None:
        return "d²/|t| could not be fitted"
    interval = rival["slope_ci95"]
    between = "" if interval is None else f" [{interval[0]:.2f}, {interval[1]:.2f}]"
    return f"on d²/|t| {rival['slope']:.2f}{between} (R² {fit['r2']:.2f} exact, {rival['r2']:.2f} d²/|t|)"


def _gross(fit: dict[str, Any], cells: pd.DataFrame) -> str:
    chosen = cells[
        (cells["matcher"] == fit["matcher"])
        & (cells["subpixel"] == fit["subpixel"])
        & (cells["surface"] == fit["surface"])
    ]
    share = float((chosen["gross"] * chosen["pixels"]).sum() / chosen["pixels"].sum())
    if share <= GROSS:
        return ""
    return f"; {share:.0%} of the estimates there are off by over a pixel: mismatches, which no law of errors covers"
