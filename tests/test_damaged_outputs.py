"""Files of a run that were cut, emptied or replaced are written anew; a damaged database is refused by name."""

import os
import random
import re
import shutil
from pathlib import Path

import pytest
from sweeps import write_small
from undrawn import undrawn

from harness.cli import main
from harness.runs.store import Store
from harness.runs.written import WRITTEN

SEED = 20


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run, and all that is written of it."""
    folder = tmp_path_factory.mktemp("damaged")
    write_small(folder / "e.toml", '[axes]\n"matching.subpixel" = ["none", "parabola"]\n')
    with undrawn():
        assert main(["run", str(folder / "e.toml"), "--out", str(folder / "o"), "--workers", "1"]) == 0
    return folder


def damaged(data: bytes, draws: random.Random) -> bytes:
    """Cut, emptied, overwritten in places, or longer than before."""
    kind = draws.randrange(5)
    if kind == 0:
        return data[: draws.randrange(len(data))]
    if kind == 1:
        return b""
    if kind == 2:
        return b"\0" * len(data)
    if kind == 3:
        changed = bytearray(data)
        for _ in range(draws.choice([1, 5, 100])):
            changed[draws.randrange(len(changed))] ^= draws.randrange(1, 256)
        return bytes(changed)
    return data + draws.randbytes(100)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["experiment.toml", "trials.csv", "summary.json", "report.html"])
def test_what_differs_is_written_anew(made: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    out, draws = made / "o", random.Random(f"{SEED} {name}")
    of_a_time = ("report.html", "environment.json")
    same = {each: (out / each).read_bytes() for each in WRITTEN if each not in of_a_time}
    (out / name).write_bytes(damaged((out / name).read_bytes(), draws))
    assert main(["run", str(made / "e.toml"), "--out", str(out)]) == 0
    assert "nothing to do" not in capsys.readouterr().out
    assert {each: (out / each).read_bytes() for each in same} == same
    assert (out / "report.html").read_bytes().endswith(b"</html>")
    assert main(["run", str(made / "e.toml"), "--out", str(out)]) == 0
    assert "nothing to do" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dangling", "loop", "victim"])
def test_a_link_in_place_of_a_table_is_replaced(made: Path, kind: str) -> None:
    table, victim = made / "o" / "trials.csv", made / "victim"
    before = table.read_bytes()
    victim.write_bytes(before)  # even one with the right content is not what was written
    table.unlink()
    table.symlink_to({"dangling": made / "nowhere", "loop": table, "victim": victim}[kind])
    assert main(["run", str(made / "e.toml"), "--out", str(made / "o"), "--no-report"]) == 0
    assert not table.is_symlink()
    assert table.read_bytes() == victim.read_bytes() == before
    assert not (made / "nowhere").exists()


@pytest.mark.slow
def test_a_damaged_database_never_gives_another_number(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever happens to it, the run is refused with its name, or gives the very table."""
    out, draws = made / "o", random.Random(SEED)
    whole, table = (out / "run.sqlite").read_bytes(), (out / "trials.csv").read_bytes()
    try:
        for _ in range(25):
            (out / "run.sqlite").write_bytes(damaged(whole, draws))
            capsys.readouterr()
            code = main(["run", str(made / "e.toml"), "--out", str(out), "--no-report"])
            said = capsys.readouterr().err
            if code:
                assert (code, said.count("\n"), "run.sqlite: " in said) == (2, 1, True), said
            else:
                assert (out / "trials.csv").read_bytes() == table
    finally:
        for rest in ("run.sqlite-journal", "run.sqlite-wal", "run.sqlite-shm"):
            (out / rest).unlink(missing_ok=True)
        (out / "run.sqlite").write_bytes(whole)


