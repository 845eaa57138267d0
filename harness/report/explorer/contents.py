"""All that the explorer is given: the maps of the base trial by each method, the views, the cost, the scene."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from harness.camera.plane_images import plane_conic
from harness.camera.sensor import Sensor, field_of, lens_from_sensor
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.matching.window.column import PER_GREY
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.maps import TrialMaps, maps_of, range_limits
from harness.pipeline.trial import Outcome
from harness.report.explorer.arrays import Packed, in_steps, on_scale, pack
from harness.report.explorer.projection import STEP_PX, projection_table
from harness.report.method_styles import Method
from harness.simulation.scene_geometry import geometry_near

MOST_CHARACTERS = 2_100_000
"""What all arrays may have together: the other half of a page of at most five megabytes is the report's."""
_MOST_PIXELS = 640_000
"""What a panorama may have: a larger one cannot fit, and is not tried."""
_IMAGE_PIXELS = 400_000
"""A mirror image of more is shown smaller."""
_SQUARES_PER_GREY = 16
"""Steps in a grey level of what square windows compare."""
_OCTAVE = 32
"""Steps of a standard deviation in a factor of two: it is known to 1.1 %."""
_LEAST_SIGMA_M = 1e-7
_ABSENT = -(2**15)
"""Stands for a pixel that is not there in what is compared; `scripts/costs.js` knows it."""
_LARGEST_OF_COLUMNS = 2047
"""As of the matcher's own whole numbers."""
_MOST_EDGES = 1500
"""What is shown of the scene, the longest ones: a mesh has one for each of its small triangles."""
_COSTS = {"sad": "grey levels", "ssd": "grey levels²", "zncc": "1 − correlation"}
"""The costs that the page works out, with their units."""
_SHADES = 41

KNOWN, UNOCCLUDED, IN_FIELD_2, SIDEWAYS, WALL = 1, 2, 4, 8, 16
"""Bits of the map `seen`: there is a surface, view 2's ray to it is free, it is in the field of view 2, it is at least
30 degrees from the baseline, it is steep."""


@dataclass(frozen=True)
class Contents:
    """What the page is given."""

    facts: dict[str, Any]
    """Plain numbers and words, ready for JSON."""
    arrays: dict[str, Packed] = field(default_factory=dict)
    shown: tuple[Method, ...] = ()
    left_out: tuple[Method, ...] = ()
    """Methods for which the page has no room."""


