"""The quality of confidences and predicted standard deviations on the base trial."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.evaluation.confidence import EXPECTED_WITHIN, Roc, calibration, exceeding, roc, sparsification
from harness.geometry.angles import Array
from harness.pipeline.sample import BAD_PX, confidence_map, domain_errors_px
from harness.report import theme
from harness.report.data import Data, Heading, Table, number, words
from harness.report.markup import html
from harness.report.method_styles import Method
from harness.report.section import About, Block, Context, Figure, TableBlock, section_of
from harness.report.theme import HALF, Picture

_LEAST = 100
"""Pixels of a kind for a curve to be drawn."""


_CURVES = """
How well confidence predicts the errors in {{ "the base trial" if several else "this experiment" }}, over the pixels of
the domain. (a) Sparsification: mean error of the remaining pixels as the least confident are removed; dashed, as those
with the largest errors are removed first, which no confidence can beat.
{%- if panels > 1 %} Further panels: the share of errors within multiples of the predicted standard deviation, beside
that of a normal distribution; and, where the scene has surfaces without texture, how well a threshold on confidence
removes them (pixels without a match are removed first).{% endif %}
"""
_FIGURES = """
AUSE: area between the two curves of (a), method minus oracle; also relative to the area for a random confidence. AUC:
the probability that a pixel with an error above 1 px has a lower confidence than one without; 0.5 is chance.
Within 1, 2, 3σ: share of errors within that many predicted standard deviations.
"""


@section_of(About.BASE_TRIAL, "confidence", "Confidence", needs_pixels=True)
def section(context: Context) -> Iterator[Block]:
    """Sparsification, calibration and ROC; nothing when no method gives a confidence."""
    with_confidence = confidences(context.methods)
    if with_confidence.pictures and with_confidence.table:
        caption = html(_CURVES, several=context.sweep.several, panels=len(with_confidence.pictures))
        yield Figure("figure-confidence", with_confidence.pictures, caption, data=with_confidence.data)
        yield TableBlock("table-confidence", with_confidence.table, html(_FIGURES))


@dataclass(frozen=True)
class Confidences:
    """Figures and a table; empty when no method gives a confidence."""

    pictures: list[Picture]
    table: Table | None
    data: Data | None


def confidences(methods: list[Method]) -> Confidences:
    """The figures and the table of the methods' confidences."""
    with_confidence = [
        (method, confidence) for method in methods if (confidence := confidence_map(method.outcome)) is not None
    ]
    if not with_confidence:
        return Confidences([], None, None)
    rows: list[list[Any]] = []
    pictures = [_sparsification(with_confidence, rows)]
    predicting = [method for method, _ in with_confidence if method.outcome.matches.sigma_alpha_2 is not None]
    if predicting:
        pictures.append(_calibration(predicting, rows))
    blank_rocs = _blank_walls(with_confidence)
    if blank_rocs:
        pictures.append(_roc(blank_rocs, rows, f"({'abc'[len(pictures)]}) detecting surfaces without texture"))
    data = Data("confidence", ["method", "curve", "x", "y"], rows)
    return Confidences(pictures, _table(with_confidence), data)


def _axes(title_of_x: str, title_of_y: str) -> tuple[Any, Any]:
    fig = theme.figure(HALF, 320)
    ax = theme.axes(fig, 62, 50, HALF - 76, 220)
    ax.set_xlabel(title_of_x)
    ax.set_ylabel(title_of_y)
    ax.grid(color="#E8E8E8", linewidth=0.5)
    ax.set_axisbelow(True)
    return fig, ax


def _domain_error(method: Method) -> Array:
    return domain_errors_px(method.outcome)


@theme.panel
def _sparsification(with_confidence: list[tuple[Method, Array]], rows: list[list[Any]]) -> Picture:
    fig, ax = _axes("least confident pixels left out (%)", "mean |disparity error| of the rest (px)")
    described, values = [], []
    for method, confidence in with_confidence:
        curve = sparsification(_domain_error(method), confidence)
        if not curve.pixels:
            continue
        ax.plot(100 * curve.removed, curve.remaining, color=method.colour, label=theme.plain(method.label))
        ax.plot(100 * curve.removed, curve.oracle, color=method.colour, linewidth=0.9, linestyle=(0, (3, 2)))
        for name, line in (("remaining_px", curve.remaining), ("oracle_px", curve.oracle)):
            rows += [[method.label, name, *each] for each in zip(curve.removed[::5], line[::5], strict=True)]
        values.append(curve.remaining)
        described.append(f"{method.label} from {curve.remaining[0]:.3g} to {curve.remaining[50]:.3g} px at half")
    ax.set_xlim(0, 99)
    known = np.concatenate([each[each > 0] for each in values]) if values else np.array([0.1, 1.0])
    if known.size and known.min() < known.max():
        theme.logarithmic(ax, "y", max(float(known.min()) / 1.3, float(known.max()) / 1000), 1.3 * float(known.max()))
    if described:
        theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=3)
    else:
        theme.note(ax, "no pixel has an estimate")
    shown = "; ".join(described) or "no estimate"
    alt = f"Mean absolute disparity error of the pixels that remain as the least confident are removed: {shown}."
    return theme.picture(fig, alt, "(a) sparsification (dashed: in the order of the true errors)")


