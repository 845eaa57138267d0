"""The file that holds a run: one SQLite database, safe against a kill at any moment.

A trial is one row, written in one transaction when it is finished. Rows are identified by the trial's key and the
code that made them: those of other code are never read, and never overwritten. Each has a seal, the hash of its
contents: a row that was truncated or changed is refused.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from harness.errors import InputError
from harness.pipeline.environment import code_hash

DATABASE = "run.sqlite"
"""The file's name in the run's folder."""

OTHER_CODE = "its trials were made by other code or libraries than today's, and are shown as they were made then"

_APPLICATION, _SCHEMA = 0x6F6D6E69, 2
"""SQLite's `application_id` of our files ("omni"), and the `user_version`, that of the tables below."""

_DAMAGE = (sqlite3.Error, UnicodeError)
"""The exceptions that reading a damaged file raises; the second one from names that are no longer text."""

_TABLES = """
CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL, seal TEXT NOT NULL);
CREATE TABLE trials (
    key TEXT NOT NULL,
    code TEXT NOT NULL,
    scene TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('done', 'failed')),
    payload TEXT NOT NULL,
    seconds TEXT NOT NULL,
    message TEXT NOT NULL,
    traceback TEXT NOT NULL,
    seal TEXT NOT NULL,
    PRIMARY KEY (key, code)
);
"""


_ANSWERS = """CREATE TABLE IF NOT EXISTS answers (
    key TEXT NOT NULL, code TEXT NOT NULL, data BLOB NOT NULL, PRIMARY KEY (key, code)
)"""
"""Made separately: older files without this table stay valid."""


@dataclass(frozen=True)
class Finished:
    """A finished trial as it is stored."""

    key: str
    scene: str
    """`fingerprint` of its scene."""
    state: Literal["done", "failed"]
    payload: str = "{}"
    """JSON of `row.row_of`; of a failed trial, `refused` if it failed by an `InputError`."""
    seconds: str = "{}"
    """JSON: wall time of each stage."""
    message: str = ""
    """The error of a failed trial, in one line."""
    traceback: str = ""

    @property
    def is_refused(self) -> bool:
        """Whether the trial failed by a mistake in the program's input, rather than by a bug."""
        return bool(json.loads(self.payload).get("refused", False))

    @property
    def figures(self) -> dict[str, float | None]:
        """The flat figures, by name."""
        return json.loads(self.payload).get("figures", {})


@dataclass(frozen=True)
class UnusedRows:
    """Rows in the file that this run does not use."""

    other_code: int
    other_scene: int
    other_settings: int


