"""What the verdict of `omnirange range` says of faults in the geometry, and whether sigma then holds.

Pairs of the box and the room are rendered, views parallel and turned, and matched with geometries that are wrong by
known amounts, and with images that a camera has degraded. For each it prints the verdict, the median error of the
range, the share of ranges within one standard deviation of the matching alone and of sigma with the geometry's part,
how far matches lie off their epipolar curves beside what noise explains, and the likely cause.

A fault *counts* where the matching's sigma alone covers less than 15 %. Each of those should be flagged (not `ok`), no
degraded image should be, and sigma should cover 60 to 75 %.

With a number, so many faults of random kind, direction and size are drawn for random pairs of the corridor instead,
which no constant was set by: one error is one draw, the same all over an image, so that what sigma covers of single
images varies, and its mean counts. Another seed draws others.

    python benchmarks/geometry_verdict.py [matcher] [draws] [seed]
"""

import io
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import harness
from harness.camera.misalignment import Misalignment
from harness.camera.reflection import reflect
from harness.camera.sensor import Sensor, pixel_directions
from harness.geometry.pose import Motion
from harness.simulation.scene_geometry import Geometry, geometry_near

FIRST = harness.Pose(position_m=(0.0, 0.0, 1.0))
SECOND = {
    "parallel": harness.Pose(position_m=(0.5, 0.0, 1.0)),
    "turned": harness.Pose(position_m=(0.4, 0.25, 1.05), yaw_deg=70.0, pitch_deg=2.0),
}
COUNTS, LOWEST, HIGHEST = 0.15, 0.6, 0.75

Pair = tuple[np.ndarray, np.ndarray]


def main() -> None:
    matcher = (sys.argv[1:] or ["slanted"])[0]
    tried = drawn(*(int(each) for each in sys.argv[2:4])) if len(sys.argv) > 2 else cases()
    missed, alarms, outside, shares = [], [], [], []
    print("pair                     verdict   median    alone  with  across  noise  cause", flush=True)
    for name, truth_m, images, sensor, motion, is_fault in tried:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = harness.estimate_range(*images, sensor, motion, matcher)
        check = estimate.geometry
        error = np.abs(estimate.range_m - truth_m)
        alone, both = (covered(error / sigma) for sigma in (estimate.sigma_matching_m, estimate.sigma_m))
        cause = ", or ".join(check.likely)
        print(
            f"{name:24} {check.verdict!s:9} {100 * np.nanmedian(error / truth_m):5.2f} %  {alone:6.2f} {both:5.2f} "
            f"{check.rms_px:7.3f} {check.noise_px:6.3f}  {cause}",
            flush=True,
        )
        flagged = check.verdict != harness.Verdict.OK
        if not is_fault:
            alarms += [name] * flagged
        else:
            shares.append(both)
            missed += [name] * (alone < COUNTS and not flagged)
            outside += [f"{name} {both:.2f}"] * (not LOWEST <= both <= HIGHEST)
    print(f"\nfaults that count and are not flagged: {', '.join(missed) or 'none'}")
    print(f"degraded images that are flagged: {', '.join(alarms) or 'none'}")
    print(f"faults whose sigma covers not {LOWEST:.0%} to {HIGHEST:.0%}, of {len(shares)}: {', '.join(outside)}")
    print(f"what sigma covers: {np.mean(shares):.3f} in the mean, {np.std(shares):.3f} its standard deviation")


def covered(z: np.ndarray) -> float:
    return float(np.mean(z[np.isfinite(z)] < 1))


def cases() -> Iterator[tuple[str, np.ndarray, Pair, Sensor, Motion, bool]]:
    for scene in ("box", "room"):
        for turned, second in SECOND.items():
            views = [
                harness.render(scene, position_m=p.position_m, yaw_deg=p.yaw_deg, pitch_deg=p.pitch_deg)
                for p in (FIRST, second)
            ]
            exact = views[0].image, views[1].image
            motion = harness.relative_motion(FIRST, second)
            truth_m, sensor = views[0].panorama_range_m, views[0].sensor
            for name, images in degraded(exact).items():
                yield f"{scene} {turned} {name}", truth_m, images, sensor, motion, False
            for noise in (0.0, 4.0):
                images = noisy(exact, noise)
                for name, other, moved in wrong(sensor, motion):
                    yield f"{scene} {turned} {name} {noise:g}", truth_m, images, other, moved, True
            for axis in "xyz":
                offset = {f"{axis}_mm": 1.0}
                images = misaligned(scene, sensor, FIRST, **offset), misaligned(scene, sensor, second, **offset)
                yield f"{scene} {turned} mirror {axis} 1 mm", truth_m, images, sensor, motion, True


