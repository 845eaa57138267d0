"""The manifest and README of a data set: files with their SHA-256, the split, the licence, and the origin."""

import hashlib
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness.datasets.layouts.layout import Files
from harness.datasets.specification import DatasetSpec
from harness.pipeline.environment import code_hash
from harness.simulation.noise import generator
from harness.spec import as_table
from harness.version import __version__

MANIFEST = "manifest.json"
JOURNAL = "finished.jsonl"
"""One line for each scene that is done, while a set is being made."""
_MAKERS = ("specification.py", "surfaces.py", "rooms.py", "rigs.py", "pair.py", "layouts/*.py")
"""The source files here that determine the contents of a set's files."""
LICENCE = "CC0-1.0"
PROVENANCE = (
    "All images and their truth are rendered by omnirange from dataset.toml; nothing was photographed or measured.",
    "Gravel, grass and brick are photographs that come with scikit-image (public domain, CC0).",
    "All other textures and meshes are made from seeds.",
)


@dataclass(frozen=True)
class FileRecord:
    """A file as it was written."""

    sha256: str
    size: int


@dataclass(frozen=True)
class SceneRecord:
    """A scene that is done."""

    number: int
    split: str
    files: Mapping[str, FileRecord]
    """Records of the scene's files by path, relative to the set's folder."""

    def line(self) -> str:
        """The record as a line of JSON."""
        files = {path: [each.sha256, each.size] for path, each in self.files.items()}
        return json.dumps({"scene": self.number, "split": self.split, "files": files})


def record_of(line: str) -> SceneRecord:
    """The record in a line of JSON; ValueError, KeyError or TypeError for one that was cut off."""
    table = json.loads(line)
    files = {path: FileRecord(str(sha256), int(size)) for path, (sha256, size) in table["files"].items()}
    return SceneRecord(int(table["scene"]), str(table["split"]), files)


def record_files(number: int, split: str, files: Files) -> SceneRecord:
    """The record of a scene's files."""
    return SceneRecord(number, split, {path: file_record(content) for path, content in files.items()})


def file_record(content: bytes) -> FileRecord:
    """A file's record."""
    return FileRecord(hashlib.sha256(content).hexdigest(), len(content))


def splits_of(spec: DatasetSpec) -> list[str]:
    """The part of each scene: shares rounded by the largest remainder, scenes drawn by the seed."""
    shares = {"train": spec.split.train, "val": spec.split.val, "test": spec.split.test}
    counts = {part: int(share * spec.scenes) for part, share in shares.items()}
    by_remainder = sorted(shares, key=lambda part: shares[part] * spec.scenes - counts[part], reverse=True)
    for part in by_remainder[: spec.scenes - sum(counts.values())]:
        counts[part] += 1
    ordered = [part for part, count in counts.items() for _ in range(count)]
    rank = generator(spec.seed, "dataset", "split").permutation(spec.scenes).tolist()
    return [ordered[i] for i in rank]


@lru_cache(maxsize=1)
def maker_hash() -> str:
    """SHA-256 of all that determines the contents of a set's files: the code, and the libraries that it uses."""
    digest = hashlib.sha256(code_hash().encode())
    here = Path(__file__).parent
    for path in sorted({path for pattern in _MAKERS for path in here.glob(pattern)}):
        digest.update(path.relative_to(here).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def spec_hash(spec: DatasetSpec) -> str:
    """SHA-256 of a specification."""
    return hashlib.sha256(json.dumps(as_table(spec), sort_keys=True).encode()).hexdigest()


def manifest_of(spec: DatasetSpec, scenes: Sequence[SceneRecord], others: Mapping[str, FileRecord]) -> bytes:
    """The manifest as JSON: the same bytes for the same set, in whatever order its scenes were made.

    Parameters
    ----------
    scenes
        In the order of their numbers.
    others
        The files that belong to no scene.
    """
    files = {path: each for scene in scenes for path, each in scene.files.items()} | dict(others)
    parts = {part: [scene.number for scene in scenes if scene.split == part] for part in ("train", "val", "test")}
    table: dict[str, Any] = {
        "name": spec.name,
        "description": spec.description,
        "layout": spec.layout,
        "pairs": spec.pairs,
        "licence": LICENCE,
        "provenance": list(PROVENANCE),
        "omnirange": __version__,
        "code_sha256": maker_hash(),
        "spec_sha256": spec_hash(spec),
        "scenes": parts,
        "files": {path: {"sha256": files[path].sha256, "bytes": files[path].size} for path in sorted(files)},
    }
    return (json.dumps(table, indent=0) + "\n").encode()


def readme_of(spec: DatasetSpec, of_layout: str) -> bytes:
    """README.txt."""
    contents = f"{spec.pairs} pairs of images with their truth over {spec.scenes} random scenes"
    colour = "in colour" if spec.colour else "in grey"
    about = f"{spec.name}: {spec.description}\n\n" if spec.description else f"{spec.name}\n\n"
    licence = textwrap.fill(f"Licence: {LICENCE}. {' '.join(PROVENANCE)}", 120)
    return (
        f"{about}{contents}, {colour}, {spec.rig.width_px} x {spec.rig.height_px} pixels. No scene is in two parts.\n\n"
        f"{of_layout}\n"
        "manifest.json has the SHA-256 of every file; dataset.toml what the set was drawn from;\n"
        f"omnirange dataset check DIR looks for what is wrong.\n\n{licence}\n"
    ).encode()
