"""A verdict on the geometry of a pair, from how far its matches lie off their epipolar curves.

A centre a third of a pixel off, a quarter of a degree of yaw or a mirror a millimetre off cost per cents of range, of
which the images' noise, which is all that a matcher's own standard deviation knows, says nothing. But it shows across
the curves, where no range can move a match: see `harness.motion.across` and `harness.motion.causes`.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from harness.camera.sensor import pixel_directions
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.panorama import pixel_that_holds
from harness.matching.pair import Pair
from harness.motion.across import Across, Counts, fit_across
from harness.motion.causes import Cause, Causes, fit_causes
from harness.motion.residuals import Turn
from harness.pipeline.geometry_cost import Cost, cost_of

LEAST_TILES = 16
"""Tiles that a verdict needs: as many as errors that are fitted, which their prior holds as well."""
LEAST_MATCHED = 0.15
"""Share of view 1's textured windows that look alike in both views, at least, for a geometry to be called ok."""
LEAST_ALIKE = 0.5
"""Share of the windows with texture that look alike where they were matched, at least."""
MOST_SHARE = 0.02
"""Range error, as a share of the range, above which a geometry is called wrong."""
LEAST_COVERED = 0.5
"""Share of the ranges that have to be within one standard deviation of the matching alone; 0.68 of them should."""
MOST_COVERED = 0.15
"""Share of covered ranges below which a geometry that also costs more than `MOST_SHARE` is called wrong."""
GROSS_SHARE = 0.1
"""Range error, as a share of the range, above which a geometry that costs more than the noise is called wrong."""
_WORTH_SAYING = 0.1
"""Size of an error beside the largest one, at least."""


class Verdict(StrEnum):
    """The verdict on a geometry."""

    OK = "ok"
    """Matches lie on their curves within the noise, or the error costs less than the noise."""
    DOUBTFUL = "doubtful"
    """An error costs more than the noise."""
    WRONG = "wrong"
    """An error costs more than 2 % of the range and much more than the noise, or more than 10 % and than the noise."""
    UNKNOWN = "unknown"
    """There are too few matches to tell."""


