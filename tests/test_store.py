"""The file of a run: what is kept, what is refused, and who may hold it."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from harness.errors import InputError
from harness.runs import store as module
from harness.runs.load import load_experiment
from harness.runs.run import open_run
from harness.runs.store import Finished, Store, UnusedRows

DONE = Finished("a", "scene", "done", payload='{"figures": {"x": 0.1}}', seconds='{"render": 1.5}')
FAILED = Finished("b", "scene", "failed", message="no view", traceback="Traceback ...")


def test_rows_come_back(tmp_path: Path) -> None:
    with Store(tmp_path / "run.sqlite") as store:
        store.add([DONE, FAILED])
    with Store(tmp_path / "run.sqlite") as store:
        assert store.finished("abc") == {"a": DONE, "b": FAILED}
        assert store.states("b") == {"b": "failed"}
        assert store.finished("a")["a"].figures == {"x": 0.1}


def test_a_failed_trial_may_be_done_later_and_a_done_one_stays() -> None:
    with Store() as store:
        store.add([DONE, FAILED])
        store.add([Finished("a", "scene", "failed"), Finished("b", "scene", "done")])
        assert store.finished("ab") == {"a": DONE, "b": Finished("b", "scene", "done")}


def test_all_of_a_batch_or_none() -> None:
    with Store() as store:
        with pytest.raises(InputError):
            store.add([DONE, Finished("b", "scene", "half-way")])
        assert store.finished("ab") == {}
        store.add([DONE])
        assert store.finished("ab") == {"a": DONE}


def test_facts() -> None:
    with Store() as store:
        assert store.fact("name") is None
        store.set_fact("name", {"a": [1, float("inf")]})
        store.set_fact("name", {"a": [2, float("inf")]})
        assert store.fact("name") == {"a": [2, float("inf")]}


def test_rows_of_other_code_are_counted_and_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Store(tmp_path / "run.sqlite") as store:
        store.add([DONE, FAILED])
    monkeypatch.setattr(module, "code_hash", lambda: "newer")
    with Store(tmp_path / "run.sqlite") as store:
        assert store.finished("ab") == {}
        newer = [Finished(key, scene, "done") for key, scene in (("a", "scene"), ("c", "other"), ("d", "scene"))]
        store.add(newer)
        assert store.unused_rows("ab", ["scene"]) == UnusedRows(other_code=2, other_scene=1, other_settings=1)
        assert store.states("abcd") == {"a": "done", "c": "done", "d": "done"}
    monkeypatch.undo()
    with Store(tmp_path / "run.sqlite") as store:
        assert store.finished("ab") == {"a": DONE, "b": FAILED}


def test_held_by_one_at_a_time(tmp_path: Path) -> None:
    with Store(tmp_path / "run.sqlite"), pytest.raises(InputError, match="another omnirange is using this folder"):
        Store(tmp_path / "run.sqlite")
    Store(tmp_path / "run.sqlite").__exit__(None, None, None)


def test_no_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.sqlite"
    path.write_text("key,state\n" * 1000)
    with pytest.raises(InputError, match=r"run\.sqlite: is not a run of omnirange, or is damaged"):
        Store(path)
    assert path.read_text() == "key,state\n" * 1000


def test_a_file_that_is_refused_is_let_go_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A notebook keeps the last error, and with it all that was in use: the next call must not find a lock."""
    opened = []
    real = sqlite3.connect
    monkeypatch.setattr(
        sqlite3, "connect", lambda *arguments, **options: opened.append(real(*arguments, **options)) or opened[-1]
    )
    (tmp_path / "run.sqlite").write_text("key,state\n" * 1000)
    with pytest.raises(InputError):
        Store(tmp_path / "run.sqlite")
    (tmp_path / "mine").mkdir()
    small = load_experiment("smoke", ["seed=1"])
    with open_run(small, tmp_path / "mine"):
        pass
    with pytest.raises(InputError, match="holds a run of the experiment 'smoke'"):
        open_run(small.model_copy(update={"name": "other"}), tmp_path / "mine")
    assert len(opened) == 3
    for connection in opened:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            connection.execute("SELECT 1")


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    path = tmp_path / "run.sqlite"
    with Store(path) as store:
        store.add([Finished(f"{i}", "scene", "done", payload=f'"{"x" * 3000}"') for i in range(50)])
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError, match="damaged"):
        Store(path)


def test_another_programs_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE notes (text)")
    with pytest.raises(InputError, match="is not a run of omnirange; give another folder"):
        Store(path)


def test_another_schema_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.sqlite"
    Store(path).__exit__(None, None, None)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(InputError, match="another version of omnirange"):
        Store(path)


def test_a_folder_in_its_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.sqlite").mkdir()
    for read_only in (False, True):
        with pytest.raises(InputError, match="is not a regular file; move it, or give another folder"):
            Store(tmp_path / "run.sqlite", read_only=read_only)


def test_what_is_only_read_is_not_opened_for_writing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.sqlite: cannot be opened \("):
        Store(tmp_path / "run.sqlite", read_only=True)


@pytest.mark.parametrize(
    "change",
    [
        'UPDATE trials SET payload = \'{"figures": {"density": 1.0}}\'',  # well-formed, and wrong
        "UPDATE trials SET payload = substr(payload, 1, 5)",
        "UPDATE trials SET payload = x'ff00'",
        "UPDATE trials SET payload = CAST(x'ff00' AS TEXT)",  # not UTF-8
        "UPDATE trials SET seconds = 5",
        "UPDATE trials SET state = 'failed'",
        "UPDATE trials SET message = 'x'",
        "UPDATE trials SET seal = ''",
    ],
)
def test_a_row_that_was_changed_is_refused(tmp_path: Path, change: str) -> None:
    path = tmp_path / "run.sqlite"
    with Store(path) as store:
        store.add([DONE])
        assert store.finished("a") == {"a": DONE}
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    with Store(path) as store, pytest.raises(InputError, match=r"run\.sqlite: "):
        store.finished("a")


@pytest.mark.parametrize("value", ["'null'", "'{'", "5", "x'ff'", "CAST(x'ff' AS TEXT)"])
def test_a_fact_that_was_changed_is_refused(tmp_path: Path, value: str) -> None:
    path = tmp_path / "run.sqlite"
    with Store(path) as store:
        store.set_fact("name", "x")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE facts SET value = {value}")
    with Store(path) as store, pytest.raises(InputError, match=r"run\.sqlite: "):
        store.fact("name")


def test_a_pipe_in_its_place_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.sqlite")
    with pytest.raises(InputError, match="is not a regular file"):
        Store(tmp_path / "run.sqlite")
