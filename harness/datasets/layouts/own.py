"""The project's own layout: a folder for each pair, with everything that is true of it."""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from harness.camera.sensor import Sensor, pixel_directions, sensor_of
from harness.datasets.layouts.layout import (
    Brief,
    Files,
    Layout,
    PlacedView,
    StoredPair,
    TruthMap,
    geometry_table,
    png,
    pose_table,
    single,
    spec_file,
    states_in_lines,
    toml,
)
from harness.datasets.layouts.reading import known, numbers_of, read_array
from harness.datasets.pair import Pair
from harness.datasets.rooms import draw_room
from harness.datasets.specification import DatasetSpec
from harness.files import read_regular
from harness.geometry.angles import Array
from harness.io.view_folder import npy, sensor_files
from harness.toml import MOST_BYTES, read_toml

README = f"""\
train, val, test/SCENE/PAIR/
    image_1.png, image_2.png  both images, 8 bits
    range_1.npy, range_2.npy  range along the ray of each pixel's centre, metres, float32, NaN where there is none
    match.npy                 where image 2 has the point that view 1's pixel sees: (u, v), pixels, float32
                              [row, column, 2]; NaN where it is not on image 2; known of hidden points, too
    state.png                 {states_in_lines(30)}
    normal.npy                unit normal of the surface, towards view 1, in view 1's frame, float16 [row, column, 3]
    pair.toml                 the motion from view 1 to view 2, both poses, noise and exposure
scenes/SCENE/
    sensor_1.toml, sensor_2.toml  the true calibrations of both views
    rays_1.npy, rays_2.npy    unit direction that the centre of each pixel sees, in the sensor's frame, z up; float32
                              [row, column, 3], NaN where it sees nothing: true of any camera
    scene.toml and its files  the scene itself: omnirange render scenes/SCENE/scene.toml --at X Y Z --out DIR

Range is the Euclidean distance from the viewpoint, not a depth along an axis. The centre of pixel [v, u] is at the
integers (u, v). A point p_v1 in view 1's frame is R_v2_from_v1 (p_v1 - t_v1) in view 2's.
"""


def _folder(split: str, scene: int, pair: int) -> str:
    return f"{split}/{scene:05d}/{pair:03d}"


def _pair_files(spec: DatasetSpec, split: str, pair: Pair) -> Files:  # noqa: ARG001
    table = {
        "scene": f"scenes/{pair.scene_number:05d}",
        "noise_sigma_grey": pair.sigma_grey,
        "gain_of_view_2": pair.gain,
        "motion": geometry_table(pair.motion),
        "pose_1": pose_table(pair.poses[0]),
        "pose_2": pose_table(pair.poses[1]),
    }
    files = {
        "image_1.png": png(pair.images[0]),
        "image_2.png": png(pair.images[1]),
        "range_1.npy": single(pair.range_m[0]),
        "range_2.npy": single(pair.range_m[1]),
        "match.npy": single(pair.match),
        "state.png": png(pair.state),
        "normal.npy": npy(pair.normal.astype(np.float16)),
        "pair.toml": toml(table),
    }
    folder = _folder(split, pair.scene_number, pair.number)
    return {f"{folder}/{name}": content for name, content in files.items()}


def _scene_files(spec: DatasetSpec, split: str, scene: int, pairs: Sequence[Brief]) -> Files:  # noqa: ARG001
    room = draw_room(spec, scene)
    files = {"scene.toml": room.toml(), **room.files}
    for number, sensor in enumerate(pairs[0].sensors, 1):
        rays, valid = pixel_directions(sensor)
        files[f"sensor_{number}.toml"] = sensor_files(sensor)["sensor.toml"]
        files[f"rays_{number}.npy"] = single(np.where(valid[..., None], rays, np.nan))
    return {f"scenes/{scene:05d}/{name}": content for name, content in files.items()}


def _set_files(spec: DatasetSpec, splits: Sequence[str]) -> Files:  # noqa: ARG001
    return spec_file(spec)


def _recognises(folder: Path) -> bool:
    return any(folder.glob("*/*/*/pair.toml"))


def _read(folder: Path) -> list[StoredPair]:
    return [_stored(folder, file) for file in sorted(folder.glob("*/*/*/pair.toml"))]


def _stored(folder: Path, file: Path) -> StoredPair:
    table = read_toml(file)
    motion = table.get("motion", {})
    R = numbers_of(motion, "R_v2_from_v1", (3, 3), file)
    t_v1 = numbers_of(motion, "t_v1_m", (3,), file)
    scene = file.parent.parent.name
    files = [folder / "scenes" / scene / f"sensor_{i}.toml" for i in (1, 2)]
    sensors = [_sensor(each, read_regular(each, MOST_BYTES)) for each in files]
    base = file.parent
    ranges = base / "range_1.npy"
    return StoredPair(
        name=base.relative_to(folder).as_posix(),
        split=base.parent.parent.name,
        scene=scene,
        views=(
            PlacedView(base / "image_1.png", sensors[0], np.eye(3), np.zeros(3)),
            PlacedView(base / "image_2.png", sensors[1], R, t_v1),
        ),
        maps=(
            TruthMap(
                ranges,
                "range",
                partial(seen_directions, sensors[0]),
                lambda: known(read_array(ranges)),
                partial(read_array, ranges),
            ),
        ),
        state=partial(read_array, base / "state.png"),
        match=lambda: known(read_array(base / "match.npy")),
    )


@lru_cache(maxsize=64)
def _sensor(file: Path, content: bytes) -> Sensor:  # noqa: ARG001 - the file may have been changed
    return sensor_of(read_toml(file), file)


def seen_directions(sensor: Sensor) -> Array:
    """Unit directions `[height, width, 3]` of a sensor's pixels; NaN where it sees nothing."""
    rays, valid = pixel_directions(sensor)
    return np.where(valid[..., None], rays, np.nan)


OWN = Layout("omnirange", "omnirange's own", README, _pair_files, _scene_files, _set_files, _recognises, _read)