@dataclass(frozen=True, repr=False)
class GeometryCheck(OneLine):
    """The agreement of a pair's motion and calibration with its images."""

    verdict: Verdict
    tiles: Across
    """The offsets of matches from their epipolar curves, tile by tile."""
    causes: Causes | None
    """The likely errors; None with too few tiles."""
    error_share: Array
    """`[tiles]`: standard deviation that the geometry adds to ranges about a tile, as a share of the range."""
    covered: float
    """Share of the ranges that the matching's standard deviation alone should cover, by what was fitted; NaN where
    there are too few tiles."""
    counts: Counts
    """Windows of view 1 with texture, those of them with ranges, and those that look alike in both views."""
    cost: Cost | None = None
    """What the likeliest error, and what is unexplained, do to ranges; None where there is neither."""

    @property
    def across_px(self) -> Array:
        """`[tiles]`: how far matches lie off their curves, pixels of view 2, towards t × x."""
        return self.tiles.delta * self.tiles.px_per_rad

    @property
    def explained_px(self) -> Array:
        """`[tiles]`: the part of `across_px` that the likeliest error explains, pixels."""
        if self.causes is None:
            return np.zeros(len(self.tiles))
        theta = self.causes.likely[0].theta if self.causes.likely else self.causes.theta
        return np.asarray(self.causes.effects.across @ theta * self.tiles.px_per_rad)

    @property
    def sigma_px(self) -> Array:
        """`[tiles]`: the standard deviation of `across_px` from noise, pixels."""
        sigma = self.tiles.sigma if self.causes is None else self.causes.noise
        return np.asarray(sigma * self.tiles.px_per_rad)

    @property
    def rms_px(self) -> float:
        """Robust root mean square of `across_px`: 1.48 times the median."""
        return _robust(self.across_px)

    @property
    def noise_px(self) -> float:
        """The expected value of `rms_px` from noise alone."""
        return float(np.sqrt(np.median(self.sigma_px**2))) if len(self.tiles) else math.nan

    @property
    def median_share(self) -> float:
        """Median, over the panorama, of the standard deviation that the geometry adds, as a share of the range."""
        if self.cost is None:
            return 0.0 if len(self.tiles) else math.nan
        return self.cost.median

    @property
    def likely(self) -> tuple[str, ...]:
        """The names of the likeliest cause and of those indistinguishable from it; none without an error."""
        if self.causes is None or not self.causes.significant:
            return ()
        best, *others = self.causes.likely
        parts = {"the centre", "the focal length"}  # of the mirror or lens
        return best.name, *(
            each.name for each in others if not (best.name in parts and each.name == "the mirror or lens")
        )

    @property
    def least(self) -> int:
        """The least number of windows for a verdict."""
        return max(LEAST_TILES, math.ceil(LEAST_MATCHED * self.counts.textured))

    @property
    def contradicted(self) -> bool:
        """Whether most matches contradict the geometry."""
        return self.counts.tried >= LEAST_TILES and self.counts.alike < LEAST_ALIKE * self.counts.tried

    def lines(self) -> list[str]:
        """The verdict in plain words, as a list of sentences."""
        if not self.contradicted:
            return self._verdict_lines()
        unlike = self.counts.tried - self.counts.alike
        text = (
            f"most matches contradict the geometry: {unlike} of {self.counts.tried} textured "
            "windows do not look alike where they were matched"
        )
        return [*self._verdict_lines(), text]

    def _verdict_lines(self) -> list[str]:
        if self.verdict == Verdict.UNKNOWN:
            if self.counts.alike >= self.least:
                text = (
                    f"geometry {self.verdict}: noise leaves only {len(self.tiles)} of {self.counts.alike} matching "
                    f"windows that tell how far off their epipolar curves they are, {LEAST_TILES} are needed"
                )
                return [text]
            text = (
                f"geometry {self.verdict}: only {self.counts.alike} of {self.counts.textured} textured windows match, "
                f"{self.least} are needed; motion or calibration may be far off, or there is no texture"
            )
            return [text]
        text = (
            f"geometry {self.verdict}: matches lie {self.rms_px:.2g} px off their epipolar curves, of which noise "
            f"explains {self.noise_px:.2g} px"
        )
        if self.causes is None or self.cost is None:
            return [text]
        cost = (
            f"it costs {100 * self.median_share:.2g} % of the range in the median, which sigma counts in; without, "
            f"sigma would cover {self.covered:.0%} of the ranges instead of 68%"
        )
        return [text, *self._cause_lines(self.causes), cost]

    def _cause_lines(self, causes: Causes) -> list[str]:
        lines = []
        if self.likely:
            best, alike = causes.likely[0], self.likely[1:]
            cause = f"likely cause: {best.name} ({errors_in_words(best)}), which explains {best.explains:.0%} of it"
            lines = [f"{cause}; it cannot be told from {' or '.join(alike)}" if alike else cause]
        if causes.unexplained_px:
            what = f"{causes.unexplained_px:.2g} px of it are" if self.likely else "it is"
            lines.append(
                f"{what} explained by no error of the motion or of a camera of this model; sigma takes matches to be "
                "as far off along their curves"
            )
        return lines

    def table(self) -> pd.DataFrame:
        """A row for each tile: its direction from view 1, where it is on both images, and how far it lies across."""
        x, y, z = self.tiles.x_1.T
        count = len(self.tiles)
        columns = {
            "azimuth_deg": np.degrees(np.arctan2(y, x)),
            "elevation_deg": np.degrees(np.arctan2(z, np.hypot(x, y))),
            "u_px": self.tiles.pixels_1[:, 0],
            "v_px": self.tiles.pixels_1[:, 1],
            "across_px": self.across_px,
            "sigma_px": self.sigma_px,
            "explained_px": self.explained_px,
            "weight": np.ones(count) if self.causes is None else self.causes.weight,
            "range_error_share": self.error_share,
        }
        return pd.DataFrame(columns)

    def summary(self) -> dict[str, Any]:
        """The figures as plain values."""
        return {
            "verdict": str(self.verdict),
            "tiles": len(self.tiles),
            "tiles_tried": self.counts.tried,
            "tiles_alike": self.counts.alike,
            "tiles_textured": self.counts.textured,
            "across_rms_px": _finite(self.rms_px),
            "noise_px": _finite(self.noise_px),
            "unexplained_px": 0.0 if self.causes is None else self.causes.unexplained_px,
            "range_error_share": _finite(self.median_share),
            "covered_without_it": _finite(self.covered),
            "likely_causes": list(self.likely),
            "causes": {
                each.name: {
                    "explains": each.explains,
                    **{_key(name): _plain(name, value) for name, value in each.errors.items()},
                }
                for each in (self.causes.alone if self.causes is not None else ())
            },
        }


