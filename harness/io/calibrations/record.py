"""The contents of a calibration file in the terms of a sensor file, as returned by every reader."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.display import OneLine
from harness.geometry.angles import Array


@dataclass(frozen=True)
class Content:
    """A parsed calibration file."""

    file: Path
    """The path, for messages."""
    syntax: str
    """`yaml`, `xml`, `json`, `toml`, or `text` for anything else."""
    text: str
    data: Any = None
    """The parsed text: tables, lists, text and numbers; None for `text`."""

    @property
    def table(self) -> Mapping[str, Any]:
        """The parsed text if it is a table, else an empty table."""
        return self.data if isinstance(self.data, Mapping) else {}


@dataclass(frozen=True, repr=False)
class CalibratedCamera(OneLine):
    """One camera of a calibration file. Tables and keys are those of a sensor file."""

    name: str
    """The camera's name in the file, such as `cam0`; may be empty."""
    model: dict[str, Any]
    """`kind` and the model's own keys."""
    camera: dict[str, float]
    """Focal length, aspect, skew and centre; pixel centres at the integers."""
    lens: dict[str, float] = field(default_factory=dict)
    size: tuple[int, int] | None = None
    """Width and height, pixels; None if the file does not contain them."""
    keys: dict[str, str] = field(default_factory=dict)
    """The key in this file of each value, by its dotted key in a sensor file; for messages."""
    notes: tuple[str, ...] = ()
    """Notes for the user on how the file was read, one sentence each."""
    doubts: tuple[str, ...] = ()
    """Problems of the file, one sentence each, of which every use of the sensor warns."""
    angle_max_deg: float | None = None
    """Largest angle of the field off the optical axis, degrees; None if the file does not contain it."""
    T_cam_from_first: Array | None = None
    """`[4, 4]`: takes points from the frame of the file's first camera to this one's, metres; None if it is unknown."""


@dataclass(frozen=True, repr=False)
class Calibration(OneLine):
    """All cameras of a calibration file."""

    file: Path
    format: str
    """A name in `READERS`."""
    cameras: tuple[CalibratedCamera, ...]


def keys_of(optics: Optics) -> dict[str, Any]:
    """The model's keys, including `kind`."""
    return optics.model.model_dump()


def focal_lengths(optics: Optics) -> tuple[float, float]:
    """The focal lengths along u and along v, pixels."""
    return optics.camera.focal_px, optics.camera.focal_px * optics.camera.aspect


@dataclass(frozen=True)
class Reader:
    """A format of calibration files that can be read."""

    title: str
    """The name for messages: `Kalibr camchain`."""
    recognises: Callable[[Content], bool]
    """Whether a file is of this format, by its content."""
    read: Callable[[Content], Calibration]
    """Reads a file; raises an `InputError` with file and key when something is missing, wrong or not supported."""


@dataclass(frozen=True)
class Format(Reader):
    """A format of calibration files that can also be written."""

    targets: tuple[Target, ...]
    """The camera models that the format has, with the other parameters that it can hold."""
    write: Callable[[Optics], str]
    """Writes the text of a file with one camera, whose model is that of a target."""
