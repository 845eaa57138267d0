"""`omnirange design`: what range errors to expect of a rig, and which rigs reach an accuracy; nothing is rendered."""

import argparse
import math
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.exits import FAILED, OK
from harness.cli.options import Commands, add_out, positive, whole_number
from harness.cli.out_folder import check_default_page
from harness.errors import InputError
from harness.files import make_folder_of

if TYPE_CHECKING:
    from harness.api.designing import RigDescription
    from harness.design.answers import Candidate
    from harness.geometry.angles import Array

_PAGE = Path("design.html")
_DRAWS = 16
"""Pairs of images that a rig is simulated with."""
_HEADINGS = {
    "matching": "match-\ning",
    "rotation": "rota-\ntion",
    "t direction": "t's di-\nrection",
    "t length": "t's\nlength",
    "odometry": "odo-\nmetry",
    "calibration": "cali-\nbration",
    "alignment": "align-\nment",
}
"""Causes as headings of two lines."""


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "design",
        run,
        brief="the range errors to expect of a rig; the rigs that reach an accuracy",
        description="Predict the range errors of a rig by cause: noise, the matcher, and errors of the "
        "motion, the calibration and the mirror's alignment. With --accuracy, find the cheapest rigs that reach it. "
        "Nothing is rendered but for --verify.",
        epilog="Cost: 1 for a megapixel, 1 for a mirror of 60 mm across (by its area), 1 for a metre of baseline; "
        "--cost changes it. Exit code 1 where no rig reaches the accuracy.",
    )
    rig = command.add_argument(
        "rig", type=Path, nargs="?", metavar="RIG", help="TOML file of a rig (default: the default sensor on 0.5 m)"
    )
    completers.offer(rig, completers.files(".toml"))
    command.add_argument(
        "--at", type=positive, nargs="+", metavar="M", default=[1.0, 2.0, 4.0, 8.0], help="ranges, metres (1 2 4 8)"
    )
    command.add_argument(
        "--point",
        type=float,
        nargs=3,
        action="append",
        metavar=("X", "Y", "Z"),
        help="a point in view 1's frame, metres, whose error ellipsoid is printed and drawn; repeatable (default: "
        "abeam, at the ranges of --at)",
    )
    command.add_argument(
        "--accuracy", type=_accuracy, metavar="M@M", help="such as 0.03@4: 68 %% of estimates within 30 mm at 4 m"
    )
    command.add_argument("--baseline-max", type=positive, default=math.inf, metavar="M", help="longest baseline")
    command.add_argument(
        "--height-max",
        type=positive,
        default=math.inf,
        metavar="M",
        help="from the camera's centre to the mirror's rim",
    )
    command.add_argument("--width", type=whole_number, metavar="PX", help="the image's width (default: several)")
    command.add_argument(
        "--cost",
        type=_not_negative,
        nargs=3,
        metavar=("PIXELS", "MIRROR", "BASELINE"),
        help="of a megapixel, of a mirror of 60 mm, of a metre of baseline (1 1 1)",
    )
    command.add_argument("--most", type=whole_number, default=10, metavar="N", help="rigs that are listed (10)")
    command.add_argument(
        "--verify",
        type=whole_number,
        nargs="?",
        const=1,
        default=0,
        metavar="N",
        help="simulate the rig, or the first N rigs (1), and print what was measured",
    )
    add_out(command, "the page, default design.html", metavar="FILE")


def run(options: Namespace) -> int:
    """Describe a rig, or search for rigs that meet a requirement."""
    if options.out is not None and options.out.suffix.lower() not in (".html", ".htm"):
        raise InputError("must end in .html", file=options.out)
    make_folder_of(options.out)
    if options.out is None:
        check_default_page(_PAGE)
    return _describe(options) if options.accuracy is None else _find(options)


def _describe(options: Namespace) -> int:
    import harness

    described = harness.describe_rig(options.rig, options.at, _points(options))
    _print_table(described)
    _print_ellipsoids(described)
    page = options.out or _PAGE
    described.write(page)
    print(f"page: {page}")
    if options.verify:
        for each in described.answers:
            _verify([described.rig], each.range_m)
    return OK


def _print_table(described: "RigDescription") -> None:
    from rich.console import Console

    from harness.cli.tables import plain_table
    from harness.design.budget import CAUSES

    shown = [name for name in CAUSES if any(each.by_cause_m[name] > 0 for each in described.answers)]
    print(f"{described.rig.title}: 68 % of range errors are within (mm)")
    table = plain_table(
        ["range\nm", "\nall", *(_HEADINGS.get(name, f"\n{name}") for name in shown), "most of\nit by"],
        [
            [
                f"{each.range_m:g}",
                _mm(each.error_m),
                *(_mm(each.by_cause_m[name]) for name in shown),
                each.leading,
            ]
            for each in described.answers
        ],
    )
    Console().print(table)
    print()


