"""Make a data set: scenes on an executor, files as they come, and a journal by which an interrupted set goes on."""

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness import interrupts
from harness.datasets.layouts import LAYOUTS
from harness.datasets.layouts.layout import Files, brief_of
from harness.datasets.manifest import (
    JOURNAL,
    MANIFEST,
    FileRecord,
    SceneRecord,
    file_record,
    maker_hash,
    manifest_of,
    readme_of,
    record_files,
    record_of,
    spec_hash,
    splits_of,
)
from harness.datasets.pair import make_pair
from harness.datasets.rooms import draw_room
from harness.datasets.specification import DatasetSpec
from harness.errors import InputError
from harness.files import LEFTOVER, clear_leftovers, make_folder, printable, replace_file, write
from harness.runs.executors import Backend
from harness.spec import as_table, dump_toml

_GRACE_S = 1.0
"""Seconds to wait after Ctrl-C for scenes that workers have begun."""
_CHUNK = 1 << 20


@dataclass(frozen=True)
class Job:
    """A scene to be made, in a form that can be sent to a worker."""

    code: str
    """`maker_hash` of the caller."""
    spec: dict[str, Any]
    scene: int
    split: str
    folder: str | None
    """The folder that the worker writes to; None for a worker that may be on another machine and sends the contents."""
    threads: int | None = 1


@dataclass(frozen=True)
class Made:
    """A scene that was made."""

    record: SceneRecord
    files: Files
    """The files that are still to be written: all of the scene's, or none."""


def work(job: Job) -> Made:
    """Make a scene. Its files are written here, or come back.

    Raises
    ------
    InputError
        When the code here differs from the caller's, or a scene has no room for the rig.
    """
    if job.code != maker_hash():
        raise InputError(
            "a worker has another version of omnirange or of its libraries; install the same one everywhere"
        )
    files = scene_files(DatasetSpec.model_validate(job.spec), job.scene, job.split, job.threads)
    record = record_files(job.scene, job.split, files)
    if job.folder is None:
        return Made(record, files)
    write_files(Path(job.folder), files)
    return Made(record, {})


def scene_files(spec: DatasetSpec, scene: int, split: str, threads: int | None = 1) -> Files:
    """All files of a scene with its pairs; they depend on nothing else."""
    layout, room = LAYOUTS[spec.layout], draw_room(spec, scene)
    files: Files = {}
    briefs = []
    for number in range(spec.pairs_per_scene):
        pair = make_pair(spec, room, scene, number, threads)
        files |= layout.pair_files(spec, split, pair)
        briefs.append(brief_of(spec, pair))
    return files | layout.scene_files(spec, split, scene, briefs)


def write_files(folder: Path, files: Files) -> None:
    """Write files, each whole or not at all, and remove half-written files of an earlier attempt."""
    for below in {(folder / path).parent for path in files}:
        make_folder(below)
        clear_leftovers(below)
    for path, content in files.items():
        replace_file(folder / path, content, durable=False)  # checksums reveal a loss of power


# --- What is done ---------------------------------------------------------------------------------------------------


