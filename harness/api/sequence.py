"""Range from a sequence of images: each with the next, one after the other."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from pydantic import TypeAdapter

from harness.api.loading import load_sensor
from harness.api.motion import MotionEstimate, estimate_motion
from harness.api.ranging import estimate_range
from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.errors import InputError
from harness.files import PAGE_MARK, OwnFiles, check_folder, check_no_others, make_folder, read_regular, write
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion
from harness.images import LIMIT_BYTES
from harness.matching.interface import MatcherSettings
from harness.pipeline.photographs import OF_A_RANGE
from harness.spec import as_table
from harness.version import __version__

_SUMMARY = "pair.json"
OF_A_SEQUENCE = OwnFiles(
    "range of a sequence",
    dict.fromkeys(("range.html", "points.ply")) | {"sequence.json": b'[\n  {\n    "left": '},
    {"range.html": PAGE_MARK + b' sequence">'},
)
"""The files of a folder with the ranges of a sequence, beside the folders of its pairs."""
_OF_A_PAIR = OwnFiles("pair of a sequence", {**OF_A_RANGE.marks, _SUMMARY: b'{\n  "key": "'})


@dataclass(frozen=True, repr=False)
class PairRange(OneLine):
    """The results of one pair of a sequence."""

    left: str
    right: str
    """The images."""
    folder: str
    """The folder of its files, in the sequence's folder."""
    status: str
    """Status of the motion: `given`, or the status from `estimate_motion`."""
    reasons: tuple[str, ...]
    """The reasons why the motion is not reliable, or why there is no range."""
    verdict: str
    """The verdict on the geometry; empty without ranges."""
    density: float
    """Share of the panorama with a range."""
    median_m: float | None
    """Median range, metres, or baselines where `has_metres` is false."""
    median_sigma_m: float | None
    has_metres: bool
    R_v2_from_v1: tuple[tuple[float, ...], ...] | None
    t_v1: tuple[float, ...] | None
    """The motion; None if it is unknown."""


@dataclass(frozen=True, repr=False)
class SequenceRange(OneLine):
    """The results of a sequence."""

    pairs: tuple[PairRange, ...]
    folder: Path

    @property
    def is_connected(self) -> bool:
        """Whether every motion is known in metres, so that all points are in one frame."""
        return all(each.has_metres and each.t_v1 is not None for each in self.pairs)


def estimate_sequence(
    images: Sequence[str | Path],
    sensor: str | Path | Mapping[str, Any] | Sensor,
    folder: str | Path,
    motions: Sequence[Motion] | None = None,
    matcher: str | Mapping[str, Any] | MatcherSettings = "slanted",
    *,
    baseline_m: float | None = None,
    grid: Grid | Literal["auto"] | None = None,
    bits: int | None = None,
    scale: float = 1.0,
    fit_limits: bool = False,
    tell: Callable[[PairRange], None] = lambda _: None,
) -> SequenceRange:
    """Estimate range from each image of a sequence with the next, and write everything into a folder.

    A pair whose folder holds its result for the same images and settings is not matched again: an interrupted sequence
    goes on where it was.

    Parameters
    ----------
    images
        Paths of two images or more, in their order.
    sensor
        Of all images, as for `estimate_range`.
    folder
        For `range.html`, a page on all pairs; `sequence.json`; `points.ply` with all points in the first view's frame,
        where every motion is known in metres; and a folder for each pair, as `RangeEstimate.write` writes it.
    motions
        From each image to the next; estimated from the images when None.
    matcher, grid, bits, scale, fit_limits
        As for `estimate_range`.
    baseline_m
        The distance between all successive viewpoints where motions are estimated, if it is known.
    tell
        Called with each pair as it is done.

    Returns
    -------
    SequenceRange

    Raises
    ------
    InputError
        One line that names the argument or the file and what would be right.

    Examples
    --------
    >>> import harness
    >>> images = [f"frame{i}.png" for i in range(10)]
    >>> sequence = harness.estimate_sequence(images, "sensor.toml", "ranges")  # doctest: +SKIP
    """
    if len(images) < 2:
        raise InputError(f"must be two images or more; found {len(images)}", key="images")
    if motions is not None and len(motions) != len(images) - 1:
        raise InputError(
            f"must be one for each image but the last, {len(images) - 1}; found {len(motions)}", key="motions"
        )
    loaded, out = load_sensor(sensor), Path(folder)
    _prepare(out, len(images) - 1)
    table = as_table(matcher) if isinstance(matcher, MatcherSettings) else matcher
    panorama = as_table(grid) if isinstance(grid, Grid) else grid
    settings = [__version__, as_table(loaded), table, panorama, bits, baseline_m, scale, fit_limits]
    ranging = {"grid": grid, "bits": bits, "scale": scale, "fit_limits": fit_limits}
    names, done = _names([Path(each) for each in images]), []
    for i, (left, right) in enumerate(pairwise(images)):
        motion = None if motions is None else motions[i]
        inside = _folder_of(out, i)
        key = _key(settings, (Path(left), Path(right)), motion)
        pair = _earlier(inside, key)
        if pair is None:
            pair = _estimated(Path(left), Path(right), loaded, motion, matcher, inside, baseline_m, ranging)
            write(inside / _SUMMARY, json.dumps({"key": key, "sizes": _sizes(inside)} | asdict(pair), indent=2) + "\n")
        pair = replace(pair, left=names[i], right=names[i + 1])
        done.append(pair)
        tell(pair)
    sequence = SequenceRange(tuple(done), out)
    _write(sequence)
    return sequence


