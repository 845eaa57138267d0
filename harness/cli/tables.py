"""Tables for the terminal."""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from harness.evaluation.metric_table import Metric

_SHOWN = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "range_rmse_m", "range_bias_m")
"""The metrics of the table that a run ends with."""
_MAIN = "range_median_abs_m"
_OF_CASES = ("density", "disparity_median_abs_px", "bad_1px", _MAIN, "range_rmse_m")
"""The metrics of the table of cases, one of them with an interval."""


def methods_table(summary: dict[str, Any]) -> "Table":
    """A table of the main figures of a run, a line for each method and surface.

    Parameters
    ----------
    summary
        As in `summary.json`.
    """
    from rich.markup import escape

    from harness.evaluation.metric_table import METRICS

    count = len(summary["comparison"])
    who = {1: "the method", 2: "both methods"}.get(count, "all methods")
    of_several = summary["trials"]["total"] > count
    which = ", the base trial" if of_several else ""
    table = _table(
        f"{escape(summary['experiment'])}{which}: errors over the pixels that {who} matched",
        caption="one trial of each method, without an interval",
    )
    names = {"pixel": "whole pixels", "subpixel": "sub-pixel"} | summary.get("labels", {})
    parts = [(where, summary[key]) for key, where in (("comparison_wall", "walls"), ("comparison", "all"))]
    columns = [METRICS[name] for name in _SHOWN]
    figures = {
        (where, method): [_figure(m[each.name], each) for each in columns]
        for where, of_part in parts
        for method, m in of_part.items()
    }
    heads = [_in_two_lines(each) for each in columns]
    room = _room_for_names(heads, figures.values()) - len("walls ")
    table.add_column("\npixels", no_wrap=True)
    table.add_column("\nmethod")
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    for where, of_part in parts:
        for method in of_part:
            table.add_row(where, escape(_in_lines(names.get(method, method), room)), *figures[where, method])
        table.add_section()
    return table


def claims_table(summary: dict[str, Any]) -> "Table":
    """A table of the paper's claims: a verdict for each, and the first line of the result.

    Parameters
    ----------
    summary
        As in `summary.json`.
    """
    from rich.markup import escape

    claims = summary["claims"]
    table = _table(f"{escape(summary['experiment'])}: the paper's claims over {claims[0]['seeds']} pairs of views")
    table.add_column("verdict", no_wrap=True)
    table.add_column("claim, and what came out [95 %]")
    for each in claims:
        because = f" ({each['because']})" if each["because"] else ""
        table.add_row(
            escape(each["verdict"]),
            f"[bold]{escape(each['claim'])}[/bold]{escape(because)}\n{escape(each['found'][0])}",
        )
    return table


