"""How long an image with its ground truth takes, beside raw Embree tracing the same samples.

Prints ratios: the median over interleaved pairs, so that a busy machine slows both down alike. Both sides use
the same threads, and what belongs to the scene or the sensor alone (the BVH, the directions of pixel corners for
`render`, all samples' directions for Embree) is made beforehand. Embree gets only the samples of pixels in the
field, and only finds triangles; our side shades them, and finds the exact range of every pixel centre in float64.

    python benchmarks/render.py [pairs] [threads]
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from harness.camera.misalignment import Misalignment
from harness.camera.models import Mirror
from harness.camera.profile import Cone, Equiangular, Paraboloid, Sphere, Table
from harness.camera.reflection import reflected_rays, seeing_pixels
from harness.camera.sensor import Sensor, pixel_directions, rays_of
from harness.geometry.pose import Pose
from harness.machine import available_cpus
from harness.simulation.cast import in_threads, nearest_triangles
from harness.simulation.render import render, render_with_range
from harness.simulation.scene import Mesh, Scene, load_scene
from harness.simulation.scene_geometry import geometry_near, geometry_of
from harness.simulation.texture import NoiseTexture

SENSOR = Sensor()
MISALIGNED = Sensor(misalignment=Misalignment(x_mm=1.0, rotation_y_deg=0.5))
POSE = Pose(position_m=(0.0, 0.0, 1.0))


def hyperboloid_table() -> Table:
    """120 points of the same mirror."""
    mirror = Mirror()
    r = np.linspace(0, 0.034, 120)
    z = mirror.a_m * np.sqrt(1 + (r / mirror.b_m) ** 2) - mirror.a_m
    return Table(camera_m=mirror.a_m + mirror.e_m, r_mm=tuple(1000 * r), z_mm=tuple(1000 * z))


REFLECTING = {
    "misaligned": MISALIGNED,
    "table": Sensor(profile=hyperboloid_table()),
    "table, misaligned": Sensor(profile=hyperboloid_table(), misalignment=MISALIGNED.misalignment),
    "paraboloid": Sensor(profile=Paraboloid(focal_length_m=0.012, rim_m=0.03, camera_m=0.08)),
    "sphere": Sensor(profile=Sphere(radius_m=0.03, rim_m=0.024, camera_m=0.06)),
    "cone": Sensor(profile=Cone(half_angle_deg=58, rim_m=0.03, camera_m=0.06)),
    "equiangular": Sensor(profile=Equiangular(gain=5, rim_m=0.03, camera_m=0.0647)),
}
"""Sensors whose rays begin on the mirror."""


def textured_sphere(folder: Path) -> Scene:
    """A dented sphere of 81,920 triangles around the view."""
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=4.0)
    x, y, z = sphere.vertices.T
    sphere.vertices *= (1 + 0.05 * np.sin(3 * x) * np.sin(3 * y) * np.sin(3 * z))[:, None]
    path = folder / "sphere.ply"
    sphere.export(path)
    noise = NoiseTexture(kind="noise", seed=1, tile_m=6.0, shortest_m=0.1, longest_m=1.0)
    mesh = Mesh(kind="mesh", file=str(path), inward=True, texture=noise)
    return Scene(name="sphere", objects=(mesh,))


def sample_directions(samples: int) -> np.ndarray:
    """Float32 directions `[n, 3]` of all samples of all valid pixels."""
    _, valid = pixel_directions(SENSOR)
    rows, columns = np.nonzero(valid)
    offsets = (np.arange(int(samples**0.5)) + 0.5) / samples**0.5 - 0.5
    v, u = np.broadcast_arrays(rows[:, None, None] + offsets[:, None], columns[:, None, None] + offsets[None, :])
    return np.ascontiguousarray(rays_of(SENSOR, u.ravel(), v.ravel()).T, dtype=np.float32)


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def reflected_samples(sensor: Sensor, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Float32 origins and directions `[n, 3]` of all samples of the pixels that see something in that mirror."""
    rows, columns = np.nonzero(seeing_pixels(sensor))
    offsets = (np.arange(int(samples**0.5)) + 0.5) / samples**0.5 - 0.5
    v, u = np.broadcast_arrays(rows[:, None, None] + offsets[:, None], columns[:, None, None] + offsets[None, :])
    origins, directions, _ = reflected_rays(sensor, u.ravel(), v.ravel())
    return tuple(np.ascontiguousarray(each.T, dtype=np.float32) for each in (origins, directions))


