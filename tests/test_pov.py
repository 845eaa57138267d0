"""A view written for POV-Ray: the same rays on paper, and the same image and ranges by tracing a physical mirror."""

import re
from pathlib import Path

import numpy as np
import pytest
from povray import averaged, positions
from repeats import few

import harness
from harness.camera.reflection import reflect, reflected_rays
from harness.camera.sensor import Sensor, pixel_directions
from harness.cli import main
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.simulation.pov import write_pov
from harness.simulation.reflected import points_seen
from harness.simulation.render import render
from harness.simulation.scene import load_scene
from harness.simulation.scene_geometry import geometry_near
from harness.simulation.truth import ranges

SMALL = {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": "centre", "cy_px": "centre"}
POSE = Pose(position_m=(0.13, -0.21, 1.04), yaw_deg=17)
OFFSET = {"x_mm": 1.3, "y_mm": -0.4, "z_mm": 0.7}
MISALIGNED = {**OFFSET, "rotation_x_deg": 0.5, "rotation_y_deg": -0.3, "rotation_z_deg": 9.0}
AWKWARD = {
    "camera": {**SMALL, "aspect": 1.02, "skew_px": 3.0, "cx_px": 150.3, "cy_px": 125.8},
    "mount": {"looks": "up", "mirrored": False, "yaw_deg": 20, "pitch_deg": 5, "roll_deg": -8},
    "field": {"elevation_min_deg": -20, "elevation_max_deg": 75},
    "misalignment": MISALIGNED,
}


def pixels_of(sensor: Sensor) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(sensor.camera.width_px), np.arange(sensor.camera.height_px)), axis=-1) + 0.0


def whole(sensor: Sensor) -> np.ndarray:
    """The pixels that neither the mirror's rim nor the camera's body cuts."""
    pixels = pixels_of(sensor)
    inside = reflect(sensor, pixels)[2]
    for corner in np.array([[-0.55, -0.55], [-0.55, 0.55], [0.55, -0.55], [0.55, 0.55]]):
        u, v = (pixels + corner).reshape(-1, 2).T.copy()
        inside &= reflected_rays(sensor, u, v)[2].reshape(inside.shape)
    return inside


def numbers(text: str) -> np.ndarray:
    return np.array([float(each) for each in text.split(",")])


# --- Without POV-Ray -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", [{}, {"misalignment": MISALIGNED}, AWKWARD], ids=["default", "misaligned", "awkward"])
def test_camera_and_mirror_on_paper_give_the_rays(table: dict, tmp_path: Path) -> None:
    sensor = Sensor.model_validate(table)
    pose = Pose(position_m=(100.3, -70.2, 1.4), yaw_deg=33, pitch_deg=-4, roll_deg=7)
    box = {"name": "hall", "objects": [{"kind": "box", "inward": True, "size_m": [400, 400, 9], "texture": GREY}]}
    write_pov(load_scene(box), sensor, pose, tmp_path)
    text = (tmp_path / "scene.pov").read_text(encoding="utf-8")
    origin = numbers(re.search(r"right-handed, from <(.+?)>", text)[1])
    place, towards, right, up = (
        numbers(re.search(rf"\n  {key} <(.+?)>\n", text)[1]) for key in ("location", "direction", "right", "up")
    )
    quadric = [numbers(each) for each in re.search(r"  <(.+?)>, <(.+?)>, <(.+?)>, (\S+)\n", text).groups()]
    matrix = numbers(re.search(r"matrix <(.+?)>", text)[1]).reshape(4, 3)

    pixels = pixels_of(sensor)[::7, ::7]
    begins, leaves, valid = (each[..., :] for each in reflect(sensor, pixels))
    begins, leaves, (u, v) = begins[valid], leaves[valid], pixels[valid].T
    x, y = (u + 0.5) / sensor.camera.width_px - 0.5, 0.5 - (v + 0.5) / sensor.camera.height_px
    rays = towards + x[:, None] * right + y[:, None] * up
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    world = pose.R_world_from_view
    points = begins @ world.T + pose.position_m - origin
    # The camera's ray passes through the point of the mirror: coordinates of 20 m have a step of 4e-15 m.
    assert np.linalg.norm(np.cross(points - place, rays), axis=1).max() < 3e-14
    # The point is on the quadric, whose coefficients are some 2,000/m², in its own frame.
    own = (points - matrix[3]) @ np.linalg.inv(matrix[:3])
    (squares, _, linear, constant) = quadric
    assert np.abs(own**2 @ squares + own @ linear + constant).max() < 1e-11
    # It leaves as light is reflected there.
    normal = (2 * own * squares + linear) @ matrix[:3]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mirrored = rays - 2 * np.sum(rays * normal, axis=1, keepdims=True) * normal
    np.testing.assert_allclose(mirrored, leaves @ world.T, atol=1e-12)


