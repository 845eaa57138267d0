"""What a run's folder still holds of earlier trials, which nothing of the present run replaces."""

import hashlib
import re
from collections.abc import Collection
from pathlib import Path

from harness.display import counted
from harness.pipeline import maps
from harness.runs import path_maps

COMPARISON = "comparison.html"
"""The page that `omnirange compare` writes into the folder of the last run that it is given."""
_MARK_BYTES = 2000
"""The page's first bytes, in which it says of which tables it is."""


def of_earlier_trials(folder: Path, keys: Collection[str]) -> list[str]:
    """What is in a run's folder that does not belong to its tables, in words.

    None of it is removed: maps take long to make, and trials that are run again find theirs; a comparison was asked
    for, and the other run may be gone.

    Parameters
    ----------
    folder
        With its tables written.
    keys
        The keys of the run's trials.
    """
    said = [COMPARISON] if _is_of_other_tables(folder) else []
    for name, files in (
        (maps.FOLDER, [(each, each.stem) for each in (folder / maps.FOLDER).glob("*.npz")]),
        (path_maps.FOLDER, [(each, _key_of(each)) for each in (folder / path_maps.FOLDER).glob("*.yaml")]),
    ):
        other = sum(
            key not in keys or (name == maps.FOLDER and not maps.is_of_present_code(file)) for file, key in files
        )
        if other:
            said.append(f"{other} of {counted(len(files), 'map')} in {name}")
    return said


def mark_of(tables: Collection[bytes]) -> str:
    """The text by which a page says that it is of these runs: the SHA-256 of each run's `trials.csv`."""
    return " ".join(hashlib.sha256(each).hexdigest() for each in tables)


def _is_of_other_tables(folder: Path) -> bool:
    """Whether there is a comparison, and it is of other tables than those in the folder."""
    try:
        with (folder / COMPARISON).open("rb") as stream:
            start = stream.read(_MARK_BYTES).decode(errors="replace")
        present = mark_of([(folder / "trials.csv").read_bytes()])
    except OSError:
        return False
    mark = re.search(r'<meta name="trials" content="([0-9a-f ]*)">', start)
    return mark is not None and present not in mark[1].split()


def _key_of(file: Path) -> str:
    """The key at the end of the name of a path's map."""
    return file.stem.rpartition("-")[2]
