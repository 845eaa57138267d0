"""A matcher in any language: a command that reads a folder of images and settings, and writes its angles into another.

Whatever the command does wrong (hang, crash, write nonsense) becomes one `InputError`.
"""

import contextlib
import glob
import hashlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import Field, JsonValue, field_validator

from harness import machine
from harness.errors import InputError
from harness.files import path_of
from harness.geometry.panorama import Grid
from harness.geometry.pose import Pose
from harness.io.view_folder import CAMERA, FILES, PANORAMA, pose_in, view_files
from harness.matching.interface import Matches, Parametrised, as_matches
from harness.matching.pair import Pair
from harness.source_files import hash_of, is_python, named_files, script_files

_MOST_FILES = 10_000
"""The most files that `files` may name."""

_LAST_OUTPUT = 400
"""Characters of stderr that a message quotes: its last lines."""

README = f"""\
Two views of one scene, for a matcher. The task: the angle alpha_2 for every pixel of view 1's panorama.

view_1/, view_2/      a folder for each view, see below
limits.toml           d_min_m, d_max_m: the ranges from viewpoint 1 to search, metres; threads: how many to use
parameters.toml       the parameters that the experiment gives, if any

Write into the output folder, in NumPy's .npy format, arrays [height, width] of float64 or float32, one value for each
pixel of view 1's panorama:

alpha_2.npy           radians, 0 .. pi; NaN where there is no match
confidence.npy        optional: higher is more confident, in any unit; NaN where there is no match, and only there
sigma_alpha_2.npy     optional: predicted standard deviation of alpha_2, radians; NaN likewise

and end with exit code 0. The working folder is temporary and is removed afterwards.

alpha_2
-------
Let x be the unit vector towards the panorama's pixel in v1's frame, t the position of viewpoint 2 in v1's frame
(view_2/pose.toml: position_m), and P = d_1 x the point that the pixel sees, d_1 metres away from viewpoint 1. Then
    alpha_1 = angle between x and t
    alpha_2 = angle between P - t and t, always larger than alpha_1 for a point that is not infinitely far
and the range follows as d_1 = |t| sin(alpha_2) / sin(alpha_2 - alpha_1). Do not write the range itself, a disparity
(alpha_2 - alpha_1), or an angle in degrees.

A point at distance d_1 along x appears in view 2's panorama in the direction d_1 x - t: at phi = atan2(y, x) and
z / sqrt(x^2 + y^2) of that vector, with no rotation left to apply.

The files of a view
-------------------
{FILES}
{CAMERA}
Both panoramas are in view 1's orientation: a rotation between the views is removed from view 2's, so that only
the translation t remains between the panoramas. The mirror images are as each camera took them.

pose.toml is in v1's frame: view 1 stands at the origin, unrotated; view 2 at t. A direction in view 2's own frame is
turned into v1's by R_world_from_view.

{PANORAMA}"""


class Program(Parametrised):
    """A matcher that is a command."""

    briefs: ClassVar[Mapping[str, str]] = {"program": "a program of your own, in any language"}

    kind: Literal["program"] = "program"
    """A program in any language."""
    command: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
    """The program and its arguments. `{input}` and `{output}` stand for the folders that it reads and writes,
    `{name}` for the parameter of that name. A relative path to a file is relative to the experiment's file."""
    files: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Other files that the program depends on: paths or patterns such as `weights/*.bin`, `lib/**/*.jl`, relative to
    the experiment's file. Their contents count as settings do."""
    timeout_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 600.0
    """Seconds after which it is killed, with all processes that it has started."""

    @field_validator("command")
    @classmethod
    def _complete(cls, command: tuple[str, ...]) -> tuple[str, ...]:
        for role in ("input", "output"):
            if not any(f"{{{role}}}" in word for word in command):
                raise ValueError(f"must name the {role} folder: no word of it contains {{{role}}}")
        return command

    @field_validator("parameters")
    @classmethod
    def _told_apart(cls, parameters: dict[str, JsonValue]) -> dict[str, JsonValue]:
        for name in ("input", "output"):
            if name in parameters:
                raise ValueError(f"'{name}' cannot be a parameter's name: {{{name}}} in command is a folder")
        return parameters

    def match(self, pair: Pair) -> Matches:
        """The matches that the program wrote for a pair.

        Raises
        ------
        InputError
            When it cannot be started, takes too long, ends with another exit code than 0, or wrote something invalid.
        """
        return as_matches(self.answer(pair), pair.grid, _name(self))

    def answer(self, pair: Pair) -> Matches:
        """The matches that the program wrote, unchecked; errors as in `match`, except for the arrays' values."""
        return answer(pair, self)

    def match_seconds(self, image_mp: float, curve_mp: float) -> None:
        """None: the time of third-party code is not known."""

    def check(self) -> None:
        """Check that the command exists."""
        check(self)

    @property
    def command_words(self) -> tuple[str, ...]:
        """The command."""
        return self.command

    def identity(self) -> str:
        """A hash of the files that the program is made of; see `digest`."""
        return digest(self)