GREY = {"kind": "grey", "value": 100}


@pytest.mark.slow
def test_the_folder_says_how_to_use_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sensor = tmp_path / "sensor.toml"
    sensor.write_text('[camera]\nwidth_px = 32\nheight_px = 24\nfocal_px = 30.0\ncx_px = "centre"\ncy_px = "centre"\n')
    out = tmp_path / "view"
    arguments = ["render", "box", "--sensor", sensor, "--at", 0, 0, 1, "--samples", 1, "--pov", "--out", out]
    assert main([str(each) for each in arguments]) == 0
    assert "povray scene.ini" in (out / "README.txt").read_text(encoding="utf-8")
    ini = (out / "scene.ini").read_text(encoding="utf-8")
    assert "Width=32\nHeight=24\n" in ini
    named = set(re.findall(r'Surface\("(.+?)"\)', (out / "scene.pov").read_text(encoding="utf-8")))
    assert named == {each.name for each in out.glob("texture_*.png")}
    assert len(named) == 4  # gravel, grass, noise and grey; a texture on two sides is one file
    assert not capsys.readouterr().err


UNIFIED = {"model": {"kind": "unified", "xi": 0.9}, "mount": {"looks": "down"}, "field": {"angle_max_deg": 110}}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (UNIFIED, "model.kind: POV-Ray has no unified (Mei) camera; a view for it needs"),
        ({"lens": {"k1": 0.01}}, "lens.k1: POV-Ray's camera has no lens terms; a view for it needs 0"),
    ],
)
def test_a_camera_that_povray_lacks_is_refused(table: dict, words: str, tmp_path: Path) -> None:
    camera = {"width_px": 32, "height_px": 24, "focal_px": "fit", "cx_px": "centre", "cy_px": "centre"}
    view = harness.render("box", sensor={"camera": camera, **table}, samples=1)
    with pytest.raises(InputError) as refused:
        view.write(tmp_path / "view", pov=True)
    assert words in str(refused.value)
    assert not (tmp_path / "view").exists()


# --- With POV-Ray --------------------------------------------------------------------------------------------------


