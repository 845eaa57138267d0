"""Random rigs: the sensors of both views, the motion between them, and a free place for both in a room."""

import math
from typing import Any

import numpy as np

from harness.camera.mount import Mount
from harness.camera.sensor import Sensor
from harness.datasets.rooms import DrawnRoom
from harness.datasets.specification import Camera, DatasetSpec, Per, Rig, number_between
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.geometry.pose import AT_REST, Motion, Pose
from harness.io.view_folder import pose_in
from harness.simulation.noise import generator
from harness.spec import parse

_TRIES = 200
_MARGIN = 0.96
"""Part of the largest focal length that keeps the whole field on the image: room for a centre that is off."""
_FISHEYE_DEG = 110.0
"""Largest angle off the axis of a fisheye."""
_OCAM_DEGREE = 5


def draw_sensors(spec: DatasetSpec, scene: int) -> tuple[Sensor, Sensor]:
    """The true sensors of both views of a scene: of one kind, each with its own focal length and centre."""
    draws = generator(spec.seed, "dataset", "sensors", _draw_name(spec.rig.calibration_per, scene, 0))
    kind = spec.rig.cameras[int(draws.integers(len(spec.rig.cameras)))]
    return _sensor(kind, spec.rig, draws), _sensor(kind, spec.rig, draws)


def _sensor(kind: Camera, rig: Rig, draws: np.random.Generator) -> Sensor:
    """A sensor whose focal length and centre are off their round values."""
    scale = math.exp(0.01 * rig.focal_percent * float(draws.standard_normal()))
    off_u, off_v = (rig.centre_px * draws.standard_normal(2)).tolist()
    nominal = _nominal(kind, rig)
    if kind == "equirectangular":  # a whole sphere has neither
        return parse(Sensor, nominal)
    if kind == "ocam":
        a = nominal["model"]["coefficients"]
        nominal["model"]["coefficients"] = [each * scale ** (1 - power) for power, each in enumerate(a)]
    else:
        nominal["camera"]["focal_px"] = parse(Sensor, nominal).camera.focal_px * _MARGIN * scale
    at_u, at_v = (rig.width_px - 1) / 2 + off_u, (rig.height_px - 1) / 2 + off_v
    # Off the image would be refused; the draws reach so far on tiny images only.
    nominal["camera"]["cx_px"] = min(max(at_u, 0.0), rig.width_px - 1.0)
    nominal["camera"]["cy_px"] = min(max(at_v, 0.0), rig.height_px - 1.0)
    return parse(Sensor, nominal)


def _nominal(kind: Camera, rig: Rig) -> dict[str, Any]:
    """A sensor's table, with its focal length to be fitted where it has one."""
    width, height = rig.width_px, rig.height_px
    camera: dict[str, Any] = {"width_px": width, "height_px": height, "cx_px": "centre", "cy_px": "centre"}
    if kind == "equirectangular":
        return {"model": {"kind": kind}, "camera": camera | {"focal_px": width / (2 * math.pi)}}
    above = {"elevation_min_deg": 90 - _FISHEYE_DEG, "elevation_max_deg": 90.0}
    if kind == "ocam":
        model = {"kind": "ocam", "coefficients": _equidistant(_MARGIN * (min(width, height) / 2 - 1))}
        return {"model": model, "camera": camera, "field": above, "mount": {"looks": "up"}}
    fitted = camera | {"focal_px": "fit"}
    if kind == "fisheye":
        return {"model": {"kind": "kannala_brandt"}, "camera": fitted, "field": above, "mount": {"looks": "up"}}
    if kind == "perspective":
        pinhole = {"model": {"kind": "unified", "xi": 0.0}, "mount": Mount(looks="forward").model_dump()}
        return pinhole | {"camera": camera | {"focal_px": width / 2}, "field": {"angle_max_deg": 75.0}}
    return {"camera": fitted}


