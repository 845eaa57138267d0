"""Third-party maps of range or disparity: the file of each pair, the meaning of its numbers, and the ranges."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from harness.datasets.layouts.helvipad import DEPTH_STEPS, DISPARITY_STEPS, polar_of, range_of_disparity
from harness.datasets.layouts.layout import StoredPair
from harness.datasets.layouts.reading import read_array
from harness.errors import InputError
from harness.geometry.angles import Array, angle_between
from harness.geometry.triangulation import range_from_angles

Quantity = Literal["range", "inverse-range", "disparity-deg", "disparity-rad", "disparity-px", "alpha-2"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
"""`range` in metres; `inverse-range` in 1/metres; `disparity`, the angle from the zenith at the upper camera less that
at the lower one, of two upright cameras above each other; `alpha-2`, the angle between t and the point at view 2,
radians."""

SUFFIXES = (".npy", ".npz", ".png", ".tiff", ".tif")
_STEPS = {"range": DEPTH_STEPS, "disparity-deg": DISPARITY_STEPS}
"""Levels to a unit of whole numbers, as Helvipad has them."""
_UPRIGHT = 1e-6


@dataclass(frozen=True)
class Meaning:
    """The meaning of the numbers in estimates."""

    quantity: Quantity = "range"
    scale: float | None = None
    """Factor from numbers in the file to the quantity's unit; by default 1 for floating point, Helvipad's for whole
    numbers."""
    invalid: float | None = None
    """The number that stands for no estimate, beside NaN and infinity; 0 for whole numbers."""


def files_of(pair: StoredPair, folder: Path) -> Iterator[Path]:
    """Candidate files of a pair's estimate: by the pair's name, or by the path of the truth's file in its set."""
    stems = [Path(pair.name), Path(pair.name) / "range_1", Path(pair.name) / "range", Path(pair.name) / "disparity"]
    if pair.maps:
        own = pair.maps[0].file.with_suffix("")
        stems += [Path(*own.parts[-length:]) for length in range(min(4, len(own.parts) - 1), 0, -1) if length > 1]
    for stem in stems:
        for suffix in SUFFIXES:
            yield folder / stem.parent / f"{stem.name}{suffix}"


def estimate_of(pair: StoredPair, source: Path) -> Path | None:
    """The file of a pair's estimate: the source itself if it is a file, or the first that is there in a folder."""
    if source.is_file():
        return source
    return next((file for file in files_of(pair, source) if file.is_file()), None)


def read_estimate(file: Path, meaning: Meaning, pair: StoredPair) -> Array:
    """Estimated ranges on the pixels of a pair's truth, metres; NaN where there is no estimate.

    Raises
    ------
    InputError
        When the file cannot be read, has another shape than the truth, or holds a quantity that the pair cannot have.
    """
    return range_of_values(read_array(file), meaning, pair, file)


def range_of_values(raw: NDArray[Any], meaning: Meaning, pair: StoredPair, file: str | Path) -> Array:
    """Estimated ranges from the numbers of a map, as `read_estimate`.

    Parameters
    ----------
    file
        Where they are from, for messages.
    """
    if raw.ndim == 3 and 1 in (raw.shape[0], raw.shape[-1]):
        raw = raw[0] if raw.shape[0] == 1 else raw[..., 0]
    directions = pair.maps[0].directions()
    if raw.shape != directions.shape[:-1]:
        size, expected = (" x ".join(map(str, shape)) for shape in (raw.shape, directions.shape[:-1]))
        raise InputError(f"has {size} numbers, and the truth {expected}; bring it to the truth's pixels", file=file)
    if raw.dtype.kind not in "fiu":
        raise InputError(f"has numbers of the type {raw.dtype}; give floating point or whole numbers", file=file)
    values = _in_unit(raw, meaning)
    return _range_of(values, meaning.quantity, directions, pair, file)


def _in_unit(raw: NDArray[Any], meaning: Meaning) -> Array:
    whole = raw.dtype.kind in "iu"
    values = raw.astype(np.float64)
    missing = meaning.invalid if meaning.invalid is not None else 0.0 if whole else None
    values[~np.isfinite(values)] = np.nan
    if missing is not None:
        values[raw == missing] = np.nan
    scale = meaning.scale or (1 / _STEPS.get(meaning.quantity, 1.0) if whole else 1.0)
    return values * scale


def _range_of(values: Array, quantity: Quantity, directions: Array, pair: StoredPair, file: str | Path) -> Array:
    """Ranges from values of a quantity; NaN for values that give no range."""
    if quantity == "range":
        return np.where(values > 0, values, np.nan)
    if quantity == "inverse-range":
        return np.where(values > 0, 1 / np.where(values > 0, values, 1), np.nan)
    motion = pair.motion
    if quantity == "alpha-2":
        return range_from_angles(angle_between(directions, motion.t_v1), values, motion.baseline_m)
    tilted = np.abs(motion.R_v2_from_v1 - np.eye(3)).max() + np.hypot(*motion.t_v1[:2]) / motion.baseline_m
    if tilted > _UPRIGHT or motion.t_v1[2] < 0:
        raise InputError(
            "a disparity needs two cameras of one orientation, view 2 straight above view 1, which these are not; "
            "give range or alpha-2",
            file=file,
        )
    degrees = {"disparity-deg": 1.0, "disparity-rad": 180 / np.pi, "disparity-px": np.degrees(pixel_rad(pair))}
    return range_of_disparity(values * degrees[quantity], polar_of(directions), motion.baseline_m)


def pixel_rad(pair: StoredPair) -> float:
    """A pixel of disparity, radians: of a panorama its columns' pitch, else the median pitch of the map's rows."""
    camera = pair.views[0].sensor.camera
    if pair.maps[0].is_image and pair.views[0].sensor.model.goes_round(camera):
        return 2 * np.pi / camera.width_px
    x = pair.maps[0].directions()
    return float(np.nanmedian(np.linalg.norm(np.diff(x, axis=0), axis=-1)))


def suspicion(range_m: Array, truth_m: Array) -> str:
    """A suspicion that estimates are not ranges in metres, in words; empty if they look like ranges.

    By the median ratio to the truth: a thousandfold is another unit, and what falls where the range rises is none.
    """
    both = np.isfinite(range_m) & np.isfinite(truth_m)
    if both.sum() < 100:
        return ""
    estimate, truth = range_m[both], truth_m[both]
    ratio = float(np.median(estimate / truth))
    for factor, name in ((1000.0, "millimetres"), (100.0, "centimetres"), (1e-3, "kilometres")):
        if abs(ratio / factor - 1) < 0.2:
            return f"the estimates are {ratio:.3g} times the truth: they may be in {name}; see --scale"
    ranks = [np.argsort(np.argsort(each)).astype(np.float64) for each in (estimate, truth)]
    falling = float(np.corrcoef(ranks[0], ranks[1])[0, 1]) if np.ptp(estimate) > 0 else 0.0
    if falling < -0.5:
        return "the estimates fall where the range rises: they may be disparities or inverse ranges; see --as"
    return ""
