"""Small data sets, one of each layout, for the tests of what makes, checks and reads them."""

from pathlib import Path

from harness.datasets.loading import load_spec
from harness.datasets.making import Journal, make
from harness.datasets.specification import DatasetSpec
from harness.runs.executors import Backend, backend_for

_SPLIT = {"train": 0.5, "val": 0.0, "test": 0.5}
_SIZES = {
    "rooms": {"width_px": 200, "height_px": 150},
    "panoramas": {"width_px": 200, "height_px": 100},
    "fisheyes": {"width_px": 160, "height_px": 160},
    "reconstructions": {"width_px": 160, "height_px": 120},
}
NAMES = tuple(_SIZES)
"""Shipped specifications, one for each layout."""


def small(name: str, **changed: object) -> DatasetSpec:
    """A shipped specification with two scenes of two small pairs."""
    from harness import shipped
    from harness.toml import read_toml

    table = read_toml(shipped.find("datasets", name))
    table |= {"scenes": 2, "pairs_per_scene": 2, "split": _SPLIT, "samples": 4, "colour": name == "reconstructions"}
    table["rig"] |= _SIZES[name] | {"centre_px": 1.0}
    table["furniture"] = {"boxes": [1, 3], "tables": [0, 1], "curved": [1, 1], "poles": [1, 1], "boards": [1, 1]}
    return load_spec(table | changed)


def made(spec: DatasetSpec, folder: Path, backend: Backend | None = None) -> Path:
    """The set in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    make(spec, folder, backend or backend_for(0.0, 1, workers=1), Journal(spec, folder))
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    """The contents of all files in a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