def cases_table(summary: dict[str, Any]) -> "Table":
    """A table of the main figures of a run's named cases, a line for each case, and method where there are several.

    Parameters
    ----------
    summary
        As in `summary.json`.
    """
    from rich.markup import escape

    from harness.evaluation.metric_table import METRICS

    cases = summary["cases"]
    methods = {(each["matcher"], each["subpixel"]) for each in cases}
    columns = [METRICS[name] for name in _OF_CASES]
    intervals = [each[f"{_MAIN}_ci95"] for each in cases]
    between = any(each and each[0] < each[1] for each in intervals)
    without = "" if between else ", the same with every seed" if any(intervals) else ", one seed, without an interval"
    heads = [_in_two_lines(each) + (" \\[95 %]" if between and each.name == _MAIN else "") for each in columns]
    figures = [
        [
            _figure(each[column.name], column, each[f"{_MAIN}_ci95"] if between and column.name == _MAIN else None)
            for column in columns
        ]
        for each in cases
    ]
    table = _table(f"{escape(summary['experiment'])}: means over the trials of each case, all pixels{without}")
    by_method = len(methods) > 1 and not summary.get("labels")
    room = _room_for_names(heads, figures)
    for heading in ("\ncase", *(["\nmethod"] if by_method else [])):
        table.add_column(heading)
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    for each, cells in zip(cases, figures, strict=True):
        method = each["matcher"] if each["subpixel"] == "own" else f"{each['matcher']} {each['subpixel']}"
        named = [each["case"], *([method] if by_method else [])]
        table.add_row(*(escape(_in_lines(name, room // len(named))) for name in named), *cells)
    return table


def law_tables(summary: dict[str, Any]) -> Iterator["Table | Group"]:
    """The test of the law: slopes and R² by method and surface; and the best baseline for each range, where tried.

    Parameters
    ----------
    summary
        As in `summary.json`.
    """
    from rich.console import Group
    from rich.markup import escape
    from rich.text import Text

    from harness.evaluation.law import slope_verdict
    from harness.runs.methods import names_for_people

    law = summary.get("law") or {}
    fits = [fit for fit in law.get("images", ()) if fit["law"] == "exact" and fit["slope"] is not None]
    if fits:
        table = _table("slope on the law [95 %]; 1 is the law")
        for heading in ("pixels", "method"):
            table.add_column(heading, no_wrap=True)
        for heading in ("slope", "R²"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("verdict")
        names = names_for_people((fit["matcher"], fit["subpixel"]) for fit in fits)
        for fit in fits:
            method = names[fit["matcher"], fit["subpixel"]]
            table.add_row(f"{fit['surface']}s", escape(method), _slope(fit), f"{fit['r2']:.2f}", slope_verdict(fit))
        yield table
    best = [each for each in summary.get("best_baseline", ()) if each["surface"] == "wall"]
    if best:
        between = "[95 %]" if best[0]["baseline_m_ci95"] else "(one seed, without an interval)"
        title = Text(f"best baseline on walls, m {between}, of those that were tried", style="table.title")
        table = _table()
        methods = names_for_people((each["matcher"], each["subpixel"]) for each in best)
        table.add_column("range m", justify="right")
        for name in methods.values():
            table.add_column(escape(name), justify="right")
        for range_m in sorted({each["range_m"] for each in best}):
            of_method = {(each["matcher"], each["subpixel"]): each for each in best if each["range_m"] == range_m}
            cells = [_baseline(of_method.get(method)) for method in methods]
            table.add_row(f"{range_m:.1f}", *cells)
        yield Group(title, table)  # a title of the table's own would be as narrow as the table


def _slope(fit: dict[str, Any]) -> str:
    between = fit["slope_ci95"]
    return f"{fit['slope']:.2f} " + (f"\\[{between[0]:.2f}, {between[1]:.2f}]" if between else "(one seed)")


def _baseline(best: dict[str, Any] | None) -> str:
    if best is None:
        return "-"
    between = best["baseline_m_ci95"]
    ends = f" \\[{between[0]:.3g}, {between[1]:.3g}]" if between else ""
    return f"{best['baseline_m']:.3g}{ends}"


def differences_table(lines: Iterable[Sequence[str]]) -> "Table":
    """A table of the differences of two runs' main figures, in parts by step or methods, in 80 columns.

    Parameters
    ----------
    lines
        Without the run's name, see `Comparison.lines`.
    """
    from rich.markup import escape

    steps: dict[str, list[list[str]]] = {}
    for figure, step, *cells in lines:
        steps.setdefault(step, []).append([figure, *cells])
    table = _table("means over pairs; disparity and range: median |error|")
    for heading in ("figure", "first", "second", "difference [95 %]", "second is"):
        side: Literal["left", "right"] = "right" if heading in {"first", "second"} else "left"
        table.add_column(heading, justify=side, no_wrap=heading in {"figure", "first", "second"})
    width = max((len(figure) for rows in steps.values() for figure, *_ in rows), default=0)
    for step, rows in steps.items():
        for part in textwrap.wrap(step, width):
            table.add_row(f"[bold]{escape(part)}[/bold]")
        for cells in rows:
            table.add_row(*map(escape, cells))
        table.add_section()
    return table


def plain_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> "Table":
    """A table of figures, right-aligned except for the last column."""
    table = _table()
    for heading in headings:
        table.add_column(heading, justify="left" if heading == headings[-1] else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def _table(title: str | None = None, caption: str | None = None) -> "Table":
    from rich import box
    from rich.table import Table

    return Table(
        title=title, title_justify="left", caption=caption, caption_justify="left", box=box.SIMPLE_HEAD,
        show_edge=False, pad_edge=False, collapse_padding=True,
    )  # fmt: skip


def _room_for_names(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> int:
    """The characters that columns of figures leave for names on this terminal, at least a short word."""
    from rich.console import Console

    widths = [max(map(len, head.replace("\\[", "[").split("\n"))) for head in heads]
    for row in rows:
        widths = [max(width, len(cell.replace("\\[", "["))) for width, cell in zip(widths, row, strict=True)]
    return max(12, Console().width - sum(widths) - 2 * len(widths) - 3)


def _in_lines(name: str, width: int) -> str:
    """A name in lines that end at a space or after a sign such as `/`, `:` and `_`, at a hyphen only where a part would
    be longer than a line, and never inside a word.
    """
    parts = re.findall(r".*?[\s/:_.(=]+|.+", name)
    pieces = (piece for part in parts for piece in ([part] if len(part) <= width else re.findall(r".*?-+|.+", part)))
    lines = [""]
    for piece in pieces:
        if lines[-1] and len(lines[-1] + piece.rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(line.rstrip() for line in lines)


def _in_two_lines(metric: "Metric") -> str:
    """A heading in two lines: the quantity above, the statistic and the unit below."""
    statistic = metric.statistic.replace("|error|", "").strip()
    above, _, below = (
        metric.quantity.lower().partition(" ") if not statistic else (metric.quantity.lower(), "", statistic)
    )
    return f"{above}\n{f'{below} {metric.unit}'.strip()}".replace("\u00a0", " ")


def _figure(value: float | None, metric: "Metric", between: Sequence[float] | None = None) -> str:
    """A figure, with its interval where it has one."""
    if value is None:
        return "none"
    low_high = [format(metric.scale * each, metric.form) for each in between or ()]
    ends = f" \\[{', '.join(low_high)}]" if low_high else ""
    return format(metric.scale * value, metric.form) + ends
