"""CamOdoCal's YAML: `model_type` MEI (the unified model), KANNALA_BRANDT or PINHOLE."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.io.calibrations.opencv import PERSPECTIVE
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, focal_lengths, keys_of
from harness.io.calibrations.values import member, number, refusal, table, whole

_LENS = ("k1", "k2", "p1", "p2")


def recognises(content: Content) -> bool:
    """Whether the file has CamOdoCal's `model_type` and a table of parameters."""
    table = content.table
    return "model_type" in table and any(str(key).endswith("_parameters") for key in table)


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    root = content.table
    kind = str(root["model_type"]).strip().upper()
    readers = {"MEI": _mei, "KANNALA_BRANDT": _kannala_brandt, "PINHOLE": _pinhole}
    if kind not in readers:
        hint = "; give OCamCalib's own text file" if kind == "SCARAMUZZA" else ""
        raise refusal(content, "model_type", f"{kind} is not supported, only {', '.join(readers)}{hint}")
    width, height = (whole(content, *member(content, root, each)) for each in ("image_width", "image_height"))
    name = str(root.get("camera_name", "")).strip()
    camera = readers[kind](content, root)
    return Calibration(
        content.file,
        "camodocal",
        (replace(camera, name=name, size=(width, height)),),
    )


def _values(content: Content, root: Mapping[str, Any], room: str, *names: str) -> list[float]:
    value, key = member(content, root, room)
    inside = table(content, value, key)
    return [number(content, *member(content, inside, name, room)) for name in names]


def _mei(content: Content, root: Mapping[str, Any]) -> CalibratedCamera:
    (xi,) = _values(content, root, "mirror_parameters", "xi")
    lens = _values(content, root, "distortion_parameters", *_LENS)
    camera = _intrinsics(content, root, "gamma1", "gamma2", "u0", "v0")
    return CalibratedCamera("", {"kind": "unified", "xi": xi}, camera, dict(zip(_LENS, lens, strict=True)), keys=_KEYS)


def _pinhole(content: Content, root: Mapping[str, Any]) -> CalibratedCamera:
    lens = _values(content, root, "distortion_parameters", *_LENS)
    camera = _intrinsics(content, root, "fx", "fy", "cx", "cy")
    model = {"kind": "unified", "xi": 0.0}
    return CalibratedCamera("", model, camera, dict(zip(_LENS, lens, strict=True)), keys=_KEYS, notes=(PERSPECTIVE,))


def _kannala_brandt(content: Content, root: Mapping[str, Any]) -> CalibratedCamera:
    """The camera of model KANNALA_BRANDT, r = theta + k2 theta³ + k3 theta⁵ + k4 theta⁷ + k5 theta⁹."""
    theirs = _values(content, root, "projection_parameters", "k2", "k3", "k4", "k5")
    model = {"kind": "kannala_brandt"} | dict(zip(("k1", "k2", "k3", "k4"), theirs, strict=True))
    camera = _intrinsics(content, root, "mu", "mv", "u0", "v0")
    keys = _KEYS | {f"model.k{i}": f"projection_parameters.k{i + 1}" for i in (1, 2, 3, 4)}
    return CalibratedCamera("", model, camera, keys=keys)


def _intrinsics(content: Content, root: Mapping[str, Any], fu: str, fv: str, cu: str, cv: str) -> dict[str, float]:
    focal, across, cx, cy = _values(content, root, "projection_parameters", fu, fv, cu, cv)
    for name, value in ((fu, focal), (fv, across)):
        if not value > 0:
            raise refusal(content, f"projection_parameters.{name}", f"must be above 0; found {value:g}")
    return {"focal_px": focal, "aspect": across / focal, "cx_px": cx, "cy_px": cy}


_KEYS = {
    "model.xi": "mirror_parameters.xi",
    "lens": "distortion_parameters",
    "camera.cx_px": "projection_parameters",
    "camera.cy_px": "projection_parameters",
    "camera.width_px": "image_width",
    "camera.height_px": "image_height",
}


def write(optics: Optics) -> str:
    """The text of a camera of `model_type` MEI or KANNALA_BRANDT."""
    camera, lens, keys = optics.camera, optics.lens, keys_of(optics)
    fu, fv = focal_lengths(optics)
    is_mei = keys["kind"] == "unified"
    head = {
        "model_type": "MEI" if is_mei else "KANNALA_BRANDT",
        "camera_name": "camera",
        "image_width": camera.width_px,
        "image_height": camera.height_px,
    }
    centre = {"u0": camera.cx_px, "v0": camera.cy_px}
    tables: dict[str, dict[str, float]] = (
        {
            "mirror_parameters": {"xi": keys["xi"]},
            "distortion_parameters": {name: getattr(lens, name) for name in _LENS},
            "projection_parameters": {"gamma1": fu, "gamma2": fv} | centre,
        }
        if is_mei
        else {
            "projection_parameters": {f"k{i + 1}": keys[f"k{i}"] for i in (1, 2, 3, 4)} | {"mu": fu, "mv": fv} | centre
        }
    )
    lines = ["%YAML:1.0", "---", *(f"{name}: {value}" for name, value in head.items())]
    for name, values in tables.items():
        lines += [f"{name}:", *(f"   {key}: {value!r}" for key, value in values.items())]
    return "\n".join([*lines, ""])


_TARGETS = (Target("unified", skew=False, k3=False), Target("kannala_brandt", skew=False))
CAMODOCAL = Format("CamOdoCal (YAML)", recognises, read, _TARGETS, write)