class Journal:
    """The scenes of a set that are done: a line each, behind a first line that says of what set."""

    def __init__(self, spec: DatasetSpec, folder: Path) -> None:
        """Open the journal of a folder, or begin one.

        Raises
        ------
        InputError
            When the folder holds another set, one by other code, or something else.
        """
        self._spec, self._folder = spec, folder
        self._file = folder / JOURNAL
        self._head = f"omnirange dataset {spec_hash(spec)} {maker_hash()}"
        self.done: dict[int, SceneRecord] = {}
        if self._file.exists():
            self._resume()
        elif any(not LEFTOVER.fullmatch(path.name) for path in folder.iterdir()):
            raise InputError(
                "is not empty, and holds no set that was begun with this specification; give another folder",
                file=folder,
            )
        else:
            write(self._file, f"{self._head}\n")
            write(folder / "dataset.toml", dump_toml(spec))

    def _resume(self) -> None:
        head, *lines = self._file.read_bytes().decode(errors="replace").split("\n")
        word = head.split()
        if word[:2] != self._head.split()[:2]:
            raise InputError("is no journal of a set; give another folder", file=self._file)
        if word[:3] != self._head.split()[:3]:
            problem = "holds a set that was begun with another specification; give another folder"
            raise InputError(problem, file=self._folder)
        if head != self._head:
            raise InputError(
                "holds a set that was begun by another version of omnirange or its libraries, which may draw other "
                "numbers; finish it with that one, or give another folder",
                file=self._folder,
            )
        for line in lines:
            with suppress(ValueError, KeyError, TypeError):  # the last line may be cut off
                record = record_of(line)
                if all(_has_size(self._folder / path, each.size) for path, each in record.files.items()):
                    self.done[record.number] = record
        # A line that was cut off must not run into the next one.
        text = "\n".join([self._head, *(record.line() for record in self.done.values()), ""])
        write(self._file, text)

    def add(self, record: SceneRecord) -> None:
        """Note that a scene is done."""
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(record.line() + "\n")
        self.done[record.number] = record

    def close(self) -> None:
        """Remove the journal: the manifest says it all."""
        self._file.unlink(missing_ok=True)


def _has_size(path: Path, size: int) -> bool:
    try:
        return path.stat().st_size == size
    except OSError:
        return False


def is_complete(spec: DatasetSpec, folder: Path) -> bool:
    """Whether a folder has the manifest of this very set; if so, a remaining journal is removed.

    Raises
    ------
    InputError
        When it has, and a file is missing or not as long as it was. (`omnirange dataset check` reads all of them.)
    """
    from harness.datasets.layouts.reading import read_json

    file = folder / MANIFEST
    manifest = read_json(file) if file.is_file() else {}
    if manifest.get("spec_sha256") != spec_hash(spec):
        return False
    try:
        files = as_file_records(manifest["files"])
    except (KeyError, TypeError, ValueError, AttributeError):
        text = "has no table of the set's files with their lengths; remove the set's folder and make it again"
        raise InputError(text, file=file) from None
    damaged = [path for path, each in files.items() if not _has_size(folder / path, each.size)]
    if damaged:
        raise InputError(
            f"is missing or cut off, as {len(damaged)} of the {len(files)} files of this finished set; "
            "remove its folder and make it again",
            file=folder / damaged[0],
        )
    (folder / JOURNAL).unlink(missing_ok=True)
    return True


# --- Running --------------------------------------------------------------------------------------------------------


def make(
    spec: DatasetSpec, folder: Path, backend: Backend, journal: Journal, observe: Callable[[int], None] = lambda _: None
) -> None:
    """Make the scenes of a set that are not done, then write its manifest.

    Parameters
    ----------
    observe
        Called with the number of pairs that have just been finished.

    Raises
    ------
    InputError
        When a scene cannot be made, two pairs are alike, a worker has other code, or the workers are gone. What is
        finished is kept.
    """
    splits = splits_of(spec)
    waiting = iter([number for number in range(spec.scenes) if number not in journal.done])

    def job(number: int) -> Job:
        folder_there = None if backend.remote else str(folder.absolute())
        return Job(maker_hash(), as_table(spec), number, splits[number], folder_there, backend.threads)

    def keep(made: Made) -> None:
        if made.files:
            write_files(folder, made.files)
        journal.add(made.record)
        observe(spec.pairs_per_scene)

    with interrupts.heard(), backend.open() as executor:
        _drain(executor, (job(number) for number in waiting), backend, keep)
    _finish(spec, folder, journal, splits)


