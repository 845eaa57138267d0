"""The explorer's data: the maps of the base trial by each method, the views, the cost, the scene."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from harness.camera.plane_images import plane_conic
from harness.camera.sensor import Sensor, field_of, lens_from_sensor
from harness.geometry.angles import Array
from harness.geometry.panorama import Grid, Panorama
from harness.geometry.pose import Motion
from harness.matching.window.column import PER_GREY
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.maps import TrialMaps, maps_of, range_limits
from harness.pipeline.trial import Outcome
from harness.report.explorer.arrays import Packed, in_steps, on_scale, pack
from harness.report.explorer.projection import STEP_PX, projection_table
from harness.report.method_styles import Method
from harness.simulation.scene_geometry import geometry_near

_MOST_PIXELS = 640_000
"""Most pixels of a panorama: a larger one cannot fit, and is not tried."""
_QUALITIES = ((1, 400_000, 0.001), (1, 400_000, 0.01), (2, 90_000, 0.01))
"""How many pixels of the panorama's rows and columns are one; how many pixels a mirror image has, which is shown
smaller if it has more; and the step of a method's ranges in parts of its usual error: the first with which all methods
fit, or else the last."""
_OCTAVE = 16
"""Steps of a standard deviation in a factor of two: it is known to 2.2 %."""
_LEAST_SIGMA_M = 1e-7
_ABSENT = -(2**15)
"""The value of a missing pixel in the images that are compared; the same as in `scripts/costs.js`."""
_LARGEST = 2047
"""The largest whole number of a pixel, as in `matching/window/column.py`."""
_SHADES_OF_GREY = 64
"""Grey levels of the images, which are for display: noise in the last bits would take a quarter of the page."""
_MOST_EDGES = 1500
"""Most edges of the scene that are shown, the longest first: a mesh has some for each of its small triangles."""
_COSTS = {"sad": "grey levels", "ssd": "grey levels²", "zncc": "1 − correlation"}
"""The costs that the page computes, with their units."""
_SHADES = 41

KNOWN, UNOCCLUDED, IN_FIELD_2, SIDEWAYS, WALL = 1, 2, 4, 8, 16
"""Bits of the map `seen`: there is a surface, view 2's ray to it is free, it is in the field of view 2, it is at least
30 degrees from the baseline, it is steep."""


@dataclass(frozen=True)
class Contents:
    """The data of the explorer's page."""

    facts: dict[str, Any]
    """Plain numbers and words, ready for JSON."""
    arrays: dict[str, Packed] = field(default_factory=dict)
    shown: tuple[Method, ...] = ()
    left_out: tuple[Method, ...] = ()
    """Methods for which the page has no room."""


