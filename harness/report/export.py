"""The figures and tables of a report as files of their own: for papers and slides."""

from collections.abc import Iterator, Sequence
from string import ascii_lowercase

import pandas as pd

from harness.report import theme
from harness.report.build import sections_of
from harness.report.data import Table
from harness.report.section import Context, Figure, FixedTable, Section, TableBlock
from harness.runs.run import Result

FIGURE_MARK = b"<!-- omnirange -->\n"
"""How the SVG files begin; by them the PDF files beside them are known as ours as well."""


def exported(result: Result, failures: list[str] | None = None, *, may_copy: bool = False) -> list[Section]:
    """The sections of the report, their pictures drawn as PDF too: what figures and tables are taken from.

    Parameters
    ----------
    failures
        Gets a line for each figure that could not be drawn and each section that could not be made.
    may_copy
        Whether a copy of this process may make some of the sections, see `copies`.
    """
    with theme.with_pdf():
        return sections_of(Context.of(result), failures, may_copy=may_copy)


def figures_in(sections: Sequence[Section]) -> dict[str, bytes]:
    """Every panel of every figure as SVG and as PDF, by file name; the same for the same result."""
    files: dict[str, bytes] = {}
    for section in sections:
        for block in section.blocks:
            if isinstance(block, Figure):
                for name, picture in _named(block):
                    files[f"{name}.svg"] = FIGURE_MARK + picture.svg.encode()
                    files[f"{name}.pdf"] = picture.pdf
    return files


def _named(figure: Figure) -> Iterator[tuple[str, theme.Picture]]:
    """The panels that were drawn, with a name each."""
    stem = figure.id.removeprefix("figure-")
    for letter, picture in zip(ascii_lowercase, figure.pictures, strict=False):
        if not picture.failure:
            yield (f"{stem}-{letter}" if len(figure.pictures) > 1 else stem), picture


def latex_of(sections: Sequence[Section]) -> str:
    """The tables of a report as LaTeX (package booktabs), one after the other, each with its caption and a label."""
    blocks = [block for section in sections for block in section.blocks]
    tables = [_latex(each, each.table) for each in blocks if isinstance(each, TableBlock | FixedTable) and each.table]
    return "% needs \\usepackage{booktabs}\n\n" + "\n".join(tables)


def _latex(block: TableBlock | FixedTable, table: Table) -> str:
    kept = [i for i in range(len(table.headings)) if i not in table.screen_only]
    formats = "".join("l" if table.headings[i].text else "r" for i in kept)
    text: str = (
        _as_frame(table)
        .iloc[:, kept]
        .to_latex(
            index=False,
            escape=True,
            column_format=formats,
            caption=_escaped(" ".join(block.caption.striptags().split())),
            label=f"tab:{block.id.removeprefix('table-')}",
            position="htbp",
        )
    )
    return _symbols(text)


def _as_frame(table: Table) -> pd.DataFrame:
    names = [f"{each.name} ({each.unit})" if each.unit else each.name for each in table.headings]
    rows = [[f"{cell.text} {cell.below}".rstrip() for cell in row] for row in table.rows]
    return pd.DataFrame(rows, columns=pd.Index(names))


_SPECIAL = str.maketrans({each: f"\\{each}" for each in "&%$#_{}"})
_SYMBOLS = {
    "\u00a0": "~",
    "\u202f": "\\,",
    "\u2212": "$-$",
    "\u00b0": "$^\\circ$",
    "\u03b4": "$\\delta$",
    "\u03c3": "$\\sigma$",
    "\u03b1": "$\\alpha$",
    "\u03c6": "$\\varphi$",
    "\u03c0": "$\\pi$",
    "\u00d7": "$\\times$",
    "\u00b1": "$\\pm$",
    "\u00b2": "$^2$",
    "\u00b5": "$\\mu$",
    "\u00e9": "\\'e",
    "\u2013": "--",
    "\u2018": "`",
    "\u2019": "'",
    "\u201c": "``",
    "\u201d": "''",
    "\u2026": "\\ldots{}",
    "\u2264": "$\\le$",
    "\u2265": "$\\ge$",
    "\u2081": "$_1$",
    "\u2082": "$_2$",
    "|": "$|$",  # letters of the oldest encoding of fonts, which is the default, have other signs in their places
    "<": "$<$",
    ">": "$>$",
}


def _escaped(text: str) -> str:
    return text.translate(_SPECIAL)


def _symbols(text: str) -> str:
    """A text with its symbols replaced by LaTeX commands, which every engine accepts."""
    for symbol, command in _SYMBOLS.items():
        text = text.replace(symbol, command)
    return text