def _drain(executor: Executor, jobs: Iterable[Job], backend: Backend, keep: Callable[[Made], None]) -> None:
    """Run jobs, at most so many at once as the backend takes; on Ctrl-C keep what finishes within a second."""
    running: set[Future[Made]] = set()
    jobs = iter(jobs)
    try:
        while True:
            interrupts.check()
            while len(running) < backend.slots and (job := next(jobs, None)) is not None:
                running.add(executor.submit(work, job))
                if backend.workers == 1 and not backend.remote:
                    break  # it is done already
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                keep(_result(future, backend))
    except BaseException:
        for future in running:
            future.cancel()
        finished, _ = wait(running, timeout=_GRACE_S)
        for future in finished:
            if not future.cancelled() and future.exception() is None:
                keep(future.result())
        raise


def _result(future: Future[Made], backend: Backend) -> Made:
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise InputError(
            f"the workers {backend.name} are gone, or one ran out of memory; finished scenes are kept, run the same "
            "command to resume"
        ) from error


def _finish(spec: DatasetSpec, folder: Path, journal: Journal, splits: list[str]) -> None:
    """Write the files about the whole set, the manifest last."""
    scenes = [journal.done[number] for number in range(spec.scenes)]
    _refuse_alike(scenes)
    layout = LAYOUTS[spec.layout]
    files = layout.set_files(spec, splits) | {"README.txt": readme_of(spec, layout.readme)}
    for path, content in files.items():
        write(folder / path, content)
    others = {path: file_record(content) for path, content in files.items()}
    write(folder / MANIFEST, manifest_of(spec, scenes, others))
    journal.close()


def _refuse_alike(scenes: list[SceneRecord]) -> None:
    """Make sure that no two pairs have an image in common."""
    images = [(path, each) for scene in scenes for path, each in scene.files.items() if _is_image(path)]
    counts = Counter(each.sha256 for _, each in images)
    alike = [path for path, each in images if counts[each.sha256] > 1]
    if alike:
        raise InputError(f"two images of the set are the same: {', '.join(map(printable, alike[:2]))}")


def _is_image(path: str) -> bool:
    folders, _, name = path.rpartition("/")
    return name.endswith(".png") and (name.startswith("image_") or "images" in folders or "/cam" in folders)


@dataclass(frozen=True)
class Cost:
    """Time and disk space of a scene on one thread, and of a whole set."""

    seconds_a_pair: float
    seconds_a_scene: float
    """Seconds of a scene without its pairs."""
    bytes_a_pair: float
    bytes_a_scene: float

    def seconds(self, spec: DatasetSpec) -> float:
        """The time of a whole set on one thread, seconds."""
        return self.seconds_a_pair * spec.pairs + self.seconds_a_scene * spec.scenes

    def bytes(self, spec: DatasetSpec) -> float:
        """The files of a whole set."""
        return self.bytes_a_pair * spec.pairs + self.bytes_a_scene * spec.scenes


_MEASURED_PAIRS = 4


def measure(spec: DatasetSpec) -> Cost:
    """Time scenes of few pairs made in memory on one thread, after another, which loads and compiles what all need."""
    costs = []
    for scene, pairs in ((0, 1), (1, 1), (2, _MEASURED_PAIRS)):
        small = spec.model_copy(update={"pairs_per_scene": pairs})
        begun = time.process_time()
        files = scene_files(small, scene, "train")
        costs.append((time.process_time() - begun, float(sum(map(len, files.values())))))
    one, several = costs[1:]
    pair = [max((b - a) / (_MEASURED_PAIRS - 1), b / (2 * _MEASURED_PAIRS)) for a, b in zip(one, several, strict=True)]
    beside_pairs = [max(b - _MEASURED_PAIRS * each, 0.0) for b, each in zip(several, pair, strict=True)]
    return Cost(pair[0], beside_pairs[0], pair[1], beside_pairs[1])


def file_hash(path: Path) -> str:
    """SHA-256 of a file's contents."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def as_file_records(files: dict[str, dict[str, Any]]) -> dict[str, FileRecord]:
    """The records in a manifest's table of files."""
    return {path: FileRecord(str(each.get("sha256")), int(each.get("bytes", -1))) for path, each in files.items()}
