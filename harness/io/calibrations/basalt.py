"""basalt's calibration JSON: `value0` with lists of intrinsics, resolutions and poses relative to the IMU."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.model_fitting import Target
from harness.camera.optics import Optics
from harness.geometry.angles import Array
from harness.io.calibrations.opencv import PERSPECTIVE
from harness.io.calibrations.record import CalibratedCamera, Calibration, Content, Format, focal_lengths, keys_of
from harness.io.calibrations.values import member, number, pixels, refusal, table

_OWN = {
    "ds": ("double_sphere", {"xi": "xi", "alpha": "alpha"}),
    "eucm": ("eucm", {"alpha": "alpha", "beta": "beta"}),
    "ucm": ("eucm", {"alpha": "alpha"}),
    "kb4": ("kannala_brandt", {"k1": "k1", "k2": "k2", "k3": "k3", "k4": "k4"}),
    "pinhole": ("unified", {}),
}
"""This program's kind for each `camera_type`, and basalt's keys by this program's."""
_MORE: dict[str, dict[str, Any]] = {"ucm": {"beta": 1.0}, "pinhole": {"xi": 0.0}}
_NOTES = {"ucm": "ucm is eucm with beta = 1", "pinhole": PERSPECTIVE}


def recognises(content: Content) -> bool:
    """Whether the file has basalt's `value0.intrinsics`."""
    inside = content.table.get("value0")
    return content.syntax == "json" and isinstance(inside, Mapping) and "intrinsics" in inside


def read(content: Content) -> Calibration:
    """See `Format.read`."""
    root = table(content, content.table["value0"], "value0")
    entries = _list(content, root["intrinsics"], "value0.intrinsics")
    sizes = _list(content, *member(content, root, "resolution", "value0"))
    if len(sizes) != len(entries):
        raise refusal(content, "value0.resolution", f"must be a list of {len(entries)}; found a list of {len(sizes)}")
    transforms: list[Array | None] = [None] * len(entries)
    if "T_imu_cam" in root:
        poses = _list(content, root["T_imu_cam"], "value0.T_imu_cam")
        if len(poses) != len(entries):
            problem = f"must be a list of {len(entries)}; found a list of {len(poses)}"
            raise refusal(content, "value0.T_imu_cam", problem)
        T_imu_cam = [_pose(content, pose, f"value0.T_imu_cam[{i}]") for i, pose in enumerate(poses)]
        transforms = [np.linalg.inv(each) @ T_imu_cam[0] for each in T_imu_cam]
    cameras = [
        _camera(
            content, entry, f"value0.intrinsics[{i}]", pixels(content, size, f"value0.resolution[{i}]"), transform, i
        )
        for i, (entry, size, transform) in enumerate(zip(entries, sizes, transforms, strict=True))
    ]
    return Calibration(content.file, "basalt", tuple(cameras))


def _list(content: Content, value: Any, key: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise refusal(content, key, "must be a list with an entry for each camera")
    return value


def _camera(
    content: Content, entry: Any, key: str, size: tuple[int, int], T_cam_from_first: Array | None, index: int
) -> CalibratedCamera:
    kind, kind_key = member(content, table(content, entry, key), "camera_type", key)
    if kind not in _OWN:
        raise refusal(content, kind_key, f"'{kind}' is not supported, only {', '.join(_OWN)}")
    value, above = member(content, entry, "intrinsics", key)
    inside = table(content, value, above)
    ours, names = _OWN[kind]
    fx, fy, cx, cy = (number(content, *member(content, inside, name, above)) for name in ("fx", "fy", "cx", "cy"))
    for name, focal in (("fx", fx), ("fy", fy)):
        if not focal > 0:
            raise refusal(content, f"{above}.{name}", f"must be above 0; found {focal:g}")
    terms = {name: number(content, *member(content, inside, theirs, above)) for name, theirs in names.items()}
    return CalibratedCamera(
        name=f"camera {index}",
        model={"kind": ours} | terms | _MORE.get(kind, {}),
        camera={"focal_px": fx, "aspect": fy / fx, "cx_px": cx, "cy_px": cy},
        size=size,
        keys={f"model.{name}": f"{above}.{theirs}" for name, theirs in names.items()}
        | {"camera.cx_px": f"{above}.cx", "camera.cy_px": f"{above}.cy", "camera.focal_px": f"{above}.fx"}
        | dict.fromkeys(("camera.width_px", "camera.height_px"), f"value0.resolution[{index}]"),
        notes=(_NOTES[kind],) if kind in _NOTES else (),
        T_cam_from_first=T_cam_from_first,
    )


def _pose(content: Content, value: Any, key: str) -> Array:
    """The rigid motion `[4, 4]` of a position and a unit quaternion."""
    inside = table(content, value, key)
    values = {
        name: number(content, *member(content, inside, name, key))
        for name in ("px", "py", "pz", "qx", "qy", "qz", "qw")
    }
    quaternion = [values[name] for name in ("qx", "qy", "qz", "qw")]
    if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
        raise refusal(content, key, "qx, qy, qz, qw must be of unit length")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = [values[name] for name in ("px", "py", "pz")]
    return pose


def write(optics: Optics) -> str:
    """The text of a calibration with one camera; all IMU parameters are zero or identity."""
    camera, keys = optics.camera, keys_of(optics)
    kind = {"double_sphere": "ds", "eucm": "eucm", "kannala_brandt": "kb4"}[keys["kind"]]
    fx, fy = focal_lengths(optics)
    intrinsics = {"fx": fx, "fy": fy, "cx": camera.cx_px, "cy": camera.cy_px}
    intrinsics |= {name: keys[name] for name in _OWN[kind][1].values()}
    root = {
        "T_imu_cam": [{"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}],
        "intrinsics": [{"camera_type": kind, "intrinsics": intrinsics}],
        "resolution": [[camera.width_px, camera.height_px]],
        "calib_accel_bias": [0.0] * 9,
        "calib_gyro_bias": [0.0] * 12,
        "imu_update_rate": 200.0,
        "accel_noise_std": [0.0] * 3,
        "gyro_noise_std": [0.0] * 3,
        "accel_bias_std": [0.0] * 3,
        "gyro_bias_std": [0.0] * 3,
        "cam_time_offset_ns": 0,
        "vignette": [],
    }
    return f"{json.dumps({'value0': root}, indent=4)}\n"


_TARGETS = tuple(Target(kind, skew=False) for kind in ("double_sphere", "eucm", "kannala_brandt"))
BASALT = Format("basalt (JSON)", recognises, read, _TARGETS, write)
