"""The layout of OmniMVS's sets: fisheyes on a rig by OCamCalib's model, and inverse ranges on a panorama around it.

The rig's frame is X to the right, Y down, Z ahead. A pixel (x, y) of the panorama looks at the azimuth
(x - w/2) 2 pi/w from Z towards X, and at the elevation (y - (h - 1)/2)/((h - 1)/2) phi below the horizon: its first and
last rows are centred on the limits. View 1 is at the rig's origin.
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image
from scipy.spatial.transform import Rotation

from harness.camera.models.ocam import OCam
from harness.camera.sensor import Sensor, lens_from_sensor
from harness.datasets.layouts.layout import Brief, Files, Layout, PlacedView, StoredPair, TruthMap, png, spec_file
from harness.datasets.layouts.reading import known, read_array
from harness.datasets.pair import Pair
from harness.datasets.specification import DatasetSpec
from harness.errors import InputError
from harness.files import read_regular
from harness.geometry.angles import Array
from harness.geometry.pose import Motion
from harness.io.calibrations.ocamcalib import fitted_inverse
from harness.io.calibrations.rigs import transform_between
from harness.io.calibrations.sensors import Chosen, read_sensor
from harness.simulation.truth import ranges

_PHI_DEG = 45.0
_RIG_FROM_SENSOR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Turns directions of a sensor's frame (x ahead, y to the left, z up) into the rig's."""

README = """\
SCENE/
    config.yaml                   both cameras: OCamCalib's direct and inverse polynomial, centre, size, and the pose
                                  that takes a camera's points to the rig (rotation vector and position, metres)
    cam1/PAIR.png, cam2/PAIR.png  both images, 8 bits
    omnidepth_gt_WIDTH/PAIR.tiff  inverse range, 1/metres, float32, on a panorama around the rig's origin, which is the
                                  first camera's viewpoint; 0 where nothing is there
train.txt, val.txt, test.txt      the scenes of each part

Range is the Euclidean distance from the rig's origin. The rig's frame is X to the right, Y down, Z ahead. Pixel (x, y)
of a panorama w wide and h high looks at the azimuth (x - w/2) 2 pi/w from Z towards X, and (y - (h-1)/2) 90/(h-1)
degrees below the horizon.
"""


def panorama_rays(width: int, height: int, phi_deg: float = _PHI_DEG) -> Array:
    """Unit directions `[height, width, 3]` of the panorama's pixels, in the rig's frame."""
    azimuth = (np.arange(width) - width / 2) * (2 * np.pi / width)
    below = np.linspace(-np.radians(phi_deg), np.radians(phi_deg), height)[:, None]
    level = np.cos(below)
    down = np.broadcast_to(np.sin(below), (height, width))
    return np.stack([level * np.sin(azimuth), down, level * np.cos(azimuth)], axis=-1)


def _scene_folder(split: str, scene: int) -> str:  # noqa: ARG001 - the split is in lists of scenes
    return f"scene{scene:05d}"


def _pair_files(spec: DatasetSpec, split: str, pair: Pair) -> Files:
    width, height = spec.rig.width_px, spec.rig.width_px // 4
    rays = panorama_rays(width, height) @ _RIG_FROM_SENSOR
    valid = np.ones(rays.shape[:2], dtype=bool)
    range_m = ranges(pair.scene, pair.poses[0], rays, valid, threads=pair.threads)
    stream = BytesIO()
    inverse = np.nan_to_num(1 / range_m).astype(np.float32)
    Image.fromarray(inverse).save(stream, format="TIFF")
    base, number = _scene_folder(split, pair.scene_number), pair.number + 1  # counted from 1, as in OmniMVS's sets
    return {
        f"{base}/cam1/{number:04d}.png": png(pair.images[0]),
        f"{base}/cam2/{number:04d}.png": png(pair.images[1]),
        f"{base}/omnidepth_gt_{width}/{number:05d}.tiff": stream.getvalue(),
    }


