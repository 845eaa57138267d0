"""The command line: the only place that prints, parses arguments or exits."""

import argparse
import json
import os
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, Self

from harness import __version__, shipped
from harness.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from harness.experiments.experiment import Experiment
    from harness.experiments.store import Finished, Foreign, Store

EXIT_OK, EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 0, 1, 2, 130
_LINE_EVERY_S = 60.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `omnirange` command.

    Returns
    -------
    int
        0 when all went well, 1 when a trial failed, 2 when something given is wrong (one line on stderr says what),
        130 after Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        return options.run(options) or EXIT_OK
    except InputError as error:
        if options.debug:
            traceback.print_exc()
        print(f"omnirange: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print("\nomnirange: interrupted; what was being written is left as it was before", file=sys.stderr)
        return EXIT_INTERRUPTED


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        print(f"omnirange: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(EXIT_INPUT)


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1; found '{text}'")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="omnirange", description="Simulation-driven evaluation of omnidirectional stereo.", allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"omnirange {__version__}")
    debug = _Parser(add_help=False)
    debug.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run",
        parents=[debug],
        allow_abbrev=False,
        help="run an experiment and write its report",
        description="Run an experiment, print its figures and write results and an HTML report into a folder.",
        epilog=f"shipped experiments: {', '.join(shipped.names('experiments'))}",
    )
    run.add_argument("experiment", metavar="EXPERIMENT", help="a shipped experiment's name, or a TOML file")
    run.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: results/NAME)")
    run.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting of the base trial; repeatable"
    )
    run.add_argument(
        "--axis", action="append", default=[], metavar="KEY=A,B,C", help="vary a setting, beside the axes; repeatable"
    )
    run.add_argument("--dry-run", action="store_true", help="say how many trials there are and how long they may take")
    run.add_argument("--no-report", action="store_true", help="leave out the summary and the report: tables only")
    where = run.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=_count, metavar="N", help="processes (default: one for each CPU, where it pays)"
    )
    where.add_argument("--dask", metavar="ADDRESS", help="run on a Dask cluster, such as tcp://127.0.0.1:8786")
    run.set_defaults(run=_run)

    report = commands.add_parser(
        "report",
        parents=[debug],
        allow_abbrev=False,
        help="write a run's report anew",
        description="Write the tables, the summary and the report of a run anew, from its folder alone.",
    )
    report.add_argument("folder", type=Path, metavar="DIR", help="output folder of a run")
    report.set_defaults(run=_report)

    compare = commands.add_parser(
        "compare",
        parents=[debug],
        allow_abbrev=False,
        help="put runs side by side",
        description="Pair the trials of runs by their settings, print how their main figures differ and write a page.",
    )
    compare.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="output folders of runs; two or more")
    compare.add_argument("--out", type=Path, metavar="FILE", help="the page (default: comparison.html in the last DIR)")
    compare.set_defaults(run=_compare)

    cache = commands.add_parser(
        "cache",
        parents=[debug],
        allow_abbrev=False,
        help="show or empty the cache of renders",
        description="Show where renders are kept between runs and how large they are. OMNIRANGE_CACHE says where, "
        "OMNIRANGE_CACHE_LIMIT_MB how much.",
    )
    cache.add_argument("--clear", action="store_true", help="remove them all")
    cache.set_defaults(run=_cache)

    render = commands.add_parser(
        "render",
        parents=[debug],
        allow_abbrev=False,
        help="render one view with its true range",
        description="Render one view of a scene into a folder that can be used without this program.",
        epilog=f"shipped scenes: {', '.join(shipped.names('scenes'))}",
    )
    render.add_argument("scene", metavar="SCENE", help="a shipped scene's name, or a TOML file")
    render.add_argument("--sensor", type=Path, metavar="FILE", help="sensor TOML (default: the paper experiment's)")
    render.add_argument(
        "--at", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help="viewpoint in the world, metres"
    )
    for angle, axis in (("yaw", "the vertical axis z"), ("pitch", "y"), ("roll", "x")):
        render.add_argument(f"--{angle}-deg", type=float, default=0.0, metavar="A", help=f"turn about {axis}, degrees")
    render.add_argument("--samples", type=int, default=16, metavar="N", help="rays per pixel, a square number (16)")
    render.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    render.set_defaults(run=_render)
    return parser


