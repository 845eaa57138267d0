"""`omnirange settings`: print every key of an experiment, its type, unit, default and meaning."""

import shutil
import textwrap
from argparse import Namespace
from typing import TYPE_CHECKING

from harness.cli import completers
from harness.cli.options import Commands

if TYPE_CHECKING:
    from harness.runs.settings_reference import Setting

_WIDEST = 100


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "settings",
        run,
        brief="explain the keys of an experiment",
        description="Print the reference of an experiment's settings: type, unit, default, meaning, and the kinds of "
        "matcher, object or texture that have them.",
        epilog="examples: omnirange settings matching.window_px; omnirange settings sensor.camera",
    )
    key = command.add_argument(
        "key", nargs="?", metavar="KEY", help="a key, a table or the last part of a key (default: all settings)"
    )
    completers.offer(key, completers.keys)
    command.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(options: Namespace) -> None:
    """Print the settings that the key names."""
    from harness.runs.settings_reference import find_settings, settings_markdown

    settings = find_settings(options.key)
    if options.markdown:
        print(settings_markdown(settings))
        return
    width = min(_WIDEST, shutil.get_terminal_size().columns)
    print("\n\n".join(entry(each, width) for each in settings))


def entry(setting: "Setting", width: int) -> str:
    """A setting as a paragraph of text."""
    facts = {
        "kind": ", ".join(setting.kinds),
        "type": setting.type,
        "unit": setting.unit,
        "default": setting.default,
        "meaning": setting.meaning,
    }
    lines = [
        textwrap.fill(
            text,
            width,
            initial_indent=f"    {name:<9}",
            subsequent_indent=" " * 13,
            break_long_words=False,
            break_on_hyphens=False,
        )
        for name, text in facts.items()
        if text
    ]
    return "\n".join([setting.key, *lines])
