"""Reading a sensor from a file: a sensor's TOML, or a camera of another program's calibration."""

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from harness import shipped
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import AnyModel
from harness.camera.models.axial import AxialModel
from harness.camera.mount import Looks
from harness.camera.optics import Optics
from harness.camera.sensor import Sensor, sensor_of
from harness.errors import InputError, Notice
from harness.io.calibrations import calibration_in
from harness.io.calibrations.opencv import AMBIGUOUS
from harness.io.calibrations.parsing import read_content
from harness.io.calibrations.record import CalibratedCamera, Calibration
from harness.spec import Spec, as_given, parse

_UNMOUNTED = (
    "the file does not say how the camera is mounted; assumed: it looks up and is not mirrored; a camera below a "
    "mirror has --looks down --mirrored"
)


@dataclass(frozen=True)
class Chosen:
    """The user's choices: values that a calibration file does not contain, or that override a sensor file's."""

    camera: int | None = None
    """The number of the camera, from 0."""
    looks: Looks | None = None
    """Direction of the optical axis; up by default."""
    mirrored: bool | None = None
    """Whether the image is mirrored left to right, as a mirror's is."""
    size: tuple[int, int] | None = None
    """Width and height in pixels, for a file that does not contain them."""
    angle_max_deg: float | None = None
    """Largest angle of the field off the optical axis; by default as far as model and image allow."""
    elevation_deg: tuple[float, float] | None = None
    """The field's lowest and highest elevation."""


@dataclass(frozen=True)
class SensorFile:
    """A sensor and its origin."""

    sensor: Sensor
    calibration: Calibration | None
    """The calibration that the sensor was read from; None for a sensor's own TOML."""
    camera: CalibratedCamera | None
    notes: tuple[str, ...]
    """Notes on how the file was read, one sentence each."""


class _Parts(Spec):
    """The parts of a sensor from which its field follows."""

    model: AnyModel
    camera: Camera
    lens: Lens = Lens()


def read_sensor(file: Path, chosen: Chosen | None = None) -> SensorFile:
    """Read a sensor from a file of any known format, or a shipped one by its name.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    chosen = chosen or Chosen()
    file = shipped.or_shipped("sensors", file)
    content = read_content(file)
    if content.syntax == "toml":
        if not content.data:
            raise InputError("is empty; a sensor's file has tables such as [model] and [camera]", file=file)
        return SensorFile(_with_choices(content.data, file, chosen), None, None, ())
    calibration = calibration_in(content)
    camera = _the_camera(calibration, chosen)
    sensor, note = _sensor_of(calibration, camera, chosen)
    is_mount_given = chosen.looks is not None or chosen.mirrored is not None or not isinstance(sensor.model, AxialModel)
    unmounted = () if is_mount_given else (_UNMOUNTED,)
    return SensorFile(sensor, calibration, camera, (*camera.doubts, *camera.notes, *unmounted, *note))


def says_its_mount(file: Path) -> bool:
    """Whether a file is a sensor's own TOML, or names a shipped sensor, rather than a calibration of another program.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    return read_content(shipped.or_shipped("sensors", file)).syntax == "toml"


def load_sensor(file: Path, chosen: Chosen | None = None) -> Sensor:
    """The sensor in a file of any known format; warns (`Notice`) of assumptions, and where the file contradicts itself.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    read = read_sensor(file, chosen)
    doubts = read.camera.doubts if read.camera is not None else ()
    for doubt in (*doubts, AMBIGUOUS) if AMBIGUOUS in read.notes else doubts:
        warnings.warn(f"{file}: {doubt}", Notice, stacklevel=2)
    return read.sensor


def sensor_of_table(table: Mapping[str, Any], file: str | Path | None = None, key: str = "") -> dict[str, Any]:
    """The complete table of a sensor from a table that names a file.

    The table has the key `file`, `number` and `size` if that file needs them, and tables of a sensor whose keys
    override those of the file.

    Parameters
    ----------
    file, key
        The file and the key of the table itself, for messages.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    over = {name: value for name, value in table.items() if name not in _OF_FILE}
    named = parse(_NamedFile, {name: value for name, value in table.items() if name in _OF_FILE}, file=file, key=key)
    for name, value in over.items():
        if not isinstance(value, Mapping) and name != "mask":
            raise InputError("must be a table, whose keys override the file's", file=file, key=_below(key, name))
    mount, field = over.get("mount", {}), over.get("field", {})
    chosen = Chosen(
        camera=named.number,
        size=named.size,
        looks=mount.get("looks"),
        mirrored=mount.get("mirrored"),
        angle_max_deg=field.get("angle_max_deg"),
    )
    base = as_given(load_sensor(Path(named.file), chosen))
    for name, value in over.items():
        is_part = isinstance(value, Mapping) and name != "mask"
        base[name] = base.get(name, {}) | dict(value) if is_part else value
    return base


