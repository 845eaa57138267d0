"""A sensor written as another program's calibration: exactly if the format allows it, else by the closest camera."""

from dataclasses import dataclass
from typing import Any

from harness.camera.model_fitting import Conversion, Target, compared_pixels, convert
from harness.camera.models import BUILT_IN
from harness.camera.optics import optics_of
from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.errors import InputError, nearest
from harness.io.calibrations import FORMATS
from harness.spec import as_table, dump_toml, parse

TOML = "toml"
"""The name of our own format among the output formats."""
_NO_LENS = "equirectangular"


@dataclass(frozen=True, repr=False)
class WrittenSensor(OneLine):
    """The text of a calibration file, and the residuals of its camera against the sensor."""

    text: str
    format: str
    kind: str
    """The `kind` of the camera model that was written."""
    conversion: Conversion


def formats() -> tuple[str, ...]:
    """The names of the output formats."""
    return (TOML, *FORMATS)


def written(sensor: Sensor, to: str, kind: str | None = None) -> WrittenSensor:
    """The text of a sensor as a calibration file, and its residuals.

    Among the format's camera models, takes the one that represents the sensor exactly, or else the one with the
    smallest RMS residual in pixels.

    Parameters
    ----------
    to
        A name in `formats()`.
    kind
        The camera model to write; any model of the format when None.

    Raises
    ------
    InputError
        When the format is unknown, does not have the model, or none of its models approximates the sensor.
    """
    if to not in formats():
        raise InputError(f"unknown format '{to}'; {nearest(to, formats())}", key="--to")
    targets = _targets(sensor, to, kind)
    pixels = compared_pixels(sensor)
    optics = optics_of(sensor)
    if to == TOML and targets[0].kind == _kind(sensor):
        return WrittenSensor(dump_toml(sensor), to, targets[0].kind, convert(optics, pixels, targets[0]))
    best: tuple[Target, Conversion] | None = None
    failure: InputError | None = None
    for target in targets:
        try:
            conversion = convert(optics, pixels, target)
        except InputError as error:
            failure = error
            continue
        if best is None or (conversion.is_exact, -conversion.rms_px) > (best[1].is_exact, -best[1].rms_px):
            best = target, conversion
        if conversion.is_exact:
            break
    if best is None:
        raise InputError(str(failure), key="--to")
    target, conversion = best
    text = _our_text(sensor, conversion, target.kind) if to == TOML else FORMATS[to].write(conversion.optics)
    return WrittenSensor(text, to, target.kind, conversion)


def _kind(sensor: Sensor) -> str:
    return str(getattr(sensor.model, "kind", ""))


def _targets(sensor: Sensor, to: str, kind: str | None) -> list[Target]:
    """The models that may be written, the likely exact ones first."""
    own = _kind(sensor)
    targets = [Target(each) for each in BUILT_IN if each != _NO_LENS] if to == TOML else list(FORMATS[to].targets)
    if to == TOML:
        kind = kind or own
        targets += [Target(own)] if own not in BUILT_IN or own == _NO_LENS else []
    chosen = [each for each in targets if kind in (None, each.kind)]
    if not chosen:
        known = ", ".join(dict.fromkeys(each.kind for each in targets))
        raise InputError(f"{to} has no model '{kind}'; it has {known}", key="--model")
    if own == _NO_LENS and [each.kind for each in chosen] != [own]:
        raise InputError("an equirectangular panorama cannot be written in another camera model", key="--to")
    return sorted(chosen, key=lambda each: each.kind != own)


def _our_text(sensor: Sensor, conversion: Conversion, kind: str) -> str:
    """The sensor's TOML with another model; mount and field are unchanged."""
    optics = conversion.optics
    table: dict[str, Any] = as_table(sensor)
    table |= {"model": as_table(optics.model) | {"kind": kind}, "camera": as_table(optics.camera)}
    table["lens"] = as_table(optics.lens)
    table["mount"] |= {"looks": sensor.looks, "mirrored": sensor.mirrored}  # models have defaults of their own
    return dump_toml(parse(Sensor, table, file="--model"))
