"""The work of a worker, in this process, in another, or on another machine: a batch of trials in, their rows out."""

import hashlib
import json
import threading
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness import interrupts
from harness.errors import InputError, described, printable
from harness.files import cache_folder, read_regular, replace_file
from harness.matching.interface import Matches
from harness.pipeline.environment import code_hash
from harness.pipeline.maps import maps_of, write_maps
from harness.pipeline.render_cache import RenderCache
from harness.pipeline.row import row_of
from harness.pipeline.specification import Trial
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import Outcome, run_trial
from harness.runs.experiment import Planned
from harness.runs.store import Finished
from harness.simulation.fingerprint import LARGEST_ASSET_BYTES, files_read, fingerprint
from harness.spec import as_table

_CODE = code_hash()
"""The hash of the modules as they are loaded: taken now, as the files may be changed under a long run."""


@dataclass(frozen=True)
class Batch:
    """Trials to run one after the other, in a form that can be sent to a worker."""

    code: str
    """`code_hash` of the caller."""
    trials: tuple[tuple[str, str, dict[str, Any]], ...]
    """The key of each trial, its scene's fingerprint and its table."""
    scene_files: tuple[str, ...]
    """The file of each trial's scene, for messages."""
    threads: int | None = 1
    """The threads of one trial; all available CPUs when None. No row depends on it."""
    maps: str | None = None
    """The folder in which to keep every trial's maps, absolute; None to keep none."""
    files: dict[str, bytes] = field(default_factory=dict)
    """The contents of the scenes' files by path, for a worker that does not have them."""


def pack(
    trials: Sequence[Planned], *, threads: int | None = 1, maps: Path | None = None, with_files: bool = False
) -> Batch:
    """Make a batch.

    Parameters
    ----------
    maps
        The folder in which to keep the trials' maps, see `pipeline.maps`.
    with_files
        Whether the worker may be on another machine.
    """
    scenes = {each.trial.scene for each in trials} if with_files else ()
    read = {path: files for scene in scenes for path, files in files_read(scene).items()}
    for path, files in read.items():
        if len(files) > 1:
            raise InputError("consists of several files, which are not sent to workers; save it as GLB", file=path)
    return Batch(
        code=code_hash(),
        trials=tuple((each.key, fingerprint(each.trial.scene), as_table(each.trial)) for each in trials),
        scene_files=tuple(each.scene_file for each in trials),
        threads=threads,
        maps=None if maps is None else str(maps),
        files={str(path): read_regular(path, LARGEST_ASSET_BYTES) for path in read},
    )


def work(batch: Batch) -> list[Finished]:
    """Run a batch. A failed trial becomes a row like any other, and the next one is run.

    Raises
    ------
    InputError
        When the code here differs from the caller's.
    """
    if batch.code != _CODE:
        raise InputError(
            "a worker has another version of omnirange or of its libraries; install the same one everywhere"
        )
    here = {path: str(_laid_down(path, content)) for path, content in batch.files.items()}
    maps = None if batch.maps is None else Path(batch.maps)
    return [
        _finish(key, scene, _replaced(table, here), scene_file, batch.threads, maps)
        for (key, scene, table), scene_file in zip(batch.trials, batch.scene_files, strict=True)
    ]


def run_here(
    trial: Trial, *, threads: int | None = None, answer: Matches | None = None, scene_file: str = ""
) -> Outcome:
    """Run a trial with this thread's cache; see `trial.run_trial`."""
    if not hasattr(_local, "cache"):
        _local.cache = StageCache(backing={"render": RenderCache()})
    return run_trial(trial, _local.cache, threads=threads, answer=answer, scene_file=scene_file)


def forget() -> None:
    """Drop this thread's cache."""
    _local.__dict__.clear()


_local = threading.local()


def _finish(
    key: str, scene: str, table: dict[str, Any], scene_file: str, threads: int | None, maps: Path | None
) -> Finished:
    try:
        outcome = run_here(_asked_for(key, table), threads=threads, scene_file=scene_file)
        payload = json.dumps(row_of(outcome), allow_nan=False)
        if maps is not None:  # before the row: a trial that is done has its maps
            write_maps(maps_of(outcome), maps)
    except BaseException as error:
        if interrupts.is_real(error):  # also one that a library has wrapped into an error of its own
            raise KeyboardInterrupt from error
        # Whatever else it is, it is this trial's alone, and kept.
        refused = isinstance(error, InputError)
        message = str(error) if refused else described(error)
        trace = printable(traceback.format_exc())
        return Finished(key, scene, "failed", json.dumps({"refused": refused}), message=message, traceback=trace)
    return Finished(key, scene, "done", payload=payload, seconds=json.dumps(outcome.seconds))


def _asked_for(key: str, table: dict[str, Any]) -> Trial:
    trial = Trial.model_validate(table)
    if trial.key != key:  # files of the scene or the matcher, here or since the run began
        raise InputError("a file of the scene or of the matcher differs here, or has changed since the run began")
    return trial


def _laid_down(path: str, content: bytes) -> Path:
    """A file with this content in the cache; its ending says how it is to be read."""
    cache = cache_folder()
    if cache is None:
        raise InputError("there is no home folder for the scenes' files; set a folder", key="OMNIRANGE_CACHE")
    copy = cache / "files" / f"{hashlib.sha256(content).hexdigest()}{Path(path).suffix}"
    if not (copy.is_file() and copy.read_bytes() == content):
        copy.parent.mkdir(parents=True, exist_ok=True)
        replace_file(copy, content)
    return copy


def _replaced(value: Any, words: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(each, words) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, words) for each in value]
    return words.get(value, value) if isinstance(value, str) else value
