"""OCamCalib's text file (calib_results.txt): direct and inverse polynomial, centre, affine part, size.

The centre is (row, column), the size is height before width, and x counts rows: (row, column) = [c d; e 1] (x, y) +
centre. The ray of a pixel is (x, y, a_0 + a_1 rho + ...) with rho = |(x, y)| in pixels and a_0 < 0: the optical axis is
-z. The usual frame of a camera is then (X, Y, Z) = (y, x, -z), a rotation.
"""

import numpy as np

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.display import shortened
from harness.geometry.angles import Array
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, keys_of
from harness.io.calibrations.values import number, refusal, whole

_MUCH_PX = 0.5
"""RMS, in pixels, up to which the two polynomials of a file may differ without a warning."""
_MOST = 64
"""The most coefficients of a polynomial: as many as OCamCalib's own reader takes."""
DIRECT, INVERSE, CENTRE, AFFINE, SIZE = (
    "direct polynomial",
    "inverse polynomial",
    "center",
    "affine parameters",
    "image size",
)


def recognises(content: Content) -> bool:
    """Whether the file begins with two counted lists of numbers, or with OCamCalib's first comment."""
    if content.syntax != "text":
        return False
    first = content.text.lstrip().partition("\n")[0].lower()
    if first.startswith("#") and "polynomial" in first:
        return True
    words = _words(content)
    try:
        direct = int(words[0])
        inverse = int(words[1 + direct])
        [float(word) for word in words[: direct + inverse + 9]]
    except (ValueError, IndexError):
        return False
    return 2 <= direct <= _MOST and 0 <= inverse <= _MOST and len(words) >= direct + inverse + 9


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    words = _words(content)
    direct = _counted(content, words, DIRECT, least=2)
    inverse = _counted(content, words, INVERSE, least=0)
    row, column = _take(content, words, 2, CENTRE)
    c, d, e = _take(content, words, 3, AFFINE)
    height, width = (whole(content, each, SIZE) for each in _take(content, words, 2, SIZE))
    notes: list[str] = []
    doubts: list[str] = []
    if words:
        notes.append(f"what follows the image size is ignored: {shortened(' '.join(words))}")
    if inverse:
        text, much = _agreement(np.array(direct), np.array(inverse), row, column, (height, width))
        (doubts if much else notes).append(text)
    camera = CalibratedCamera(
        name="",
        model={"kind": "ocam", "coefficients": direct, "c": c, "d": d, "e": e},
        camera={"cx_px": column, "cy_px": row},
        size=(width, height),
        keys={"model.coefficients": DIRECT, "camera.cx_px": CENTRE, "camera.cy_px": CENTRE}
        | {f"model.{each}": AFFINE for each in "cde"}
        | {"camera.width_px": SIZE, "camera.height_px": SIZE},
        notes=tuple(notes),
        doubts=tuple(doubts),
    )
    return Calibration(content.file, "ocamcalib", (camera,))


def inverse_radius(inverse: Array, theta: Array) -> Array:
    """The radius rho, pixels, by the inverse polynomial, with coefficients of ascending powers of theta.

    theta
        Angle above the plane z = 0, radians; -pi/2 on the axis.
    """
    return np.asarray(np.polynomial.polynomial.polyval(theta, inverse), dtype=np.float64)


def _reach(row: float, column: float, shape: tuple[int, int]) -> float:
    """The distance of the farthest corner of the image from the centre, pixels."""
    return max(np.hypot(row - at_row, column - at_column) for at_row in (0, shape[0]) for at_column in (0, shape[1]))


def _monotonic(direct: Array, rho: Array) -> tuple[Array, Array]:
    """The radii up to which the angle above the plane z = 0 grows, and these angles."""
    theta = np.arctan2(np.polynomial.polynomial.polyval(rho, direct), rho)
    grows = np.logical_and.accumulate(np.concatenate([[True], np.diff(theta) > 0]))
    return rho[grows], theta[grows]


def _agreement(direct: Array, inverse: Array, row: float, column: float, shape: tuple[int, int]) -> tuple[str, bool]:
    """A sentence on how far the two polynomials of a file differ, and whether that is too much.

    They are compared up to the farthest side of the image: image circles end before its corners.
    """
    reach = max(row, shape[0] - 1 - row, column, shape[1] - 1 - column)
    rho, theta = _monotonic(direct, np.linspace(0.0, reach, 400))
    difference = np.abs(inverse_radius(inverse, theta) - rho)
    rms = float(np.sqrt(np.mean(difference**2)))
    text = (
        f"the direct polynomial is used; the file's inverse polynomial is off by {difference.max():.2g} px at most and "
        f"{rms:.2g} px RMS up to {rho[-1]:.0f} px from the centre"
    )
    if rms < _MUCH_PX:
        return text, False
    return f"{text}; programs that project with it get other pixels", True


def _words(content: Content) -> list[str]:
    lines = (line.partition("#")[0] for line in content.text.splitlines())
    return " ".join(lines).split()


def _counted(content: Content, words: list[str], key: str, least: int) -> list[float]:
    (count,) = _take(content, words, 1, key)
    if not least <= whole(content, count, key) <= _MOST:
        raise refusal(
            content, key, f"must begin with the number of its coefficients, {least} to {_MOST}; found {count:g}"
        )
    return _take(content, words, int(count), key)


def _take(content: Content, words: list[str], count: int, key: str) -> list[float]:
    """The next `count` numbers, removed from `words`."""
    if len(words) < count:
        raise refusal(content, key, f"must be {count} numbers; the file ends after {len(words)} of them")
    taken = [number(content, word, key) for word in words[:count]]
    del words[:count]
    return taken


def write(optics: Optics) -> str:
    """The text of a calib_results.txt; its inverse polynomial is fitted to the direct one over the image."""
    camera, keys = optics.camera, keys_of(optics)
    direct = np.array(keys["coefficients"])
    inverse = fitted_inverse(direct, _reach(camera.cy_px, camera.cx_px, (camera.height_px, camera.width_px)))
    parts = {
        "polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). "
        "These are used by cam2world": [
            direct.size,
            *direct.tolist(),
        ],
        "polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). "
        "These are used by world2cam": [inverse.size, *inverse.tolist()],
        'center: "row" and "column", starting from 0 (C convention)': [camera.cy_px, camera.cx_px],
        'affine parameters "c", "d", "e"': [keys[name] for name in "cde"],
        'image size: "height" and "width"': [camera.height_px, camera.width_px],
    }
    return "\n".join(f"#{title}\n\n{' '.join(map(repr, values))}\n" for title, values in parts.items())


def fitted_inverse(direct: Array, reach: float) -> Array:
    """The inverse polynomial up to a radius in pixels.

    Its degree is the lowest that is accurate to a thousandth of a pixel, or the best one up to 24.
    """
    rho, theta = _monotonic(direct, reach * 0.5 * (1 - np.cos(np.linspace(0, np.pi, 1001))))
    best: Array = np.zeros(1)
    least = np.inf
    for degree in range(3, 25):
        coefficients = np.asarray(np.polynomial.Polynomial.fit(theta, rho, degree).convert().coef, dtype=np.float64)
        difference = float(np.abs(inverse_radius(coefficients, theta) - rho).max())
        if difference < least:
            best, least = coefficients, difference
        if least < 1e-3:
            break
    return best


OCAMCALIB = Format("OCamCalib (text)", recognises, read, (Target("ocam"),), write)
