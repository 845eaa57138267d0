"""Kalibr's camchain YAML: `omni`, `eucm`, `ds` and `pinhole` cameras, and the motion from each to the next one."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.errors import with_article
from harness.io.calibrations.opencv import PERSPECTIVE
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, focal_lengths, keys_of
from harness.io.calibrations.values import member, numbers, pixels, refusal, table, transform

INTRINSICS = {
    "omni": "xi fu fv pu pv",
    "eucm": "alpha beta fu fv pu pv",
    "ds": "xi alpha fu fv pu pv",
    "pinhole": "fu fv pu pv",
}
"""The order of `intrinsics`."""
_DISTORTION = {"none": "", "radtan": "k1 k2 p1 p2", "equidistant": "k1 k2 k3 k4", "fov": "w"}
_SUPPORTED = {
    "omni": ("none", "radtan"),
    "eucm": ("none",),
    "ds": ("none",),
    "pinhole": ("none", "radtan", "equidistant"),
}
_KINDS = {"omni": "unified", "eucm": "eucm", "ds": "double_sphere", "pinhole": "unified"}


def recognises(content: Content) -> bool:
    """Whether the file has tables cam0, cam1, ... with a `camera_model`."""
    return any(isinstance(each, Mapping) and "camera_model" in each for each in _chain(content).values())


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    cameras: list[CalibratedCamera] = []
    T_cam_from_first = np.eye(4)
    is_placed = True
    for i, (name, value) in enumerate(_chain(content).items()):
        entry = table(content, value, name)
        camera = _camera(content, entry, name)
        if i:
            is_placed = is_placed and "T_cn_cnm1" in entry
        if i and is_placed:
            T_cam_from_first = transform(content, entry["T_cn_cnm1"], f"{name}.T_cn_cnm1") @ T_cam_from_first
        cameras.append(replace(camera, T_cam_from_first=T_cam_from_first if is_placed else None))
    return Calibration(content.file, "kalibr", tuple(cameras))


def _chain(content: Content) -> dict[str, Any]:
    names = [str(key) for key in content.table if re.fullmatch(r"cam\d{1,4}", str(key))]
    return {name: content.table[name] for name in sorted(names, key=lambda name: int(name[3:]))}


def _camera(content: Content, entry: Mapping[str, Any], name: str) -> CalibratedCamera:
    model = _word(content, entry, name, "camera_model", tuple(INTRINSICS))
    distortion = (
        _word(content, entry, name, "distortion_model", tuple(_DISTORTION))
        if (model not in ("eucm", "ds") or "distortion_model" in entry)
        else "none"
    )
    if distortion not in _SUPPORTED[model]:
        known = " or ".join(_SUPPORTED[model])
        raise refusal(
            content,
            f"{name}.distortion_model",
            f"{distortion} of {with_article(model)} camera is not supported, only {known}",
        )
    intrinsics = numbers(content, *member(content, entry, "intrinsics", name), INTRINSICS[model])
    values = dict(zip(INTRINSICS[model].split(), intrinsics, strict=True))
    fu, fv = values.pop("fu"), values.pop("fv")
    if not (fu > 0 and fv > 0):
        raise refusal(content, f"{name}.intrinsics", f"fu and fv must be above 0; found {fu:g} and {fv:g}")
    camera = {"focal_px": fu, "aspect": fv / fu, "cx_px": values.pop("pu"), "cy_px": values.pop("pv")}
    terms: list[float] = []
    if distortion != "none" or "distortion_coeffs" in entry:
        coefficients, key = member(content, entry, "distortion_coeffs", name)
        terms = numbers(content, coefficients, key, _DISTORTION[distortion])
    named = dict(zip(_DISTORTION[distortion].split(), terms, strict=True))
    if distortion == "equidistant":
        ours: dict[str, Any] = {"kind": "kannala_brandt"} | named
    else:
        ours = {"kind": _KINDS[model]} | ({"xi": 0.0} if model == "pinhole" else values)
    return CalibratedCamera(
        name=name,
        model=ours,
        camera=camera,
        lens=named if distortion == "radtan" else {},
        size=pixels(content, *member(content, entry, "resolution", name)),
        keys={f"camera.{each}": f"{name}.intrinsics" for each in camera}
        | {f"model.{each}": f"{name}.intrinsics" for each in values}
        | {"camera.width_px": f"{name}.resolution", "camera.height_px": f"{name}.resolution"}
        | {"lens": f"{name}.distortion_coeffs"},
        notes=(PERSPECTIVE,) if ours["kind"] == "unified" and model == "pinhole" else (),
    )


def _word(content: Content, entry: Mapping[str, Any], name: str, key: str, known: tuple[str, ...]) -> str:
    value, at = member(content, entry, key, name)
    word = str(value).strip().lower()
    word = {"equi": "equidistant"}.get(word, word)
    if word not in known:
        raise refusal(content, at, f"'{word}' is not supported, only {', '.join(known)}")
    return word


def write(optics: Optics) -> str:
    """The text of a camchain with one camera, cam0."""
    camera, keys = optics.camera, keys_of(optics)
    shape = {"unified": ["xi"], "eucm": ["alpha", "beta"], "double_sphere": ["xi", "alpha"], "kannala_brandt": []}
    intrinsics = [*(keys[name] for name in shape[keys["kind"]]), *focal_lengths(optics), camera.cx_px, camera.cy_px]
    terms: list[float] = []
    distortion = "none"
    if keys["kind"] == "unified":
        distortion, terms = "radtan", [getattr(optics.lens, name) for name in ("k1", "k2", "p1", "p2")]
    elif keys["kind"] == "kannala_brandt":
        distortion, terms = "equidistant", [keys[name] for name in ("k1", "k2", "k3", "k4")]
    model = {"unified": "omni", "eucm": "eucm", "double_sphere": "ds", "kannala_brandt": "pinhole"}[keys["kind"]]
    lines = [
        "cam0:",
        "  cam_overlaps: []",
        f"  camera_model: {model}",
        f"  distortion_coeffs: {_listed(terms)}",
        f"  distortion_model: {distortion}",
        f"  intrinsics: {_listed(intrinsics)}",
        f"  resolution: [{camera.width_px}, {camera.height_px}]",
        "  rostopic: /cam0/image_raw",
    ]
    return "\n".join([*lines, ""])


def _listed(values: list[float]) -> str:
    """A list of floats that YAML 1.1 reads back as numbers: a number with an exponent needs a decimal point."""
    words = (repr(float(value)) for value in values)
    return f"[{', '.join(word if '.' in word else word.replace('e', '.0e') for word in words)}]"


_TARGETS = (
    Target("unified", skew=False, k3=False),
    Target("eucm", skew=False),
    Target("double_sphere", skew=False),
    Target("kannala_brandt", skew=False),
)
KALIBR = Format("Kalibr camchain (YAML)", recognises, read, _TARGETS, write)
