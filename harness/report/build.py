"""Assembles the report: one HTML file that needs nothing else."""

import json
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from harness.evaluation.errors import MIN_SINE_ALPHA_1
from harness.experiments.experiment import text_of
from harness.experiments.run import Result
from harness.experiments.trial import Outcome
from harness.report import curve, distributions, images, law, maps, profiles, theme, words
from harness.report.curve import Curve
from harness.report.methods import Method, methods_of
from harness.report.theme import Picture
from harness.spec import dump_toml

MOST_TRIALS = 60
"""Rows of the tables of trials; a sweep of thousands is not read on a page."""


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


def build_report(result: Result) -> str:
    """The report of a finished experiment as HTML text, the same for the same result.

    The axes may be any: the report is about the trials in detail, one of each method, and lists all trials in a table.
    """
    methods = methods_of(result.outcomes)
    outcome = methods[0].outcome
    reference = outcome.reference
    trials = _trials(result)
    with theme.style():
        figures = draw(methods)
    return _template().render(
        result=result,
        experiment=result.experiment,
        trial=outcome.trial,
        methods=methods,
        places=_places(result, methods),
        abstract=list(words.abstract(result, methods)),
        columns=words.COLUMNS,
        trials=trials,
        most_trials=MOST_TRIALS,
        varied=_varied(trials),
        figures=figures,
        min_sine=MIN_SINE_ALPHA_1,
        toward=_azimuth_of_t(outcome),
        domain_px=int(reference.domain.sum()),
        domain_share=float(reference.domain.mean()),
        wall_px=int((reference.domain & reference.wall).sum()),
        column_deg=float(np.degrees(outcome.trial.panorama.phi_pitch)),
        law=law,
        example=law.worked_example(),
        within=[law.within_steps(method.outcome, method.label) for method in methods],
        settings=words.settings(outcome.trial),
        toml=dump_toml(result.experiment),
        stages=list(dict.fromkeys(stage for each in trials for stage in each["seconds"])),
    )


def draw(methods: list[Method]) -> Figures:
    """Draw everything."""
    first = methods[0].outcome
    pixel = curve.typical_pixel(methods)
    search = curve.curve_at(first, *pixel) if pixel else None
    row = profiles.row_at(methods, profiles.main_row(methods))
    span = profiles.limits(methods, row.index)
    limit = maps.common_limit_mm(methods)
    lettered = list(zip(methods, ascii_lowercase, strict=False))
    return Figures(
        environment=[images.environment(first), images.mirror_image(first)],
        panoramas=[images.panorama(first), images.filtered(first)],
        curve=curve.cost_along_curve(first, search) if search else [],
        profile=[profiles.profile(method, row, span, letter) for method, letter in lettered],
        rows=[profiles.small_profile(methods, profiles.row_at(methods, i)) for i in profiles.other_rows(methods)],
        errors=[maps.error_map(method, limit, letter) for method, letter in lettered],
        reasons=[maps.reason_map(methods[0])],
        distributions=[
            *distributions.cumulative(methods),
            distributions.signed(methods, "(c) signed disparity, walls", wall=True),
            distributions.signed(methods, "(d) signed disparity, floor and ceiling", wall=False),
        ],
        law=[law.law_chart(), law.measured_chart(methods)],
        search=search,
        row=row,
        limit_mm=limit,
    )


def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("harness.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = words.figure
    return environment.get_template("report.html.j2")


def _azimuth_of_t(outcome: Outcome) -> float | None:
    """Where on view 1's panorama the second viewpoint lies, degrees; None straight above or below."""
    x, y, _ = outcome.whole.curves.t
    level = np.hypot(x, y) > 1e-9 * np.linalg.norm(outcome.whole.curves.t)
    return float(np.degrees(np.arctan2(y, x))) if level else None


def _places(result: Result, methods: list[Method]) -> list[tuple[Method, str]]:
    """Each method with where its trial lies on the axes."""
    return [
        (method, ", ".join(f"{key} = {value}" for key, value in place.items()))
        for method in methods
        for place, outcome in zip(result.places, result.outcomes, strict=True)
        if outcome is method.outcome
    ]


def _trials(result: Result) -> list[dict[str, Any]]:
    """Key, place, durations, and measures on all its own wall pixels, of every trial; why, of one that failed."""
    return [
        {
            "key": row.planned.key,
            "place": {key: text_of(value) for key, value in row.place.items()},
            "seconds": json.loads(row.finished.seconds),
            "walls": {
                name.removeprefix("wall_"): value
                for name, value in row.finished.figures.items()
                if name.startswith("wall_")
            },
            "failed": row.finished.message if row.state == "failed" else "",
        }
        for row in result.rows
    ]


def _varied(trials: list[dict[str, Any]]) -> dict[str, list[str]]:
    """The keys that vary between trials, and the values that each takes."""
    return {key: list(dict.fromkeys(each["place"][key] for each in trials)) for key in trials[0]["place"]}