def contents_of(methods: list[Method], limit_mm: float, start: tuple[int, int] | None) -> Contents | None:
    """What the explorer of these methods is made of; None where not even one of them fits the page.

    Parameters
    ----------
    limit_mm
        End of the scale of range errors.
    start
        The pixel that is shown first.
    """
    outcome = methods[0].outcome
    grid = outcome.trial.panorama
    if grid.width_px * grid.height_px > _MOST_PIXELS:
        return None
    compared = _compared(methods)
    step_m = range_step(outcome.truth.range_m)
    arrays = _common(outcome, compared, step_m)
    views = [_view(outcome, view, arrays) for view in (0, 1)]
    room = MOST_CHARACTERS - sum(len(each.text) for each in arrays.values())
    shown: list[Method] = []
    maps: list[TrialMaps] = []
    for method in methods:
        its = maps_of(method.outcome)
        own = _of_method(its, step_m, len(shown))
        size = sum(len(each.text) for each in own.values())
        if size <= room:
            room -= size
            arrays |= own
            shown.append(method)
            maps.append(its)
    if not shown:
        return None
    facts = {
        "grid": {"rows": grid.height_px, "columns": grid.width_px, "zMax": grid.z_max, "zMin": grid.z_min},
        "given": _motion(outcome.pair.motion),
        "true": _motion(outcome.trial.true_motion),
        "pose": {
            "position": list(outcome.trial.poses[0].position_m),
            "R": outcome.trial.poses[0].R_world_from_view.ravel().tolist(),
            "second": list(outcome.trial.poses[1].position_m),
        },
        "views": views,
        "steps": {
            "range": step_m,
            "octave": _OCTAVE,
            "leastSigma": _LEAST_SIGMA_M,
            "grey": compared.step_grey,
            "pixel": STEP_PX,
        },
        "cost": compared.facts,
        "methods": [{"key": each.key, "label": each.label, "colour": each.colour} for each in shown],
        "scales": _scales(maps, limit_mm),
        "edges": _edges(outcome),
        "start": list(start or (grid.height_px // 3, grid.width_px // 4)),
        "arrays": {name: [each.rows, each.columns, each.planes] for name, each in arrays.items()},
    }
    return Contents(facts, arrays, tuple(shown), tuple(each for each in methods if each not in shown))


def range_step(range_m: Array) -> float:
    """The step to which ranges are rounded, metres: a power of ten, at most a hundred-thousandth of the usual range."""
    known = range_m[np.isfinite(range_m)]
    usual = float(np.median(known)) if known.size else 1.0
    return float(10.0 ** (math.floor(math.log10(max(usual, 1e-9))) - 5))


# --- What is compared along a curve -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Compared:
    """The cost that the page works out, and the images that it needs."""

    facts: dict[str, Any]
    first: Array
    second: Array
    """`[height, width]`: whole numbers of `step_grey`, or `_ABSENT`."""
    step_grey: float


def cost_matcher(methods: list[Method]) -> tuple[WindowMatcher, list[int]]:
    """The matcher whose cost the page shows, and the methods whose own cost that is.

    That of the first window matcher, if the page can work it out, of columns at whole ones; else that of square
    windows, on the curves of the first method.
    """
    for method in methods:
        matcher = method.outcome.trial.matching
        if isinstance(matcher, WindowMatcher) and matcher.cost in _COSTS:
            own = matcher.search
            its = [each.outcome.trial.matching for each in methods]
            same = [isinstance(other, WindowMatcher) and other.search == own for other in its]
            whole = own.model_copy(update={"pitch_px": 1.0}) if own.kind == "column" else own
            return whole, np.flatnonzero(same).tolist()
    matcher, motion = methods[0].outcome.trial.matching, methods[0].outcome.pair.motion
    sampling, _ = matcher.sampled(motion.t_v1)
    return WindowMatcher(d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m, sampling=sampling), []


def _compared(methods: list[Method]) -> _Compared:
    matcher, own = cost_matcher(methods)
    filtered = methods[0].outcome.filtered
    largest = max(float(np.abs(each.values).max(initial=0.0)) for each in filtered)
    if matcher.kind == "column":
        step, most = 1 / PER_GREY, _LARGEST_OF_COLUMNS  # that matcher's own whole numbers
    else:
        # Finer than anything that shows, and within 16 bits.
        step, most = max(1 / _SQUARES_PER_GREY, 2.0 ** math.ceil(math.log2(max(largest, 1e-9) / 2**15))), 2**15 - 1
    first, second = (
        np.where(each.valid, np.rint(np.clip(each.values / step, -most, most)), _ABSENT) for each in filtered
    )
    facts = {
        "kind": matcher.kind,
        "cost": matcher.cost,
        "unit": _COSTS[matcher.cost],
        "window": matcher.window_px,
        "sampling": matcher.sampling,
        "pitch": matcher.pitch_px * filtered[0].grid.phi_pitch,
        "dMin": matcher.d_min_m,
        "dMax": matcher.d_max_m if math.isfinite(matcher.d_max_m) else None,
        "own": own,
    }
    return _Compared(facts, first, second, step)


# --- The maps -----------------------------------------------------------------------------------------------------


def _common(outcome: Outcome, compared: _Compared, step_m: float) -> dict[str, Packed]:
    """What all methods share."""
    truth, expected = outcome.truth, outcome.reference
    seen = np.isfinite(truth.range_m) * KNOWN
    for bit, where in (
        (UNOCCLUDED, truth.unoccluded),
        (IN_FIELD_2, truth.in_field_2),
        (SIDEWAYS, expected.sideways),
        (WALL, expected.wall),
    ):
        seen = seen + bit * where
    # Towards viewpoint 1: the cloud leaves out what is seen from behind.
    normal = np.rint(100 * np.nan_to_num(truth.normal))
    return {
        "seen": pack(seen),
        "trueRange": pack(in_steps(truth.range_m, step_m)),
        "normal": pack(np.concatenate(np.moveaxis(normal, -1, 0))),
        "first": pack(compared.first),
        "second": pack(compared.second),
    }


def _of_method(maps: TrialMaps, step_m: float, number: int) -> dict[str, Packed]:
    return {
        f"reason{number}": pack(maps.reason),
        f"range{number}": pack(in_steps(maps.range_m, step_m)),
        f"sigma{number}": pack(on_scale(maps.sigma_range_m, _LEAST_SIGMA_M, _OCTAVE)),
    }


def _scales(maps: list[TrialMaps], limit_mm: float) -> dict[str, Any]:
    """The ends of the layers' scales, and their colours."""
    low, high = range_limits(maps[0].true_range_m)
    sigmas = [each.sigma_range_m[np.isfinite(each.sigma_range_m)] for each in maps]
    largest = max((1000 * float(np.quantile(each, 0.9)) for each in sigmas if each.size), default=1.0)
    return {
        "range": {"low": low, "high": high, "colours": _shades("viridis_r", 0, 1)},
        "error": {"low": -limit_mm, "high": limit_mm, "colours": _shades("RdBu_r", 0.02, 0.98)},
        "sigma": {"low": 0, "high": rounded_up(largest), "colours": _shades("cividis", 0, 1)},
    }


def rounded_up(value: float) -> float:
    """The next of 1, 2, 3, 5, 10, 20 ... times a power of ten."""
    size = 10.0 ** math.floor(math.log10(max(value, 1e-3)))
    return float(size * next(step for step in (1, 2, 3, 5, 10) if value <= step * size * (1 + 1e-9)))


def _shades(name: str, low: float, high: float) -> list[str]:
    return [to_hex(colour) for colour in colormaps[name](np.linspace(low, high, _SHADES))]


# --- Views and scene ----------------------------------------------------------------------------------------------


def _motion(motion: Motion) -> dict[str, list[float]]:
    return {"R": motion.R_v2_from_v1.ravel().tolist(), "t": motion.t_v1.tolist()}


def _view(outcome: Outcome, view: int, arrays: dict[str, Packed]) -> dict[str, Any]:
    """A view's sensor; its image and projection go to `arrays`, the latter only if it is not that of view 1."""
    sensor = outcome.pair.sensors[view]
    image = np.clip(np.rint(outcome.images[view]), 0, 255)
    rows, columns = image.shape
    smaller = math.ceil(math.sqrt(image.size / _IMAGE_PIXELS))
    if smaller > 1:
        cut = image[: rows // smaller * smaller, : columns // smaller * smaller]
        image = np.rint(cut.reshape(rows // smaller, smaller, columns // smaller, smaller).mean(axis=(1, 3)))
    arrays[f"image{view}"] = pack(image)
    same = view == 1 and sensor == outcome.pair.sensors[0]
    facts: dict[str, Any] = {
        "rows": rows,
        "columns": columns,
        "smaller": smaller,
        "title": sensor.model.title,
        "field": list(field_of(sensor)),
        "table": 0 if same else view,
        **_lens_of(sensor),
    }
    if not same:
        table = projection_table(sensor)
        for name, values in zip("uv", np.moveaxis(table.pixels, -1, 0), strict=True):
            arrays[f"{name}{view}"] = pack(np.rint(values / STEP_PX))
        facts |= {"frame": table.frame.ravel().tolist(), "thetaMax": table.theta_max}
    return facts


def _lens_of(sensor: Sensor) -> dict[str, Any]:
    """What tells the kind of conic that planes are seen as; nothing where they are seen as none."""
    conic = plane_conic(sensor, (0.0, 0.0, 1.0))
    return {} if conic is None else {"xi": conic.xi, "lens": lens_from_sensor(sensor).ravel().tolist()}


def _edges(outcome: Outcome) -> list[list[float]]:
    """The scene's edges in the world, `[x, y, z, x, y, z]` of their ends, to the millimetre."""
    geometry = geometry_near(outcome.trial.scene, outcome.trial.poses[0].position_m)
    length = np.linalg.norm(geometry.edges[:, 1] - geometry.edges[:, 0], axis=-1)
    longest = np.sort(np.argsort(-length, kind="stable")[:_MOST_EDGES])
    ends = (geometry.edges[longest] + geometry.centre).reshape(-1, 6)
    return np.round(ends, 3).tolist()