def _scene_files(spec: DatasetSpec, split: str, scene: int, pairs: Sequence[Brief]) -> Files:
    first, width = pairs[0], spec.rig.width_px
    cameras = [_camera(i, sensor, first.motion) for i, sensor in enumerate(first.sensors)]
    formats = {"img_fmt": "cam%d/%04d.png", "gt_depth_fmt": f"omnidepth_gt_{width}/%05d.tiff"}
    frames = {"start": 1, "step": 1, "end": len(pairs), "equirect_size": [width // 4, width], "phi_deg": _PHI_DEG}
    table = {"dataset": formats | frames | {"dtype": "gt"}, "cameras": cameras}
    return {f"{_scene_folder(split, scene)}/config.yaml": yaml.safe_dump(table, sort_keys=False, width=2000).encode()}


def _camera(number: int, sensor: Sensor, motion: Motion) -> dict[str, Any]:
    model, camera = sensor.model, sensor.camera
    assert isinstance(model, OCam)
    reach = float(
        np.hypot(
            *np.maximum([camera.cx_px, camera.cy_px], [camera.width_px - camera.cx_px, camera.height_px - camera.cy_px])
        )
    )
    direct = list(model.coefficients)
    inverse = fitted_inverse(np.array(direct), reach).tolist()
    R = _RIG_FROM_SENSOR @ (motion.R_v2_from_v1.T if number else np.eye(3)) @ lens_from_sensor(sensor).T
    position = _RIG_FROM_SENSOR @ motion.t_v1 if number else np.zeros(3)
    return {
        "cam_id": number + 1,
        "img_dir": f"cam{number + 1}",
        "model": "ocam",
        "poly": [len(direct), *direct],
        "inv_poly": [len(inverse), *inverse],
        "center": [camera.cy_px, camera.cx_px],
        "affine": [model.c, model.d, model.e],
        "image_size": [camera.height_px, camera.width_px],
        "pose": [*Rotation.from_matrix(R).as_rotvec().tolist(), *position.tolist()],
        "max_fov": 2 * sensor.field.angle_max_deg if sensor.field.angle_max_deg < 180 else 220.0,
    }


def _set_files(spec: DatasetSpec, splits: Sequence[str]) -> Files:
    names = {
        part: [_scene_folder(part, i) for i, each in enumerate(splits) if each == part]
        for part in ("train", "val", "test")
    }
    return spec_file(spec) | {f"{part}.txt": "".join(f"{each}\n" for each in of).encode() for part, of in names.items()}


def _configs(folder: Path) -> list[Path]:
    return sorted([*folder.glob("config.yaml"), *folder.glob("*/config.yaml")])


def _recognises(folder: Path) -> bool:
    return bool(_configs(folder))


def _read(folder: Path) -> list[StoredPair]:
    split_of: dict[str, str] = {}
    for part in ("train", "val", "test"):
        file = folder / f"{part}.txt"
        if file.is_file():
            split_of |= dict.fromkeys(read_regular(file, 2**26).decode(errors="replace").split(), part)
    return [pair for config in _configs(folder) for pair in _of_config(folder, config, split_of)]


def _of_config(folder: Path, config: Path, split_of: dict[str, str]) -> list[StoredPair]:
    base = config.parent
    views = [_view(config, read_regular(config, 2**22), i) for i in (0, 1)]
    phi_deg = _phi_deg(config)
    pairs = []
    for image in sorted((base / "cam1").glob("*.png")):
        other = base / "cam2" / image.name
        maps = [
            file
            for file in sorted(base.glob("omnidepth_gt_*/*.tif*"))
            if file.stem.lstrip("0") == image.stem.lstrip("0")
        ]
        placed = [PlacedView(file, *view) for file, view in zip((image, other), views, strict=True)]
        scene = base.relative_to(folder).as_posix()
        pairs.append(
            StoredPair(
                name=f"{scene}/{image.stem}".removeprefix("./"),
                split=split_of.get(scene, ""),
                scene=scene,
                views=(placed[0], placed[1]),
                maps=tuple(_map(file, phi_deg) for file in maps[:1]),
            )
        )
    return pairs


def _map(file: Path, phi_deg: float) -> TruthMap:
    def directions() -> Array:
        height, width = read_array(file).shape[:2]
        return panorama_rays(width, height, phi_deg)

    read = lambda: known(read_array(file), invalid=0)  # noqa: E731
    return TruthMap(file, "inverse range", directions, read, partial(read_array, file), is_image=False)


def _phi_deg(config: Path) -> float:
    try:
        table = yaml.safe_load(read_regular(config, 2**22).decode())
        phi_deg = float(table.get("dataset", {}).get("phi_deg", _PHI_DEG))
    except (yaml.YAMLError, AttributeError, TypeError, ValueError) as error:
        raise InputError("cannot be read as the configuration of a rig", file=config) from error
    if not 0 < phi_deg <= 90:
        raise InputError(f"must be above 0 and at most 90; found {phi_deg:g}", file=config, key="dataset.phi_deg")
    return phi_deg


@lru_cache(maxsize=256)
def _view(config: Path, content: bytes, number: int) -> tuple[Sensor, Array, Array]:
    """A camera of a rig: its sensor, the rotation that takes the rig's directions to it, and its place on the rig."""
    read = read_sensor(config, Chosen(camera=number, looks="up"))
    assert read.calibration is not None
    rig_from_first = _rig_from_first(content)
    from_first = transform_between(read.calibration, 0, number)
    from_rig = from_first @ np.linalg.inv(rig_from_first)
    return read.sensor, from_rig[:3, :3], -from_rig[:3, :3].T @ from_rig[:3, 3]


def _rig_from_first(content: bytes) -> Array:
    """`[4, 4]`: takes points of the first camera to the rig; what reads calibrations gives poses between cameras."""
    table = yaml.safe_load(content.decode())
    pose = np.asarray(table["cameras"][0]["pose"], dtype=np.float64)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(pose[:3]).as_matrix(), pose[3:]
    return T


OMNIMVS = Layout("omnimvs", "OmniMVS's", README, _pair_files, _scene_files, _set_files, _recognises, _read)
