"""The maps of a trial: estimate, truth and error, pixel by pixel; in memory and as NPZ."""

import io
import os
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.display import OneLine, coloured, grey, html_figure
from harness.files import is_marked, make_folder, write
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid
from harness.geometry.triangulation import sigma_of_range
from harness.matching.interface import Reason
from harness.matching.uncertainty import sigma_alpha_2
from harness.pipeline.environment import code_hash
from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome
from harness.spec import dump_toml

Mask = NDArray[np.bool_]

FOLDER = "maps"
"""The folder of maps in a run's output folder."""

MAPS = {
    "panorama_1": ("grey", "view 1's panorama, grey levels of 0 .. 255"),
    "panorama_2": ("grey", "view 2's panorama in v1's orientation, grey levels of 0 .. 255"),
    "range_m": ("m", "estimated range from viewpoint 1; NaN where reason is not 0"),
    "true_range_m": ("m", "true range along the ray through the pixel's centre; NaN where nothing is seen"),
    "alpha_1": ("rad", "angle between the pixel's direction and t, the direction to viewpoint 2"),
    "alpha_2": ("rad", "estimated angle between t and the direction from viewpoint 2 to the point; NaN: no match"),
    "true_alpha_2": ("rad", "the angle that alpha_2 should be"),
    "sigma_alpha_2": (
        "rad",
        "standard deviation of alpha_2 as the matcher predicts it, or else from the residuals between the views",
    ),
    "confidence": ("", "the matcher's own, higher is more confident; only if the matcher has one"),
    "reason": ("", "why there is no range: " + ", ".join(f"{each.value} {each.name.lower()}" for each in Reason)),
    "domain": ("", "whether errors are counted: the true point is visible, at least 30 degrees from the baseline"),
    "visible": ("", "whether view 2 sees the true point"),
}
"""Unit and meaning of each map by name. Every map is `[height, width]` of view 1's panorama."""

_BEGINNING = "The maps of the trials that were run with --keep-arrays"
README = f"""\
{_BEGINNING}, one file KEY.npz for each, where KEY is the trial's key in
trials.csv. A file whose KEY is not there is of other trials, which were run into this folder before.

    import numpy as np
    maps = np.load("maps/KEY.npz")
    error_m = maps["range_m"] - maps["true_range_m"]

Every map is [height, width] of view 1's panorama: row 0 at the top, columns ascending in azimuth.

{"".join(f"{name:<15}{unit:<6}{text}{chr(10)}" for name, (unit, text) in MAPS.items())}
phi            rad   [width]: azimuth of the columns
z                    [height]: height of the rows on the unit cylinder; the elevation is atan(z)
baseline_m     m     scalar: |t|
key                  the trial's key, as in the file's name
settings             the trial's settings, TOML text
code                 SHA-256 of the source and libraries that made the file

Range is the Euclidean distance from the effective viewpoint, not a depth along an axis.
The errors are range_m - true_range_m and alpha_2 - true_alpha_2; one pixel of disparity is 2 pi/width radians.
The predicted standard deviation of the range is sigma_alpha_2 d_2^2/(|t| sin(alpha_1)), with
d_2 = |t| sin(alpha_1)/sin(alpha_2 - alpha_1).
"""


