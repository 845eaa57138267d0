"""TOML is read within limits: whatever the file holds, the answer is a table or one line, at once."""

import os
from pathlib import Path

import pytest

from harness.errors import InputError
from harness.toml import MOST_BYTES, MOST_LEVELS, levels, parse_toml, read_toml

TOO_DEEP = f"tables and lists are nested more than {MOST_LEVELS} deep"
MANY = 200_000
"""Enough that anything quadratic takes minutes, and the stack of a recursive parser is not deep enough."""


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a = " + "[" * MANY, TOO_DEEP),
        ("a = " + "[" * 65 + "]" * 65, TOO_DEEP),
        ("a = " + "{a = " * MANY, TOO_DEEP),
        ("a." * MANY + "a = 1", TOO_DEEP),
        ("a . " * MANY + "a = 1", TOO_DEEP),
        ("'a'.\"a\"." * MANY + "a = 1", TOO_DEEP),
        (f"[{'a.' * 40}a]\n{'b.' * 40}b = 1", TOO_DEEP),
        ("a = " + '"' * MANY, "not valid TOML"),
        ("'''a" * MANY, "not valid TOML"),
        ('"""\\' * MANY, "not valid TOML"),
        ('a = "' + '\\"' * MANY, "not valid TOML"),
        ("a = " + "9" * MANY, "not valid TOML: Exceeds the limit"),
        ("a = 1\0", "not valid TOML"),
        ("a = 1\n" * (MOST_BYTES // 6 + 1), "is larger than the 4 MiB"),
    ],
    ids=lambda each: each[:20].strip(),
)
def test_what_would_take_long_is_refused_at_once(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: {problem}")


@pytest.mark.parametrize(
    "text",
    [
        "a = '[[[[" + "[" * 99 + "'",
        'a = """' + "{a." * 99 + '"""',
        "# " + "[" * 99 + "\na = 1",
        "a = '" + "b." * 99 + "'",
    ],
)
def test_brackets_and_dots_in_text_and_comments_do_not_count(text: str) -> None:
    assert list(parse_toml(text)) == ["a"]


def test_the_deepest_table_is_read() -> None:
    table = parse_toml("a = " + "[" * (MOST_LEVELS - 1) + "]" * (MOST_LEVELS - 1))
    assert levels(table) == MOST_LEVELS


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfname = 'x'\r\n")
    assert read_toml(path) == {"name": "x"}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without named pipes")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.toml")
    with pytest.raises(InputError, match="is not a regular file"):
        read_toml(tmp_path / "a.toml")
