"""Whether a map has ranges or depths along an axis: planes tell.

On a plane the inverse range is linear in the unit direction, 1/d = m . x. Windows of the map are fitted so, with the
numbers taken as ranges, as depths along the camera's axis, as distances from its vertical axis, and as inverses. On the
quarter of the windows that fit best, which lie on planes if there are any, only the right reading is linear.
"""

from collections.abc import Iterator

import numpy as np

from harness.camera.sensor import lens_from_sensor
from harness.datasets.checks.finding import Finding, StoredSet
from harness.datasets.layouts.layout import StoredPair, TruthMap
from harness.display import counted
from harness.geometry.angles import Array

_WINDOW_PX = 13
_MOST_WINDOWS = 400
_MOST_PAIRS = 12
_DECISIVE = 0.5
"""A reading is said to be the right one where its windows fit at least twice as well."""
_QUARTILE = 25.0
_LEAST_COSINE = 0.1

READINGS = {
    "range": "the range",
    "axis": "the depth along the camera's axis, not the range",
    "level": "the distance from the camera's vertical axis, not the range",
    "inverse": "the inverse of what it should be",
}


def check_planes(data: StoredSet) -> Iterator[Finding]:
    """Whether the ranges of a set are ranges."""
    misfits = [each for pair in data.some(_MOST_PAIRS) if pair.maps and (each := misfits_of(pair))]
    if not misfits:
        return
    median = {reading: float(np.median([each[reading] for each in misfits])) for reading in READINGS}
    best = min(median, key=lambda reading: median[reading])
    if best != "range" and median[best] < _DECISIVE * median["range"]:
        yield Finding(
            "planes",
            counted(len(misfits), "pair"),
            f"the maps have {READINGS[best]}, as planes show: they are flat to {median[best]:.1e} of the range if read "
            f"so, to {median['range']:.1e} as ranges",
        )


def misfits_of(pair: StoredPair) -> dict[str, float] | None:
    """The relative misfit of planes to a pair's first map under each reading; None where no window can be fitted."""
    map_ = pair.maps[0]
    if map_.quantity == "disparity":
        return None
    values = map_.read()
    range_m = 1 / np.where(values > 0, values, np.nan) if map_.quantity == "inverse range" else values
    windows = _windows(map_, range_m)
    if windows is None:
        return None
    x, d = windows
    axis = lens_from_sensor(pair.views[0].sensor)[2] @ pair.views[0].R_view_from_map
    along, level = x @ axis, np.hypot(x[..., 0], x[..., 1])
    read = {
        "range": d,
        "axis": np.where(along > _LEAST_COSINE, d / np.maximum(along, _LEAST_COSINE), np.nan),
        "level": np.where(level > _LEAST_COSINE, d / np.maximum(level, _LEAST_COSINE), np.nan),
        "inverse": 1 / d,
    }
    if not map_.is_image:  # there is no axis, and z is no vertical
        del read["axis"], read["level"]
    misfit = {reading: _misfit(x, each) for reading, each in read.items()}
    return {reading: misfit.get(reading, np.inf) for reading in READINGS}


def _windows(map_: TruthMap, range_m: Array) -> tuple[Array, Array] | None:
    """Directions `[windows, pixels, 3]` and ranges `[windows, pixels]` of windows whose pixels all have one."""
    x = map_.directions()
    if x.ndim != 3 or min(x.shape[:2]) < _WINDOW_PX:
        return None
    ranged = np.isfinite(range_m) & (range_m > 0) & np.isfinite(x[..., 0])
    view = np.lib.stride_tricks.sliding_window_view
    step = max(2, _WINDOW_PX // 2)
    shape = (_WINDOW_PX, _WINDOW_PX)
    whole = view(ranged, shape)[::step, ::step].all(axis=(2, 3))
    row, column = np.nonzero(whole)
    if row.size < 20:
        return None
    chosen = np.linspace(0, row.size - 1, min(row.size, _MOST_WINDOWS)).astype(int)
    row, column = row[chosen] * step, column[chosen] * step
    rows = row[:, None, None] + np.arange(_WINDOW_PX)[:, None]
    columns = column[:, None, None] + np.arange(_WINDOW_PX)
    pixels = _WINDOW_PX**2
    return x[rows, columns].reshape(-1, pixels, 3), range_m[rows, columns].reshape(-1, pixels)


def _misfit(x: Array, range_m: Array) -> float:
    """The lower quartile over windows of the RMS misfit of a plane, relative to the inverse range."""
    complete = np.isfinite(range_m).all(axis=1)
    if complete.sum() < 20:
        return np.inf
    x, inverse = x[complete], 1 / range_m[complete]
    Q = np.linalg.qr(x)[0]
    fitted = np.einsum("wpk,wk->wp", Q, np.einsum("wpk,wp->wk", Q, inverse))
    rms = np.sqrt(np.mean((fitted - inverse) ** 2, axis=1)) / np.mean(inverse, axis=1)
    return float(np.percentile(rms, _QUARTILE))