@theme.panel
def _calibration(predicting: list[Method], rows: list[list[Any]]) -> Picture:
    """The distribution of |error|/sigma against that of a normal variable."""
    from scipy import stats

    fig, ax = _axes("|error| / predicted standard deviation", "share of pixels below (%)")
    x = np.linspace(0, 4, 81)
    ax.plot(x, 100 * (2 * stats.norm.cdf(x) - 1), color=theme.FAINT, linestyle=(0, (3, 2)), label="normal")
    described = []
    for method in predicting:
        outcome = method.outcome
        domain = outcome.reference.domain & outcome.valid
        error, sigma = outcome.errors.alpha_2[domain], outcome.matches.sigma_alpha_2
        scaled = np.abs(error) / sigma[domain] if sigma is not None else np.empty(0)
        scaled = np.sort(scaled[np.isfinite(scaled)])
        if not scaled.size:
            continue
        share = np.searchsorted(scaled, x, side="right") / scaled.size
        ax.plot(x, 100 * share, color=method.colour, label=theme.plain(method.label))
        rows += [[method.label, "below_sigmas", *each] for each in zip(x[::4], share[::4], strict=True)]
        described.append(f"{method.label} {100 * share[20]:.0f} % within one")
    ax.set_xlim(0, 4)
    ax.set_ylim(0, 100)
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=3)
    shares = "; ".join(described)
    alt = f"Share of errors within multiples of the predicted standard deviation, and of a normal variable: {shares}."
    return theme.picture(fig, alt, "(b) calibration of the predicted standard deviation")


def _blank_walls(with_confidence: list[tuple[Method, Array]]) -> list[tuple[Method, Roc]]:
    """ROC curves of confidence as a detector of untextured pixels; a pixel without a match has the least confidence."""
    rocs = []
    for method, confidence in with_confidence:
        outcome = method.outcome
        bare: NDArray[np.bool_] = outcome.truth.textureless
        domain = outcome.reference.domain
        if (domain & bare).sum() >= _LEAST and (domain & ~bare).sum() >= _LEAST:
            rocs.append((method, roc(np.where(outcome.valid, confidence, np.nan), bare, among=domain)))
    return rocs


@theme.panel
def _roc(blank_rocs: list[tuple[Method, Roc]], rows: list[list[Any]], title: str) -> Picture:
    fig, ax = _axes("pixels with texture left out (%)", "pixels without texture left out (%)")
    ax.plot([0, 100], [0, 100], color=theme.FAINT, linewidth=0.8, linestyle=(0, (3, 2)), label="chance")
    described = []
    for method, curve in blank_rocs:
        drawn = np.unique(np.linspace(0, curve.lost.size - 1, 300).astype(int))
        ax.plot(
            100 * curve.lost[drawn], 100 * curve.caught[drawn], color=method.colour, label=theme.plain(method.label)
        )
        thinned = drawn[::10]
        rows += [[method.label, "roc", *each] for each in zip(curve.lost[thinned], curve.caught[thinned], strict=True)]
        described.append(f"{method.label} area {curve.auc:.3f}")
    ax.set_xlim(0, 100)
    ax.set_ylim(0, 100)
    theme.legend_above(ax, *ax.get_legend_handles_labels(), gap=0.3, most=3)
    return theme.picture(fig, f"Receiver operating characteristic: {'; '.join(described)}.", title)


def _table(with_confidence: list[tuple[Method, Array]]) -> Table:
    headings = [
        Heading("Method", text=True),
        Heading("AUSE", "px"),
        Heading("AUSE, share of chance", "%"),
        Heading("AUC, error above 1\u00a0px"),
        *(
            Heading(f"within {k}σ", f"%, normal {100 * share:.1f}")
            for k, share in zip("123", EXPECTED_WITHIN, strict=True)
        ),
    ]
    rows = []
    for method, confidence in with_confidence:
        error = _domain_error(method)
        curve = sparsification(error, confidence)
        bad, among = exceeding(error, BAD_PX)
        sigma = method.outcome.matches.sigma_alpha_2
        within: list[float | None] = [None] * 3
        if sigma is not None:
            angle = error * method.outcome.trial.panorama.phi_pitch
            within = list(calibration(angle, sigma).within)
        rows.append(
            [
                words(method.label, method.colour),
                number(curve.ause, ".3f"),
                number(curve.ause_over_random, ".1f", 100),
                number(roc(confidence, bad, among=among).auc, ".3f"),
                *(number(each, ".1f", 100) for each in within),
            ]
        )
    return Table(headings, rows)