def _below(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


class _NamedFile(Spec):
    """The keys of a table that names a file."""

    file: str
    number: Annotated[int, Field(ge=0)] | None = None
    size: tuple[int, int] | None = None


_OF_FILE = tuple(_NamedFile.model_fields)


def _with_choices(table: dict[str, Any], file: Path, chosen: Chosen) -> Sensor:
    """The sensor of a TOML file, with the user's choices instead of its own values."""
    if chosen.camera not in (None, 0):
        raise InputError("has one camera, number 0", file=file, key="--camera")
    if chosen.size is not None:
        raise InputError("leave it out: the sensor file says its size", file=file, key="--size")
    sensor = sensor_of(table, file)
    changed = as_given(sensor)
    if chosen.looks is not None or chosen.mirrored is not None:
        changed["mount"] |= _mount(chosen)
    if chosen.angle_max_deg is not None:
        changed["field"]["angle_max_deg"] = chosen.angle_max_deg
    if chosen.elevation_deg is not None:
        changed["field"] |= _elevations(*chosen.elevation_deg)
    return parse(Sensor, changed, file=file) if changed != as_given(sensor) else sensor


def _the_camera(calibration: Calibration, chosen: Chosen) -> CalibratedCamera:
    cameras = calibration.cameras
    if chosen.camera is None and len(cameras) > 1:
        named = ((i, "" if each.name == f"camera {i}" else each.name) for i, each in enumerate(cameras))
        names = ", ".join(f"{i} ({name})" if name else str(i) for i, name in named)
        raise InputError(f"has {len(cameras)} cameras, {names}; choose one", file=calibration.file, key="--camera")
    number = chosen.camera or 0
    if not 0 <= number < len(cameras):
        last = len(cameras) - 1
        problem = f"there is no camera {number}; the file has " + ("0 alone" if not last else f"0 to {last}")
        raise InputError(problem, file=calibration.file, key="--camera")
    return cameras[number]


def _sensor_of(calibration: Calibration, camera: CalibratedCamera, chosen: Chosen) -> tuple[Sensor, tuple[str, ...]]:
    """The sensor, and a note on its field if the user did not choose one."""
    file = calibration.file
    size = camera.size
    if size is None:
        size = chosen.size
    elif chosen.size is not None and chosen.size != size:
        problem = f"the file says {size[0]} x {size[1]} pixels; leave it out"
        raise InputError(problem, file=file, key="--size")
    if size is None:
        raise InputError(
            "the file does not contain the size of the image; give its width and height", file=file, key="--size"
        )
    width, height = size
    table = {
        "model": camera.model,
        "camera": camera.camera | {"width_px": width, "height_px": height},
        "lens": camera.lens,
    }
    parts = _parsed(_Parts, table, file, camera)
    field, note = _field(parts, chosen, camera.angle_max_deg)
    table["field"] = field
    mount = _mount(chosen)
    if mount:
        table["mount"] = mount
    return _parsed(Sensor, table, file, camera), note


def _parsed(spec: Any, table: dict[str, Any], file: Path, camera: CalibratedCamera) -> Any:
    """The specification in a table; an error names the key in the file."""
    try:
        return parse(spec, table, file=file)
    except InputError as error:
        ours = error.key or ""
        first = re.match(r"\w*", error.problem)
        # An error that concerns several keys has the table's key, and its message begins with one of them.
        places = [f"{ours}.{first[0] if first else ''}", ours, ours.rpartition(".")[0], ours.partition(".")[0]]
        theirs = next((camera.keys[each] for each in places if each in camera.keys), ours)
        raise InputError(error.problem, file=file, key=theirs or None) from error


def _mount(chosen: Chosen) -> dict[str, Any]:
    return {
        name: value for name, value in (("looks", chosen.looks), ("mirrored", chosen.mirrored)) if value is not None
    }


def _elevations(low: float, high: float) -> dict[str, float]:
    return {"elevation_min_deg": low, "elevation_max_deg": high}


def _field(parts: _Parts, chosen: Chosen, by_file: float | None) -> tuple[dict[str, float], tuple[str, ...]]:
    """The table of the field: as chosen, as in the file, or as far as model and image allow."""
    model = parts.model
    if not isinstance(model, AxialModel):
        return _elevations(*(chosen.elevation_deg or (-90.0, 90.0))), ()
    optics = Optics(model, parts.camera, parts.lens)
    by_model = model.largest_angle_rad(parts.camera, parts.lens)
    by_image = optics.largest_angle_on_image()
    widest = math.floor(math.degrees(min(by_model, by_image)) * 1e6) / 1e6
    given = chosen.angle_max_deg if chosen.angle_max_deg is not None else by_file
    angle = widest if given is None else given
    looks = chosen.looks or "up"
    if looks == "up":
        elevations = (max(-90.0, 90 - angle), 90.0)
    elif looks == "down":
        elevations = (-90.0, min(90.0, angle - 90))
    else:
        elevations = (-min(90.0, angle), min(90.0, angle))
    field = _elevations(*(chosen.elevation_deg or elevations))
    if looks == "forward" or given is not None:
        field["angle_max_deg"] = angle
    if given is not None or chosen.elevation_deg is not None:
        return field, ()
    why = "the image" if by_image <= by_model else "the model"
    note = (
        f"the file does not say how far the lens sees; all that {why} allows is taken, {widest:.4g} deg off the "
        "optical axis: --angle-max narrows it"
    )
    return field, (note,)
