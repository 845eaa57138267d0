"""Calibration files of other programs, one module per format; formats are recognised by content."""

from pathlib import Path

from harness.errors import InputError
from harness.io.calibrations.basalt import BASALT
from harness.io.calibrations.camodocal import CAMODOCAL
from harness.io.calibrations.colmap import COLMAP
from harness.io.calibrations.kalibr import KALIBR
from harness.io.calibrations.ocamcalib import OCAMCALIB
from harness.io.calibrations.omnimvs import OMNIMVS
from harness.io.calibrations.opencv import OPENCV, OPENCV_XML
from harness.io.calibrations.parsing import read_content
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, Reader

FORMATS: dict[str, Format] = {
    "camodocal": CAMODOCAL,
    "kalibr": KALIBR,
    "basalt": BASALT,
    "opencv": OPENCV,
    "opencv-xml": OPENCV_XML,
    "ocamcalib": OCAMCALIB,
    "colmap": COLMAP,
}
"""The formats that can also be written, by name."""
READERS: dict[str, Reader] = {**FORMATS, "omnimvs": OMNIMVS}
"""The formats by name, in the order in which they are tried."""

__all__ = [
    "FORMATS",
    "READERS",
    "CalibratedCamera",
    "Calibration",
    "Format",
    "Reader",
    "calibration_in",
    "read_calibration",
]


def read_calibration(file: Path) -> Calibration:
    """The cameras in a calibration file of any known format.

    Raises
    ------
    InputError
        When the file cannot be read, is of no known format, or is invalid; names the file and the key.
    """
    return calibration_in(read_content(file))


def calibration_in(content: Content) -> Calibration:
    """The cameras in a parsed calibration file; raises as `read_calibration`."""
    for known in READERS.values():
        if known.recognises(content):
            return known.read(content)
    titles = ", ".join(each.title for name, each in READERS.items() if name != "opencv-xml")
    problem = f"is neither a sensor file nor a calibration in a known format; known are a sensor's TOML, {titles}"
    raise InputError(problem, file=content.file)
