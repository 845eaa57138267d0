"""What a calibration file says, in the terms of a sensor file: the record that every reader makes."""

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
    """The text of a calibration file and what a parser makes of it."""

    file: Path
    """For messages."""
    syntax: str
    """`yaml`, `xml`, `json`, `toml`, or `text` for all else."""
    text: str
    data: Any = None
    """The parsed text: tables, lists, text and numbers; None for `text`."""

    @property
    def table(self) -> Mapping[str, Any]:
        """The parsed text where it is a table; an empty one where it is not."""
        return self.data if isinstance(self.data, Mapping) else {}


@dataclass(frozen=True, repr=False)
class CalibratedCamera(OneLine):
    """One camera of a calibration file. Tables and keys are those of a sensor file."""

    name: str
    """What the file calls it, such as `cam0`; may be empty."""
    model: dict[str, Any]
    """`kind` and the model's own keys."""
    camera: dict[str, float]
    """Focal length, aspect, skew and centre; pixel centres at the integers."""
    lens: dict[str, float] = field(default_factory=dict)
    size: tuple[int, int] | None = None
    """Width and height, pixels; None where the file does not say."""
    keys: dict[str, str] = field(default_factory=dict)
    """Where a value of a sensor file, by its dotted key, comes from: the key in this file, for messages."""
    notes: tuple[str, ...] = ()
    """What a user should know of how the file was read, one sentence each."""
    doubts: tuple[str, ...] = ()
    """What every user of the file has to know, likewise: it is a warning where the sensor is used."""
    angle_max_deg: float | None = None
    """How far the lens sees off its optical axis; None where the file does not say."""
    T_cam_from_first: Array | None = None
    """`[4, 4]`: a point in the frame of the file's first camera in this one's, metres; None where it is not told."""


@dataclass(frozen=True, repr=False)
class Calibration(OneLine):
    """All cameras of a calibration file."""

    file: Path
    format: str
    """A name in `READERS`."""
    cameras: tuple[CalibratedCamera, ...]


def keys_of(optics: Optics) -> dict[str, Any]:
    """The model's keys, `kind` among them."""
    return optics.model.model_dump()


def focal_lengths(optics: Optics) -> tuple[float, float]:
    """Along u and along v, pixels."""
    return optics.camera.focal_px, optics.camera.focal_px * optics.camera.aspect


@dataclass(frozen=True)
class Reader:
    """A kind of calibration file that is read."""

    title: str
    """For people: `Kalibr camchain`."""
    recognises: Callable[[Content], bool]
    """Whether a file is of this kind, by what is in it."""
    read: Callable[[Content], Calibration]
    """Raises an `InputError` with file and key where something is missing, wrong or not supported."""


@dataclass(frozen=True)
class Format(Reader):
    """A kind of calibration file that is written, too."""

    targets: tuple[Target, ...]
    """The models that it can hold, and what it has room for beside them."""
    write: Callable[[Optics], str]
    """The text of a file with one camera, whose model is that of a target."""