def _equidistant(rim_px: float) -> list[float]:
    """Coefficients of OCamCalib's polynomial of a camera that is nearly equidistant, `r = f theta` to the rim."""
    theta = np.radians(np.linspace(1.0, _FISHEYE_DEG, 200))
    r = rim_px * theta / theta[-1]
    powers = np.array([0, *range(2, _OCAM_DEGREE + 1)])
    columns = np.sin(theta)[:, None] * (r[:, None] / rim_px) ** powers
    solved = np.linalg.lstsq(columns, -np.cos(theta) * r, rcond=None)[0]
    coefficients = np.zeros(_OCAM_DEGREE + 1)
    coefficients[powers] = solved / float(rim_px) ** powers
    return [float(f"{each:.9g}") for each in coefficients]


def draw_motion(spec: DatasetSpec, scene: int, pair: int) -> Motion:
    """The motion from view 1 to view 2."""
    rig = spec.rig
    draws = generator(spec.seed, "dataset", "motion", _draw_name(rig.motion_per, scene, pair))
    low, high = np.log(rig.baseline_m)
    baseline = math.exp(number_between((low, high), draws.random()))
    elevation = math.radians(number_between(rig.elevation_deg, draws.random()))
    azimuth = draws.uniform(-np.pi, np.pi)
    level = math.cos(elevation) if abs(elevation) < math.pi / 2 else 0.0
    t_v1 = baseline * np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    turned = Pose(
        yaw_deg=float(draws.uniform(-rig.turn_deg, rig.turn_deg)),
        pitch_deg=rig.tilt_deg * float(draws.standard_normal()),
        roll_deg=rig.tilt_deg * float(draws.standard_normal()),
    )
    R = turned.R_world_from_view.T if rig.turn_deg or rig.tilt_deg else AT_REST.R_v2_from_v1
    return Motion(R_v2_from_v1=R, t_v1=t_v1)


def draw_poses(spec: DatasetSpec, room: DrawnRoom, scene: int, pair: int) -> tuple[Pose, Pose]:
    """The poses of both views: away from walls and furniture by the clearance, if one of many tries finds such a place.

    Raises
    ------
    InputError
        When the room has no free place for them at all.
    """
    rig, motion = spec.rig, draw_motion(spec, scene, pair)
    draws = generator(spec.seed, "dataset", "place", str(scene), str(pair))
    best, best_clearance = None, 0.01
    for _ in range(_TRIES):
        x, y = (draws.uniform(-0.5, 0.5, 2) * room.size_m[:2]).tolist()
        height = number_between(rig.viewpoint_height_m, draws.random())
        yaw_deg = float(draws.uniform(-180, 180))
        pitch_deg, roll_deg = (rig.sway_deg * draws.standard_normal(2)).tolist()
        first = Pose(position_m=(x, y, height), yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)
        R = first.R_world_from_view
        at = first.position_m + R @ motion.t_v1
        clearance = min(_clearance(room, np.array(first.position_m)), _clearance(room, at))
        if clearance > best_clearance:
            best, best_clearance = (first, R, at), clearance
        if clearance >= rig.clearance_m:
            break
    if best is None:
        raise InputError(
            f"scene {scene} has no free place for a baseline of {motion.baseline_m:.3g} m; use larger rooms, fewer "
            "things in them, or a shorter baseline",
            key="rig.baseline_m",
        )
    first, R, at = best
    if np.array_equal(motion.R_v2_from_v1, np.eye(3)):  # alike to the last bit
        return first, first.model_copy(update={"position_m": tuple(at.tolist())})
    return first, pose_in(Motion(R_v2_from_v1=motion.R_v2_from_v1 @ R.T, t_v1=at))


def _clearance(room: DrawnRoom, point: Array) -> float:
    """Distance of a point from walls, floor, ceiling and the cylinders around what stands there, metres."""
    length, width, height = room.size_m
    x, y, z = point.tolist()
    least = min(length / 2 - abs(x), width / 2 - abs(y), z, height - z)
    for each in room.obstacles:
        beside = math.hypot(x - each.x, y - each.y) - each.radius
        least = min(least, max(beside, z - each.high, each.low - z))
    return least


def _draw_name(per: Per, scene: int, pair: int) -> str:
    """The word that draws are named by, the same for whatever shares them."""
    return {"set": "set", "scene": str(scene), "pair": f"{scene} {pair}"}[per]