def _run(options: argparse.Namespace) -> int:
    # Heavy libraries are loaded here, so that --help and a mistyped name answer at once.
    from harness.experiments.executors import ONE_THREAD, workplace

    os.environ.update(ONE_THREAD | os.environ)  # threads are ours to deal out; read as the libraries are loaded

    from harness.experiments.experiment import load_experiment
    from harness.experiments.files import make_folder
    from harness.experiments.run import is_reported, open_run, standing, sweep

    experiment = load_experiment(options.experiment, options.set, options.axis)
    if options.dry_run:
        return _dry_run(experiment)
    folder = options.out or Path("results") / experiment.name
    make_folder(folder)
    with open_run(experiment, folder) as store:
        before = standing(experiment, store)
        _say_foreign(before.foreign)
        if before.done == before.total and is_reported(experiment, store, folder):
            print(
                f"{experiment.name}: all {before.total} trials are done and the report is made; nothing is left to do"
            )
            _show(json.loads((folder / "summary.json").read_text(encoding="utf-8")), folder)
            return EXIT_OK
        with _Progress(experiment.name, before.total, before.done) as progress:
            try:
                left = before.plan
                if left.trials:
                    place = workplace(left.total_s, len(left.trials), options.workers, options.dask)
                    progress.say(f"{len(left.trials)} trials to run {place.name}, {before.done} done before")
                    sweep(left, store, place, progress.update)
            except KeyboardInterrupt:
                progress.stop()
                after = standing(experiment, store)
                print(
                    f"\nomnirange: interrupted; {after.done} of {after.total} trials are done and kept; "
                    "run the same command to go on",
                    file=sys.stderr,
                )
                return EXIT_INTERRUPTED
            progress.finish()
        return _write(experiment, store, folder, given=options.experiment, with_report=not options.no_report)


def _dry_run(experiment: "Experiment") -> int:
    from harness.experiments.executors import cpus
    from harness.experiments.plan import plan

    whole = plan(experiment.planned)
    seconds = whole.total_s / cpus()
    print(
        f"{experiment.name}: {len(whole.trials)} trials, {whole.renders} distinct renders, "
        f"about {_duration(seconds)} on {cpus()} CPUs (a guess from the sizes of images)"
    )
    return EXIT_OK


def _report(options: argparse.Namespace) -> int:
    from harness.experiments.experiment import Experiment
    from harness.experiments.run import DATABASE, standing
    from harness.experiments.store import Store
    from harness.spec import parse

    database = options.folder / DATABASE
    if not database.is_file():
        raise InputError(f"holds no run: there is no {DATABASE} in it", file=options.folder)
    with Store(database) as store:
        experiment = parse(Experiment, store.fact("experiment"), file=database)
        now = standing(experiment, store)
        _say_foreign(now.foreign)
        if now.done < now.total:
            print(f"{experiment.name}: {now.done} of {now.total} trials are done; the report is about those")
        return _write(experiment, store, options.folder, given=options.folder)


def _compare(options: argparse.Namespace) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from harness.experiments.files import write
    from harness.report.compare import build_comparison

    comparison = build_comparison(*options.folders)
    page = options.out or options.folders[-1] / "comparison.html"
    write(page, comparison.html)
    console = Console()
    lines = list(comparison.lines())
    for pairing in comparison.pairings:
        first, second = pairing.first.name, pairing.second.name
        if pairing.why_none:
            console.print(f"{second} against {first}: {pairing.why_none}", markup=False, highlight=False)
            continue
        changed = "; ".join(f"{key}: {old} -> {new}" for key, (old, new) in pairing.differing.items())
        title = f"{second} against {first}: {pairing.pairs} pairs, {pairing.seeds} seeds; {changed or 'same settings'}"
        console.print(title, markup=False, highlight=False)
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
        for heading in ("figure", "step", "first", "second", "difference [95 %]", "second is"):
            side: Literal["left", "right"] = "right" if heading in {"first", "second"} else "left"
            table.add_column(heading, justify=side, no_wrap=heading != "figure")
        for name, *cells in lines:
            if name == second:
                table.add_row(*map(escape, cells))
        console.print(table)
    console.print(f"comparison: {page}", soft_wrap=True, highlight=False, markup=False)


def _write(
    experiment: "Experiment", store: "Store", folder: Path, *, given: str | Path, with_report: bool = True
) -> int:
    """Write everything that is made from the rows, and say what came out.

    Where no trial could be carried out because of what was `given`, that is the user's to mend, like a wrong key.
    """
    from harness.experiments.run import result_of, standing, write_result, write_tables

    write_tables(experiment, store, folder)
    now = standing(experiment, store)
    if now.done and with_report:
        from harness.report.build import build_report

        result = result_of(experiment, store)
        write_result(result, build_report(result), store, folder)
        _show(result.summary, folder)
    if not now.failed:
        return EXIT_OK
    failures = [
        row for row in store.finished(each.key for each in experiment.planned).values() if row.state == "failed"
    ]
    if len(failures) == now.total and all(row.is_refused for row in failures):
        raise InputError(failures[0].message, file=given)
    print(
        f"omnirange: {now.failed} of {now.total} trials failed; {folder / 'failures.csv'} says why, "
        "and the same command tries them again",
        file=sys.stderr,
    )
    return EXIT_FAILED


