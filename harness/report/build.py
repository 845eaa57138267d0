"""Assembles the report: one HTML file that needs nothing else."""

from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from harness.evaluation.errors import MIN_SINE_ALPHA_1
from harness.evaluation.limit import GROSS_PX
from harness.evaluation.metric_table import METRICS
from harness.evaluation.statistics import FEW_SEEDS
from harness.pipeline.trial import Outcome
from harness.report import (
    confidence,
    curve,
    distributions,
    downloads,
    images,
    limit,
    locking,
    maps,
    measures,
    profiles,
    regions,
    steps,
    sweeps,
    theme,
    words,
)
from harness.report.curve import Curve
from harness.report.law import example
from harness.report.law.sections import sections_of
from harness.report.methods import Method, methods_of, names_of
from harness.report.sweep import Sweep, sweep_of, texts_of, values_of
from harness.report.theme import Picture
from harness.runs.run import Result
from harness.spec import dump_toml


@dataclass(frozen=True)
class Figures:
    """The panels of every figure, none where there is nothing to draw, and what their captions speak of."""

    environment: list[Picture]
    panoramas: list[Picture]
    curve: list[Picture]
    profile: list[Picture]
    rows: list[Picture]
    errors: list[Picture]
    reasons: list[Picture]
    distributions: list[Picture]
    law: list[Picture]
    search: Curve | None
    """The pixel of the figure `curve`."""
    row: profiles.Row
    """The row of the figure `profile`."""
    limit_mm: float
    """Where the maps of `errors` are clipped."""


def build_report(result: Result, failures: list[str] | None = None) -> str:
    """The report of a finished experiment as HTML text, the same for the same result.

    What is said of all trials comes from their rows. The base trial is shown in detail, once for each method.

    Parameters
    ----------
    failures
        Gets a line for each panel that could not be drawn; the page says so in its place.
    """
    planned = result.experiment.planned
    methods = methods_of(result.outcomes, planned)
    compared = names_of(result.details.trials, planned)
    compared = [each for each in compared if each.key in result.summary["comparison"]]
    trial = methods[0].outcome.trial if methods else result.details.trials[0]
    swept = sweep_of(result)
    column_deg = float(np.degrees(trial.panorama.phi_pitch))
    with theme.style() as missing:
        base = _of_base_trial(methods) if methods else {}
        over_all = _over_all_trials(result, swept, methods, column_deg)
    if failures is not None:
        failures.extend(missing)
    return template("report.html.j2").render(
        result=result,
        experiment=result.experiment,
        trial=trial,
        methods=methods,
        compared=compared,
        left_out=result.details.left_out,
        places=_places(result, methods),
        abstract=list(words.abstract(result, trial, compared)),
        overview=list(words.overview(result, swept)),
        columns=[METRICS[name] for name in words.COMPARED],
        cell=words.cell,
        varied=_varied(result),
        min_sine=MIN_SINE_ALPHA_1,
        gross_px=GROSS_PX,
        column_deg=column_deg,
        stepped=trial.matching.whole_samples,
        law=example,
        example=example.worked_example(),
        settings=words.settings(trial),
        toml=dump_toml(result.experiment),
        sweep=swept,
        surfaces=sweeps.SURFACES,
        few_seeds=len(swept.seeds) < FEW_SEEDS,
        sections=_sections(result, swept, over_all, methods),
        **base,
        **over_all,
    )


def _of_base_trial(methods: list[Method]) -> dict[str, Any]:
    """Figures, tables and numbers that are made from the pixels of the base trial."""
    reference = methods[0].outcome.reference
    figures = draw(methods)
    return {
        "figures": figures,
        "downloads": downloads.of_base_trial(methods, figures.search, figures.row),
        "toward": _azimuth_of_t(methods[0].outcome),
        "domain_px": int(reference.domain.sum()),
        "domain_share": float(reference.domain.mean()),
        "wall_px": int((reference.domain & reference.wall).sum()),
        "within": [example.within_steps(method.outcome, method.label) for method in methods],
        "regions_base": regions.of_base_trial(methods),
    }


def _over_all_trials(result: Result, swept: Sweep, methods: list[Method], column_deg: float) -> dict[str, Any]:
    """Figures and tables that are made from the rows of all trials."""
    figures = sweeps.swept_figures(swept, column_deg)
    locking_pictures, locking_data, near = locking.histograms(swept)
    region_pictures, regions_table = regions.over_trials(swept)
    found: dict[str, Any] = {
        "sure": confidence.confidences(methods),
        "swept": figures,
        "swept_key": sweeps.key_picture(swept, laws=any(each.law for each in figures)),
        "line_key": sweeps.key_picture(swept, laws=False),
        "locking": locking_pictures,
        "locking_data": locking_data,
        "near": near,
        "regions": region_pictures,
        "regions_table": regions_table,
        "measures": measures.all_measures(swept),
        "stepwise": steps.steps(swept),
        "limited": limit.limit(swept, result.summary["limit"]) if "limit" in result.summary else None,
        "failures": measures.failures(result),
        "durations": measures.durations(result),
        "findings": [],
    }
    tested = result.summary.get("law")
    if tested:
        found |= sections_of(swept, tested, column_deg)
    return found