def answer(pair: Pair, program: Program) -> Matches:
    """The matches that the program wrote, unchecked; errors as in `Program.match`, except for the arrays' values."""
    name = _name(program)
    with tempfile.TemporaryDirectory(prefix="omnirange-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        for part in ("input", "output", "work"):
            (folder / part).mkdir()
        write_input(pair, program, folder / "input")
        _run(filled_in(program, folder), program.timeout_s, folder, name)
        return _read_answer(folder / "output", pair.grid, name)


def check(program: Program) -> None:
    """Check that the command exists.

    Raises
    ------
    InputError
        `error.key` is `command` or `files`.
    """
    first = program.command[0]
    if shutil.which(first) is None:
        why = "is not executable" if Path(first).is_file() else "there is no such program"
        raise InputError(f"{first}: {why}", key="command")
    _matching_files(program.files)


def digest(program: Program) -> str:
    """SHA-256 of the files that the settings name, by their contents.

    These are the words of the command that name a file (for a Python script also the modules that it imports from its
    own folder, see `source_files.script_files`), `files`, and the parameters that name a file. A program on the search
    path counts by its contents too, unless another word names a file: then it is taken for an interpreter.

    Raises
    ------
    InputError
        When a file cannot be read, or a pattern of `files` names none or too many.
    """
    files = [Path(word) for word in program.command if Path(word).is_file()]
    if not files and (executable := shutil.which(program.command[0])):
        files = [Path(executable)]
    lines = []
    for word in files:
        scripts = script_files(word) if is_python(word) else []
        lines += [hash_of(word), *(f"{each.relative_to(word.parent).as_posix()} {hash_of(each)}" for each in scripts)]
    lines += [f"{name} {hash_of(path)}" for name, path in named_files(program.parameters.items())]
    if program.files:
        lines += ["files", *sorted(f"{path.name} {hash_of(path)}" for path in _matching_files(program.files))]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _matching_files(patterns: Sequence[str]) -> list[Path]:
    """The files that patterns name."""
    known: dict[Path, None] = {}
    for pattern in patterns:
        paths = itertools.islice(glob.iglob(pattern, recursive=True), _MOST_FILES + 1)  # noqa: PTH207 - absolute patterns
        files = [path for path in map(Path, paths) if path.is_file()]
        if not files:
            raise InputError(f"no file matches '{pattern}'", key="files")
        known |= dict.fromkeys(files)
        if len(known) > _MOST_FILES:
            raise InputError(f"more than {_MOST_FILES} files match '{pattern}'", key="files")
    return sorted(known)


def with_absolute_files(command: Sequence[Any], folder: Path, *, patterns: bool = False) -> list[Any]:
    """A command whose words are made absolute paths where they name a file in a folder.

    The first word is looked for on the search path unless there is a slash in it, as a shell does, and then beside the
    experiment.

    Parameters
    ----------
    patterns
        Whether they are the words of `files`: all of them name files.
    """
    if patterns:
        return [
            str(path_of(word, folder, key="files").absolute()) if isinstance(word, str) else word for word in command
        ]
    return [
        str(path_of(word, folder, key="command").resolve())
        if isinstance(word, str) and word and _is_file_of(folder, word, first=i == 0)
        else word
        for i, word in enumerate(command)
    ]


def _is_file_of(folder: Path, word: str, *, first: bool) -> bool:
    if first and "/" in word:
        return True
    if first and shutil.which(word) is not None:
        return False
    try:
        return path_of(word, folder).is_file()
    except InputError:  # no word that could name a file
        return False


def filled_in(program: Program, folder: Path) -> list[str]:
    """The command with the folders `input` and `output` of a folder, and with the parameters filled in."""
    values = {name: _word(value) for name, value in program.parameters.items()}
    values |= {part: str(folder / part) for part in ("input", "output")}
    return [re.sub(r"\{(\w+)\}", lambda name: values.get(name[1], name[0]), word) for word in program.command]


def _word(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def write_input(pair: Pair, program: Program, folder: Path) -> None:
    """Write a matcher's whole input, which includes neither the truth nor the scene."""
    poses = (Pose(), pose_in(pair.motion))
    turned = (np.eye(3), pair.motion.R_v2_from_v1.T)
    for view, panorama in enumerate(pair.panoramas()):
        view_folder = folder / f"view_{view + 1}"
        view_folder.mkdir()
        for name, data in view_files(
            pair.images[view], panorama, pair.sensors[view], poses[view], turned[view]
        ).items():
            (view_folder / name).write_bytes(data)
    limits = {"d_min_m": program.d_min_m, "d_max_m": program.d_max_m, "threads": pair.available_threads}
    (folder / "limits.toml").write_text(tomli_w.dumps(limits), encoding="utf-8")
    (folder / "parameters.toml").write_text(tomli_w.dumps(_without_null(program.parameters)), encoding="utf-8")
    (folder / "README.txt").write_text(README, encoding="utf-8")


def _without_null(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in parameters.items() if value is not None}


def _name(program: Program) -> str:
    """The program's name in messages: the first file among its arguments, rather than the interpreter."""
    files = [word for word in program.command[1:] if Path(word).is_file()]
    return f"program {Path((files or program.command)[0]).name}"


def _run(command: list[str], timeout_s: float, folder: Path, name: str) -> None:
    """Run a command to its end or until the time is up; no process of its group is left running."""
    log = folder / "stderr"
    with log.open("wb") as stderr, _group_that_dies_with_us() as group:
        try:
            process = subprocess.Popen(  # noqa: S603 - its purpose is to run the user's command
                command,
                cwd=folder / "work",
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                process_group=group,
            )
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be started ({getattr(error, 'strerror', None) or error})", file=name) from error
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise InputError(
                f"did not finish within timeout_s = {timeout_s:g} s, and was killed{_last_output(log)}", file=name
            ) from None
        finally:
            machine.kill(process, group)
    if code < 0:
        raise InputError(f"was ended by {_signal(-code)}{_last_output(log)}", file=name)
    if code:
        raise InputError(f"ended with exit code {code}{_last_output(log)}", file=name)


@contextlib.contextmanager
def _group_that_dies_with_us() -> Iterator[int | None]:
    """A process group that is killed if this process dies and can no longer enforce the time limit.

    Its first member waits at a pipe, which ends with the process that holds the other end. It is there before the
    program is, so that there is no moment in which a program would be left alone.
    """
    if not machine.has_process_groups():
        yield None
        return
    with subprocess.Popen(
        ["/bin/sh", "-c", "read nothing; kill -s KILL 0"],  # 0 is its own group
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        process_group=0,
    ) as watcher:
        try:
            yield watcher.pid
        finally:
            watcher.kill()


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _last_output(log: Path) -> str:
    with log.open("rb") as stream:
        stream.seek(max(0, log.stat().st_size - 4 * _LAST_OUTPUT))
        text = " ".join(stream.read().decode("utf-8", "replace").split())
    if not text:
        return "; it wrote nothing to stderr"
    return f"; its last output: {text if len(text) <= _LAST_OUTPUT else '... ' + text[-_LAST_OUTPUT:]}"


def _read_answer(folder: Path, grid: Grid, name: str) -> Matches:
    if not folder.is_dir():
        raise InputError("removed the output folder", file=name)
    alpha_2 = _read_array(folder / "alpha_2.npy", grid, name)
    if alpha_2 is None:
        present = ", ".join(sorted(path.name for path in folder.iterdir())[:5]) or "nothing"
        raise InputError(f"wrote no alpha_2.npy into the output folder, but {present}", file=name)
    confidence, sigma = (_read_array(folder / f"{each}.npy", grid, name) for each in ("confidence", "sigma_alpha_2"))
    return Matches(alpha_2, confidence, sigma)


def _read_array(path: Path, grid: Grid, name: str) -> NDArray[Any] | None:
    """The array in a file; None if there is no such file."""
    if not os.path.lexists(path):
        return None
    if not path.is_file():  # a pipe would be waited for
        raise InputError(f"{path.name} is not a file", file=name)
    try:
        # Mapped, not read: a header may claim any size, and only a file that is as long as it says can be mapped.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, TypeError, SyntaxError, OverflowError) as error:
        raise InputError(
            f"{path.name} cannot be read as a .npy file of plain numbers: cut short, pickled or of another format",
            file=name,
        ) from error
    if not isinstance(array, np.ndarray):
        array.close()
        raise InputError(f"{path.name} is an .npz archive; write the array alone", file=name)
    if array.shape != grid.shape:  # before it is copied
        raise InputError(f"{path.stem} must have the panorama's shape {grid.shape}; it has {array.shape}", file=name)
    return np.array(array)
