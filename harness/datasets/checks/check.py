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
    """The question that it answers."""
    run: Callable[[StoredSet], Iterator[Finding]]
    of_files: bool = False
    """Whether it includes pairs that cannot be read."""
    applies: Callable[[StoredSet], bool] = lambda _: True
    """Whether it applies to a set: the set has the data that it checks."""


def _has_maps(*quantities: str) -> Callable[[StoredSet], bool]:
    """Whether a pair of a set has maps of all of these quantities, or any map if no quantity is named."""

    def applies(data: StoredSet) -> bool:
        of_pairs = ({map_.quantity for map_ in pair.maps} for pair in data.pairs)
        return any(set(quantities) <= each and bool(each) for each in of_pairs)

    return applies


def _has_manifest(data: StoredSet) -> bool:
    return data.manifest is not None


def _has_correspondences(data: StoredSet) -> bool:
    return any(pair.match is not None or pair.observed is not None for pair in data.pairs)


def _has_image_maps(data: StoredSet) -> bool:
    return any(pair.maps and pair.maps[0].is_image for pair in data.pairs)


def _has_points(data: StoredSet) -> bool:
    return any(pair.maps or pair.observed is not None for pair in data.pairs)


def _has_ranges(data: StoredSet) -> bool:
    return any(pair.maps and pair.maps[0].quantity != "disparity" for pair in data.pairs)


CHECKS = (
    Check("checksums", "every file is as the manifest says", check_checksums, True, _has_manifest),
    Check("readable", "images and maps can be read and have their sizes", check_readable, True),
    Check("duplicates", "no scene or image is in two parts of the split", check_duplicates),
    Check("values", "what was not measured does not count as measured", check_values, applies=_has_maps()),
    Check("planes", "ranges are ranges, not depths along an axis", check_planes, applies=_has_ranges),
    Check(
        "disparity",
        "disparities have the unit, the sign and the formula",
        check_disparity,
        applies=_has_maps("range", "disparity"),
    ),
    Check(
        "correspondences",
        "correspondences are where range, motion and calibration put them",
        check_correspondences,
        applies=_has_correspondences,
    ),
    Check("outlines", "the map lies on image 1 to a fraction of a pixel", check_outlines, applies=_has_image_maps),
    Check("images", "images agree with ranges, poses and calibrations", check_images, applies=_has_points),
)


def open_set(folder: Path) -> StoredSet:
    """The set in a folder, of whatever layout.

    Raises
    ------
    InputError
        When there is no such folder, it has no known layout, or the files that list its contents cannot be read.
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


def check_set(data: StoredSet, names: Sequence[str] = ()) -> Iterator[tuple[Check, list[Finding] | None]]:
    """Each check with its findings, one after the other; None for a check that does not apply to the set.

    What cannot be read is left out by all checks that come later.

    Parameters
    ----------
    names
        Names of the checks; all of them when empty.

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
        looked_at = data if check.of_files else whole
        yield check, list(check.run(looked_at)) if looked_at.pairs and check.applies(looked_at) else None
