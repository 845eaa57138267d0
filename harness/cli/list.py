"""`omnirange list`, and `omnirange` by itself: the shipped experiments, scenes, sensors, matchers and camera models."""

import shutil
import textwrap
from argparse import Namespace
from collections.abc import Mapping

from harness import shipped
from harness.cli.options import Commands

_WIDEST = 120


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    commands.add(
        "list",
        run,
        brief="list the shipped experiments, scenes, sensors and data sets, the matchers and the camera models",
        description="Print a line about each shipped experiment, scene, sensor, data set, matcher and camera model.",
    )


def run(_options: Namespace) -> None:
    """Print the lists, and how to use their entries."""
    from harness.camera.models import MODELS
    from harness.matching.registry import BUILT_IN

    matchers = {kind: matcher.briefs.get(kind, "") for kind, matcher in BUILT_IN.items()}
    sections = (
        ("experiments", "omnirange run NAME", shipped.descriptions("experiments")),
        ("scenes", "--set scene=NAME", shipped.descriptions("scenes")),
        ("sensors", "--set sensor=NAME", shipped.descriptions("sensors")),
        ("data sets", "omnirange dataset NAME --out DIR", shipped.descriptions("datasets")),
        ("matchers", "--set matching.kind=NAME", matchers),
        ("camera models", "sensor.model.kind", {kind: model.title for kind, model in MODELS.items()}),
    )
    indent = max(len(name) for _, _, each in sections for name in each) + 4
    print("\n\n".join(_section(title, used, each, indent) for title, used, each in sections))
    print("\nomnirange run paper reproduces the paper and ends in a report; omnirange --help lists the commands")


def _section(title: str, used: str, described: Mapping[str, str], indent: int) -> str:
    width = min(_WIDEST, shutil.get_terminal_size().columns)
    lines = [
        textwrap.fill(text or "-", width, initial_indent=f"  {name}".ljust(indent), subsequent_indent=" " * indent)
        for name, text in described.items()
    ]
    return "\n".join([f"{title} ({used})", *lines])