def contents_of(methods: list[Method], limit_mm: float, start: tuple[int, int] | None, room: int) -> Contents | None:
    """The data of the explorer for these methods; None if not even one of them fits the page.

    Parameters
    ----------
    limit_mm
        End of the scale of range errors.
    start
        The pixel that is shown first.
    room
        Characters that all arrays may have together.
    """
    outcome = methods[0].outcome
    grid = outcome.trial.panorama
    if grid.width_px * grid.height_px > _MOST_PIXELS:
        return None
    matcher = cost_matcher(methods)
    step_m = range_step(outcome.truth.range_m)
    arrays = {"first": pack(_compared(outcome.filtered[0])), "second": pack(_compared(outcome.filtered[1]))}
    views = [_view(outcome, view, arrays) for view in (0, 1)]
    maps = [maps_of(method.outcome) for method in methods]
    shown: list[_Fitting] = []
    for every, image_pixels, part in _QUALITIES:
        arrays |= _truth(outcome, step_m, every)
        for view in (0, 1):
            arrays[f"image{view}"], views[view]["smaller"] = _image(outcome.images[view], image_pixels)
        fitting = [
            _packed(method, method_maps, step_of_method(method_maps, step_m, part), every)
            for method, method_maps in zip(methods, maps, strict=True)
        ]
        shown = _selected(fitting, room - sum(len(each.text) for each in arrays.values()))
        if len(shown) == len(methods):
            break
    if not shown:
        return None
    for number, each in enumerate(shown):
        arrays |= {f"{name}{number}": packed for name, packed in each.arrays.items()}
    facts = {
        "grid": {"rows": grid.height_px, "columns": grid.width_px, "zMax": grid.z_max, "zMin": grid.z_min},
        "every": every,
        "given": _motion(outcome.pair.motion),
        "true": _motion(outcome.trial.true_motion),
        "pose": {
            "position": list(outcome.trial.poses[0].position_m),
            "R": outcome.trial.poses[0].R_world_from_view.ravel().tolist(),
            "second": list(outcome.trial.poses[1].position_m),
        },
        "views": views,
        "steps": {
            "trueRange": step_m,
            "octave": _OCTAVE,
            "leastSigma": _LEAST_SIGMA_M,
            "grey": 1 / PER_GREY,
            "pixel": STEP_PX,
            "shade": 255 / (_SHADES_OF_GREY - 1),
        },
        "cost": _cost(matcher, grid) | {"own": own_cost(matcher, [each.method for each in shown])},
        "methods": [
            {"key": each.method.key, "label": each.method.label, "colour": each.method.colour, "step": each.step_m}
            for each in shown
        ],
        "scales": _scales([each.maps for each in shown], limit_mm),
        "edges": _edges(outcome),
        "start": list(start or (grid.height_px // 3, grid.width_px // 4)),
        "arrays": {name: [each.rows, each.columns, each.planes] for name, each in arrays.items()},
    }
    kept = tuple(each.method for each in shown)
    return Contents(facts, arrays, kept, tuple(each for each in methods if each not in kept))


def range_step(range_m: Array) -> float:
    """The step to which ranges are rounded, metres: a power of ten, at most a hundred-thousandth of the usual range."""
    known = range_m[np.isfinite(range_m)]
    return power_of_ten(1e-5 * float(np.median(known)) if known.size else 1e-5)


def step_of_method(maps: TrialMaps, least_m: float, part: float) -> float:
    """The step of a method's ranges, metres: up to a part of its median error, but not below the truth's step."""
    usual = usual_error_m(maps)
    return max(least_m, power_of_ten(part * usual)) if math.isfinite(usual) else least_m


def usual_error_m(maps: TrialMaps) -> float:
    """The median absolute error of the range, metres; infinite for a method without any."""
    error = np.abs(maps.range_error_m[np.isfinite(maps.range_error_m)])
    return float(np.median(error)) if error.size else math.inf


def power_of_ten(value: float) -> float:
    """The largest power of ten up to a value."""
    return float(10.0 ** math.floor(math.log10(max(value, 1e-12)) + 1e-9))


# --- What is compared along a curve -------------------------------------------------------------------------------


def cost_matcher(methods: list[Method]) -> WindowMatcher:
    """The matcher whose cost the page shows.

    It is the first window matcher, if the page can work out its cost, of columns at whole ones; else one of square
    windows, on the curves of the first method.
    """
    for method in methods:
        matcher = method.outcome.trial.matching
        if isinstance(matcher, WindowMatcher) and matcher.cost in _COSTS:
            return matcher.search.model_copy(update={"pitch_px": 1.0}) if matcher.kind == "column" else matcher.search
    matcher, motion = methods[0].outcome.trial.matching, methods[0].outcome.pair.motion
    sampling, _ = matcher.sampled(motion.t_v1)
    return WindowMatcher(d_min_m=matcher.d_min_m, d_max_m=matcher.d_max_m, sampling=sampling)


def own_cost(shown: WindowMatcher, methods: list[Method]) -> list[int]:
    """The indices of the methods that minimise this cost, however finely they sample it."""
    matchers = [method.outcome.trial.matching for method in methods]
    alike = {"pitch_px": shown.pitch_px} if shown.kind == "column" else {}
    return [
        number
        for number, matcher in enumerate(matchers)
        if isinstance(matcher, WindowMatcher) and matcher.search.model_copy(update=alike) == shown
    ]


def _cost(matcher: WindowMatcher, grid: Grid) -> dict[str, Any]:
    return {
        "kind": matcher.kind,
        "cost": matcher.cost,
        "unit": _COSTS[matcher.cost],
        "window": matcher.window_px,
        "sampling": matcher.sampling,
        "pitch": matcher.pitch_px * grid.phi_pitch,
        "dMin": matcher.d_min_m,
        "dMax": matcher.d_max_m if math.isfinite(matcher.d_max_m) else None,
    }


def _compared(panorama: Panorama) -> Array:
    """The panorama in integers of 1/PER_GREY: those that `column` compares, and fine enough for squares."""
    numbers = np.rint(np.clip(panorama.values * PER_GREY, -_LARGEST, _LARGEST))
    return np.where(panorama.valid, numbers, _ABSENT)


# --- The maps -----------------------------------------------------------------------------------------------------


def _truth(outcome: Outcome, step_m: float, every: int) -> dict[str, Packed]:
    """Maps of the truth, at every `every`-th row and column."""
    truth, expected = outcome.truth, outcome.reference
    flags = np.isfinite(truth.range_m) * KNOWN
    for bit, where in (
        (UNOCCLUDED, truth.unoccluded),
        (IN_FIELD_2, truth.in_field_2),
        (SIDEWAYS, expected.sideways),
        (WALL, expected.wall),
    ):
        flags = flags + bit * where
    # Towards viewpoint 1: the cloud leaves out surfaces that are seen from behind.
    normal = np.rint(100 * np.nan_to_num(truth.normal[::every, ::every]))
    return {
        "seen": pack(flags[::every, ::every]),
        "trueRange": pack(in_steps(truth.range_m[::every, ::every], step_m)),
        "normal": pack(np.concatenate(np.moveaxis(normal, -1, 0))),
    }


@dataclass(frozen=True)
class _Fitting:
    """A method with its maps, in memory and packed."""

    method: Method
    maps: TrialMaps
    step_m: float
    arrays: dict[str, Packed]


def _packed(method: Method, maps: TrialMaps, step_m: float, every: int) -> _Fitting:
    range_m, sigma_m = (each[::every, ::every] for each in (maps.range_m, maps.sigma_range_m))
    arrays = {
        "reason": pack(maps.reason[::every, ::every]),
        "range": pack(in_steps(range_m, step_m)),
        "sigma": pack(on_scale(sigma_m, _LEAST_SIGMA_M, _OCTAVE)),
    }
    return _Fitting(method, maps, step_m, arrays)


def _selected(methods: list[_Fitting], room: int) -> list[_Fitting]:
    """The methods that fit in `room` characters, preferring those with the smallest errors; in their order."""
    fitting = []
    for each in sorted(methods, key=lambda each: usual_error_m(each.maps)):
        size = sum(len(packed.text) for packed in each.arrays.values())
        if size <= room:
            room -= size
            fitting.append(each)
    return [each for each in methods if each in fitting]


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
    """A view's sensor; its projection goes to `arrays`, if it is not that of view 1."""
    sensor = outcome.pair.sensors[view]
    rows, columns = outcome.images[view].shape
    same = view == 1 and sensor == outcome.pair.sensors[0]
    facts: dict[str, Any] = {
        "rows": rows,
        "columns": columns,
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


def _image(image: NDArray[np.float32], most_pixels: int) -> tuple[Packed, int]:
    """A mirror image for looking at, and how many of its pixels are one, along each side."""
    smaller = math.ceil(math.sqrt(image.size / most_pixels))
    rows, columns = (side // smaller for side in image.shape)
    cut = np.clip(image[: rows * smaller, : columns * smaller], 0, 255)
    mean = cut.reshape(rows, smaller, columns, smaller).mean(axis=(1, 3)) if smaller > 1 else cut
    return pack(np.rint(mean * ((_SHADES_OF_GREY - 1) / 255))), smaller


def _lens_of(sensor: Sensor) -> dict[str, Any]:
    """The parameters of the conics that are the images of planes; empty if the images are no conics."""
    conic = plane_conic(sensor, (0.0, 0.0, 1.0))
    return {} if conic is None else {"xi": conic.xi, "lens": lens_from_sensor(sensor).ravel().tolist()}


def _edges(outcome: Outcome) -> list[list[float]]:
    """The scene's edges in the world, `[x, y, z, x, y, z]` of their ends, to the millimetre."""
    geometry = geometry_near(outcome.trial.scene, outcome.trial.poses[0].position_m)
    length = np.linalg.norm(geometry.edges[:, 1] - geometry.edges[:, 0], axis=-1)
    longest = np.sort(np.argsort(-length, kind="stable")[:_MOST_EDGES])
    ends = (geometry.edges[longest] + geometry.centre).reshape(-1, 6)
    return np.round(ends, 3).tolist()
