"""OmniMVS's YAML of fisheye rigs: `cameras`, each with OCamCalib's parameters in one line and its pose on the rig.

`poly` and `inv_poly` are OCamCalib's direct and inverse polynomial, each after the number of coefficients; `center`
is (row, column), `image_size` height and width, `pose` a rotation vector and a position that take the camera's points
to the rig. A camera's frame is that of the other models: X right, Y down, Z along the optical axis.

OmniMVS's own programs project with `inv_poly` alone, and the poses fit that one. If the two polynomials differ by more
than rounding, the camera is therefore a direct polynomial fitted to the inverse one.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from harness.geometry.angles import Array
from harness.io.calibrations.ocamcalib import inverse_radius
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Reader
from harness.io.calibrations.values import member, number, numbers, refusal, table, whole

_ALIKE_PX = 0.5
"""RMS difference, pixels, up to which the direct polynomial is used."""
_DEGREE = 11
"""The highest degree of the camera model; inverse polynomials of degree 12 are fitted to 0.02 px."""
_ANGLES = 2000


def recognises(content: Content) -> bool:
    """Whether the file has a list of cameras with polynomials."""
    cameras = content.table.get("cameras")
    return isinstance(cameras, list) and any(isinstance(each, Mapping) and "inv_poly" in each for each in cameras)


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    entries = [
        (table(content, each, f"cameras[{i}]"), f"cameras[{i}]") for i, each in enumerate(content.table["cameras"])
    ]
    poses = [_rig_from_camera(content, entry, name) for entry, name in entries]
    cameras = tuple(
        _camera(content, entry, name, np.linalg.inv(pose) @ poses[0])
        for (entry, name), pose in zip(entries, poses, strict=True)
    )
    return Calibration(content.file, "omnimvs", cameras)


def _camera(content: Content, entry: Mapping[str, Any], name: str, T_cam_from_first: Array) -> CalibratedCamera:
    kind, kind_key = member(content, entry, "model", name)
    if kind != "ocam":
        raise refusal(content, kind_key, f"must be ocam; found {kind}")
    direct, inverse = (_counted(content, entry, each, name) for each in ("poly", "inv_poly"))
    row, column = numbers(content, *member(content, entry, "center", name), "row column")
    c, d, e = numbers(content, *member(content, entry, "affine", name), "c d e")
    height, width = (
        whole(content, each, f"{name}.image_size")
        for each in numbers(content, *member(content, entry, "image_size", name), "height width")
    )
    fov, fov_key = member(content, entry, "max_fov", name)
    angle = number(content, fov, fov_key) / 2
    if not 0 < angle < 180:
        raise refusal(content, fov_key, f"must be above 0 and below 360 degrees; found {2 * angle:g}")
    coefficients, doubt = _one_polynomial(direct, inverse, math.radians(angle))
    return CalibratedCamera(
        name=f"camera {entry['cam_id']}" if "cam_id" in entry else "",
        model={"kind": "ocam", "coefficients": coefficients, "c": c, "d": d, "e": e},
        camera={"cx_px": column, "cy_px": row},
        size=(width, height),
        angle_max_deg=angle,
        keys={"model.coefficients": f"{name}.poly", "camera.cx_px": f"{name}.center", "camera.cy_px": f"{name}.center"}
        | {f"model.{each}": f"{name}.affine" for each in "cde"}
        | {"camera.width_px": f"{name}.image_size", "camera.height_px": f"{name}.image_size"}
        | {"field.angle_max_deg": fov_key},
        doubts=(doubt,) if doubt else (),
        T_cam_from_first=T_cam_from_first,
    )


def _counted(content: Content, entry: Mapping[str, Any], name: str, above: str) -> Array:
    value, key = member(content, entry, name, above)
    found = numbers(content, value, key)
    if len(found) < 3 or found[0] != len(found) - 1:
        raise refusal(content, key, f"must begin with the number of its coefficients, 2 or more; found {found[:1]}")
    return np.array(found[1:])


def _rig_from_camera(content: Content, entry: Mapping[str, Any], name: str) -> Array:
    pose = numbers(content, *member(content, entry, "pose", name), "r_x r_y r_z t_x t_y t_z")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(pose[:3]).as_matrix(), pose[3:]
    return T


def _one_polynomial(direct: Array, inverse: Array, angle_max: float) -> tuple[list[float], str]:
    """Coefficients of the camera's polynomial, and a warning if the file's two are not inverse to each other."""
    angle = np.linspace(0.0, angle_max, _ANGLES)[1:]
    r = inverse_radius(inverse, angle - np.pi / 2)
    # The direct polynomial's radius for an angle is where r/|Z| is its tangent; to first order the difference is:
    apart = _excess(direct, r, angle) / _excess_slope(direct, r, angle)
    rms = float(np.sqrt(np.mean(apart**2)))
    if rms < _ALIKE_PX:
        return direct.tolist(), ""
    powers = np.array([0, *range(2, _DEGREE + 1)])
    unit = float(np.abs(r).max())
    columns = np.sin(angle)[:, None] * (r[:, None] / unit) ** powers
    solved = np.linalg.lstsq(columns, -np.cos(angle) * r, rcond=None)[0]
    coefficients = np.zeros(_DEGREE + 1)
    coefficients[powers] = solved / unit**powers
    text = (
        f"its two polynomials are {rms:.2g} px RMS apart, {np.abs(apart).max():.2g} px at most; the inverse one is "
        "used, as OmniMVS projects with it"
    )
    return coefficients.tolist(), text


def _excess(direct: Array, r: Array, angle: Array) -> Array:
    """A function that is 0 when the direct polynomial has a radius at an angle off the axis."""
    return np.asarray(np.sin(angle) * np.polynomial.polynomial.polyval(r, direct) + np.cos(angle) * r)


def _excess_slope(direct: Array, r: Array, angle: Array) -> Array:
    slope = np.polynomial.polynomial.polyval(r, np.polynomial.polynomial.polyder(direct))
    return np.asarray(np.sin(angle) * slope + np.cos(angle))


OMNIMVS = Reader("OmniMVS rig (YAML)", recognises, read)
