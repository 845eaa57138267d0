"""Calibration files of other programs, one file a format, told apart by what is in them."""

from pathlib import Path

from harness.errors import InputError
from harness.io.calibrations.basalt import BASALT
from harness.io.calibrations.camodocal import CAMODOCAL
from harness.io.calibrations.colmap import COLMAP
from harness.io.calibrations.kalibr import KALIBR
from harness.io.calibrations.ocamcalib import OCAMCALIB
from harness.io.calibrations.opencv import OPENCV
from harness.io.calibrations.parsing import read_content
from harness.io.calibrations.record import CalibratedCamera, Calibration, Format

FORMATS: dict[str, Format] = {
    "camodocal": CAMODOCAL,
    "kalibr": KALIBR,
    "basalt": BASALT,
    "opencv": OPENCV,
    "ocamcalib": OCAMCALIB,
    "colmap": COLMAP,
}
"""By name, in the order in which a file is held against them."""

__all__ = ["FORMATS", "CalibratedCamera", "Calibration", "Format", "read_calibration"]


def read_calibration(file: Path) -> Calibration:
    """The cameras in a calibration file of any known format.

    Raises
    ------
    InputError
        When the file cannot be read, is of no known format, or is wrong; names the file and the key.
    """
    content = read_content(file)
    for known in FORMATS.values():
        if known.recognises(content):
            return known.read(content)
    titles = ", ".join(each.title for each in FORMATS.values())
    raise InputError(
        f"is no sensor file and no calibration of a known kind; known are a sensor's TOML, {titles}", file=file
    )