@pytest.mark.parametrize("name", ["run.sqlite", "trials.csv"])
def test_a_pipe_or_folder_in_its_place_is_refused_by_name(
    made: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made / "o" / name
    whole = path.read_bytes()
    for make in (os.mkfifo, os.mkdir):
        path.unlink()
        make(path)
        assert main(["run", str(made / "e.toml"), "--out", str(made / "o"), "--no-report"]) == 2
        said = capsys.readouterr().err
        assert (said.count("\n"), f"{name}: " in said) == (1, True)
        path.rmdir() if path.is_dir() else path.unlink()
        path.write_bytes(whole)


def test_a_database_that_is_a_link_is_refused(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, victim = made / "o" / "run.sqlite", made / "victim.sqlite"
    run, report = ["run", str(made / "e.toml"), "--out", str(made / "o")], ["report", str(made / "o")]
    path.rename(victim)
    try:
        for target, command in ((victim, run), (victim, report), (made / "nowhere.sqlite", run)):
            path.symlink_to(target)
            assert main(command) == 2
            said = capsys.readouterr().err
            assert (said.count("\n"), "run.sqlite: is a symbolic link" in said) == (1, True)
            path.unlink()
        assert not (made / "nowhere.sqlite").exists()
    finally:
        victim.rename(path)


def test_what_a_second_interrupt_left_is_cleared_away(made: Path) -> None:
    out = made / "o"
    left, others = out / f".{'0f' * 16}.partial", (out / ".mine.partial", out / "notes.partial")
    for each in (left, *others):
        each.touch()
    assert main(["run", str(made / "e.toml"), "--out", str(out), "--no-report"]) == 0
    assert not left.exists()
    assert all(each.exists() for each in others)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("experiment.toml", b'name = "x'),
        ("experiment.toml", b'name = "x"'),
        ("environment.json", b"{"),
        ("trials.csv", b"\xff"),
    ],
)
def test_compare_names_the_file_that_it_cannot_read(
    made: Path, tmp_path: Path, name: str, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    for each in ("experiment.toml", "environment.json", "trials.csv"):
        (tmp_path / each).write_bytes((made / "o" / each).read_bytes())
    (tmp_path / name).write_bytes(content)
    assert main(["compare", str(tmp_path), str(made / "o"), "--out", str(tmp_path / "c.html")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"omnirange: {tmp_path / name}: cannot be read as part of a run (")
    assert said.count("\n") == 1


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("harm", ["a digit", "cut", "settings", "facts"])
def test_compare_refuses_a_file_that_is_not_as_it_was_written(
    made: Path, tmp_path: Path, harm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, page = tmp_path / "copy", tmp_path / "c.html"
    shutil.copytree(made / "o", copy)
    assert main(["compare", str(made / "o"), str(copy), "--out", str(page)]) == 0
    page.unlink()
    capsys.readouterr()
    name = {"settings": "experiment.toml", "facts": "environment.json"}.get(harm, "trials.csv")
    before = (copy / name).read_text(encoding="utf-8")
    digit = re.search(r"(?<=\.\d\d)\d", before)
    changes = {
        "a digit": lambda: before[: digit.start()] + str(9 - int(digit.group())) + before[digit.end() :],
        "cut": lambda: before[: before.rindex("\n", 0, -1) + 1],  # whole lines: it reads as well as before
        "settings": lambda: before.replace("seed = 1\n", "seed = 2\n"),
        "facts": lambda: before.replace('"python": "', '"python": "1'),
    }
    after = changes[harm]()
    assert after != before
    (copy / name).write_text(after, encoding="utf-8")
    assert main(["compare", str(made / "o"), str(copy), "--out", str(page)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"omnirange: {copy / name}: differs from what was written")
    assert (said.count("\n"), page.exists()) == (1, False)
    assert main(["report", str(copy)]) == 0  # which writes it anew
    assert main(["compare", str(made / "o"), str(copy), "--out", str(page)]) == 0


def test_compare_says_where_tables_cannot_be_checked(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for each in ("experiment.toml", "environment.json", "trials.csv"):
        (tmp_path / each).write_bytes((made / "o" / each).read_bytes())
    assert main(["compare", str(tmp_path), str(made / "o"), "--out", str(tmp_path / "c.html")]) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"omnirange: {tmp_path}: has no database with the hashes of its tables")
    assert said.count("\n") == 1


def test_compare_writes_nothing_into_the_folders(made: Path, tmp_path: Path) -> None:
    """Those of somebody else can be compared, even while another process reads them."""
    for name in ("one", "two"):
        shutil.copytree(made / "o", tmp_path / name)
        for path in [*(tmp_path / name).rglob("*"), tmp_path / name]:
            path.chmod(0o555 if path.is_dir() else 0o444)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    command = ["compare", str(tmp_path / "one"), str(tmp_path / "two"), "--out", str(made / "c.html")]
    with Store(tmp_path / "one" / "run.sqlite", read_only=True):
        assert main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    for name in ("one", "two"):
        (tmp_path / name).chmod(0o755)  # for pytest to clear away
