"""Numbers in words and cells. Every sentence follows from the numbers alone."""

from collections.abc import Iterator, Sequence
from typing import Any

from harness.camera.models import Mirror
from harness.camera.sensor import Sensor
from harness.display import counted
from harness.errors import with_article
from harness.evaluation.metric_table import Metric
from harness.evaluation.metrics import CORE
from harness.matching.interface import MatcherSettings
from harness.matching.registry import method_of
from harness.matching.window.settings import WindowMatcher
from harness.pipeline.specification import Trial
from harness.report.method_styles import Named
from harness.report.sweep import Axis, Sweep
from harness.report.typography import figure
from harness.runs.cases import CASE
from harness.runs.run import Result
from harness.spec import as_table

COMPARED = ("density", *CORE)
"""The metrics of the tables that compare methods, in the order of their columns."""


def cell(metric: Metric, measures: dict[str, Any]) -> str:
    """A figure in the metric's unit; a dash for None."""
    value = measures.get(metric.name)
    return "–" if value is None else figure(metric.scale * value, metric.form)


def abstract(result: Result, trial: Trial, methods: Sequence[Named]) -> Iterator[str]:
    """Sentences for the head of the report, about the base trial and how the methods compare on it."""
    matcher, grid = trial.matching, trial.panorama
    noise = f" and noise of σ = {trial.noise.sigma_grey:g} grey levels" if trial.noise.sigma_grey else ""
    noise += "".join(f", {each}" for each in camera_effects(trial))
    yield (
        f"Two {kind_of_image(trial.sensors)}s of {images_of(trial.sensors)}, rendered "
        f"{trial.view_2.baseline_m:g}\u00a0m apart in the scene “{trial.scene.name}” with exact truth{noise}, are "
        f"unwrapped to panoramas of {grid.width_px} × {grid.height_px} pixels and matched {_by(matcher)}."
    )
    walls, everything = result.summary["comparison_wall"], result.summary["comparison"]
    if not everything:
        yield "The comparison of the methods on it cannot be shown here."
        return
    yield from _compared("On wall pixels", walls, methods)
    yield from _compared("Over the whole domain, floor and ceiling included,", everything, methods, gross=True)


def kind_of_image(sensors: tuple[Sensor, Sensor]) -> str:
    """The term for the images: `mirror image` if both sensors have a mirror, else `image`."""
    return "mirror image" if all(isinstance(each.model, Mirror) for each in sensors) else "image"


def camera_effects(trial: Trial) -> list[str]:
    """The effects of lens and chip on an ideal image, in words."""
    chip, effects = trial.chip, []
    if any(not each.is_ideal for each in trial.lenses):
        effects.append("through a lens that is not ideal")
    if chip.saturation_e:
        effects.append(f"with shot noise (saturation capacity {chip.saturation_e:,.0f} electrons)")
    if chip.bits:
        effects.append(f"in {chip.bits} bits")
    if chip.gamma != 1:
        effects.append(f"with a gamma of {chip.gamma:g}")
    if chip.jpeg_quality:
        effects.append(f"as JPEG of quality {chip.jpeg_quality}")
    return effects


def images_of(sensors: tuple[Sensor, Sensor]) -> str:
    """The sizes of both views' images, one where they are equal, and whether the views differ in more."""
    sizes = " and ".join(dict.fromkeys(f"{each.camera.width_px} × {each.camera.height_px}" for each in sensors))
    own = what_differs(sensors)
    titles = dict.fromkeys(each.profile.title for each in sensors if each.profile is not None)
    profiles = f", of {' and '.join(map(with_article, titles))} told as a central camera," if titles else ""
    misaligned = ", whose mirrors are misaligned," if not all(each.misalignment.is_zero for each in sensors) else ""
    return f"{sizes} pixels{f', each with {own}' if own else ''}{profiles}{misaligned}"


def what_differs(sensors: tuple[Sensor, Sensor]) -> str:
    """The part that differs between the views, in words: the sensor, or a mask alone; empty if both are the same."""
    first, second = (each.model_copy(update={"mask": None}) for each in sensors)
    if first != second:
        return "a sensor of its own"
    return "a mask of its own" if sensors[0] != sensors[1] else ""


def _by(matcher: MatcherSettings) -> str:
    if isinstance(matcher, WindowMatcher):
        size = f"{matcher.window_px} × {matcher.window_px}\u00a0px"
        return f"by {matcher.cost.upper()} over {size} windows along epipolar curves"
    return f"by the matcher “{method_of(matcher)[0]}”"


def overview(result: Result, sweep: Sweep) -> Iterator[str]:
    """Sentences on the axes of a sweep, and on how many of its trials are done."""
    counts = result.summary["trials"]
    trials = counted(counts["done"], "trial")
    seeds = [f"{len(sweep.seeds)} seeds"] if len(sweep.seeds) > 1 else []
    labels = [f"“{method.label}”" if "," in method.label else method.label for method in sweep.methods]
    methods = f"method{'s' * (len(labels) != 1)}: {', '.join(labels)}"
    yield f"{'; '.join([trials, *map(_varied, sweep.axes), *seeds, methods])}."
    if counts["done"] < counts["total"]:
        failed = f", {counts['failed']} of them failed" if counts["failed"] else ""
        yield f"{counts['total'] - counts['done']} of {counts['total']} trials are missing{failed}."


