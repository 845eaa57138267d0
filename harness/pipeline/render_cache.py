"""Renders stored on disk between runs, by their contents' identity, within a size limit.

A file is the SHA-256 of its name and of what follows, a NumPy array. It is written whole or not at all; one that does
not match its checksum is made again. Any number of processes may share the folder.
"""

import hashlib
import io
import os
import re
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.files import LEFTOVER, cache_folder, replace_file
from harness.pipeline.environment import render_hash
from harness.spec import Spec

DEFAULT_LIMIT_MB = 2048
_DIGEST = hashlib.sha256().digest_size
_OF_AN_IMAGE = re.compile(r"[0-9a-f]{64}\.npy")
"""The names of its files; what else is in the folder is the user's."""
_STALE_S = 3600
"""Age after which a half-written file is taken to be left by a process that died."""


def limit_bytes() -> int:
    """`$OMNIRANGE_CACHE_LIMIT_MB` in bytes.

    Raises
    ------
    InputError
        When it is not a number.
    """
    text = os.environ.get("OMNIRANGE_CACHE_LIMIT_MB", str(DEFAULT_LIMIT_MB))
    try:
        return int(float(text) * 2**20)
    except (ValueError, OverflowError):
        raise InputError(f"must be a number of megabytes; found '{text}'", key="OMNIRANGE_CACHE_LIMIT_MB") from None


@dataclass(frozen=True)
class Contents:
    """The number of files in the cache, and their size."""

    files: int
    bytes: int


class RenderCache:
    """Images in `folder`/renders. One that cannot be read is made again; one that cannot be written is not stored.

    Parameters
    ----------
    limit
        Bytes; beyond it the least recently used images are removed.
    """

    def __init__(self, folder: Path | None = None, limit: int | None = None) -> None:
        cache = folder or cache_folder()
        self.folder = cache / "renders" if cache else None
        """The cache's folder; None without a home folder: nothing is stored then."""
        self.limit = limit_bytes() if limit is None else limit
        self._room = 0
        """Bytes that may be written before the folder is checked again."""

    def get(self, key: Hashable, make: Callable[[], NDArray[np.float32]]) -> NDArray[np.float32]:
        """The image with this key; a failure to make it is not stored."""
        if self.folder is None:
            return make()
        path = self.folder / f"{_name(key)}.npy"
        image = _read(path)
        if image is None:
            image = make()
            self._write(path, image)
        return image

    def contents(self) -> Contents:
        """The number of images in the cache, and their size."""
        sizes = [size for _, _, size in self._files()]
        return Contents(len(sizes), sum(sizes))

    def clear(self) -> None:
        """Remove all images."""
        for _, path, _ in self._files():
            path.unlink(missing_ok=True)

    def _write(self, path: Path, image: NDArray[np.float32]) -> None:
        stream = io.BytesIO()
        np.save(stream, image)
        data = stream.getvalue()
        if len(data) > self.limit:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, _seal(path, data) + data, durable=False)
        except OSError:  # a full or read-only disk costs time, not the run
            return
        self._room -= len(data)
        if self._room < 0:
            self._evict()

    def _evict(self) -> None:
        """Make room for a sixteenth of the limit, the least recently used images first."""
        files = sorted(self._files())
        total = sum(size for _, _, size in files)
        for _, path, size in files:
            if total <= self.limit * 15 / 16:
                break
            _remove(path)
            total -= size
        # Other processes write too: each writes at most a share of the remaining room before it checks again.
        self._room = (self.limit - total) // 8

    def _files(self) -> list[tuple[float, Path, int]]:
        """When last used, where, and bytes."""
        files = []
        for path in self.folder.glob("*") if self.folder else ():
            try:
                status = path.stat()
            except OSError:  # another process has just removed it
                continue
            if _OF_AN_IMAGE.fullmatch(path.name):
                files.append((status.st_mtime, path, status.st_size))
            elif LEFTOVER.fullmatch(path.name) and time.time() - status.st_mtime > _STALE_S:
                _remove(path)
        return files


def _remove(path: Path) -> None:
    with suppress(OSError):  # another process has done so, or it is not ours to remove
        path.unlink()


def _read(path: Path) -> NDArray[np.float32] | None:
    """The image in a file of the cache; None if the file is missing, or its contents are damaged."""
    try:
        if not path.is_file():  # a pipe would be waited for
            return None
        data = path.read_bytes()
    except OSError:
        return None
    if _seal(path, data[_DIGEST:]) != data[:_DIGEST]:
        return None
    try:
        image = np.load(io.BytesIO(data[_DIGEST:]))
    except Exception:  # noqa: BLE001 - somebody has put something else there; NumPy fails in many ways
        return None
    if not isinstance(image, np.ndarray) or image.dtype != np.float32:
        return None
    with suppress(OSError):  # a read-only cache has no order of removal
        os.utime(path)
    image.flags.writeable = False
    return image


def _seal(path: Path, data: bytes) -> bytes:
    """SHA-256 of a file's name and contents: one that was copied over another is detected too."""
    return hashlib.sha256(path.name.encode() + data).digest()


def _name(key: Hashable) -> str:
    return hashlib.sha256(f"{render_hash()} {_words(key)}".encode()).hexdigest()


def _words(key: Any) -> str:
    if isinstance(key, tuple):
        return f"({', '.join(_words(each) for each in key)})"
    return key.model_dump_json() if isinstance(key, Spec) else repr(key)
