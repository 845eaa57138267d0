"""The expected range errors of a rig, and the search for rigs that meet a requirement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from harness.camera.coverage import Coverage, coverage
from harness.design.answers import Answer, Candidate, Cost, answers, candidates, height_m, mirror_diameter_m
from harness.design.budget import CAUSES
from harness.design.ellipsoid import Ellipsoid, abeam, ellipsoids
from harness.design.rig import RigDesign, load_rig
from harness.display import OneLine, brief
from harness.errors import InputError
from harness.files import write
from harness.geometry.angles import Array
from harness.report.sensor_words import facts_of, title_of
from harness.spec import parse

if TYPE_CHECKING:
    import pandas as pd

FARTHEST_M = 1e6
"""Largest distance of a point, metres: beyond, the parallax is below the rounding errors."""
RANGES_M = (1.0, 2.0, 4.0, 8.0)
"""The ranges at which a rig is described, metres."""


@dataclass(frozen=True, repr=False)
class RigDescription(OneLine):
    """The expected range errors of a rig, and its sensor's field of view."""

    rig: RigDesign
    facts: dict[str, str]
    """The sensor's field of view and size, in words by name."""
    answers: tuple[Answer, ...]
    """The expected error at each range."""
    coverage: Coverage
    """The sensor's field of view, in figures."""
    ellipsoids: tuple[Ellipsoid, ...]
    """The uncertainty of the positions of chosen points."""

    @property
    def table(self) -> "pd.DataFrame":
        """The errors that 68 % of the estimates stay within, millimetres.

        A row for each range; columns are the causes, `total` and the `leading` cause.
        """
        import pandas as pd

        rows = [
            {"range_m": each.range_m, "total": 1000 * each.error_m}
            | {name: 1000 * each.by_cause_m[name] for name in CAUSES}
            | {"leading": each.leading}
            for each in self.answers
        ]
        return pd.DataFrame(rows).set_index("range_m")

    def write(self, path: str | Path) -> None:
        """Write a page.

        Raises
        ------
        InputError
            When it cannot be written, or does not end in .html.
        """
        from harness.report.design_page import build_page

        if Path(path).suffix.lower() not in (".html", ".htm"):
            raise InputError("must end in .html", file=path)
        write(Path(path), build_page(self.rig, self.facts, self.answers, self.coverage, self.ellipsoids))

    def _repr_html_(self) -> str:
        return str(self.table.to_html(float_format="{:.3g}".format))


def describe_rig(
    rig: str | Path | Mapping[str, Any] | RigDesign | None = None,
    ranges_m: Sequence[float] = RANGES_M,
    points_m: ArrayLike | None = None,
) -> RigDescription:
    """The expected range errors of a rig, by cause, without rendering anything.

    Parameters
    ----------
    rig
        A TOML file, a table, or a `RigDesign`; the default sensor on half a metre when None.
    ranges_m
        The ranges at which errors are given, metres.
    points_m
        `[n, 3]`: points in view 1's frame whose position is asked for; when None, abeam of view 1 at these ranges.

    Returns
    -------
    RigDescription

    Raises
    ------
    InputError
        One line that names the file or the argument, the key, and what would be right.

    Examples
    --------
    >>> import harness
    >>> described = harness.describe_rig({"baseline_m": 0.3, "uncertainty": {"rotation_deg": 0.05}})
    >>> described.table.leading.tolist()
    ['rotation', 'rotation', 'rotation', 'rotation']
    >>> (1000 * described.ellipsoids[2].semi_axes_m).round(1)  # of a point 4 m abeam, millimetres
    array([47. ,  0.2,  0.2])
    """
    loaded = loaded_rig(rig)
    for range_m in ranges_m:
        if not 0 < range_m < float("inf"):
            raise InputError(f"must be above 0; found {range_m:g}", key="ranges_m")
    points = abeam(loaded, ranges_m) if points_m is None else _points(points_m)
    covered = coverage(loaded.sensor)
    facts = {"sensor": title_of(covered), **facts_of(covered), "baseline": f"{loaded.baseline_m:g} m"}
    if loaded.has_mirror:
        facts["size"] = (
            f"mirror {1000 * mirror_diameter_m(loaded.sensor):.0f} mm across; from the camera's centre to its rim "
            f"{1000 * height_m(loaded.sensor):.0f} mm"
        )
    return RigDescription(loaded, facts, answers(loaded, ranges_m), covered, ellipsoids(loaded, points))


def _points(points_m: ArrayLike) -> Array:
    points = np.asarray(points_m)
    if points.ndim != 2 or points.shape[1:] != (3,) or points.dtype.kind not in "iuf":
        raise InputError(f"must be numbers [n, 3]; found {brief(points)}", key="points_m")
    points = points.astype(np.float64)
    for point in points:
        if not (np.isfinite(point).all() and 0 < np.linalg.norm(point) <= FARTHEST_M):
            raise InputError(f"must be within {FARTHEST_M:g} m of view 1, but not at it; found {point}", key="points_m")
    return points


def find_rigs(
    accuracy_m: float,
    range_m: float,
    rig: str | Path | Mapping[str, Any] | RigDesign | None = None,
    *,
    baseline_max_m: float = float("inf"),
    height_max_m: float = float("inf"),
    width_px: int | None = None,
    cost: Cost | None = None,
    most: int = 10,
) -> list[Candidate]:
    """The cheapest rigs whose range errors stay, for 68 % of the estimates, within an accuracy at a range.

    Parameters
    ----------
    accuracy_m, range_m
        The required accuracy, metres.
    rig
        Whose sensor is resized, and whose noise, texture and uncertainties hold, as for `describe_rig`.
    baseline_max_m, height_max_m
        The longest baseline, and the largest distance from the camera's centre to the mirror's rim.
    width_px
        The image's width, where it is given.
    cost
        The costs of pixels, mirrors and baselines.
    most
        Most rigs to return.

    Returns
    -------
    list of Candidate
        The cheapest first; empty if no rig reaches the accuracy.

    Raises
    ------
    InputError
        As of `describe_rig`.

    Examples
    --------
    >>> import harness
    >>> best = harness.find_rigs(0.03, 4.0, {"uncertainty": {"rotation_deg": 0.02}}, most=1)[0]
    >>> best.rig.title, best.answer.leading
    ('640 x 480 px, 0.3 m', 'rotation')
    """
    for name, value in (
        ("accuracy_m", accuracy_m),
        ("range_m", range_m),
        ("baseline_max_m", baseline_max_m),
        ("height_max_m", height_max_m),
    ):
        if not value > 0:
            raise InputError(f"must be above 0; found {value:g}", key=name)
    if width_px is not None and not 8 <= width_px <= 16384:
        raise InputError(f"must be 8 to 16384; found {width_px}", key="width_px")
    if most < 1:
        raise InputError(f"must be at least 1; found {most}", key="most")
    return candidates(
        loaded_rig(rig),
        accuracy_m,
        range_m,
        baseline_max_m=baseline_max_m,
        height_max_m=height_max_m,
        width_px=width_px,
        cost=cost,
        most=most,
    )


def loaded_rig(rig: str | Path | Mapping[str, Any] | RigDesign | None) -> RigDesign:
    """A rig from a file, a table or an object."""
    if isinstance(rig, RigDesign):
        return rig
    if isinstance(rig, str | Path):
        return load_rig(Path(rig))
    return parse(RigDesign, dict(rig or {}), file="rig")
