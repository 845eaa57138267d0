"""Tables for the terminal."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.table import Table

    from harness.evaluation.metric_table import Metric

_SHOWN = ("density", "disparity_median_abs_px", "bad_1px", "range_median_abs_m", "range_rmse_m", "range_bias_m")
"""The metrics of the table that a run ends with."""


def methods_table(summary: dict[str, Any]) -> "Table":
    """A table of the main figures of a run, a line for each method and surface.

    Parameters
    ----------
    summary
        As in `summary.json`.
    """
    from rich.markup import escape

    count = len(summary["comparison"])
    who = {1: "the method", 2: "both methods"}.get(count, "all methods")
    which = ", the base trial" if summary["trials"]["total"] > count else ""
    title = f"{escape(summary['experiment'])}{which}: errors over the pixels that {who} matched"
    table = _table(title)
    table.add_column("\npixels", no_wrap=True)
    table.add_column("\nmethod", overflow="fold")  # the only column that may wrap: names can be long
    columns = _add_figures(table)
    names = {"pixel": "whole pixels", "subpixel": "sub-pixel"} | summary.get("labels", {})
    for key, where in (("comparison_wall", "walls"), ("comparison", "all")):
        for method, m in summary[key].items():
            table.add_row(
                where,
                escape(names.get(method, method)),
                *(_figure(m[each.name], each) for each in columns),
            )
        table.add_section()
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
    table = _table(f"{escape(summary['experiment'])}: means over the trials of each case")
    longest = max(len(word) for each in cases for word in each["case"].split())
    table.add_column("\ncase", min_width=longest)  # names wrap between words, and never inside one
    if len(methods) > 1:
        table.add_column("\nmethod", overflow="fold")
    columns = _add_figures(table)
    for each in cases:
        method = each["matcher"] if each["subpixel"] == "own" else f"{each['matcher']} {each['subpixel']}"
        table.add_row(
            escape(each["case"]),
            *([escape(method)] if len(methods) > 1 else []),
            *(_figure(each[column.name], METRICS[column.name]) for column in columns),
        )
    return table


def _add_figures(table: "Table") -> list["Metric"]:
    """Add the columns of the main figures."""
    from harness.evaluation.metric_table import METRICS

    columns = [METRICS[name] for name in _SHOWN]
    for each in columns:
        table.add_column(_in_two_lines(each), justify="right", no_wrap=True)
    return columns


def differences_table(lines: Iterable[Sequence[str]]) -> "Table":
    """A table of the differences of two runs' main figures, one sub-pixel step per line, in 80 columns.

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
    for step, rows in steps.items():
        if step:
            table.add_row(f"[bold]{escape(step)}[/bold]")
        for cells in rows:
            table.add_row(*map(escape, cells))
        table.add_section()
    return table


def plain_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> "Table":
    """A table of figures, right-aligned but for the last column."""
    table = _table()
    for heading in headings:
        table.add_column(heading, justify="left" if heading == headings[-1] else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def _table(title: str | None = None) -> "Table":
    from rich import box
    from rich.table import Table

    return Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True
    )


def _in_two_lines(metric: "Metric") -> str:
    """A heading in two lines: the quantity above, the statistic and the unit below."""
    statistic = metric.statistic.replace("|error|", "").strip()
    above, _, below = (
        metric.quantity.lower().partition(" ") if not statistic else (metric.quantity.lower(), "", statistic)
    )
    return f"{above}\n{f'{below} {metric.unit}'.strip()}".replace("\u00a0", " ")


def _figure(value: float | None, metric: "Metric") -> str:
    return "none" if value is None else format(metric.scale * value, metric.form)