def drawn(count: int, seed: int = 11) -> Iterator[tuple[str, np.ndarray, Pair, Sensor, Motion, bool]]:
    for i in range(count):
        draws = np.random.default_rng([seed, i])
        azimuth, baseline_m = draws.uniform(-np.pi, np.pi), draws.uniform(0.25, 0.6)
        first = harness.Pose(position_m=(0.0, 0.0, 1.0), yaw_deg=draws.uniform(-180, 180))
        step = baseline_m * np.array([np.cos(azimuth), np.sin(azimuth), draws.uniform(-0.1, 0.1)])
        second = harness.Pose(position_m=tuple(np.add(step, [0, 0, 1])), yaw_deg=draws.uniform(-180, 180))
        poses = first, second
        views = [harness.render("corridor", position_m=p.position_m, yaw_deg=p.yaw_deg) for p in poses]
        exact = views[0].image, views[1].image
        motion, sensor = harness.relative_motion(first, second), views[0].sensor
        camera, size = sensor.camera, np.exp(draws.uniform(np.log(0.5), np.log(2)))
        kind = ("centre", "rotation", "direction", "focal", "mirror")[i % 5]
        axis = draws.normal(size=3)
        axis /= np.linalg.norm(axis)
        if kind == "rotation":
            turn = Rotation.from_rotvec(np.radians(0.15 * size) * axis).as_matrix()
            motion = Motion(motion.R_v2_from_v1 @ turn, motion.t_v1)
        elif kind == "direction":
            across = np.cross(motion.t_v1, axis)
            turn = Rotation.from_rotvec(np.radians(1.5 * size) * across / np.linalg.norm(across))
            motion = Motion(motion.R_v2_from_v1, turn.apply(motion.t_v1))
        elif kind == "mirror":
            offset = {f"{name}_mm": float(0.7 * size * axis[k]) for k, name in enumerate("xyz")}
            exact = tuple(misaligned("corridor", sensor, p, **offset) for p in poses)  # type: ignore[assignment]
        else:
            u, v = 0.5 * size * axis[:2] / np.linalg.norm(axis[:2])
            change = {"cx_px": camera.cx_px + u, "cy_px": camera.cy_px + v}
            if kind == "focal":
                change = {"focal_px": camera.focal_px * (1 + 0.004 * size)}
            sensor = sensor.model_copy(update={"camera": camera.model_copy(update=change)})
        images = noisy(exact, 2.0)
        yield f"{i} {kind} x {size:.2f}", views[0].panorama_range_m, images, sensor, motion, True


def degraded(exact: Pair) -> dict[str, Pair]:
    v, u = np.mgrid[: exact[0].shape[0], : exact[0].shape[1]]
    square = ((u - u.mean()) ** 2 + (v - v.mean()) ** 2) / np.square(u - u.mean()).max()
    return {
        "exact": exact,
        "noise 4": noisy(exact, 4.0),
        "noise 10": noisy(exact, 10.0),
        "JPEG 70": (jpeg(exact[0]), jpeg(exact[1])),
        "vignetting": tuple(each * (1 - 0.4 * square) for each in exact),  # type: ignore[dict-item]
        "gamma": (exact[0], 255 * (exact[1] / 255) ** 0.7),
        "exposure": (exact[0], 0.6 * exact[1] + 25),
    }


def noisy(exact: Pair, noise: float) -> Pair:
    draws = np.random.default_rng(7)
    first, second = (np.clip(each + noise * draws.normal(size=each.shape), 0, 255) for each in exact)
    return first, second


