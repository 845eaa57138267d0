"""The one writer of files: whole or not at all, through no link, and nothing left behind."""

import errno
import os
import stat
from pathlib import Path

import pytest

from harness import files
from harness.errors import InputError
from harness.files import replace_file, write
from harness.pipeline.render_cache import RenderCache
from harness.runs.worker import _laid_down


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("content", ["text, °\n", b"\0bytes", ""])
def test_what_is_written_is_read(tmp_path: Path, content: str | bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"before, and longer than what comes after it")
    write(path, content)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert names(tmp_path) == ["file"]
    os.umask(umask := os.umask(0))
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


def test_text_that_is_not_unicode_is_escaped(tmp_path: Path) -> None:
    write(tmp_path / "file", os.fsdecode(b"caf\xe9"))
    assert (tmp_path / "file").read_text() == r"caf\udce9"


@pytest.mark.parametrize("name", ["table.csv", "table.csv.partial"])
@pytest.mark.parametrize("kind", ["link", "dangling", "loop"])
def test_no_link_is_followed(tmp_path: Path, name: str, kind: str) -> None:
    """Neither one at the file's own name nor one at a name that a temporary file might have."""
    precious = tmp_path / "precious"
    precious.write_text("precious")
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to({"link": precious, "dangling": tmp_path / "new", "loop": out / name}[kind])
    write(out / "table.csv", "table")
    assert (out / "table.csv").read_text() == "table"
    assert not (out / "table.csv").is_symlink()
    assert precious.read_text() == "precious"
    assert names(tmp_path) == ["out", "precious"]


def test_no_pipe_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "table.csv.partial")
    write(tmp_path / "table.csv", "table")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"pipe: cannot be written .* not a regular file"):
        write(tmp_path / "pipe", "table")
    assert names(tmp_path) == ["pipe", "table.csv", "table.csv.partial"]


def test_a_device_is_not_replaced() -> None:
    with pytest.raises(InputError, match=r"/dev/null: cannot be written .* not a regular file"):
        write(Path("/dev/null"), "table")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_what_cannot_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "x", tmp_path / ("y" * 300), tmp_path / "a\0b", tmp_path / "no" / "x"):
        with pytest.raises(InputError, match="cannot be written"):
            write(path, "table")
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_breaks_off_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    write(tmp_path / "table.csv", "before")

    def fail(_: int) -> None:
        raise error

    monkeypatch.setattr(files.os, "fsync", fail)
    with pytest.raises((InputError, KeyboardInterrupt)) as caught:
        write(tmp_path / "table.csv", "after")
    if isinstance(error, OSError):
        assert str(caught.value) == f"{tmp_path / 'table.csv'}: cannot be written (No space left on device)"
    assert names(tmp_path) == ["table.csv"]
    assert (tmp_path / "table.csv").read_text() == "before"


def test_on_the_disk_before_it_is_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced = []
    monkeypatch.setattr(files.os, "fsync", lambda d: synced.append((os.fstat(d).st_ino, (tmp_path / "file").exists())))
    write(tmp_path / "file", "content")
    assert synced == [((tmp_path / "file").stat().st_ino, False), (tmp_path.stat().st_ino, True)]
    replace_file(tmp_path / "other", b"content", durable=False)
    assert len(synced) == 2


def test_caches_write_through_no_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    precious = tmp_path / "precious"
    precious.write_text("precious")
    image = np.ones((2, 2), dtype=np.float32)
    cache = RenderCache(tmp_path / "cache", 10**6)
    cache.get("key", lambda: image)
    (entry,) = cache.folder.iterdir()
    laid = _laid_down("wall.png", b"picture")
    for path in (entry, laid):
        path.unlink()
        path.symlink_to(precious)
    assert np.array_equal(cache.get("key", lambda: image), image)
    assert _laid_down("wall.png", b"picture") == laid
    assert laid.read_bytes() == b"picture"
    assert not entry.is_symlink()
    assert precious.read_text() == "precious"
