"""The command line: the only place that prints, parses arguments or exits."""

import argparse
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from harness import __version__, shipped
from harness.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

EXIT_OK, EXIT_INPUT, EXIT_INTERRUPTED = 0, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the `omnirange` command.

    Returns
    -------
    int
        0 when all went well, 2 when something given is wrong (one line on stderr says what), 130 after Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except InputError as error:
        if options.debug:
            traceback.print_exc()
        print(f"omnirange: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print("\nomnirange: interrupted; what was being written is left as it was before", file=sys.stderr)
        return EXIT_INTERRUPTED
    return EXIT_OK


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        print(f"omnirange: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(EXIT_INPUT)


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
    run.set_defaults(run=_run)

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


def _run(options: argparse.Namespace) -> None:
    # Heavy libraries are loaded here, so that --help and a mistyped name answer at once.
    from rich.console import Console

    from harness.experiments.files import make_folder, write
    from harness.experiments.run import run_experiment, write_result
    from harness.experiments.spec import load_experiment
    from harness.report.build import build_report

    console = Console()
    experiment = load_experiment(options.experiment)
    folder = options.out or Path("results") / experiment.name
    make_folder(folder)
    with _Progress(console) as progress:
        result = run_experiment(experiment, progress.update)
        progress.say("report")
        report = build_report(result)
    write_result(result, folder)
    write(folder / "report.html", report)
    console.print(_comparison(result.summary))
    console.print(f"\nreport: {folder / 'report.html'}", soft_wrap=True, highlight=False)


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
    """Trials done, the stage under way, rate and time left: a bar on a terminal, one line a trial elsewhere."""

    def __init__(self, console: "Console") -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._console = console
        self._bar = Progress(
            TextColumn("{task.description:<22}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("trials"),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task("starting", total=None)
        self._done = -1

    def __enter__(self) -> "_Progress":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, done: int, total: int, stage: str) -> None:
        self._bar.update(self._task, completed=done, total=total, description=stage)
        if not self._console.is_terminal and done != self._done:
            self._done = done
            self._console.print(f"trial {done + 1} of {total}", highlight=False)

    def say(self, stage: str) -> None:
        self._bar.update(self._task, description=stage)
        if not self._console.is_terminal:
            self._console.print(stage, highlight=False)


def _comparison(summary: dict[str, Any]) -> "Table":
    from rich import box
    from rich.table import Table

    title = f"{summary['experiment']}: errors over the pixels that both methods matched"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("\npixels", no_wrap=True)
    table.add_column("\nmethod", no_wrap=True)
    headings = ("\ndensity", "disparity\nmedian px", "bad\n> 1 px", "range\nmedian mm", "range\nRMSE mm", "range\nbias mm")
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
