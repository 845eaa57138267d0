"""OpenCV's calibrations in FileStorage files (YAML, XML, JSON), and ROS's `camera_info`, which has the same keys.

- with `xi`: `cv2.omnidir`, the unified model with k1, k2, p1, p2;
- four coefficients without `xi`: `cv2.fisheye`, the Kannala-Brandt polynomial of the angle;
- five or more, or a file that declares it: a perspective camera, which is the unified model with xi = 0.

K may have a skew, `K[0, 1]`. Several cameras have numbered keys: K1, D1, xi1, K2, ... or camera_matrix_0, ...
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.geometry.angles import Array
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, focal_lengths, keys_of
from harness.io.calibrations.values import check_rotation, is_matrix, matrix, number, pixels, refusal, whole

_STEMS = {
    "K": ("k", "m", "cameramatrix", "intrinsicmatrix"),
    "D": ("d", "distortioncoefficients", "distcoeffs", "distortion", "cameradistortion"),
    "xi": ("xi", "cameraxi"),
}
"""Common names, in lower case and without underscores; a number may follow."""
_LENS = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE = {"fisheye", "equidistant", "kannala_brandt"}
_PERSPECTIVE = {"pinhole", "plumb_bob", "radtan", "rational_polynomial"}

AMBIGUOUS = "four distortion coefficients and no xi: read as cv2.fisheye's; a perspective camera's have a fifth, k3"
PERSPECTIVE = "a perspective camera, which is the unified model with xi = 0"


def recognises(content: Content) -> bool:
    """Whether the file has a camera matrix, or FileStorage's root element."""
    return (content.syntax == "xml" and "opencv_storage" in content.table) or (
        content.syntax in {"yaml", "xml", "json"} and bool(_cameras(_root(content)))
    )


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    root = _root(content)
    listed = _cameras(root)
    if not listed:
        there = ", ".join(map(str, root)) or "none"
        raise refusal(content, "camera_matrix", f"this key is missing (or K); there are: {there}")
    cameras = [_camera(content, root, suffix, keys) for suffix, keys in sorted(listed.items())]
    if len(cameras) == 2:
        cameras[1] = _placed(content, root, cameras[1])
    return Calibration(content.file, "opencv", tuple(cameras))


def _root(content: Content) -> Mapping[str, Any]:
    root = content.table.get("opencv_storage", content.table)
    return root if isinstance(root, Mapping) else {}


def _cameras(root: Mapping[str, Any]) -> dict[int, dict[str, str]]:
    """The keys of K, D and xi by camera number (-1 without a number)."""
    cameras: dict[int, dict[str, str]] = {}
    for key in root:
        name, digits = re.fullmatch(r"(.*?)(\d{0,3})", str(key).lower().replace("_", ""), re.DOTALL).groups()  # type: ignore[union-attr]
        for what, stems in _STEMS.items():
            if name in stems and (what == "xi" or is_matrix(root[key])):
                cameras.setdefault(int(digits or -1), {}).setdefault(what, str(key))
    return {suffix: keys for suffix, keys in cameras.items() if "K" in keys}


def _camera(content: Content, root: Mapping[str, Any], suffix: int, keys: dict[str, str]) -> CalibratedCamera:
    K = _camera_matrix(content, root[keys["K"]], keys["K"])
    name = f"camera {suffix}" if suffix >= 0 else ""
    if "D" not in keys:
        raise refusal(content, "distortion_coefficients", "this key is missing (or D); for a lens without, write zeros")
    D = matrix(content, root[keys["D"]], keys["D"]).ravel().tolist()
    kind, notes = _kind(content, root, keys, D)
    if kind == "kannala_brandt":
        model: dict[str, Any] = {"kind": kind} | dict(zip(("k1", "k2", "k3", "k4"), D, strict=True))
        lens: dict[str, float] = {}
    else:
        xi = 0.0
        if "xi" in keys:
            value = root[keys["xi"]]
            value = matrix(content, value, keys["xi"]).ravel()[0].item() if is_matrix(value) else value
            xi = number(content, value, keys["xi"])
        model = {"kind": "unified", "xi": xi}
        lens = dict(zip(_LENS, D[:5], strict=False))
    fx, fy, skew = K[0, 0].item(), K[1, 1].item(), K[0, 1].item()
    return CalibratedCamera(
        name=name,
        model=model,
        camera={"focal_px": fx, "aspect": fy / fx, "skew_px": skew, "cx_px": K[0, 2].item(), "cy_px": K[1, 2].item()},
        lens=lens,
        size=_size(content, root),
        keys={f"camera.{each}": keys["K"] for each in ("focal_px", "aspect", "skew_px", "cx_px", "cy_px")}
        | {"lens": keys["D"], "model.xi": keys.get("xi", "xi")},
        notes=notes,
    )


def _camera_matrix(content: Content, value: Any, key: str) -> Array:
    K = matrix(content, value, key)
    if K.size == 9:
        K = K.reshape(3, 3)
    if K.shape != (3, 3):
        raise refusal(content, key, f"must be 3 x 3 numbers; found {K.shape[0]} x {K.shape[1]}")
    if not (K[0, 0] > 0 and K[1, 1] > 0) or K[1, 0] != 0 or not np.array_equal(K[2], [0, 0, 1]):
        raise refusal(content, key, "must be [f_x s c_x; 0 f_y c_y; 0 0 1] with f_x and f_y above 0")
    return K