def _sections(result: Result, swept: Sweep, over_all: dict[str, Any], methods: list[Method]) -> dict[str, str]:
    """Identifiers and titles, in the order of the page."""
    of_all = {
        "sweeps": "Errors over every axis" if swept.axes else "Errors over the range",
        "locking": "Pixel locking",
        "regions": "Errors by region",
        "measures": "All figures",
    }
    if not over_all["swept"]:
        del of_all["sweeps"]
    if over_all["stepwise"]:
        of_all["steps"] = "Whole samples and sub-pixel steps"
    if over_all["limited"]:
        of_all["limit"] = "The limit that noise sets"
    if over_all["findings"]:
        of_all = {
            "verdict": "The law of the range error, tested",
            "law-geometry": "The law: geometry alone",
            "law-images": "The law: images",
            "law-decomposition": "The law: decomposition",
        } | of_all
    of_base = {
        "comparison": "The base trial: methods compared" if swept.several else "Comparison of methods",
        "data": "From scene to filtered panorama",
        "matching": "Matching along one curve",
        "profiles": "Range profiles",
        "maps": "Range-error maps",
        "distributions": "Error distributions",
        "confidence": "Confidence",
        "law": "The law of the range error: worked example" if over_all["findings"] else "The law of the range error",
    }
    if methods and not over_all["sure"].pictures:
        del of_base["confidence"]
    last = {"failures": "Failures"} if result.summary["trials"]["failed"] else {}
    last |= {"settings": "Settings", "environment": "Provenance and durations"}
    return (of_all | of_base if swept.several else of_base | of_all) | last


def draw(methods: list[Method]) -> Figures:
    """Draw everything."""
    first = methods[0].outcome
    pixel = curve.typical_pixel(methods)
    searched = curve.with_windows(methods)
    search = curve.curve_at(searched, *pixel) if searched and pixel else None
    row = profiles.row_at(methods, profiles.main_row(methods))
    span = profiles.limits(methods, row.index)
    limit = maps.common_limit_mm(methods)
    lettered = list(zip(methods, ascii_lowercase, strict=False))
    return Figures(
        environment=[images.environment(first), images.mirror_image(first)],
        panoramas=[images.panorama(first), images.filtered(first)],
        curve=curve.cost_along_curve(searched, search) if searched and search else [],
        profile=[profiles.profile(method, row, span, letter) for method, letter in lettered],
        rows=[profiles.small_profile(methods, profiles.row_at(methods, i)) for i in profiles.other_rows(methods)],
        errors=[maps.error_map(method, limit, letter) for method, letter in lettered],
        reasons=[maps.reason_map(methods[0])],
        distributions=[
            *distributions.cumulative(methods),
            distributions.signed(methods, "(c) signed disparity, walls", wall=True),
            distributions.signed(methods, "(d) signed disparity, floor and ceiling", wall=False),
        ],
        law=[example.law_chart(), example.measured_chart(methods)],
        search=search,
        row=row,
        limit_mm=limit,
    )


def template(name: str) -> Template:
    """A template of a whole page; its figures and tables are numbered from 1."""
    environment = Environment(
        loader=PackageLoader("harness.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = words.figure
    environment.filters["symbols"] = words.symbols
    return environment.get_template(name)


def _azimuth_of_t(outcome: Outcome) -> float | None:
    """Where on view 1's panorama the second viewpoint lies, degrees; None straight above or below."""
    x, y, _ = outcome.curves.t
    level = np.hypot(x, y) > 1e-9 * np.linalg.norm(outcome.curves.t)
    return float(np.degrees(np.arctan2(y, x))) if level else None


def _places(result: Result, methods: list[Method]) -> list[tuple[Method, str, str]]:
    """Each method with where its trial lies on the axes, and the trial's key."""
    return [
        (method, ", ".join(f"{key} = {value}" for key, value in place.items()), key_of_trial)
        for method in methods
        for place, key_of_trial, outcome in zip(result.places, result.details.keys, result.outcomes, strict=True)
        if outcome is method.outcome
    ]


def _varied(result: Result) -> dict[str, list[str]]:
    """The keys that vary between trials, and the values that each takes."""
    return {key: texts_of(values) for key, values in values_of(result.rows).items()}