@dataclass(frozen=True, eq=False, repr=False)
class TrialMaps(OneLine):
    """The estimates of a trial and the truth; arrays are `[height, width]` of view 1's panorama, read-only.

    Row 0 is at the top, columns ascend in azimuth. Missing is NaN, with the reason beside it.
    """

    key: str
    """`Trial.key`."""
    trial: Trial
    """The settings."""
    panorama_1: NDArray[np.float32]
    """View 1's panorama, grey levels of 0 .. 255."""
    panorama_2: NDArray[np.float32]
    """View 2's panorama in v1's orientation, grey levels of 0 .. 255."""
    range_m: Array
    """Estimated range from viewpoint 1, metres; NaN where `reason` is not 0."""
    true_range_m: Array
    """True range, metres; NaN where nothing is seen."""
    alpha_1: Array
    """Angle between the pixel's direction and t, radians."""
    alpha_2: Array
    """Estimated angle between t and the direction from viewpoint 2 to the point, radians; NaN: no match."""
    true_alpha_2: Array
    """True value of `alpha_2`, radians."""
    sigma_alpha_2: Array
    """Predicted standard deviation of `alpha_2`, radians; NaN where nothing is predicted. The matcher's own, or
    derived from the residuals between the views."""
    confidence: Array | None
    """The matcher's confidence, higher is more confident; None for a matcher without one."""
    reason: NDArray[np.uint8]
    """The `Reason` for a missing range; 0 where there is a range."""
    domain: Mask
    """Pixels whose errors count: the true point is visible, at least 30 degrees from the baseline."""
    visible: Mask
    """Whether view 2 sees the true point."""

    @property
    def grid(self) -> Grid:
        """The panorama's pixels."""
        return self.trial.panorama

    @property
    def valid(self) -> Mask:
        """Pixels with an estimated range."""
        return np.isfinite(self.range_m)

    @property
    def range_error_m(self) -> Array:
        """Estimated less true range, metres."""
        return self.range_m - self.true_range_m

    @property
    def alpha_2_error(self) -> Array:
        """Estimated less true alpha_2, radians."""
        return self.alpha_2 - self.true_alpha_2

    @property
    def disparity_error_px(self) -> Array:
        """The error of alpha_2 in pixels of disparity, 2 pi/width."""
        return self.alpha_2_error / self.grid.phi_pitch

    @property
    def sigma_range_m(self) -> Array:
        """Predicted standard deviation of the range, metres, to first order."""
        baseline_m = self.trial.true_motion.baseline_m
        sigma_m = sigma_of_range(self.alpha_1, self.alpha_2, self.sigma_alpha_2, baseline_m)
        return np.where(self.valid, sigma_m, np.nan)

    def to_xarray(self) -> Any:
        """The maps as an `xarray.Dataset` over `z` and `phi`, with units; errors and `sigma_range_m` among them.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        ImportError
            When xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise ImportError("to_xarray needs xarray: pip install 'omnirange[xarray]'") from None
        derived = {
            "range_error_m": ("m", "estimated less true range"),
            "disparity_error_px": ("px", "estimated less true alpha_2, in pixels of disparity"),
            "sigma_range_m": ("m", "predicted standard deviation of the range"),
        }
        maps = {
            name: (("z", "phi"), array, {"units": unit, "long_name": meaning})
            for name, (unit, meaning) in (MAPS | derived).items()
            if (array := getattr(self, name)) is not None
        }
        coordinates = {
            "phi": ("phi", self.grid.phi, {"units": "rad", "long_name": "azimuth"}),
            "z": ("z", self.grid.z, {"units": "1", "long_name": "height on the unit cylinder"}),
        }
        return xarray.Dataset(maps, coordinates, {"key": self.key, "settings": dump_toml(self.trial)})

    def _repr_html_(self) -> str:
        """The panorama and the range, seen from inside: azimuth descends to the right."""
        low, high = range_limits(self.true_range_m)
        share = float((self.valid & self.domain).sum() / max(1, self.domain.sum()))
        return html_figure(
            {
                "view 1": grey(self.panorama_1[:, ::-1]),
                f"estimated range, {low:.2g} (dark) to {high:.2g} m": coloured(self.range_m[:, ::-1], low, high),
            },
            f"trial {self.key}: {share:.1%} of the pixels that count have a range",
        )


def range_limits(range_m: Array) -> tuple[float, float]:
    """The ranges at the ends of a map's colour scale, metres: the middle 98 % of the finite ones."""
    finite = range_m[np.isfinite(range_m)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.quantile(finite, [0.01, 0.99]).tolist()
    return low, max(high, low + 1e-6)


def maps_of(outcome: Outcome) -> TrialMaps:
    """The maps of a trial that was run."""
    trial, matches = outcome.trial, outcome.matches
    first, second = outcome.panoramas
    return TrialMaps(
        key=trial.key,
        trial=trial,
        panorama_1=_locked(first.values),
        panorama_2=_locked(second.values),
        range_m=_locked(outcome.range_m),
        true_range_m=_locked(outcome.truth.range_m),
        alpha_1=_locked(outcome.reference.alpha_1),
        alpha_2=_locked(matches.alpha_2),
        true_alpha_2=_locked(outcome.reference.alpha_2),
        sigma_alpha_2=_locked(sigma_alpha_2(outcome.pair, trial.matching, matches)),
        confidence=None if matches.confidence is None else _locked(matches.confidence),
        reason=_locked(outcome.reason),
        domain=_locked(outcome.reference.domain),
        visible=_locked(outcome.truth.visible),
    )


def _locked(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.flags.writeable = False
    return view


# --- Files --------------------------------------------------------------------------------------------------------

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)
"""The exceptions that reading a missing, truncated or unrelated file raises."""


def write_maps(maps: TrialMaps, folder: Path) -> None:
    """Write `KEY.npz` into a folder, whole or not at all.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    arrays: dict[str, Any] = {name: array for name in MAPS if (array := getattr(maps, name)) is not None}
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        **arrays,
        phi=maps.grid.phi,
        z=maps.grid.z,
        baseline_m=maps.trial.true_motion.baseline_m,
        key=maps.key,
        settings=dump_toml(maps.trial),
        code=code_hash(),
    )
    write(maps_file(folder, maps.key), stream.getvalue())


def prepare_folder(folder: Path) -> Path:
    """Make the folder for the maps of a run, with a README if there is no other; returns its absolute path.

    Raises
    ------
    InputError
        When it cannot be written to.
    """
    make_folder(folder)
    readme = folder / "README.txt"
    if not os.path.lexists(readme) or is_marked(readme, _BEGINNING.encode()):
        write(readme, README)
    return folder.resolve()


def maps_file(folder: Path, key: str) -> Path:
    """The file of a trial's maps."""
    return folder / f"{key}.npz"


def has_maps(folder: Path, key: str) -> bool:
    """Whether the maps of this trial exist, are complete, and were made by the present code and libraries."""
    try:
        with maps_file(folder, key).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            stored = (str(archive["key"]), str(archive["code"]))
            return stored == (key, code_hash()) and archive.zip.testzip() is None
    except _UNREADABLE:
        return False


def is_of_present_code(file: Path) -> bool:
    """Whether a file of maps was made by the present code and libraries; quicker than `has_maps`."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return str(archive["code"]) == code_hash()
    except _UNREADABLE:
        return False


def read_maps(folder: Path, trial: Trial) -> TrialMaps | None:
    """The maps of a trial from its file; None if the present code made no such file."""
    key = trial.key
    if not has_maps(folder, key):
        return None
    try:
        with maps_file(folder, key).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: _locked(archive[name]) if name in archive.files else None for name in MAPS}
    except _UNREADABLE:
        return None
    complete = all(array is not None or name == "confidence" for name, array in arrays.items())
    return TrialMaps(key=key, trial=trial, **arrays) if complete else None  # type: ignore[arg-type]
