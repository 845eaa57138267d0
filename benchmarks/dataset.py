"""How long a pair of a data set takes, with its truth and its files, and how that grows with the number of pairs.

First, interleaved and on one thread: pairs of the shipped set `rooms` (640 x 480, mirror cameras) as they are made by
`omnirange dataset`, files included, against raw Embree tracing as many rays from the same viewpoints: every pixel's
samples in both images, and one ray through each pixel's centre for the range of either view and for the occlusion.
Then sets of small pairs, made into folders, manifest included: the exponent of time against their number.

    python benchmarks/dataset.py [SCENES] [MOST PAIRS]
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from harness.camera.sensor import Sensor, pixel_directions, rays_of
from harness.datasets.loading import load_spec
from harness.datasets.making import Journal, make, scene_files, write_files
from harness.datasets.rigs import draw_poses, draw_sensors
from harness.datasets.rooms import draw_room
from harness.datasets.specification import DatasetSpec
from harness.geometry.pose import Pose
from harness.runs.executors import backend_for
from harness.simulation.cast import nearest_triangles, rotated
from harness.simulation.scene_geometry import geometry_of

CHUNK = 1 << 16


def rays_of_view(sensor: Sensor, pose: Pose, samples: int, centres: int) -> np.ndarray:
    """Float32 world directions `[n, 3]` of a view: all samples of its pixels, and their centres so many times."""
    _, seen = pixel_directions(sensor)
    rows, columns = np.nonzero(seen)
    offsets = (np.arange(int(samples**0.5)) + 0.5) / samples**0.5 - 0.5
    v, u = np.broadcast_arrays(rows[:, None, None] + offsets[:, None], columns[:, None, None] + offsets[None, :])
    sampled = rays_of(sensor, u.ravel(), v.ravel())
    centre = rays_of(sensor, columns.astype(np.float64), rows.astype(np.float64))
    rays = np.concatenate([sampled, *[centre] * centres], axis=1).T
    return np.ascontiguousarray(rotated(rays, pose.R_world_from_view), dtype=np.float32)


def throughput(scenes: int) -> None:
    """Print pairs a second on one thread, and their ratio to Embree's."""
    spec = load_spec("rooms")
    ours, embree = [], []
    for scene in range(scenes + 1):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            write_files(Path(folder), scene_files(spec, scene, "train"))
            spent = time.process_time() - begun
        room, sensors = draw_room(spec, scene), draw_sensors(spec, scene)
        geometry = geometry_of(room.scene())
        traced = 0.0
        for pair in range(spec.pairs_per_scene):
            # Both ranges, and the occlusion by rays from view 2.
            for sensor, pose, centres in zip(sensors, draw_poses(spec, room, scene, pair), (1, 2), strict=True):
                rays = rays_of_view(sensor, pose, spec.samples, centres)
                origin = np.asarray(pose.position_m)
                begun = time.process_time()
                for start in range(0, len(rays), CHUNK):
                    nearest_triangles(geometry, origin, rays[start : start + CHUNK])
                traced += time.process_time() - begun
        if scene:  # the first one loads and compiles
            ours.append(spent / spec.pairs_per_scene)
            embree.append(traced / spec.pairs_per_scene)
    ratio = statistics.median(a / b for a, b in zip(ours, embree, strict=True))
    each = statistics.median(ours)
    print(f"640 x 480 with truth and files, {scenes} scenes of {spec.pairs_per_scene} pairs, CPU time on one thread")
    print(
        f"  {each:.3f} s a pair ({2 / each:.1f} pairs/s on two CPUs), Embree's rays {statistics.median(embree):.3f} s"
    )
    print(f"  ratio {ratio:.2f}")


def growth(most: int) -> None:
    """Print the exponent of the time for a whole set against its number of pairs."""
    table = {"name": "small", "samples": 1, "pairs_per_scene": 10, "furniture": {"curved": [1, 1]}}
    rig = {"width_px": 64, "height_px": 48}
    sizes, seconds = [], []
    pairs = most
    while pairs >= 60:
        sizes.append(pairs)
        pairs //= 2
    for pairs in [sizes[-1], *reversed(sizes)]:
        spec = DatasetSpec.model_validate(table | {"scenes": pairs // 10, "rig": rig})
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            make(spec, Path(folder), backend_for(0.0, 1, workers=1), Journal(spec, Path(folder)))
            seconds.append(time.process_time() - begun)
    seconds = seconds[1:]  # the first one compiled
    slope = np.polyfit(np.log(sorted(sizes)), np.log(seconds), 1)[0]
    shown = ", ".join(f"{n}: {s:.1f} s" for n, s in zip(sorted(sizes), seconds, strict=True))
    print(f"64 x 48, whole sets ({shown}): exponent {slope:.3f}   <= 1.02")


def main() -> None:
    throughput(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
    growth(int(sys.argv[2]) if len(sys.argv) > 2 else 960)


if __name__ == "__main__":
    main()
