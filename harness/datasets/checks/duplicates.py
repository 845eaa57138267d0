"""Scenes and images that are in two parts of the split, and images that are there twice."""

import hashlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from harness.datasets.checks.finding import Finding, StoredSet, listed
from harness.datasets.layouts.reading import read_grey
from harness.files import read_regular

_SIDE = 24
_ALIKE = 0.995
"""Correlation of two thumbnails, less the mean of all, from which they are one image: 0.999 after JPEG, 0.9 at most of
two views of one room."""
_BLOCK = 2048
_LEAST = 4
"""Images below which the mean of all says nothing."""


def check_duplicates(data: StoredSet) -> Iterator[Finding]:
    """Whether parts of the split share scenes or images, and whether an image is there twice."""
    parts: dict[str, set[str]] = {}
    for pair in data.pairs:
        parts.setdefault(pair.scene.rpartition("/")[2], set()).add(pair.split)
    shared = [scene for scene, splits in parts.items() if len(splits) > 1]
    if shared:
        splits = sorted({split for scene in shared for split in parts[scene]})
        yield Finding("duplicates", listed(shared), f"the scene is in several parts of the split: {', '.join(splits)}")
    names, splits_of_image, thumbnails, twice = [], [], [], []
    hashes: dict[str, str] = {}
    for pair in data.pairs:
        for view in pair.views:
            name = f"{pair.name}: {view.image.name}"
            digest = hashlib.sha256(read_regular(view.image, 2**30, "image")).hexdigest()
            if digest in hashes:
                twice.append(f"{hashes[digest]} = {name}")
            hashes[digest] = name
            names.append(name)
            splits_of_image.append(pair.split)
            thumbnails.append(_thumbnail(read_grey(view.image)))
    if twice:
        yield Finding("duplicates", listed(twice), "two images are the same file")
    if across := list(_across(names, splits_of_image, np.array(thumbnails), set(twice))):
        yield Finding("duplicates", listed(across), "two parts of the split have the same image, in files that differ")


def _thumbnail(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """The means of a grid of blocks."""
    rows, columns = (np.linspace(0, size, _SIDE + 1).astype(int) for size in grey.shape)
    sums = np.add.reduceat(np.add.reduceat(grey, rows[:-1], axis=0), columns[:-1], axis=1)
    counts = np.maximum(np.outer(np.diff(rows), np.diff(columns)), 1)
    return np.asarray((sums / counts).ravel(), dtype=np.float32)


def _across(names: list[str], splits: list[str], thumbnails: NDArray[np.float32], known: set[str]) -> Iterator[str]:
    """Pairs of images of different parts that are alike."""
    if len(set(splits)) < 2 or len(names) < _LEAST:
        return
    unit = thumbnails - thumbnails.mean(axis=0)
    unit -= unit.mean(axis=1, keepdims=True)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-9)
    part = np.array(splits)
    for start in range(0, len(names), _BLOCK):
        alike = unit[start : start + _BLOCK] @ unit.T > _ALIKE
        alike &= part[start : start + _BLOCK, None] != part
        for i, j in zip(*np.nonzero(alike), strict=True):
            pair = f"{names[start + i]} = {names[j]}"
            if start + i < j and pair not in known:
                yield pair