def compare(scene: Scene, samples: int, pairs: int, threads: int) -> tuple[float, float, float]:
    """Median ratio, and median seconds of ours and of Embree's."""
    geometry = geometry_of(scene)
    rays = sample_directions(samples)
    origin = np.array(POSE.position_m)
    chunk = 1 << 16

    def ours() -> None:
        render_with_range(scene, SENSOR, POSE, samples, threads)

    def embree() -> None:
        def trace(start: int) -> None:
            nearest_triangles(geometry, origin, rays[start : start + chunk])

        in_threads(trace, range(0, len(rays), chunk), threads)

    return medians(ours, embree, pairs)


def compare_reflecting(
    scene: Scene, sensor: Sensor, samples: int, pairs: int, threads: int
) -> tuple[float, float, float]:
    """The same for a mirror on which rays begin apart; the image alone, as every sample of it is traced."""
    geometry = geometry_near(scene, POSE.position_m)
    begin, rays = reflected_samples(sensor, samples)
    begin += np.asarray(POSE.position_m - geometry.centre, dtype=np.float32)
    chunk = 1 << 16

    def ours() -> None:
        render(scene, sensor, POSE, samples, threads)

    def embree() -> None:
        def trace(start: int) -> None:
            nearest_triangles(geometry, begin[start : start + chunk], rays[start : start + chunk])

        in_threads(trace, range(0, len(rays), chunk), threads)

    return medians(ours, embree, pairs)


def medians(ours: Callable[[], None], embree: Callable[[], None], pairs: int) -> tuple[float, float, float]:
    """Median ratio, and median seconds of both, interleaved."""
    ours()
    embree()
    times = [(seconds(ours), seconds(embree)) for _ in range(pairs)]
    return (
        statistics.median(a / b for a, b in times),
        statistics.median(a for a, _ in times),
        statistics.median(b for _, b in times),
    )


def main() -> None:
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    threads = min(int(sys.argv[2]) if len(sys.argv) > 2 else 2, available_cpus())
    print(f"640 x 480, {threads} threads, {pairs} interleaved pairs; image and ranges against raw Embree")
    print(f"{'scene':10} {'samples':>7} {'ratio':>7} {'ours ms':>9} {'Embree ms':>9}   target")
    with tempfile.TemporaryDirectory() as folder:
        for scene, samples, target in (
            (load_scene("box"), 16, 0.6),
            (load_scene("box"), 64, 0.3),
            (load_scene("room"), 16, None),
            (textured_sphere(Path(folder)), 16, 1.5),
        ):
            ratio, ours, embree = compare(scene, samples, pairs, threads)
            limit = f"<= {target}" if target else ""
            print(f"{scene.name:10} {samples:7} {ratio:7.2f} {1e3 * ours:9.1f} {1e3 * embree:9.1f}   {limit}")
        print("rays that begin on the mirror; the image alone (misaligned: by 1 mm and half a degree)")
        for name in ("box", "room"):
            for mirror, sensor in REFLECTING.items():
                ratio, ours, embree = compare_reflecting(load_scene(name), sensor, 16, pairs, threads)
                print(f"{name:5} {mirror:18} {ratio:7.2f} {1e3 * ours:9.1f} {1e3 * embree:9.1f}   <= 2.0")


if __name__ == "__main__":
    main()