def _kind(
    content: Content, root: Mapping[str, Any], keys: Mapping[str, str], D: list[float]
) -> tuple[str, tuple[str, ...]]:
    """The model's kind, and a note on how it was chosen."""
    said = {str(root[key]).strip().lower() for key in ("distortion_model", "camera_model") if key in root}
    flag = root.get("fisheye_model")
    is_fisheye = bool(said & _FISHEYE) or (flag is not None and number(content, flag, "fisheye_model") != 0)
    is_perspective = bool(said & _PERSPECTIVE) or (flag is not None and not is_fisheye)
    if "xi" in keys:
        _check_count(content, keys["D"], D, 4, "cv2.omnidir has four coefficients, k1 k2 p1 p2")
        return "unified", ()
    if is_fisheye or (not is_perspective and len(D) == 4):
        _check_count(content, keys["D"], D, 4, "cv2.fisheye has four coefficients, k1 k2 k3 k4")
        return "kannala_brandt", () if is_fisheye else (AMBIGUOUS,)
    if len(D) not in (4, 5, 8, 12, 14):
        raise refusal(content, keys["D"], f"must be 4 coefficients, or 5 of a perspective camera; found {len(D)}")
    if any(D[5:]):
        problem = (
            "are of the rational, thin prism or tilted model, which is not supported; calibrate with k1 k2 p1 p2 k3"
        )
        raise refusal(content, keys["D"], f"the coefficients after the fifth {problem}")
    return "unified", (PERSPECTIVE,)


def _check_count(content: Content, key: str, D: list[float], count: int, text: str) -> None:
    if len(D) != count:
        raise refusal(content, key, f"{text}; found {len(D)}")


def _size(content: Content, root: Mapping[str, Any]) -> tuple[int, int] | None:
    names = {str(key).lower().replace("_", ""): str(key) for key in root}
    for width, height in (("imagewidth", "imageheight"), ("width", "height")):
        if width in names and height in names:
            return (
                whole(content, root[names[width]], names[width]),
                whole(content, root[names[height]], names[height]),
            )
    for each in ("imagesize", "resolution"):
        if each in names:
            return pixels(content, root[names[each]], names[each])
    return None


def _placed(content: Content, root: Mapping[str, Any], second: CalibratedCamera) -> CalibratedCamera:
    """The second camera, with the motion of `stereoCalibrate`: x_2 = R x_1 + T."""
    if not ("R" in root and "T" in root):
        return second
    R, T = matrix(content, root["R"], "R"), matrix(content, root["T"], "T").ravel()
    if R.size == 9:
        R = R.reshape(3, 3)
    if R.shape != (3, 3) or T.shape != (3,):
        raise refusal(content, "R" if R.shape != (3, 3) else "T", "R must be 3 x 3 numbers, T three numbers")
    check_rotation(content, R, "R")
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = R, T
    return replace(second, T_cam_from_first=transform)


def _values(optics: Optics) -> tuple[Array, list[float], dict[str, float]]:
    """K, the distortion coefficients, and further numbers by name."""
    camera, keys = optics.camera, keys_of(optics)
    fx, fy = focal_lengths(optics)
    K = np.array([[fx, camera.skew_px, camera.cx_px], [0, fy, camera.cy_px], [0, 0, 1]])
    if keys["kind"] == "kannala_brandt":
        return K, [keys[name] for name in ("k1", "k2", "k3", "k4")], {"fisheye_model": 1}
    return K, [getattr(optics.lens, name) for name in _LENS[:4]], {"xi": keys["xi"]}


def write_yaml(optics: Optics) -> str:
    """The text of a FileStorage in YAML: K, D and xi of `cv2.omnidir`, or K and D of `cv2.fisheye`."""
    K, D, more = _values(optics)
    lines = [
        "%YAML:1.0",
        "---",
        f"image_width: {optics.camera.width_px}",
        f"image_height: {optics.camera.height_px}",
        *(f"{name}: {value!r}" for name, value in more.items()),
    ]
    for name, values in (("camera_matrix", K), ("distortion_coefficients", np.array([D]))):
        rows, columns = values.shape
        numbers = ", ".join(map(repr, values.ravel().tolist()))
        lines += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
        lines.append(f"   data: [ {numbers} ]")
    return "\n".join([*lines, ""])


def write_xml(optics: Optics) -> str:
    """The text of a FileStorage in XML, with the same keys."""
    K, D, more = _values(optics)
    plain = {"image_width": optics.camera.width_px, "image_height": optics.camera.height_px} | more
    lines = ['<?xml version="1.0"?>', "<opencv_storage>"]
    lines += [f"<{name}>{value!r}</{name}>" for name, value in plain.items()]
    for name, values in (("camera_matrix", K), ("distortion_coefficients", np.array([D]))):
        rows, columns = values.shape
        numbers = " ".join(map(repr, values.ravel().tolist()))
        lines.append(f'<{name} type_id="opencv-matrix">')
        lines.append(f"  <rows>{rows}</rows>\n  <cols>{columns}</cols>\n  <dt>d</dt>")
        lines.append(f"  <data>{numbers}</data></{name}>")
    return "\n".join([*lines, "</opencv_storage>", ""])


_TARGETS = (Target("unified", k3=False), Target("kannala_brandt"))

OPENCV = Format("OpenCV FileStorage (YAML, XML or JSON)", recognises, read, _TARGETS, write_yaml)
OPENCV_XML = Format("OpenCV FileStorage (XML)", recognises, read, _TARGETS, write_xml)
