"""COLMAP's text models, one for each scene: cameras.txt, images.txt, points3D.txt, with range maps beside them.

COLMAP puts the corner of the first pixel at (0, 0), so that all pixels are half a pixel larger there. A pose takes
points of the world to the lens's frame: X along u, Y along v, Z along the optical axis.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.models.kannala_brandt import KannalaBrandt
from harness.camera.mount import camera_from_sensor
from harness.camera.optics import optics_of
from harness.camera.sensor import Sensor, lens_from_sensor
from harness.datasets.layouts.layout import (
    Brief,
    Files,
    Layout,
    PlacedView,
    StoredPair,
    TruthMap,
    png,
    single,
    spec_file,
)
from harness.datasets.layouts.own import seen_directions
from harness.datasets.layouts.reading import known, read_array
from harness.datasets.pair import Pair
from harness.datasets.specification import DatasetSpec
from harness.errors import InputError
from harness.files import read_regular
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.io.calibrations.sensors import Chosen, read_sensor

_HALF = 0.5
_LEAST_COSINE = 0.1
"""The least cosine of a point's angle off the axis: COLMAP's fisheyes end at 90 degrees."""

README = """\
train, val, test/SCENE/
    images/PAIR_1.png, PAIR_2.png   both images, 8 bits
    sparse/cameras.txt              the true calibrations, camera 1 of all first views and camera 2 of all second ones
    sparse/images.txt               true poses, from the world to the camera, with the places of the points
    sparse/points3D.txt             points that both views of a pair see
    range/PAIR_1.npy, PAIR_2.npy    range along the ray of each pixel's centre, metres, float32, NaN where there is none

Range is the Euclidean distance from the camera's centre, not COLMAP's depth along the axis. The conventions are
COLMAP's: quaternions w x y z, the corner of the first pixel at (0, 0).
"""


def _scene_folder(split: str, scene: int) -> str:
    return f"{split}/scene{scene:05d}"


def _pair_files(spec: DatasetSpec, split: str, pair: Pair) -> Files:  # noqa: ARG001
    model = _scene_folder(split, pair.scene_number)
    files = {}
    for i in (0, 1):
        files[f"{model}/images/{pair.number:04d}_{i + 1}.png"] = png(pair.images[i])
        files[f"{model}/range/{pair.number:04d}_{i + 1}.npy"] = single(pair.range_m[i])
    return files


def _scene_files(spec: DatasetSpec, split: str, scene: int, pairs: Sequence[Brief]) -> Files:  # noqa: ARG001
    cameras = [_camera(i + 1, sensor) for i, sensor in enumerate(pairs[0].sensors)]
    images, points = [], []
    identity = 0
    for pair in pairs:
        usable = np.flatnonzero(_in_front(pair))
        tracks = range(identity + 1, identity + 1 + usable.size)
        identity += usable.size
        for i in (0, 1):
            number = 2 * pair.number + i + 1
            at = pair.pixels[i][usable] + _HALF
            observed = " ".join(f"{u!r} {v!r} {track}" for (u, v), track in zip(at.tolist(), tracks, strict=True))
            pose = _pose_words(pair.sensors[i], pair.poses[i])
            images += [f"{number} {pose} {i + 1} {pair.number:04d}_{i + 1}.png", observed]
        for k, (track, j) in enumerate(zip(tracks, usable.tolist(), strict=True)):
            x, y, z = pair.points_m[j].tolist()
            grey = int(pair.grey[j])
            observations = f"{2 * pair.number + 1} {k} {2 * pair.number + 2} {k}"
            points.append(f"{track} {x!r} {y!r} {z!r} {grey} {grey} {grey} 0.0 {observations}")
    heads = {
        "cameras": "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        "images": "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)",
        "points3D": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)",
    }
    bodies = {"cameras": cameras, "images": images, "points3D": points}
    return {
        f"{_scene_folder(split, scene)}/sparse/{name}.txt": "\n".join([heads[name], *bodies[name], ""]).encode()
        for name in heads
    }


def _camera(number: int, sensor: Sensor) -> str:
    camera, model = sensor.camera, sensor.model
    fx, fy = camera.focal_px, camera.focal_px * camera.aspect
    values = [fx, fy, camera.cx_px + _HALF, camera.cy_px + _HALF]
    kind = "PINHOLE"
    if isinstance(model, KannalaBrandt):
        kind = "OPENCV_FISHEYE"
        values += [getattr(model, name) for name in ("k1", "k2", "k3", "k4")]
    return f"{number} {kind} {camera.width_px} {camera.height_px} {' '.join(map(repr, values))}"


def _pose_words(sensor: Sensor, pose: Pose) -> str:
    R = lens_from_sensor(sensor) @ pose.R_world_from_view.T
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return " ".join(map(repr, (w, x, y, z, *(-R @ np.array(pose.position_m)).tolist())))


def _in_front(pair: Brief) -> np.ndarray:
    """`[n]`: whether each of a pair's points lies well within 90 degrees of both axes."""
    in_front = np.ones(len(pair.points_m), dtype=bool)
    for i in (0, 1):
        rays = optics_of(pair.sensors[i]).unproject(pair.pixels[i]) if len(in_front) else np.empty((0, 3))
        in_front &= rays[:, 2] > _LEAST_COSINE
    return in_front


