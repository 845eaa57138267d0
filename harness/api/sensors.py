"""Descriptions of sensors, and their conversion to calibration files of other programs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.api.loading import load_sensor
from harness.camera.central import central_of
from harness.camera.coverage import Coverage, coverage
from harness.camera.sensor import Sensor
from harness.display import OneLine
from harness.errors import InputError
from harness.files import write
from harness.io.calibrations.conversion import WrittenSensor, written
from harness.report.sensor_words import facts_of, misalignment_of, title_of, warnings_of

LARGEST_RESIDUAL_PX = 0.2
"""RMS residual, pixels, above which a conversion has to be allowed explicitly."""


@dataclass(frozen=True, repr=False)
class SensorDescription(OneLine):
    """A description of a sensor and its field of view."""

    title: str
    """Camera model and size."""
    facts: dict[str, str]
    """Facts by name: field, image circle, blind spot, resolution, used."""
    warnings: tuple[str, ...]
    """Inconsistencies, one sentence each."""
    coverage: Coverage
    """The figures: rim, blind spot, pixels per degree."""

    def __str__(self) -> str:
        """The description as lines of text."""
        width = max(map(len, self.facts))
        lines = [self.title, *(f"  {name:<{width}}  {text}" for name, text in self.facts.items())]
        return "\n".join([*lines, *(f"  ! {each}" for each in self.warnings)])

    def write(self, path: str | Path, notes: tuple[str, ...] = ()) -> None:
        """Write a page (`.html`), or the picture alone (`.svg`, `.png`).

        Parameters
        ----------
        notes
            Further sentences for the page.

        Raises
        ------
        InputError
            When it cannot be written, or has another ending.
        """
        from harness.report.sensor_page import build_page, build_picture

        path = Path(path)
        kind = path.suffix.lower().removeprefix(".")
        if kind in ("svg", "png"):
            write(path, build_picture(self.coverage, kind))
        elif kind in ("html", "htm"):
            write(path, build_page(self.coverage, self.title, self.facts, self.warnings, notes))
        else:
            raise InputError("must end in .html, .svg or .png", file=path)

    def _repr_html_(self) -> str:
        from base64 import b64encode

        from harness.report.sensor_page import build_picture

        picture = b64encode(build_picture(self.coverage, "png")).decode()
        return f'<img alt="" style="max-width: 100%" src="data:image/png;base64,{picture}">'


def describe_sensor(sensor: str | Path | Mapping[str, Any] | Sensor | None = None) -> SensorDescription:
    """Describe a sensor: field, image circle, blind spot, pixels per degree, and inconsistencies.

    Parameters
    ----------
    sensor
        As for `load_sensor`.

    Returns
    -------
    SensorDescription

    Raises
    ------
    InputError
        As for `load_sensor`, or when no pixel is in the field.

    Examples
    --------
    >>> import harness
    >>> described = harness.describe_sensor()
    >>> described.facts["image circle"]
    '476 px across, around (319.5, 239.5), all of it on the image'
    >>> described.write("sensor.html")
    """
    loaded = load_sensor(sensor)
    try:
        covered = coverage(central_of(loaded))
    except ValueError as error:
        raise InputError(str(error), key="sensor") from error
    warnings = (*misalignment_of(loaded), *warnings_of(covered))
    return SensorDescription(title_of(covered), facts_of(covered), warnings, covered)


def convert_sensor(
    sensor: str | Path | Mapping[str, Any] | Sensor,
    to: str,
    *,
    model: str | None = None,
    allow_residual_px: float = LARGEST_RESIDUAL_PX,
) -> WrittenSensor:
    """Convert a sensor to the calibration file of another program.

    The conversion is exact if the format has the sensor's model, or one that is the same in other parameters. Otherwise
    the result is the camera whose rays are closest over the pixels of the field.

    Parameters
    ----------
    sensor
        As for `load_sensor`.
    to
        `toml`, `opencv`, `opencv-xml`, `kalibr`, `camodocal`, `basalt`, `ocamcalib` or `colmap`.
    model
        The camera model to write; when None, the best one of the format.
    allow_residual_px
        The largest RMS residual that is accepted, pixels.

    Returns
    -------
    WrittenSensor
        `text`, and `conversion` with the residuals.

    Raises
    ------
    InputError
        When the format is unknown, or the closest camera has a larger residual than allowed.

    Examples
    --------
    >>> import harness
    >>> written = harness.convert_sensor({}, "kalibr", model="eucm")
    >>> written.conversion.is_exact
    True
    """
    conversion = written(load_sensor(sensor), to, model)
    fit = conversion.conversion
    if not fit.rms_px <= allow_residual_px:
        raise InputError(
            f"the nearest {fit.optics.model.title} is {fit.rms_px:.2g} px RMS away, {fit.largest_px:.2g} px at "
            "most; --allow-residual PX accepts it",
            key="--to",
        )
    return conversion
