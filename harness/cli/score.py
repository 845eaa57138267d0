"""`omnirange score`: anybody's maps of range or disparity against the truth of a data set."""

import warnings
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.exits import OK
from harness.cli.options import Commands, add_out, positive
from harness.display import counted
from harness.errors import InputError, Notice

if TYPE_CHECKING:
    from harness.api.datasets import DatasetScore

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
    import harness
    from harness.api.datasets import OF_A_SCORE, DataSet
    from harness.files import check_folder, check_no_others

    if options.out is not None:
        check_folder(options.out)
        check_no_others(options.out, OF_A_SCORE)
    data = harness.open_dataset(options.truth)
    try:
        if options.split is not None:
            data = data.part(options.split)
        if options.pair is not None:
            data = DataSet(replace(data.stored, pairs=(data[options.pair].stored,)))
    except InputError as error:
        raise InputError(error.problem, file=f"--{error.key}") from error
    score = data.score(options.estimate, options.quantity, scale=options.scale, invalid=options.invalid)
    if score.doubt:
        warnings.warn(f"{options.estimate}: {score.doubt}", Notice, stacklevel=1)
    if score.missing:
        warnings.warn(
            f"{len(score.missing)} of {len(score.pairs)} pairs have no estimate, such as {score.missing[0]}: their "
            "density counts as 0",
            Notice,
            stacklevel=1,
        )
    _show(score, options.out)
    if options.out is not None:
        score.write(options.out)
    return OK


def _show(score: "DatasetScore", out: Path | None) -> None:
    from rich.console import Console

    from harness.cli.tables import plain_table
    from harness.evaluation.metric_table import METRICS

    rows = []
    for name in _SHOWN:
        metric, values = METRICS[name], [score.figures.get(each) for each in (name, f"solid_angle_{name}")]
        cells = [_cell(value, metric.scale, metric.form) for value in values]
        rows.append([*cells, f"{metric.heading}{f', {metric.unit}' if metric.unit else ''}".replace("\u00a0", " ")])
    console = Console()
    console.print(plain_table(["pixels", "by solid angle", "figure"], rows))
    pixels = "pixels that both views see 30 degrees or more off the baseline"
    note = f"means over {counted(len(score.pairs), 'pair')}, over {pixels}"
    console.print(note, highlight=False, markup=False, soft_wrap=True)
    if out is not None:
        console.print(f"page: {out / 'score.html'}", soft_wrap=True, highlight=False, markup=False)


def _cell(value: float | None, scale: float, form: str) -> str:
    return "–" if value is None else format(scale * value, form)
