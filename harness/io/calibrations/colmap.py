"""COLMAP's cameras.txt: fisheyes, EUCM, and the perspective models with Brown-Conrady distortion.

COLMAP puts the corner of the first pixel at (0, 0), all others its centre: principal points shift by half a pixel.
"""

from typing import Any

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.io.calibrations.opencv import PERSPECTIVE
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, focal_lengths, keys_of
from harness.io.calibrations.values import numbers, refusal, whole

PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "EUCM": "fx fy cx cy alpha beta",
    "EQUIRECTANGULAR": "w h",
}
"""The parameters of each model in COLMAP's order, under the names of our keys."""
_NOT_SUPPORTED = ("FOV", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION")
_HALF = 0.5


def recognises(content: Content) -> bool:
    """Whether the first line that is no comment begins with a number and a word in capitals."""
    if content.syntax != "text":
        return False
    for words in _lines(content).values():
        return len(words) >= 4 and words[0].isdecimal() and words[1].replace("_", "").isalpha() and words[1].isupper()
    return False


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    cameras = [_camera(content, line, words) for line, words in _lines(content).items()]
    return Calibration(content.file, "colmap", tuple(cameras))


def _lines(content: Content) -> dict[int, list[str]]:
    """The words of each line that is no comment, by line number."""
    lines = enumerate(content.text.splitlines(), 1)
    return {number: words for number, line in lines if (words := line.partition("#")[0].split())}


def _camera(content: Content, line: int, words: list[str]) -> CalibratedCamera:
    key = f"line {line}"
    if len(words) < 4:
        raise refusal(content, key, "must be CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS")
    name, kind = words[0], words[1]
    if kind not in PARAMETERS:
        why = "is not supported" if kind in _NOT_SUPPORTED else "is not a COLMAP model"
        raise refusal(content, key, f"{kind} {why}, only {', '.join(PARAMETERS)}")
    width, height = (whole(content, word, key) for word in words[2:4])
    values = dict(zip(PARAMETERS[kind].split(), numbers(content, words[4:], key, PARAMETERS[kind]), strict=True))
    model, lens, used = _model(kind, values)
    for unused in values.keys() - used:
        if values[unused] != 0:
            raise refusal(content, key, f"{kind} with {unused} = {values[unused]:g} is not supported, only with 0")
    is_perspective = kind in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
    return CalibratedCamera(
        name=f"camera {name}",
        model=model,
        camera=_intrinsics(content, key, kind, values, (width, height)),
        lens=lens,
        size=(width, height),
        keys=dict.fromkeys(("model", "camera", "lens"), key),
        notes=(PERSPECTIVE,) if is_perspective else (),
    )


def _model(kind: str, values: dict[str, float]) -> tuple[dict[str, Any], dict[str, float], set[str]]:
    """The tables `model` and `lens`, and the names of the parameters that are used."""
    used = {"f", "fx", "fy", "cx", "cy", "w", "h"}
    if kind == "EQUIRECTANGULAR":
        return {"kind": "equirectangular"}, {}, used
    if kind == "EUCM":
        return {"kind": "eucm", "alpha": values["alpha"], "beta": values["beta"]}, {}, used | {"alpha", "beta"}
    names = ("k1", "k2", "k3", "k4") if kind.endswith("FISHEYE") else ("k1", "k2", "p1", "p2", "k3")
    terms = {each: values.get(each, 0.0) for each in names}
    if kind.endswith("FISHEYE"):
        return {"kind": "kannala_brandt"} | terms, {}, used | set(names)
    return {"kind": "unified", "xi": 0.0}, terms, used | set(names)


def _intrinsics(
    content: Content, key: str, kind: str, values: dict[str, float], size: tuple[int, int]
) -> dict[str, float]:
    if kind == "EQUIRECTANGULAR":
        width, height = size
        if (values["w"], values["h"]) != (width, height):
            raise refusal(content, key, f"w and h must be the image's size, {width} and {height}")
        focal = width / 6.283185307179586
        across = height / 3.141592653589793
        return {"focal_px": focal, "aspect": across / focal, "cx_px": width / 2 - _HALF, "cy_px": height / 2 - _HALF}
    fx = values["fx"] if "fx" in values else values["f"]
    fy = values.get("fy", fx)
    if not (fx > 0 and fy > 0):
        raise refusal(content, key, f"the focal length must be above 0; found {min(fx, fy):g}")
    return {"focal_px": fx, "aspect": fy / fx, "cx_px": values["cx"] - _HALF, "cy_px": values["cy"] - _HALF}


def write(optics: Optics) -> str:
    """The text of a cameras.txt with one camera, number 1."""
    camera, keys = optics.camera, keys_of(optics)
    fx, fy = focal_lengths(optics)
    values = {"fx": fx, "fy": fy, "cx": camera.cx_px + _HALF, "cy": camera.cy_px + _HALF} | keys
    model = {"kannala_brandt": "OPENCV_FISHEYE", "eucm": "EUCM"}[keys["kind"]]
    parameters = " ".join(repr(float(values[name])) for name in PARAMETERS[model].split())
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        "# Number of cameras: 1",
        f"1 {model} {camera.width_px} {camera.height_px} {parameters}",
    ]
    return "\n".join([*lines, ""])


_TARGETS = (Target("kannala_brandt", skew=False), Target("eucm", skew=False))
COLMAP = Format("COLMAP cameras.txt", recognises, read, _TARGETS, write)