def _set_files(spec: DatasetSpec, splits: Sequence[str]) -> Files:  # noqa: ARG001
    return spec_file(spec)


# --- Reading ----------------------------------------------------------------------------------------------------------


def _models(folder: Path) -> list[Path]:
    """The folders of a set's models, those with an images.txt."""
    patterns = ("sparse/images.txt", "sparse/0/images.txt", "images.txt")
    found = [path for depth in ("", "*/", "*/*/") for each in patterns for path in folder.glob(f"{depth}{each}")]
    return sorted({path.parent for path in found if (path.parent / "cameras.txt").is_file()})


def _recognises(folder: Path) -> bool:
    return bool(_models(folder))


def _read(folder: Path) -> list[StoredPair]:
    return [pair for model in _models(folder) for pair in _of_model(folder, model)]


def _base(model: Path) -> Path:
    """The folder that a model is of."""
    base = model
    while base.name in ("sparse", "0"):
        base = base.parent
    return base


def _of_model(folder: Path, model: Path) -> list[StoredPair]:
    lines = _lines(model / "images.txt", keep_empty=True)
    points = _points(model / "points3D.txt") if (model / "points3D.txt").is_file() else {}
    images = sorted(
        (_image(model, *both) for both in zip(lines[::2], lines[1::2], strict=False)), key=lambda each: each[0]
    )
    base = _base(model)
    name = base.relative_to(folder).as_posix()
    pairs = []
    for first, second in zip(images[::2], images[1::2], strict=False):
        pairs.append(_stored(name, base, first, second, points))
    return pairs


_Seen = tuple[str, Sensor, Array, Array, dict[int, tuple[float, float]]]
"""An image: its name, sensor, the rotation from the world, its place there, and its points' pixels by number."""


def _stored(place: str, base: Path, first: _Seen, second: _Seen, points: dict[int, Array]) -> StoredPair:
    views = []
    for name, sensor, R, centre, _ in (first, second):
        views.append(PlacedView(base / "images" / name, sensor, R @ first[2].T, first[2] @ (centre - first[3])))
    common = sorted(first[4].keys() & second[4].keys() & points.keys())
    observed = None
    if common:
        in_world = np.array([points[track] for track in common])
        pixels = [np.array([seen[4][track] for track in common]) - _HALF for seen in (first, second)]
        observed = ((in_world - first[3]) @ first[2].T, pixels[0], pixels[1])
    file = base / "range" / f"{Path(first[0]).stem}.npy"
    maps: tuple[TruthMap, ...] = ()
    if file.is_file():
        read = lambda: known(read_array(file))  # noqa: E731
        maps = (TruthMap(file, "range", partial(seen_directions, first[1]), read, partial(read_array, file)),)
    split = place.partition("/")[0]
    return StoredPair(
        name=f"{place}/{Path(first[0]).stem.removesuffix('_1')}".removeprefix("./"),
        split=split if split in ("train", "val", "test") else "",
        scene=place,
        views=(views[0], views[1]),
        maps=maps,
        observed=observed,
    )


def _lines(file: Path, *, keep_empty: bool = False) -> list[str]:
    text = read_regular(file, 2**30).decode(errors="replace")
    lines = [line.strip() for line in text.splitlines() if not line.startswith("#")]
    return lines if keep_empty else [line for line in lines if line]


def _image(model: Path, line: str, observed: str) -> _Seen:
    """An image of images.txt: see `_Seen`; rotations are to the sensor's frame, which looks up along the axis."""
    file = model / "images.txt"
    words = line.split(maxsplit=9)
    try:
        w, x, y, z, *t = (float(word) for word in words[1:8])
        R = Rotation.from_quat([x, y, z, w]).as_matrix()
        camera, name = int(words[8]), words[9]
        observations = observed.split()
        tracks = {
            int(k): (float(u), float(v))
            for u, v, k in zip(observations[::3], observations[1::3], observations[2::3], strict=True)
            if k != "-1"
        }
    except (ValueError, IndexError) as error:
        raise InputError(f"'{line[:60]}' must be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", file=file) from error
    sensor = _sensor(model, camera)
    to_sensor = camera_from_sensor("up", mirrored=False).T @ R
    return name, sensor, to_sensor, -R.T @ np.array(t), tracks


def _sensor(model: Path, identity: int) -> Sensor:
    """A camera of cameras.txt, as one that looks up: its sensor's frame is then the lens's."""
    file = model / "cameras.txt"
    for number, line in enumerate(_lines(file)):
        if line.split()[0] == str(identity):
            return read_sensor(file, Chosen(camera=number, looks="up", mirrored=False)).sensor
    raise InputError(f"has no camera {identity}, which images.txt names", file=file)


def _points(file: Path) -> dict[int, Array]:
    try:
        split = [line.split() for line in _lines(file)]
        return {int(words[0]): np.array([float(word) for word in words[1:4]]) for words in split}
    except (ValueError, IndexError) as error:
        raise InputError("must have POINT3D_ID X Y Z ... in each line", file=file) from error


COLMAP = Layout("colmap", "COLMAP's", README, _pair_files, _scene_files, _set_files, _recognises, _read)