def _say_foreign(foreign: "Foreign") -> None:
    for count, why in (
        (foreign.other_code, "by other code or libraries"),
        (foreign.other_scene, "of other scenes, or of this one before it was changed"),
        (foreign.other_settings, "with other settings"),
    ):
        if count:
            print(f"{count} trials in this folder were made {why}: they are set aside, and not used")


def _show(summary: dict[str, Any], folder: Path) -> None:
    from rich.console import Console

    console = Console()
    console.print(_comparison(summary))
    console.print(f"\nreport: {folder / 'report.html'}", soft_wrap=True, highlight=False)


def _cache(options: argparse.Namespace) -> None:
    from harness.experiments.cache import RenderCache

    cache = RenderCache()
    if options.clear:
        cache.clear()
    contents = cache.contents()
    print(
        f"{cache.folder}: {contents.files} renders, "
        f"{contents.bytes / 2**20:.1f} MB of at most {cache.limit / 2**20:.0f} MB"
    )


def _render(options: argparse.Namespace) -> None:
    from harness.camera.pose import Pose
    from harness.camera.sensor import Sensor, load_sensor
    from harness.experiments.render_folder import write_render
    from harness.experiments.spec import Rendering
    from harness.simulation.scene import load_scene
    from harness.spec import parse

    scene = load_scene(str(shipped.find("scenes", options.scene)))
    sensor = load_sensor(options.sensor) if options.sensor else Sensor()
    samples = parse(Rendering, {"samples": options.samples}, file="--samples").samples
    pose = parse(
        Pose,
        {
            "position_m": options.at,
            "yaw_deg": options.yaw_deg,
            "pitch_deg": options.pitch_deg,
            "roll_deg": options.roll_deg,
        },
        file="--at",
    )
    write_render(scene, sensor, pose, options.out, samples=samples)
    print(f"{scene.name} seen from {tuple(options.at)} m: {options.out}")


class _Progress:
    """Trials done, failures, rate and time left: a bar on a terminal; elsewhere a line a minute, and one at the end."""

    def __init__(self, name: str, total: int, done: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        self._name, self._total, self._before = name, total, done
        self._done, self._failed = done, 0
        self._begun = self._said = time.monotonic()
        self._console = Console()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[pace]}"),
            console=self._console,
            disable=not self._console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task(name, total=total, completed=done, pace="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self._bar.stop()

    def say(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.print(f"{self._name}: {text}", highlight=False)

    def update(self, rows: "Sequence[Finished]") -> None:
        self._done += len(rows)
        self._failed += sum(row.state == "failed" for row in rows)
        rate = (self._done - self._before) / max(time.monotonic() - self._begun, 1e-9)
        failed = f", {self._failed} failed" if self._failed else ""
        pace = f"{failed.lstrip(', ')} {rate:.1f}/s, {_duration((self._total - self._done) / rate)} left".lstrip()
        self._bar.update(self._task, completed=self._done, pace=pace)
        if not self._console.is_terminal and time.monotonic() - self._said > _LINE_EVERY_S:
            self._said = time.monotonic()
            print(f"{self._name}: {self._done} of {self._total} trials{failed}, {pace}", flush=True)

    def finish(self) -> None:
        ran = self._done - self._before
        self.stop()
        if not ran:
            print(f"{self._name}: all {self._total} trials are done")
            return
        seconds = time.monotonic() - self._begun
        failed = f", {self._failed} of them failed" if self._failed else ""
        before = f", {self._before} done before" if self._before else ""
        print(
            f"{self._name}: {ran} of {self._total} trials run{failed}, in {_duration(seconds)} "
            f"({ran / seconds:.1f} trials/s){before}",
            flush=True,
        )


def _duration(seconds: float) -> str:
    if seconds < 99.5:
        return f"{seconds:.3g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _comparison(summary: dict[str, Any]) -> "Table":
    from rich import box
    from rich.table import Table

    title = f"{summary['experiment']}: errors over the pixels that both methods matched"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("\npixels", no_wrap=True)
    table.add_column("\nmethod", no_wrap=True)
    headings = (
        "\ndensity",
        "disparity\nmedian px",
        "bad\n> 1 px",
        "range\nmedian mm",
        "range\nRMSE mm",
        "range\nbias mm",
    )
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for key, where in (("comparison_wall", "walls"), ("comparison", "all")):
        for method, m in summary[key].items():
            table.add_row(
                where,
                {"subpixel": "sub-pixel"}.get(method, method),
                _figure(m["density"], 100, "{:.1f} %"),
                _figure(m["disparity_median_abs_px"], 1, "{:.3f}"),
                _figure(m["bad_1px"], 100, "{:.1f} %"),
                _figure(m["range_median_abs_m"], 1000, "{:.1f}"),
                _figure(m["range_rmse_m"], 1000, "{:.1f}"),
                _figure(m["range_bias_m"], 1000, "{:+.1f}"),
            )
        table.add_section()
    return table


def _figure(value: float | None, scale: float, form: str) -> str:
    return "none" if value is None else form.format(scale * value)