def check_geometry(pair: Pair, range_m: Array, sigma_m: Array) -> GeometryCheck:
    """Judge motion and calibration by the images.

    Parameters
    ----------
    range_m, sigma_m
        `[height, width]` on the panorama: what was estimated with them, and the matching's standard deviation; NaN
        where there is none.
    """
    turn = Turn(np.asarray(pair.motion.R_v2_from_v1, np.float64), pair.t_v1 / pair.motion.baseline_m)
    first, second = pair.images
    tiles, counts = fit_across((first, second), pair.sensors, turn, _inverse_ranges(pair, range_m))
    none = np.zeros(len(tiles))
    if len(tiles) < LEAST_TILES:
        return GeometryCheck(Verdict.UNKNOWN, tiles, None, none, math.nan, counts)
    causes = fit_causes(tiles, pair.sensors, turn)
    if not causes.significant and not causes.unexplained_px:
        few = counts.alike < LEAST_MATCHED * counts.textured
        verdict, covered = (Verdict.UNKNOWN, math.nan) if few else (Verdict.OK, 0.6827)
        return GeometryCheck(verdict, tiles, causes, none, covered, counts)
    cost = cost_of(tiles, causes, pair.sensors, pair.motion, pair.grid, (range_m, sigma_m))
    if cost is None:
        return GeometryCheck(Verdict.UNKNOWN, tiles, causes, none, math.nan, counts)
    verdict = Verdict.OK if cost.covered >= LEAST_COVERED else Verdict.DOUBTFUL
    large = cost.median > MOST_SHARE and cost.covered < MOST_COVERED
    if large or (cost.median > GROSS_SHARE and verdict == Verdict.DOUBTFUL):
        verdict = Verdict.WRONG
    return GeometryCheck(verdict, tiles, causes, cost.at_tiles, cost.covered, counts, cost)


def geometry_share(check: GeometryCheck, pair: Pair, range_m: Array) -> Array:
    """The geometry's standard deviation at every pixel of the panorama, as a share of the range; NaN where there is no
    range.
    """
    if check.cost is None:
        return np.where(np.isfinite(range_m), 0.0, np.nan)
    return check.cost.everywhere(pair.grid, pair.motion.baseline_m / range_m)


def _inverse_ranges(pair: Pair, range_m: Array) -> Array:
    """1/range of view 1's mirror pixels, in 1/|t|."""
    x, seen = pixel_directions(pair.sensors[0])
    row, column, inside = pixel_that_holds(pair.grid, np.nan_to_num(x))
    inside = inside & seen
    w = np.full(x.shape[:2], np.nan)
    w[inside] = pair.motion.baseline_m / range_m[row[inside].astype(np.intp), column[inside]]
    return w


def _robust(values: Array) -> float:
    return float(1.4826 * np.median(np.abs(values))) if values.size else math.nan


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _is_angle(name: str) -> bool:
    return name.startswith(("turn ", "t "))


def _unit(name: str) -> str:
    return "deg" if _is_angle(name) else "mm" if name.startswith("mirror ") else "px"


def _plain(name: str, value: float) -> float:
    return math.degrees(value) if _is_angle(name) else value


def _where(name: str) -> str:
    """Where an error has that size, if not everywhere."""
    everywhere = _is_angle(name) or name.startswith(("centre ", "mirror "))
    return "" if everywhere else " at the rim"


def _key(name: str) -> str:
    return f"{name.replace(' ', '_')}_{_unit(name)}"


def errors_in_words(cause: Cause) -> str:
    """The largest errors, at most three, in degrees, pixels or millimetres; of the focal length and what else shifts
    pixels more towards the rim, the shift there.
    """
    plain = {name: _plain(name, value) for name, value in cause.errors.items()}
    most = max(abs(value) for value in plain.values())
    largest = sorted(plain.items(), key=lambda each: -abs(each[1]))[:3]
    return ", ".join(
        f"{name} {value:+.2g} {_unit(name).replace('deg', 'degrees')}{_where(name)}"
        for name, value in largest
        if abs(value) >= _WORTH_SAYING * most
    )
