"""Writes `generated/settings.md` before the build: what `omnirange settings` says, as a list that fits a phone."""

from itertools import groupby
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from harness.runs.settings_reference import Setting, find_settings


def markdown() -> str:
    """A heading for each table of an experiment, and an entry for each key."""
    parts, plain = [], ["## Keys outside of tables\n"]
    for table, group in groupby(find_settings(None), lambda each: each.key.partition(".")[0]):
        entries = list(group)
        if len(entries) == 1:
            plain.append(_entry(entries[0]))
        else:
            parts += [f"## {table}\n", *map(_entry, entries)]
    return "\n".join(parts + plain)


def _entry(setting: Setting) -> str:
    default = "" if setting.default in ("", "required") else f"default `{setting.default}`"
    kinds = ", ".join(setting.kinds)
    facts = [
        setting.type + (f", {setting.unit}" if setting.unit and setting.unit not in setting.type else ""),
        default or setting.default,
        f"only for {kinds}" if kinds else "",
    ]
    return f"`{setting.key}`\n: {setting.meaning}\n\n  *{'; '.join(each for each in facts if each)}*\n"


def write(app: Sphinx) -> None:
    """Write the list; an unchanged file is left alone."""
    file = Path(app.srcdir) / "generated" / "settings.md"
    file.parent.mkdir(exist_ok=True)
    text = markdown()
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        file.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write before pages are read."""
    app.connect("builder-inited", write)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