def jpeg(image: np.ndarray, quality: int = 70) -> np.ndarray:
    stream = io.BytesIO()
    Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(stream, "JPEG", quality=quality)
    return np.asarray(Image.open(stream), dtype=np.float32)


def wrong(sensor: Sensor, motion: Motion) -> Iterator[tuple[str, Sensor, Motion]]:
    camera = sensor.camera

    def with_camera(**change: Any) -> Sensor:
        return sensor.model_copy(update={"camera": camera.model_copy(update=change)})

    def about_z(degrees: float) -> Rotation:
        return Rotation.from_euler("z", degrees, degrees=True)

    yield "centre 1/3 px", with_camera(cx_px=camera.cx_px + 1 / 3), motion
    yield "centre 1 px", with_camera(cx_px=camera.cx_px + 1), motion
    yield "yaw 0.25", sensor, Motion(motion.R_v2_from_v1 @ about_z(0.25).as_matrix(), motion.t_v1)
    yield "t 1", sensor, Motion(motion.R_v2_from_v1, about_z(1.0).apply(motion.t_v1))
    yield "t 3", sensor, Motion(motion.R_v2_from_v1, about_z(3.0).apply(motion.t_v1))
    yield "focal 0.5 %", with_camera(focal_px=camera.focal_px * 1.005), motion


def misaligned(name: str, sensor: Sensor, pose: harness.Pose, side: int = 4, **offset_mm: float) -> np.ndarray:
    """The image of a camera that is displaced from the mirror's outer focus: its rays have no point in common."""
    camera = sensor.camera
    within = (np.arange(side) + 0.5) / side - 0.5
    v, u = np.meshgrid(
        (np.arange(camera.height_px)[:, None] + within).ravel(),
        (np.arange(camera.width_px)[:, None] + within).ravel(),
        indexing="ij",
    )
    inside = np.kron(pixel_directions(sensor)[1], np.ones((side, side), bool))
    displaced = sensor.model_copy(update={"misalignment": Misalignment(**offset_mm)})
    starts, rays, _ = reflect(displaced, np.stack([u[inside], v[inside]], axis=-1))
    geometry = geometry_near(harness.load_scene(name), pose.position_m)
    R = pose.R_world_from_view
    grey = np.zeros(inside.shape)
    grey[inside] = seen_along(geometry, starts @ R.T + pose.position_m - geometry.centre, rays @ R.T)
    return np.asarray(grey.reshape(camera.height_px, side, camera.width_px, side).mean(axis=(1, 3)), dtype=np.float32)


def seen_along(geometry: Geometry, starts: np.ndarray, rays: np.ndarray) -> np.ndarray:
    grey = np.empty(len(rays))
    for first in range(0, len(rays), 1 << 18):
        part = slice(first, first + (1 << 18))
        triangle = geometry.embree.run(starts[part].astype(np.float32), rays[part].astype(np.float32))
        face = geometry.face_of_triangle[np.asarray(triangle)]
        normal = geometry.normals[face]
        length = (geometry.offsets[face] - np.sum(normal * starts[part], 1)) / np.sum(normal * rays[part], 1)
        points = np.c_[starts[part] + length[:, None] * rays[part], np.ones(len(face))]
        u, v = np.einsum("nij,nj->in", geometry.uv_maps[face], points)
        values = np.empty(len(face))
        for texture in np.unique(geometry.texture_of_face[face]):
            here = geometry.texture_of_face[face] == texture
            texels = geometry.textures[texture]
            x, y = u[here] * texels.shape[1] - 0.5, (1 - v[here]) * texels.shape[0] - 0.5
            column, row = np.floor(x).astype(int), np.floor(y).astype(int)
            right, down = x - column, y - row
            values[here] = sum(
                weight * texels[(row + i) % texels.shape[0], (column + j) % texels.shape[1]]
                for i, j, weight in (
                    (0, 0, (1 - down) * (1 - right)), (0, 1, (1 - down) * right),
                    (1, 0, down * (1 - right)), (1, 1, down * right),
                )
            )  # fmt: skip
        grey[part] = values
    return grey


if __name__ == "__main__":
    main()