def _varied(axis: Axis) -> str:
    """An axis with its values: `window: 7, 15 px`. Cases are counted: their names would not be told from each other."""
    if axis.key == CASE:
        return f"{len(axis.values)} cases"
    texts = [
        f"{value:.3g}" if isinstance(value, float) else text
        for value, text in zip(axis.values, axis.texts, strict=True)
    ]
    texts = texts if len(set(texts)) == len(texts) else axis.texts
    return f"{axis.name}: {_first_few(texts)}{f' {axis.unit}' if axis.unit else ''}"


def _first_few(texts: list[str]) -> str:
    return ", ".join(texts) if len(texts) <= 8 else f"{len(texts)} values from {texts[0]} to {texts[-1]}"


def _figure(value: float, least: float, spec: str) -> str:
    """A number as `spec` writes it; below `least`, with two significant digits."""
    return format(value, spec if value >= least else ".2g")


def _compared(where: str, measures: dict[str, Any], methods: Sequence[Named], *, gross: bool = False) -> Iterator[str]:
    named = {method.key: measures[method.key] for method in methods if method.key in measures}
    known = {key: m for key, m in named.items() if m["range_median_abs_m"] is not None}
    if not known:
        yield f"{where} nothing was matched."
        return
    density = f"density of {100 * next(iter(known.values()))['density']:.1f}\u00a0%"
    if {"pixel", "subpixel"} <= known.keys():
        pair = known["pixel"], known["subpixel"]
        of_range = _changes(*pair, "range_median_abs_m", 1000, ".0f", "the median range error", "mm")
        of_disparity = _changes(*pair, "disparity_median_abs_px", 1, ".2f", "the median disparity error", "px")
        yield f"{where} the sub-pixel step {of_range} and {of_disparity}, at a {density}."
    else:
        yield f"{where} the median absolute errors are {_errors_of(known, methods)}, at a {density}."
    if gross:
        first, last = _ends(known, methods, "bad_1px")
        shares = " and ".join(
            f"{100 * known[each.key]['bad_1px']:.0f}\u00a0% ({each.label})" for each in dict.fromkeys((first, last))
        )
        between = "between " if len(known) > 2 else ""
        yield f"There the disparity is off by more than one pixel for {between}{shares} of the estimates."


def _errors_of(known: dict[str, dict[str, Any]], methods: Sequence[Named]) -> str:
    """The median errors of the methods; of more than three those of the best and the worst."""
    shown = [each for each in methods if each.key in known]
    if len(shown) > 3:
        shown = list(_ends(known, methods, "range_median_abs_m"))
    errors = [
        f"{_figure(1000 * known[each.key]['range_median_abs_m'], 10, '.0f')}\u00a0mm of range and "
        f"{_figure(known[each.key]['disparity_median_abs_px'], 0.1, '.2f')}\u00a0px of disparity ({each.label})"
        for each in shown
    ]
    if len(known) > 3:
        return f"between {errors[0]} and {errors[1]}"
    return f"{', '.join(errors[:-1])} and {errors[-1]}" if len(errors) > 1 else errors[0]


def _ends(known: dict[str, dict[str, Any]], methods: Sequence[Named], key: str) -> tuple[Named, Named]:
    """The methods with the least and the largest value."""
    ranked = sorted((each for each in methods if each.key in known), key=lambda each: float(known[each.key][key]))
    return ranked[0], ranked[-1]


def _changes(
    before: dict[str, Any], after: dict[str, Any], key: str, scale: float, form: str, what: str, unit: str
) -> str:
    old, new = (format(scale * m[key], form) for m in (before, after))
    if old == new:
        return f"leaves {what} at {new}\u00a0{unit}"
    return f"{'lowers' if after[key] < before[key] else 'raises'} {what} from {old}\u00a0{unit} to {new}\u00a0{unit}"


UNITS = {"_m": "m", "_deg": "°", "_px": "px", "_mm": "mm", "_grey": "grey levels"}


def settings(trial: Trial) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """All settings but the scene's objects by section: name, value, unit."""
    table = as_table(trial)
    scene = table.pop("scene")
    sections = [("scene", [(key, _shown(scene[key]), "") for key in ("name", "description", "closed", "scale")])]
    sections += [(section, list(_flat(values))) for section, values in table.items() if isinstance(values, dict)]
    alone = {key: value for key, value in table.items() if not isinstance(value, dict)}
    return [*sections, ("trial", list(_flat(alone)))] if alone else sections


def _flat(values: dict[str, Any], above: str = "") -> Iterator[tuple[str, str, str]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            unit = next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")
            yield f"{above}{key}", _shown(value), unit


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.10g}".replace("-", "−")
    if isinstance(value, list):
        return f"({', '.join(_shown(each) for each in value)})"
    return str(value)