def shift_px(image: np.ndarray, other: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """By how much `other` is shifted against an image, (u, v): least squares on the gradient."""
    v, u = (each[pixels] for each in np.gradient(image))
    return np.linalg.lstsq(np.stack([u, v], axis=-1), (image - other)[pixels], rcond=None)[0]


PLACES = {"box": (Pose(position_m=(0, 0, 1)), 1000), "room": (POSE, 10)}
"""Where each scene is seen from, and how many of 4.9 million rays may be lost between two triangles.

From the middle of the cube four of its edges lie on diagonals of pixels, and on samples: 90 pixels of 8 samples each.
POV-Ray 3.7.0.10 loses 201 of them, and none or one of the others.
"""
MISALIGNMENTS = {"default": {}, "shifted": {"x_mm": 1.0}, "tilted": {"rotation_x_deg": 0.5}}


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("misaligned", MISALIGNMENTS)
@pytest.mark.parametrize("name", PLACES)
def test_image_and_ranges_are_those_of_the_physical_mirror(name: str, misaligned: str, tmp_path: Path) -> None:
    sensor = Sensor.model_validate({"camera": SMALL, "misalignment": MISALIGNMENTS[misaligned]})
    scene, (pose, most_lost) = load_scene(name), PLACES[name]
    write_pov(scene, sensor, pose, tmp_path)
    traced, lost = averaged(tmp_path, 320, 240, 8)
    assert lost.sum() <= most_lost
    image, pixels = render(scene, sensor, pose, samples=64), whole(sensor)
    assert pixels.sum() > 43_000
    difference = (traced - image)[pixels]
    # Most pixels have the same samples: what is left is the 16 bits of textures and samples, averaged. Others, at edges
    # and where texels are small, get 4 or 16 times as many from the renderer; the mean of 64 is so far from theirs.
    assert np.median(np.abs(difference)) < 1e-3
    assert np.sqrt(np.mean(difference**2)) < 0.2
    assert np.abs(shift_px(image, traced, pixels)).max() < 1e-3

    points, shown = positions(tmp_path)
    truth = points_seen(scene, sensor, pose)
    # The rim and the camera's body are where the field of view says, to the pixel.
    np.testing.assert_array_equal(shown, np.isfinite(truth.range_m))
    hit = np.isfinite(points[..., 0])
    assert np.count_nonzero(shown & ~hit) <= most_lost
    # POV-Ray's triangles are single precision, 2e-7 m at 4 m, and more along a grazing ray.
    own = (points - pose.position_m) @ pose.R_world_from_view
    np.testing.assert_allclose(own[hit], truth.point_m[hit], rtol=0, atol=1e-5)
    range_m = np.linalg.norm(own, axis=-1)[hit]
    np.testing.assert_allclose(range_m, truth.range_m[hit], rtol=0, atol=1e-5)
    if sensor.is_central:
        directions, valid = pixel_directions(sensor)
        np.testing.assert_allclose(range_m, ranges(scene, pose, directions, valid)[hit], rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("misalignment", few(1, [MISALIGNED, {}]), ids=["misaligned", "aligned"])
def test_with_the_same_samples_the_image_is_the_same(misalignment: dict, tmp_path: Path) -> None:
    """1,024 samples a pixel are the most that the renderer takes, and it takes them everywhere."""
    camera = {"width_px": 40, "height_px": 30, "focal_px": 38.0, "cx_px": 19.0, "cy_px": 14.2}
    sensor, scene = Sensor.model_validate({"camera": camera, "misalignment": misalignment}), load_scene("room")
    write_pov(scene, sensor, POSE, tmp_path)
    traced, lost = averaged(tmp_path, 40, 30, 32)
    assert lost.sum() <= 10
    pixels = whole(sensor)
    assert pixels.sum() > 500
    difference = (traced - render(scene, sensor, POSE, samples=1024))[pixels]
    assert np.median(np.abs(difference)) < 1e-4  # 0.004 grey / sqrt(12 * 1024)
    # A sample that falls on the other side of an edge, which single precision moves, changes its pixel by 255/1024.
    assert np.abs(difference).max() < 0.25


@pytest.mark.slow
def test_any_camera_matrix_mount_and_misalignment_see_along_their_rays(tmp_path: Path) -> None:
    sensor, scene = Sensor.model_validate(AWKWARD), load_scene("room")
    pose = Pose(position_m=(0.4, 0.3, 1.4), yaw_deg=33, pitch_deg=-4, roll_deg=7)
    write_pov(scene, sensor, pose, tmp_path)
    points, shown = positions(tmp_path)
    begins, directions, valid = reflect(sensor, pixels_of(sensor))
    np.testing.assert_array_equal(shown, valid)
    both = np.isfinite(points[..., 0])
    assert both.sum() > 10_000
    own = (points[both] - pose.position_m) @ pose.R_world_from_view
    across = np.linalg.norm(np.cross(own - begins[both], directions[both]), axis=1)
    # Positions are known in 16 bits of 7 mm, 1e-7 m.
    assert across.max() < 1e-6


@pytest.mark.slow
def test_an_open_scene_far_away_shows_its_background(tmp_path: Path) -> None:
    """5,000 km off, where single precision has a step of half a metre; positions count from a point near by."""
    noise = {"kind": "noise", "seed": 1, "tile_m": 2, "shortest_m": 0.1, "longest_m": 1}
    crate = {"kind": "box", "size_m": [1, 1, 2], "position_m": [5000002, 1000, 0], "texture": noise}
    scene = load_scene({"name": "field", "closed": False, "background_grey": 77, "objects": [crate]})
    camera = {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": "centre", "cy_px": "centre"}
    sensor, pose = Sensor.model_validate({"camera": camera}), Pose(position_m=(5000000.3, 1000.2, 1))
    write_pov(scene, sensor, pose, tmp_path)
    traced, lost = averaged(tmp_path, 160, 120, 4)
    assert not lost.any()
    pixels = whole(sensor)
    difference = (traced - render(scene, sensor, pose, samples=16))[pixels]
    # Nearly all is background, of one grey in 16 bits. Outlines have 4 times as many samples, as above.
    assert np.median(np.abs(difference)) < 255 / 65535
    assert np.sqrt(np.mean(difference**2)) < 0.2
    points, _ = positions(tmp_path)
    directions, valid = pixel_directions(sensor)
    range_m = ranges(scene, pose, directions, valid)
    np.testing.assert_array_equal(np.isfinite(points[..., 0]), np.isfinite(range_m))
    from_centre = np.subtract(pose.position_m, geometry_near(scene, pose.position_m).centre)
    # A step of a float64 at 5,000 km is 9e-10 m; that of POV-Ray's triangles at 16 m from the centre, 1e-6.
    np.testing.assert_allclose(np.linalg.norm(points - from_centre, axis=-1), range_m, rtol=0, atol=1e-5)