def folders_of_others(sequence: SequenceRange) -> list[str]:
    """The folders of pairs in a sequence's folder that are of a longer one, matched there before."""
    mine = {each.folder for each in sequence.pairs}
    return sorted(each.parent.name for each in sequence.folder.glob(f"*/{_SUMMARY}") if each.parent.name not in mine)


def _prepare(out: Path, pairs: int) -> None:
    """Make the folder of a sequence, unless files are there that are not of one."""
    check_no_others(out, OF_A_SEQUENCE)
    for i in range(pairs):
        check_folder(_folder_of(out, i))
        check_no_others(_folder_of(out, i), _OF_A_PAIR)
    make_folder(out)


def _folder_of(out: Path, i: int) -> Path:
    """The folder of a pair's files."""
    return out / f"{i:04d}"


def _names(images: list[Path]) -> list[str]:
    """The files' names, with their folders where some are alike."""
    names = [each.name for each in images]
    return names if len(set(names)) == len(names) else [f"{each.parent.name}/{each.name}" for each in images]


def _key(settings: list[Any], images: tuple[Path, Path], motion: Motion | None) -> str:
    contents = [hashlib.sha256(read_regular(each, LIMIT_BYTES, "image")).hexdigest() for each in images]
    moved = None if motion is None else [motion.R_v2_from_v1.tolist(), motion.t_v1.tolist()]
    text = json.dumps([settings, contents, moved], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _earlier(folder: Path, key: str) -> PairRange | None:
    """The result of an earlier call with the same key; None if there is none, or one of its files is damaged."""
    try:
        table = json.loads((folder / _SUMMARY).read_text(encoding="utf-8"))
        if table.pop("key") != key or table.pop("sizes") != _sizes(folder):
            return None
        return TypeAdapter(PairRange).validate_python(table)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _sizes(folder: Path) -> dict[str, int]:
    """The sizes of a pair's files, by name: one that was cut off, or removed, is noticed."""
    return {name: (folder / name).stat().st_size for name in OF_A_RANGE.marks if (folder / name).is_file()}


def _estimated(
    left: Path,
    right: Path,
    sensor: Sensor,
    given: Motion | None,
    matcher: str | Mapping[str, Any] | MatcherSettings,
    folder: Path,
    baseline_m: float | None,
    ranging: dict[str, Any],
) -> PairRange:
    motion: Motion | MotionEstimate
    status, reasons = "given", list[str]()
    if given is not None:
        motion = given
    else:
        motion = estimate_motion(left, right, sensor, baseline_m=baseline_m, bits=ranging["bits"])
        status, reasons = str(motion.status), list(motion.reasons)
        if motion.direction_v1 is None:
            make_folder(folder)
            for name in OF_A_RANGE.marks:  # of another pair, matched here before
                (folder / name).unlink(missing_ok=True)
            return PairRange(
                left.name, right.name, folder.name, status, tuple(reasons), "", 0.0, None, None, False, None, None
            )
    estimate = estimate_range(left, right, sensor, motion, matcher, **ranging)
    estimate.write(folder)
    known = estimate.pair.motion
    return PairRange(
        left=left.name,
        right=right.name,
        folder=folder.name,
        status=status,
        reasons=tuple(reasons),
        verdict=str(estimate.geometry.verdict),
        density=float(estimate.valid.mean()),
        median_m=_median(estimate.range_m),
        median_sigma_m=_median(estimate.sigma_m),
        has_metres=estimate.has_metres,
        R_v2_from_v1=tuple(map(tuple, known.R_v2_from_v1.tolist())),
        t_v1=tuple(known.t_v1.tolist()),
    )


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


def _write(sequence: SequenceRange) -> None:
    from harness.report.sequence_page import build_page

    out = sequence.folder
    write(out / "sequence.json", json.dumps([asdict(each) for each in sequence.pairs], indent=2) + "\n")
    viewpoints = positions(sequence)
    write(out / "range.html", build_page(sequence.pairs, viewpoints))
    if viewpoints is None:
        (out / "points.ply").unlink(missing_ok=True)  # of another sequence
    else:
        points, colours = _points(sequence)
        cloud = trimesh.PointCloud(points, colors=colours)  # type: ignore[no-untyped-call]
        write(out / "points.ply", cloud.export(file_type="ply"))  # type: ignore[no-untyped-call]


def positions(sequence: SequenceRange) -> np.ndarray | None:
    """`[views, 3]`: all viewpoints in the first view's frame, metres; None where they are not known."""
    if not sequence.is_connected:
        return None
    return np.array([T[:3, 3] for T in _transforms(sequence)])


def _transforms(sequence: SequenceRange) -> list[np.ndarray]:
    """`[4, 4]` each: points of a view's frame in the first view's."""
    transforms = [np.eye(4)]
    for each in sequence.pairs:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = np.array(each.R_v2_from_v1).T, each.t_v1
        transforms.append(transforms[-1] @ T)
    return transforms


def _points(sequence: SequenceRange) -> tuple[np.ndarray, np.ndarray]:
    """All pairs' points in the first view's frame, with their colours."""
    points, colours = [], []
    for each, T in zip(sequence.pairs, _transforms(sequence), strict=False):
        cloud: Any = trimesh.load(sequence.folder / each.folder / "points.ply")
        if len(cloud.vertices):
            points.append(np.asarray(cloud.vertices) @ T[:3, :3].T + T[:3, 3])
            colours.append(np.asarray(cloud.colors)[:, :3])
    return (np.concatenate(points), np.concatenate(colours)) if points else (np.empty((0, 3)), np.empty((0, 3)))