def _points(options: Namespace) -> "list[list[float]] | None":
    """The points of `--point`, if any are given."""
    for point in options.point or ():
        if not (all(map(math.isfinite, point)) and any(point)):
            text = " ".join(f"{each:g}" for each in point)
            raise InputError(f"must be three numbers, a point other than view 1's; found {text}", key="--point")
    points: list[list[float]] | None = options.point
    return points


def _print_ellipsoids(described: "RigDescription") -> None:
    from rich.console import Console

    from harness.cli.tables import plain_table

    print("one standard deviation of the position of points: range, and semi-axes with their directions")
    rows = []
    for each in described.ellipsoids:
        coordinates = [f"{value:.4g}" for value in each.point_m + 0.0]
        if not each.is_seen:
            rows.append([*coordinates, "unseen", "", ""])
            continue
        for number, (size, direction) in enumerate(zip(each.semi_axes_m, each.directions, strict=True)):
            first = [*coordinates, _mm(each.sigma_range_m)] if number == 0 else [""] * 4
            rows.append([*first, _mm(float(size)), _direction(direction)])
    headings = ["x\nm", "y\nm", "z\nm", "range\nmm", "semi-axis\nmm", "direction\nx      y      z"]
    Console().print(plain_table(headings, rows))
    print()


def _direction(unit: "Array") -> str:
    return " ".join(f"{0.0 if abs(each) < 5e-4 else each:+6.3f}" for each in unit)


def _find(options: Namespace) -> int:
    import harness
    from harness.design.answers import Cost

    accuracy_m, range_m = options.accuracy
    rigs = harness.find_rigs(
        accuracy_m,
        range_m,
        options.rig,
        baseline_max_m=options.baseline_max,
        height_max_m=options.height_max,
        width_px=options.width,
        cost=Cost(*options.cost) if options.cost else None,
        most=options.most,
    )
    if not rigs:
        print(
            f"no rig reaches {1000 * accuracy_m:g} mm at {range_m:g} m with these uncertainties; "
            "give smaller ones, or allow a longer baseline"
        )
        return FAILED
    _print_found(rigs, accuracy_m, range_m)
    if options.out is not None:
        harness.describe_rig(rigs[0].rig, options.at, _points(options)).write(options.out)
        print(f"page of the first: {options.out}")
    if options.verify:
        _verify([each.rig for each in rigs[: options.verify]], range_m)
    return OK


def _print_found(rigs: "list[Candidate]", accuracy_m: float, range_m: float) -> None:
    from rich.console import Console

    from harness.cli.tables import plain_table
    from harness.design.answers import height_m, mirror_diameter_m

    print(f"68 % within {1000 * accuracy_m:g} mm at {range_m:g} m: the cheapest rigs")
    of_mirror = ["mirror\nmm", "height\nmm"] if rigs[0].rig.has_mirror else []
    table = plain_table(
        ["image\npx", "baseline\nm", *of_mirror, "\ncost", "error\nmm", "\nmargin", "limited\nby"],
        [
            [
                f"{each.rig.sensor.camera.width_px} x {each.rig.sensor.camera.height_px}",
                f"{each.rig.baseline_m:g}",
                *(f"{1000 * size(each.rig.sensor):.0f}" for size in (mirror_diameter_m, height_m) if of_mirror),
                f"{each.cost:.2f}",
                _mm(each.answer.error_m),
                f"{each.margin:.2f}",
                each.answer.leading,
            ]
            for each in rigs
        ],
    )
    Console().print(table)
    print()


def _verify(rigs: list, range_m: float) -> None:  # type: ignore[type-arg]
    from harness.design.verify import verify

    for rig in rigs:
        print(f"simulating {rig.title}, walls at {range_m:g} m: {_DRAWS} draws ...", file=sys.stderr, flush=True)
        result = verify(rig, range_m, draws=_DRAWS)
        print(
            f"simulated, {rig.title}, walls at {range_m:g} m and beyond: predicted {_mm(result.predicted_m)} mm, "
            f"measured {_mm(result.measured_m)} mm ({result.ratio:.2f} of it); {result.density:.1%} matched, "
            f"{result.draws} draws"
        )


def _mm(metres: float) -> str:
    return f"{1000 * metres:.3g}" if math.isfinite(metres) else "unseen"


def _accuracy(text: str) -> tuple[float, float]:
    accuracy, at, range_m = text.partition("@")
    try:
        values = (float(accuracy), float(range_m))
    except ValueError:
        values = (math.nan, math.nan)
    if not at or not all(1e-9 <= each <= 1e9 for each in values):
        raise argparse.ArgumentTypeError(f"must be like 0.03@4, an error and a range in metres; found '{text}'")
    return values


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number from 0; found '{text}'")
    return value
