"""The files made from a run's rows, and the hashes that reveal later changes."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.errors import InputError
from harness.files import OwnFiles, check_no_others, check_unprotected, encoded, read_regular, write
from harness.runs.store import DATABASE, Store

WRITTEN = (
    "experiment.toml",
    "environment.json",
    "trials.csv",
    "timings.csv",
    "summary.json",
    "report.html",
)
"""The files made from the rows; `FAILURES` too, when a trial failed."""

FAILURES = "failures.csv"
"""Written, or removed, with the tables."""

OF_A_RUN = OwnFiles(
    "run",
    dict.fromkeys(WRITTEN)
    | {
        "environment.json": b'{\n  "omnirange": "',
        "trials.csv": b"state,",
        "summary.json": b'{\n  "schema": ',
        FAILURES: b"message,traceback,key\n",
    },
)
"""How these files show whose they are; those whose hashes are in the run's database are its own, whatever is in them
now."""

OF_ALL_ROWS = ("environment.json", "summary.json", "report.html")
"""Those that are written after the tables, and not at all without a report."""

_LIMIT_BYTES = 1 << 30
"""The most that is read of such a file: a hundred thousand trials have tables of some hundred megabytes."""

_FACT, _FACT_OF_REPORT, _FACT_OF_TABLES = "written", "reported", "tables"


def check_begins_no_run(folder: Path) -> None:
    """Refuse a folder that has no run yet, but files of the names that a run replaces or removes.

    Raises
    ------
    InputError
        Names one of them.
    """
    if os.path.lexists(folder / DATABASE):  # what it is, is said where it is opened
        return
    for path in (folder / name for name in (*WRITTEN, FAILURES)):
        if os.path.lexists(path):
            raise InputError("is there already, and not from a run in this folder; give another folder", file=path)


def check_no_others_in(folder: Path, store: Store) -> None:
    """Refuse a run's folder that has somebody's own files of the names that a run replaces or removes.

    Raises
    ------
    InputError
        Names one of them.
    """
    check_unprotected((folder / name for name in OF_A_RUN.marks), option=None)
    recorded = _stored_hashes(store) or {}
    marks = {name: mark for name, mark in OF_A_RUN.marks.items() if recorded.get(name) is None}
    advice = "move it, or give another folder"
    check_no_others(folder, OwnFiles(OF_A_RUN.what, marks), option=None, advice=advice)


def write_files(files: Mapping[str, str], folder: Path, store: Store) -> None:
    """Write files into a run's folder, by name, and keep their hashes in its database.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    contents = {name: encoded(text) for name, text in files.items()}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    # Beforehand: a file that is there when the process dies is known as ours.
    store.set_fact(_FACT, (_stored_hashes(store) or {}) | hashes)
    for name, data in contents.items():
        write(folder / name, data)


def remove_failures(folder: Path, store: Store) -> list[str]:
    """Remove `FAILURES`, as no trial failed; if somebody has changed it since, leave it, and return its name."""
    path, hashes = folder / FAILURES, _stored_hashes(store) or {}
    if not path.is_file():
        return []
    recorded = hashes.get(FAILURES)  # earlier versions have recorded none
    if path.is_symlink() or recorded not in (None, hashlib.sha256(path.read_bytes()).hexdigest()):
        return [FAILURES]
    path.unlink()
    # A file of this name that comes later is none of ours.
    store.set_fact(_FACT, {name: digest for name, digest in hashes.items() if name != FAILURES})
    return []


def set_reported(digest: str, store: Store, folder: Path) -> None:
    """Record that the files belong to the rows with this digest."""
    store.set_fact(_FACT_OF_REPORT, [digest, _hashes(folder)])


def remove_stale(digest: str, store: Store, folder: Path) -> tuple[list[str], list[str]]:
    """Remove the files that follow from other rows than those with this digest, which are the rows from now on.

    They would stand beside new tables and contradict them. Files that somebody has changed since are left. To be called
    before anything is written: then all that is there after it is of these rows, reported to the end or not.

    Returns
    -------
    removed, left : list of str
        Names of files.
    """
    hashes, present = _stored_hashes(store) or {}, _hashes(folder)
    reported = store.fact(_FACT_OF_REPORT)
    # Earlier versions have recorded only for which rows the report was finished.
    of_rows, kept = store.fact(_FACT_OF_TABLES) or [reported and reported[0], []]
    are_new = of_rows != digest
    there = [name for name in (OF_ALL_ROWS if are_new else kept) if present[name] is not None]
    left = [name for name in there if present[name] != hashes.get(name)]
    removed = [name for name in there if name not in left] if are_new else []
    for name in removed:
        (folder / name).unlink()
    if removed:  # files of these names that come later, and before they are written again, are none of ours
        store.set_fact(_FACT, {name: each for name, each in hashes.items() if name not in removed})
    store.set_fact(_FACT_OF_TABLES, [digest, left])
    return removed, left


def is_written(digest: str, store: Store, folder: Path) -> bool:
    """Whether all files that follow from the rows with this digest exist and are unchanged."""
    hashes = _hashes(folder)
    return None not in hashes.values() and store.fact(_FACT_OF_REPORT) == [digest, hashes]


def read_written(folder: Path, names: tuple[str, ...]) -> tuple[dict[str, bytes], bool]:
    """Files that a run of any code wrote, by name; missing ones are left out.

    Returns
    -------
    files : dict of bytes
    checked : bool
        Whether they were compared with the hashes in the run's database. A copy of the tables alone has none.

    Raises
    ------
    InputError
        When a file is not as it was written, or the database cannot be read.
    """
    files = {name: read_regular(folder / name, _LIMIT_BYTES) for name in names if (folder / name).is_file()}
    database = folder / DATABASE
    hashes = None
    if database.exists() or database.is_symlink():
        with Store(database, read_only=True) as store:
            hashes = _stored_hashes(store)
    if hashes is None:
        return files, False
    for name, data in files.items():
        if hashes.get(name) != hashlib.sha256(data).hexdigest():
            raise InputError(
                "differs from what was written: it was truncated or edited; "
                "the command that made the run writes it again",
                file=folder / name,
            )
    return files, True


def _stored_hashes(store: Store) -> dict[str, Any] | None:
    """The hashes in the database; None if it has none, as for a run that has not ended yet."""
    hashes: dict[str, Any] | None = store.fact(_FACT)
    reported = store.fact(_FACT_OF_REPORT)
    return hashes or (reported[1] if reported else None)


def _hashes(folder: Path) -> dict[str, str | None]:
    """SHA-256 of the files made from the rows, by name; None for one that is no regular file."""
    hashes: dict[str, str | None] = dict.fromkeys(WRITTEN)
    for name in WRITTEN:
        path = folder / name
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as stream:
                hashes[name] = hashlib.file_digest(stream, "sha256").hexdigest()
    return hashes
