"""Checks of files: checksums, missing and truncated files, sizes that differ from the other files'."""

from collections.abc import Iterator

import numpy as np

from harness.datasets.checks.finding import Finding, StoredSet, gathered, problem_of
from harness.datasets.layouts.layout import StoredPair
from harness.datasets.layouts.reading import read_levels
from harness.datasets.making import file_hash
from harness.datasets.manifest import MANIFEST
from harness.errors import InputError
from harness.files import read_regular

_LIMIT_BYTES = 2**30


def check_checksums(data: StoredSet) -> Iterator[Finding]:
    """Every file of the manifest is there with its size and SHA-256, and no other one is."""
    if data.manifest is None:
        return
    faults: dict[str, list[str]] = {}
    stated = data.manifest.get("files")
    if not isinstance(stated, dict):
        yield Finding("checksums", MANIFEST, "has no table of files")
        return
    for path, record in stated.items():
        file = data.folder / path
        if not file.is_file():
            faults.setdefault("is in the manifest, and not there", []).append(path)
        elif file.stat().st_size < record.get("bytes", 0):
            faults.setdefault("is shorter than the manifest says: it was cut off", []).append(path)
        elif file_hash(file) != record.get("sha256"):
            faults.setdefault("has another SHA-256 than the manifest says: it was changed", []).append(path)
    present = {path.relative_to(data.folder).as_posix() for path in data.folder.rglob("*") if path.is_file()}
    if more := sorted(present - set(stated) - {MANIFEST}):
        faults["is there, and not in the manifest"] = more
    yield from gathered("checksums", faults)


def check_readable(data: StoredSet) -> Iterator[Finding]:
    """Every image and map can be read, and has the size that the calibration says."""
    faults: dict[str, list[str]] = {}
    for pair in data.pairs:
        for file, text in _unreadable(pair):
            faults.setdefault(text, []).append(file)
    yield from gathered("readable", faults)


def _unreadable(pair: StoredPair) -> Iterator[tuple[str, str]]:
    """The parts of a pair that cannot be read, each with the reason."""
    for view in pair.views:
        name = f"{pair.name}: {view.image.name}"
        try:
            levels = read_levels(read_regular(view.image, _LIMIT_BYTES, "image"), view.image)
        except InputError as error:
            yield name, problem_of(error)
            continue
        camera = view.sensor.camera
        if levels.shape[:2] != (camera.height_px, camera.width_px):
            height, width = levels.shape[:2]
            yield name, f"is {width} x {height} pixels, its calibration {camera.width_px} x {camera.height_px}"
    for each in pair.maps:
        name = f"{pair.name}: {each.file.name}"
        try:
            shape = each.raw().shape
            expected = each.directions().shape[:-1]
        except InputError as error:
            yield name, problem_of(error)
            continue
        if shape != expected:
            yield name, f"has the shape {_words(shape)}, and {_words(expected)} pixels are seen"
    for kind in ("state", "match"):
        read = getattr(pair, kind)
        if read is not None:
            try:
                read()
            except InputError as error:
                yield f"{pair.name}: {kind}", problem_of(error)


def _words(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "one number"


def is_whole(pair: StoredPair) -> bool:
    """Whether all of a pair can be read, so that other checks may look at it."""
    return not any(True for _ in _unreadable(pair))


def is_usable(values: np.ndarray) -> bool:
    """Whether an array has any finite number."""
    return bool(np.isfinite(values).any())