class Store:
    """An open run, held by this process alone until it is closed.

    Parameters
    ----------
    path
        The file, made if it is not there; None for one in memory.
    read_only
        Nothing is written, and the file has to be there. Others may read it at the same time.

    Raises
    ------
    InputError
        When the file is no run of this program, is damaged, or is held by another process.
    """

    def __init__(self, path: Path | None = None, *, read_only: bool = False) -> None:
        self._path, self._read_only = path, read_only
        self._code = self._read = code_hash()
        if path is not None and path.is_symlink():  # it could lead to another's file
            raise InputError("is a symbolic link, which is not followed; move it, or give another folder", file=path)
        if path is not None and path.exists() and not path.is_file():
            raise InputError("is not a regular file; move it, or give another folder", file=path)
        try:
            name = f"{path.absolute().as_uri()}?mode=ro" if path and read_only else path or ":memory:"
            self._connection = sqlite3.connect(name, timeout=0, isolation_level=None, uri=read_only)
        except _DAMAGE as error:
            raise self._explained(error) from error
        try:
            self._open(read_only=read_only)
        except BaseException as error:
            self._connection.close()  # there is no store that would close it
            if isinstance(error, _DAMAGE):
                raise self._explained(error) from error
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def _open(self, *, read_only: bool) -> None:
        # The lock is kept until the connection closes, and falls with the process, however it ends.
        self._do("PRAGMA locking_mode = EXCLUSIVE")
        self._do("PRAGMA synchronous = FULL")
        self._do("BEGIN" if read_only else "BEGIN EXCLUSIVE")
        application, tables = self._number("PRAGMA application_id"), self._number("SELECT count(*) FROM sqlite_master")
        if not application and not tables and not read_only:
            for statement in _TABLES.split(";"):
                self._do(statement)
            self._do(f"PRAGMA application_id = {_APPLICATION}")
            self._do(f"PRAGMA user_version = {_SCHEMA}")
        elif application != _APPLICATION:
            raise InputError("is not a run of omnirange; give another folder, or move this file away", file=self._path)
        elif self._number("PRAGMA user_version") != _SCHEMA:
            raise InputError("was written by another version of omnirange; give another folder", file=self._path)
        elif self._do("PRAGMA quick_check").fetchone()[0] != "ok":
            raise sqlite3.DatabaseError("quick_check")
        if not read_only:
            self._do(_ANSWERS)
        self._do("COMMIT")

    @property
    def other_code(self) -> str | None:
        """The hash of the code whose rows are read, where it is not today's."""
        return None if self._read == self._code else self._read

    def read_earlier(self, keys: Iterable[str]) -> None:
        """Read the rows of other code if today's has made none of these trials: of the one that has made the most.

        For reports. Rows of several codes are never mixed, and new rows are always of the present code.
        """
        wanted = set(keys)
        codes = [code for key, code in self._rows("SELECT key, code FROM trials ORDER BY rowid") if key in wanted]
        if codes and self._code not in codes:
            self._read = max(reversed(codes), key=codes.count)  # of two with as many, the later

    def finished(self, keys: Iterable[str]) -> dict[str, Finished]:
        """The rows of these trials that the present code made, or that of `read_earlier`, by key.

        Raises
        ------
        InputError
            When one of them is not as it was written.
        """
        wanted = set(keys)
        trials = {}
        for key, *values, seal in self._rows(
            "SELECT key, scene, state, payload, seconds, message, traceback, seal FROM trials WHERE code = ?",
            self._read,
        ):
            if key in wanted:
                if seal != _seal(key, self._read, *values):
                    raise self._changed(f"the row of trial {key}")
                trials[key] = Finished(key, *values)
        return trials

    def states(self, keys: Iterable[str]) -> dict[str, str]:
        """The states of these trials by key; quicker than `finished`."""
        wanted = set(keys)
        rows = self._rows("SELECT key, state FROM trials WHERE code = ?", self._read)
        return {key: state for key, state in rows if key in wanted}

    def unused_rows(self, keys: Iterable[str], scenes: Iterable[str]) -> UnusedRows:
        """The numbers of rows that are from other code, or of none of these trials."""
        wanted, known = set(keys), set(scenes)
        rows = self._rows("SELECT key, code, scene FROM trials")
        strange = [scene for key, code, scene in rows if code == self._read and key not in wanted]
        other_scene = sum(scene not in known for scene in strange)
        return UnusedRows(sum(row[1] != self._read for row in rows), other_scene, len(strange) - other_scene)

    def add(self, rows: Iterable[Finished]) -> None:
        """Write finished trials: all of them or, if the process dies, none. One that is done stays as it is."""
        self._do("BEGIN IMMEDIATE")
        try:
            self._connection.executemany(
                "INSERT INTO trials VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) "
                "ON CONFLICT DO UPDATE SET state = excluded.state, payload = excluded.payload, "
                "seconds = excluded.seconds, message = excluded.message, traceback = excluded.traceback, "
                "seal = excluded.seal "
                "WHERE trials.state = 'failed'",
                [(*values, _seal(*values)) for values in map(self._values, rows)],
            )
            self._do("COMMIT")
        except _DAMAGE as error:
            raise self._explained(error) from error
        finally:
            if self._connection.in_transaction:
                self._connection.rollback()

    def _values(self, row: Finished) -> tuple[str, ...]:
        return row.key, self._code, row.scene, row.state, row.payload, row.seconds, row.message, row.traceback

    def answer(self, key: str) -> bytes | None:
        """The stored result of a matcher for a trial; None if nothing is stored."""
        row = self._do("SELECT data FROM answers WHERE key = ? AND code = ?", key, self._read).fetchone()
        return None if row is None else bytes(row[0])

    def set_answers(self, answers: Mapping[str, bytes]) -> None:
        """Store these results, by key of the trial, and no others."""
        self._do("BEGIN IMMEDIATE")
        try:
            self._connection.execute("DELETE FROM answers")
            self._connection.executemany(
                "INSERT INTO answers VALUES (?, ?, ?)", [(key, self._code, data) for key, data in answers.items()]
            )
            self._do("COMMIT")
        except sqlite3.Error as error:
            raise self._explained(error) from error
        finally:
            if self._connection.in_transaction:
                self._connection.rollback()

    def fact(self, name: str) -> Any:
        """A stored fact about the run; None if nothing is stored under the name.

        Raises
        ------
        InputError
            When it is not as it was written.
        """
        rows = self._rows("SELECT value, seal FROM facts WHERE name = ?", name)
        if not rows:
            return None
        ((value, seal),) = rows
        if seal != _seal(name, value):
            raise self._changed(f"the record '{name}'")
        return json.loads(value)

    def set_fact(self, name: str, value: Any) -> None:
        """Store something JSON-able beside the rows."""
        text = json.dumps(value)
        self._do("INSERT OR REPLACE INTO facts VALUES (?, ?, ?)", name, text, _seal(name, text))

    def _changed(self, what: str) -> InputError:
        return InputError(
            f"{what} differs from what was written: the file is damaged or was edited; move it, or give another folder "
            "with --out",
            file=self._path,
        )

    def _rows(self, statement: str, *values: Any) -> list[Any]:
        try:
            return self._connection.execute(statement, values).fetchall()
        except _DAMAGE as error:
            raise self._explained(error) from error

    def _do(self, statement: str, *values: Any) -> sqlite3.Cursor:
        try:
            return self._connection.execute(statement, values)
        except _DAMAGE as error:
            raise self._explained(error) from error

    def _number(self, statement: str) -> int:
        return int(self._do(statement).fetchone()[0])

    def _explained(self, error: Exception) -> Exception:
        code = getattr(error, "sqlite_errorcode", None)
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            text = "another omnirange is using this folder; wait until it ends, or give another folder with --out"
        elif code == sqlite3.SQLITE_FULL:
            text = "the disk is full; finished trials are stored, make room and run the same command again"
        elif code in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM):
            text = f"cannot be opened{'' if self._read_only else ' for writing'} ({error})"
        else:
            text = f"is not a run of omnirange, or is damaged ({error}); move it, or give another folder with --out"
        return InputError(text, file=self._path)


def _seal(*values: Any) -> str:
    """SHA-256 over values and where each of them ends."""
    return hashlib.sha256(json.dumps([repr(value) for value in values]).encode()).hexdigest()
