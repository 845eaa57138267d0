"""`omnirange score`: anybody's maps of range or disparity against the truth of a data set."""

import csv
import io
import json
import warnings
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness import interrupts
from harness.cli import completers
from harness.cli.exits import OK
from harness.cli.options import Commands, add_out, positive
from harness.errors import InputError, Notice

if TYPE_CHECKING:
    from harness.datasets.scoring import Score

_QUANTITIES = ("range", "inverse-range", "disparity-deg", "disparity-rad", "disparity-px", "alpha-2")
_SHOWN = (
    "density",
    "range_median_abs_m",
    "range_mae_m",
    "range_rmse_m",
    "range_bias_m",
    "range_abs_rel",
    "range_delta_1.1",
    "disparity_median_abs_px",
    "disparity_rmse_px",
    "bad_1px",
)


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "score",
        run,
        brief="score anybody's maps of range or disparity on a data set",
        description="Compare maps of range or disparity, made by any program, with the truth of a data set, and print "
        "the figures; with --out write them with a page.",
        epilog="An estimate lies at the pair's name (test/00003/001.npy), or as the truth's file lies in its set. NPY, "
        "NPZ, PNG of 16 bits and TIFF are read, on the truth's own pixels.",
    )
    estimate = command.add_argument("estimate", type=Path, metavar="ESTIMATE", help="a folder of maps, or one map")
    completers.offer(estimate, completers.files())
    truth = command.add_argument("--truth", type=Path, required=True, metavar="DIR", help="the data set")
    completers.offer(truth, completers.folders)
    command.add_argument(
        "--as", dest="quantity", choices=_QUANTITIES, default="range", help="what the numbers are (range, in metres)"
    )
    command.add_argument(
        "--scale",
        type=positive,
        metavar="S",
        help="a number in the file times S is in that unit (1; of whole numbers 1/256 m and 1/2048 degree)",
    )
    command.add_argument(
        "--invalid", type=float, metavar="V", help="the number that means no estimate, beside NaN (0 in whole numbers)"
    )
    command.add_argument("--split", metavar="PART", help="score this part of the set only: train, val or test")
    command.add_argument("--pair", metavar="NAME", help="score this pair only")
    add_out(command, "folder for score.json, scores.csv, parts.csv and score.html")


def run(options: Namespace) -> int:
    """Score every pair, print the figures, and write the files."""
    from harness.datasets.checks.check import open_set
    from harness.datasets.estimates import Meaning, estimate_of, read_estimate, suspicion
    from harness.datasets.scoring import mean_of, mean_of_regions, nothing_for, score_pair, true_ranges

    data = open_set(options.truth)
    pairs = [pair for pair in data.pairs if pair.maps]
    pairs = _chosen(pairs, options.split, options.pair)
    source = options.estimate
    if not source.exists():
        raise InputError("there is no such file or folder", file=str(source))
    if source.is_file() and len(pairs) > 1:
        raise InputError(f"is one map, and the set has {len(pairs)} pairs; give --pair NAME, or a folder", file=source)
    meaning = Meaning(options.quantity, options.scale, options.invalid)
    files = {pair.name: estimate_of(pair, source) for pair in pairs}
    missing = [name for name, file in files.items() if file is None]
    if len(missing) == len(pairs):
        raise InputError(
            f"has no estimate of any pair; that of the first may be {source / pairs[0].name}.npy", file=source
        )
    scores: list[Score] = []
    for pair in pairs:
        interrupts.check()
        file = files[pair.name]
        if file is None:
            scores.append(nothing_for(pair))
            continue
        range_m = read_estimate(file, meaning, pair)
        if not scores and (doubt := suspicion(range_m, true_ranges(pair))):
            warnings.warn(f"{file}: {doubt}", Notice, stacklevel=1)
        scores.append(score_pair(pair, range_m))
    if missing:
        warnings.warn(
            f"{len(missing)} of {len(pairs)} pairs have no estimate, such as {missing[0]}: their density counts as 0",
            Notice,
            stacklevel=1,
        )
    summary = mean_of([each.measures for each in scores])
    parts = mean_of_regions(scores)
    _show(summary, len(scores) - len(missing), options)
    if options.out is not None:
        _write(options, scores, summary, parts)
    return OK


def _chosen(pairs: "list[Any]", split: str | None, name: str | None) -> "list[Any]":
    """The pairs that are asked for."""
    if split is not None:
        splits = sorted({pair.split for pair in pairs} - {""})
        if split not in splits:
            raise InputError(f"no pair is in '{split}'; there are {', '.join(splits) or 'no parts'}", file="--split")
        pairs = [pair for pair in pairs if pair.split == split]
    if name is not None:
        from harness.errors import nearest

        names = [pair.name for pair in pairs]
        if name not in names:
            raise InputError(f"there is no pair '{name}'; {nearest(name, names[:20])}", file="--pair")
        pairs = [pair for pair in pairs if pair.name == name]
    if not pairs:
        raise InputError("the set has no pair with a map of truth", file="--truth")
    return pairs


def _show(summary: dict[str, float | None], pairs: int, options: Namespace) -> None:
    from rich.console import Console

    from harness.cli.tables import plain_table
    from harness.evaluation.metric_table import METRICS

    rows = []
    for name in _SHOWN:
        metric, weighted = METRICS[name], summary.get(f"solid_angle_{name}")
        cells = [_cell(value, metric.scale, metric.form) for value in (summary.get(name), weighted)]
        rows.append([*cells, f"{metric.heading}{f', {metric.unit}' if metric.unit else ''}".replace("\u00a0", " ")])
    console = Console()
    console.print(plain_table(["pixels", "by solid angle", "figure"], rows))
    console.print(
        f"means over {pairs} pairs, over pixels that both views see 30 degrees or more off the baseline",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    if options.out is not None:
        console.print(f"page: {options.out / 'score.html'}", soft_wrap=True, highlight=False, markup=False)


def _cell(value: float | None, scale: float, form: str) -> str:
    return "–" if value is None else format(scale * value, form)


def _write(
    options: Namespace, scores: "list[Score]", summary: dict[str, float | None], parts: list[dict[str, Any]]
) -> None:
    from harness.files import make_folder, write
    from harness.report.score_page import build_page
    from harness.version import __version__

    make_folder(options.out)
    table = {
        "estimate": str(options.estimate),
        "truth": str(options.truth),
        "as": options.quantity,
        "pairs": len(scores),
        "omnirange": __version__,
        "figures": summary,
        "parts": parts,
    }
    write(options.out / "score.json", json.dumps(table, indent=2, ensure_ascii=False) + "\n")
    write(options.out / "scores.csv", _csv([{"pair": each.pair.name, **each.measures} for each in scores]))
    write(options.out / "parts.csv", _csv(parts))
    page = build_page(scores, summary, parts, estimate=str(options.estimate), truth=str(options.truth))
    write(options.out / "score.html", page)


def _csv(rows: list[dict[str, Any]]) -> str:
    stream = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if value is None else value for name, value in row.items()} for row in rows)
    return stream.getvalue()
