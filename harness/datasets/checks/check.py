"""All checks of a data set, in order."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from harness.datasets.checks.agreement import check_correspondences, check_disparity
from harness.datasets.checks.duplicates import check_duplicates
from harness.datasets.checks.files import check_checksums, check_readable, is_whole
from harness.datasets.checks.finding import Finding, StoredSet
from harness.datasets.checks.images import check_images, check_outlines
from harness.datasets.checks.planes import check_planes
from harness.datasets.checks.values import check_values
from harness.datasets.layouts import LAYOUTS
from harness.datasets.layouts.reading import read_json
from harness.datasets.manifest import MANIFEST
from harness.errors import InputError, nearest


@dataclass(frozen=True)
class Check:
    """A check of a set."""

    name: str
    title: str
    """What it asks."""
    run: Callable[[StoredSet], Iterator[Finding]]
    of_files: bool = False
    """Whether it looks at pairs that cannot be read, too."""


CHECKS = (
    Check("checksums", "every file is as the manifest says", check_checksums, of_files=True),
    Check("readable", "images and maps can be read and have their sizes", check_readable, of_files=True),
    Check("duplicates", "no scene or image is in two parts of the split", check_duplicates),
    Check("values", "what was not measured does not count as measured", check_values),
    Check("planes", "ranges are ranges, not depths along an axis", check_planes),
    Check("disparity", "disparities have the unit, the sign and the formula", check_disparity),
    Check("correspondences", "correspondences are where range, motion and calibration put them", check_correspondences),
    Check("outlines", "the map lies on image 1 to a fraction of a pixel", check_outlines),
    Check("images", "images agree with ranges, poses and calibrations", check_images),
)


def open_set(folder: Path) -> StoredSet:
    """The set in a folder, of whatever layout.

    Raises
    ------
    InputError
        When the folder is none, or laid out in no known way, or what says what there is cannot be read.
    """
    if not folder.is_dir():
        raise InputError("is no folder of a data set", file=folder)
    layout = next((each for each in LAYOUTS.values() if each.recognises(folder)), None)
    if layout is None:
        known = ", ".join(each.title for each in LAYOUTS.values())
        raise InputError(f"is laid out in no known way; known are {known}", file=folder)
    pairs = tuple(layout.read(folder))
    if not pairs:
        raise InputError(f"has {layout.title} layout, and no pair in it", file=folder)
    manifest = folder / MANIFEST
    return StoredSet(folder, layout, pairs, read_json(manifest) if manifest.is_file() else None)


def check_set(data: StoredSet, names: Sequence[str] = ()) -> Iterator[tuple[Check, list[Finding]]]:
    """Each check with what it found, one after the other. What cannot be read is left out by all that come later.

    Parameters
    ----------
    names
        Of the checks; all of them when there are none.

    Raises
    ------
    InputError
        When there is no check of a name.
    """
    every = [check.name for check in CHECKS]
    for name in names:
        if name not in every:
            raise InputError(f"unknown check '{name}'; {nearest(name, every)}", file="--only")
    whole = data
    for check in CHECKS:
        if names and check.name not in names:
            continue
        if not check.of_files and whole is data:
            whole = replace(data, pairs=tuple(pair for pair in data.pairs if is_whole(pair)))
        yield check, list(check.run(data if check.of_files else whole)) if whole.pairs else []
