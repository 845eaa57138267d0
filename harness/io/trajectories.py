"""Trajectory files of other programs: one pose in each line, by TUM's or KITTI's convention."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.io.calibrations.record import Content

_KINDS = {8: "TUM", 12: "KITTI"}
"""Formats by count of numbers in a line: `time x y z qx qy qz qw`, or the 3 x 4 matrix [R | t], row by row."""
_ORTHOGONAL = 1e-3
"""Tolerance of a rotation's orthonormality: KITTI's files have seven digits, others four."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(OneLine):
    """The poses of a moving frame in a fixed one."""

    file: Path
    kind: str
    """`TUM` or `KITTI`."""
    T_world_from_frame: Array
    """`[poses, 4, 4]`, metres."""

    def transform(self, first: int, second: int) -> Array:
        """`[4, 4]`: a point in the frame at pose `first`, in the frame at pose `second`.

        Raises
        ------
        InputError
            When there is no such pose.
        """
        count = len(self.T_world_from_frame)
        for number in (first, second):
            if not 0 <= number < count:
                raise InputError(f"there is no pose {number}; the file has 0 to {count - 1}", file=self.file)
        at_first, at_second = self.T_world_from_frame[[first, second]]
        return np.linalg.inv(at_second) @ at_first


def is_trajectory(content: Content) -> bool:
    """Whether the first line that is no comment holds 8 or 12 numbers."""
    lines = _lines(content.text)
    return bool(lines) and len(lines[0][1]) in _KINDS and all(map(_is_number, lines[0][1]))


def read_trajectory(content: Content) -> Trajectory:
    """Read the poses of a file that `is_trajectory`.

    Raises
    ------
    InputError
        When a line has another count of words than the first, a word is no finite number, or the rotation is none;
        names the file and the line.
    """
    lines = _lines(content.text)
    count = len(lines[0][1])
    for number, words in lines:
        if len(words) != count:
            problem = f"must hold {count} numbers, as the first line does; found {len(words)}"
            raise InputError(problem, file=content.file, key=f"line {number}")
        wrong = next((word for word in words if not _is_number(word)), None)
        if wrong is not None:
            raise InputError(f"'{wrong}' is not a finite number", file=content.file, key=f"line {number}")
    values = np.array([words for _, words in lines], dtype=np.float64)
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    if count == 8:
        poses[:, :3, 3], quaternions = values[:, 1:4], values[:, 4:]
        _check([n for n, _ in lines], abs(np.linalg.norm(quaternions, axis=1) - 1), "quaternion's length", content.file)
        poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    else:
        poses[:, :3] = values.reshape(-1, 3, 4)
        R = poses[:, :3, :3]
        deviation = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
        _check([n for n, _ in lines], deviation, "rotation matrix times its transpose", content.file)
        # The nearest rotation, as the file has few digits.
        poses[:, :3, :3] = Rotation.from_matrix(R).as_matrix()
    return Trajectory(content.file, _KINDS[count], poses)


def _lines(text: str) -> list[tuple[int, list[str]]]:
    """Numbers and words of the lines that hold something; `#` begins a comment, commas separate as blanks do."""
    split = [(i, re.split(r"[\s,]+", line.strip())) for i, line in enumerate(text.splitlines(), 1)]
    return [(i, words) for i, words in split if words[0] and not words[0].startswith("#")]


def _is_number(word: str) -> bool:
    try:
        return bool(np.isfinite(float(word)))
    except ValueError:
        return False


def _check(numbers: list[int], deviation: Array, what: str, file: Path) -> None:
    worst = int(np.argmax(deviation))
    if deviation[worst] > _ORTHOGONAL:
        problem = f"must hold a rotation: the {what} is off 1 by {deviation[worst]:.2g}"
        raise InputError(problem, file=file, key=f"line {numbers[worst]}")
