"""Data sets in Python: make one, go through its pairs, check it, and score maps on it."""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.api.progress import Progress, someone_watches
from harness.camera.sensor import Sensor
from harness.datasets.checks.check import Check, check_set, open_set
from harness.datasets.checks.finding import Finding, StoredSet
from harness.datasets.estimates import Meaning, Quantity, estimate_of, range_of_values, read_estimate, suspicion
from harness.datasets.layouts.layout import StoredPair
from harness.datasets.layouts.reading import LIMIT_BYTES, read_levels
from harness.datasets.loading import load_spec
from harness.datasets.making import Journal, is_complete, make
from harness.datasets.scoring import Score, mean_of, mean_of_regions, nothing_for, score_pair, true_ranges
from harness.datasets.specification import DatasetSpec
from harness.display import OneLine
from harness.errors import InputError, nearest
from harness.files import OwnFiles, check_no_others, make_folder, read_regular, write
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.runs.executors import backend_for
from harness.version import __version__

OF_A_SCORE = OwnFiles(
    "score",
    {
        "score.json": b'{\n  "estimate": ',
        "scores.csv": b"pair,density,",
        "parts.csv": b"split,part,",
        "score.html": None,
    },
)
"""The files of a folder with the scores of a data set."""


@dataclass(frozen=True, eq=False, repr=False)
class DatasetPair(OneLine):
    """A pair of a data set; arrays are read from its files when they are asked for."""

    stored: StoredPair
    """The pair's files, and how they are read."""

    @property
    def name(self) -> str:
        """The pair's name, unique within the set: `train/00003/001`."""
        return self.stored.name

    @property
    def split(self) -> str:
        """`train`, `val` or `test`; empty where the set does not say."""
        return self.stored.split

    @property
    def sensors(self) -> tuple[Sensor, Sensor]:
        """The true sensors of both views."""
        first, second = self.stored.views
        return first.sensor, second.sensor

    @property
    def motion(self) -> Motion:
        """The motion from view 1 to view 2."""
        return self.stored.motion

    @property
    def images(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Both images as in their files: `[height, width]`, or `[height, width, 3]` in colour."""
        paths = [view.image for view in self.stored.views]
        first, second = (read_levels(read_regular(path, LIMIT_BYTES, "image"), path) for path in paths)
        return first, second

    @property
    def range_m(self) -> Array:
        """`[height, width]`: true ranges, metres; NaN where they are unknown.

        On the pixels of view 1's image, except in OmniMVS's layout, which has a panorama around the rig.
        """
        return true_ranges(self.stored)

    @property
    def directions(self) -> Array:
        """`[height, width, 3]`: the unit direction of each of these pixels; NaN for a pixel without one."""
        return self.stored.maps[0].directions()

    @property
    def state(self) -> NDArray[np.uint8] | None:
        """`[height, width]`: 1 where both views see the point, others as the set's README.txt says; None in a set
        without states.
        """
        return None if self.stored.state is None else self.stored.state()

    @property
    def match(self) -> Array | None:
        """`[height, width, 2]`: where image 2 has the point, (u, v), NaN where it has not; None in a set without."""
        return None if self.stored.match is None else self.stored.match()


Estimates = str | Path | Callable[[DatasetPair], NDArray[Any] | None]


@dataclass(frozen=True, eq=False, repr=False)
class DatasetScore(OneLine):
    """The scores of estimates on a data set."""

    pairs: tuple[Score, ...]
    missing: tuple[str, ...]
    """Names of the pairs without an estimate, whose density counts as 0."""
    doubt: str
    """A doubt about the unit or quantity of the first estimate, in words; empty if there is none."""
    about: dict[str, str]
    """The data set and the estimates that were scored, for the files."""

    @cached_property
    def figures(self) -> dict[str, float | None]:
        """Means over pairs, of medians as logarithms; by the names of `trials.csv`."""
        return mean_of([each.measures for each in self.pairs])

    @cached_property
    def parts(self) -> list[dict[str, Any]]:
        """The figures of parts of the picture: `split`, `part`, `pixels` and figures."""
        return mean_of_regions(self.pairs)

    def write(self, folder: str | Path) -> None:
        """Write `score.json`, `scores.csv`, `parts.csv` and `score.html` into a folder, made if it is not there.

        Raises
        ------
        InputError
            When the folder cannot be written to.
        """
        from harness.report.score_page import build_page

        folder = Path(folder)
        check_no_others(folder, OF_A_SCORE)
        make_folder(folder)
        about = {**self.about, "pairs": len(self.pairs), "missing": list(self.missing), "omnirange": __version__}
        table = {**about, "figures": self.figures, "parts": self.parts}
        write(folder / "score.json", json.dumps(table, indent=2, ensure_ascii=False) + "\n")
        write(folder / "scores.csv", _csv([{"pair": each.pair.name, **each.measures} for each in self.pairs]))
        write(folder / "parts.csv", _csv(self.parts))
        write(folder / "score.html", build_page(self.pairs, self.figures, self.parts, **self.about))


@dataclass(frozen=True, eq=False, repr=False)
class DataSet(OneLine):
    """A data set on the disk: a sequence of pairs."""

    stored: StoredSet

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.stored.pairs)

    def __iter__(self) -> Iterator[DatasetPair]:
        """The pairs, by name."""
        return map(DatasetPair, self.stored.pairs)

    def __getitem__(self, which: int | str) -> DatasetPair:
        """A pair by its number or its name."""
        if isinstance(which, int):
            return DatasetPair(self.stored.pairs[which])
        stored = next((pair for pair in self.stored.pairs if pair.name == which), None)
        if stored is None:
            names = [pair.name for pair in self.stored.pairs]
            hint = nearest(which, names)
            raise InputError(f"there is no pair '{which}'; {hint if len(hint) < 200 else 'see its names'}", key="pair")
        return DatasetPair(stored)

    def part(self, split: str) -> "DataSet":
        """The pairs of `train`, `val` or `test`.

        Raises
        ------
        InputError
            When no pair is in it.
        """
        pairs = tuple(pair for pair in self.stored.pairs if pair.split == split)
        if not pairs:
            parts = sorted({pair.split for pair in self.stored.pairs} - {""})
            raise InputError(f"no pair is in '{split}'; there are {', '.join(parts) or 'no parts'}", key="split")
        return DataSet(replace(self.stored, pairs=pairs))

    def check(self, only: Sequence[str] = ()) -> list[Finding]:
        """The faults of the set, as found by `omnirange dataset check`; empty if there are none.

        Parameters
        ----------
        only
            Names of checks; all when empty.
        """
        return [finding for _, findings in self.checks(only) for finding in findings or ()]

    def checks(self, only: Sequence[str] = ()) -> Iterator[tuple[Check, list[Finding] | None]]:
        """Each check with its findings, one after the other; None for a check that does not apply to the set."""
        return check_set(self.stored, only)

    def score(
        self,
        estimates: Estimates,
        quantity: Quantity = "range",
        *,
        scale: float | None = None,
        invalid: float | None = None,
    ) -> DatasetScore:
        """Score maps on all pairs of the set.

        Parameters
        ----------
        estimates
            A folder of maps, or one map of a set of one pair; or a function that takes a `DatasetPair` and returns its
            map, None for none.
        quantity
            What the numbers are: `range`, `inverse-range`, `disparity-deg`, `disparity-rad`, `disparity-px`, `alpha-2`.
        scale
            What a number is times this, in the quantity's unit.
        invalid
            The number that means no estimate, beside NaN and infinity.

        Raises
        ------
        InputError
            When an estimate cannot be read, has another shape than the truth, or no pair has an estimate.
        """
        meaning = Meaning(quantity, scale, invalid)
        pairs = [pair for pair in self.stored.pairs if pair.maps]
        if not pairs:
            raise InputError("has no pair with a map of truth", file=self.stored.folder)
        maps = _given(estimates, meaning) if callable(estimates) else _in_files(Path(estimates), meaning, pairs)
        scores, missing, doubt = [], [], ""
        for pair in pairs:
            range_m = maps(pair)
            if range_m is None:
                missing.append(pair.name)
                scores.append(nothing_for(pair))
                continue
            doubt = doubt if len(scores) > len(missing) else suspicion(range_m, true_ranges(pair))
            scores.append(score_pair(pair, range_m))
        source = getattr(estimates, "__name__", "a function") if callable(estimates) else str(estimates)
        about = {"estimate": source, "truth": str(self.stored.folder), "quantity": quantity}
        return DatasetScore(tuple(scores), tuple(missing), doubt, about)


def _given(
    function: Callable[[DatasetPair], NDArray[Any] | None], meaning: Meaning
) -> Callable[[StoredPair], Array | None]:
    def of(pair: StoredPair) -> Array | None:
        values = function(DatasetPair(pair))
        return None if values is None else range_of_values(np.asarray(values), meaning, pair, pair.name)

    return of


def _in_files(source: Path, meaning: Meaning, pairs: list[StoredPair]) -> Callable[[StoredPair], Array | None]:
    if not source.exists():
        raise InputError("there is no such file or folder", file=str(source))
    if source.is_file() and len(pairs) > 1:
        raise InputError(f"is one map, and the set has {len(pairs)} pairs; name one, or give a folder", file=source)
    if all(estimate_of(pair, source) is None for pair in pairs):
        raise InputError(
            f"has no estimate of any pair; that of the first may be {source / pairs[0].name}.npy", file=source
        )

    def of(pair: StoredPair) -> Array | None:
        file = estimate_of(pair, source)
        return None if file is None else read_estimate(file, meaning, pair)

    return of


def _csv(rows: list[dict[str, Any]]) -> str:
    stream = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if value is None else value for name, value in row.items()} for row in rows)
    return stream.getvalue()


def open_dataset(folder: str | Path) -> DataSet:
    """Open a data set, made here or by anybody else.

    Parameters
    ----------
    folder
        The set's folder, in omnirange's own layout, Helvipad's, OmniMVS's or COLMAP's.

    Returns
    -------
    DataSet

    Raises
    ------
    InputError
        When the folder has no known layout, or the files that list its contents cannot be read.

    Examples
    --------
    >>> import harness
    >>> small = {"name": "small", "scenes": 2, "pairs_per_scene": 1, "rig": {"width_px": 64, "height_px": 48}}
    >>> data = harness.make_dataset(small, "sets/small", workers=1)
    >>> data = harness.open_dataset("sets/small")
    >>> [pair.range_m.shape for pair in data]
    [(48, 64), (48, 64)]
    >>> data.check(only=["checksums", "planes"])
    []
    >>> round(data.score(lambda pair: 1.1 * pair.range_m).figures["range_abs_rel"], 6)
    0.1
    """
    return DataSet(open_set(Path(folder)))


def make_dataset(
    spec: str | Path | Mapping[str, Any] | DatasetSpec,
    out: str | Path,
    *,
    sets: Sequence[str] = (),
    workers: int | None = None,
    progress: bool | None = None,
) -> DataSet:
    """Make a data set, or the missing part of one that was interrupted.

    Parameters
    ----------
    spec
        A shipped name (`rooms`), the path of a TOML file, or a table like that of a file.
    out
        The set's folder.
    sets
        `key=value`: changed keys, such as `rig.width_px=320`.
    workers
        Number of processes; when None, as many as save time. The set does not depend on it.
    progress
        Whether to show progress; when None, in a terminal and in a notebook.

    Returns
    -------
    DataSet

    Raises
    ------
    InputError
        When an argument is invalid, or the folder holds something else.

    Examples
    --------
    >>> import harness
    >>> small = {"name": "small", "scenes": 2, "pairs_per_scene": 1, "rig": {"width_px": 64, "height_px": 48}}
    >>> data = harness.make_dataset(small, "sets/small", workers=1)
    >>> len(data), data[0].name
    (2, 'train/00000/000')
    """
    if workers is not None and workers < 1:
        raise InputError(f"must be at least 1; found {workers}", key="workers")
    loaded, folder = load_spec(spec, sets), Path(out)
    make_folder(folder)
    if not is_complete(loaded, folder):
        journal = Journal(loaded, folder)
        done = len(journal.done) * loaded.pairs_per_scene
        with ExitStack() as stack:
            shown = someone_watches() if progress is None else progress
            bar = stack.enter_context(Progress(loaded.name, loaded.pairs, done, "pairs")) if shown else None
            backend = backend_for(float(loaded.pairs - done), max(loaded.scenes - len(journal.done), 1), workers)
            make(loaded, folder, backend, journal, bar.count if bar else lambda _: None)
            if bar:
                bar.finish()
    return open_dataset(folder)
