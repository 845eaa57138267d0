"""Images in colour: walls have their colours, the luma is the grey image, and points the colours of their pixels."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from sweeps import omnirange

import harness
from harness.camera.misalignment import Misalignment
from harness.camera.profile import Cone
from harness.camera.sensor import Sensor, pixel_directions, project
from harness.geometry.pose import Pose
from harness.images import LUMA
from harness.simulation.chip import Chip, captured
from harness.simulation.export import write_glb
from harness.simulation.exposure import with_exposure
from harness.simulation.noise import generator
from harness.simulation.optics import Optics, with_optics
from harness.simulation.reflected import points_seen
from harness.simulation.render import render
from harness.simulation.scene import Scene, load_scene
from harness.simulation.truth import truth
from harness.spec import dump_toml, parse

WALLS = {
    "x_min": (200, 30, 40),
    "x_max": (20, 180, 60),
    "y_min": (30, 60, 220),
    "y_max": (240, 200, 10),
    "bottom": (120, 80, 40),
    "top": (255, 250, 245),
}
CAMERA = {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}
SENSORS = {
    "central": Sensor(camera=CAMERA),
    "misaligned": Sensor(camera=CAMERA, misalignment=Misalignment(x_mm=1.0, rotation_y_deg=0.5)),
    "profile": Sensor(camera=CAMERA, profile=Cone(half_angle_deg=55, rim_m=0.03, camera_m=0.06)),
}
POSE = Pose(position_m=(0.4, -0.3, 1.2), yaw_deg=20, pitch_deg=3)
# Texels and pixels are float32: a few roundings of 1.5e-5 at 255 each, and luma sums three.
ROUNDINGS = 2e-4


def painted(folder: Path) -> Scene:
    """The box with a wall in each colour."""
    room = {"kind": "box", "inward": True, "size_m": [6, 6, 6]}
    for side, colour in WALLS.items():
        Image.new("RGB", (2, 2), colour).save(folder / f"{side}.png")
        room[side] = {"kind": "image", "file": str(folder / f"{side}.png"), "tile_m": 6.0}
    return parse(Scene, {"name": "painted", "objects": [room]})


def speckled(folder: Path) -> Scene:
    """A box of colours drawn at random, with a thing before one wall that has a texture of its own."""
    draws = np.random.default_rng(7)
    for name in ("walls", "thing"):
        Image.fromarray(draws.integers(0, 256, (64, 48, 3), dtype=np.uint8)).save(folder / f"{name}.png")
    room = {"kind": "box", "inward": True, "size_m": [6, 6, 6]}
    room["texture"] = {"kind": "image", "file": str(folder / "walls.png"), "tile_m": 3.0}
    thing = {"kind": "box", "size_m": [0.8, 0.6, 1.4], "position_m": [1.6, 0.7, 0.1], "yaw_deg": 20}
    thing["texture"] = {"kind": "image", "file": str(folder / "thing.png"), "tile_m": 1.0}
    return parse(Scene, {"name": "speckled", "objects": [room, thing]})


def luma(image: np.ndarray) -> np.ndarray:
    return np.asarray(image.astype(np.float64) @ LUMA)


@pytest.mark.long
@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
def test_a_pixel_of_a_wall_has_the_walls_colour(sensor, tmp_path):
    scene = painted(tmp_path)
    image = render(scene, sensor, POSE, 4, colour=True)
    assert image.shape == (120, 160, 3)
    if sensor.is_central:
        rays, valid = pixel_directions(sensor)
        points = rays * truth(scene, POSE, rays, valid, wrap_columns=False).range_m[..., None]
    else:
        points = points_seen(scene, sensor, POSE).point_m
    world = points @ POSE.R_world_from_view.T + POSE.position_m - [0, 0, 3]
    known = np.isfinite(world).all(axis=-1)
    # Pixels whose point is a quarter of a metre or more from any edge are of one wall; the others mix.
    by_size = np.sort(np.abs(world), axis=-1)
    inner = known & (by_size[..., 1] < 2.75)
    assert inner.sum() > 3000
    axis = np.abs(world[inner]).argmax(axis=-1)
    low = np.take_along_axis(world[inner], axis[:, None], axis=-1)[:, 0] < 0
    colours = np.array(list(WALLS.values()))
    np.testing.assert_allclose(image[inner], colours[2 * axis + ~low], rtol=0, atol=ROUNDINGS)
    assert len(np.unique(2 * axis + ~low)) >= 5
    assert (image[~known] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
def test_the_luma_of_colours_is_the_grey_image(sensor, tmp_path):
    scene = speckled(tmp_path)
    grey, colours = render(scene, sensor, POSE, 4), render(scene, sensor, POSE, 4, colour=True)
    np.testing.assert_allclose(luma(colours), grey, rtol=0, atol=ROUNDINGS)
    assert np.ptp(colours, axis=-1)[grey > 0].mean() > 5  # colours, not three greys


def test_what_is_grey_has_three_equal_colours():
    grey, colours = (render(load_scene("box"), SENSORS["central"], POSE, 4, colour=each) for each in (False, True))
    np.testing.assert_array_equal(colours, np.repeat(grey[..., None], 3, axis=-1))


def test_a_scene_far_away_has_its_colours(tmp_path):
    scene = speckled(tmp_path)
    far = scene.model_copy(
        update={
            "objects": tuple(
                each.model_copy(update={"position_m": tuple(np.add(each.position_m, (4e5, 0, 0)).tolist())})
                for each in scene.objects
            )
        }
    )
    pose = POSE.model_copy(update={"position_m": (4e5 + 0.4, -0.3, 1.2)})
    grey, colours = (render(far, SENSORS["central"], pose, 4, colour=each) for each in (False, True))
    np.testing.assert_allclose(luma(colours), grey, rtol=0, atol=ROUNDINGS)


def meshes(folder: Path) -> dict[str, Path]:
    """A plate in three kinds of colour: of its vertices, of a texture, and of a factor of its material."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    faces = [[0, 1, 2], [0, 2, 3]]
    colours = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255]], dtype=np.uint8)
    vertices = trimesh.Trimesh(corners, faces, vertex_colors=colours, process=False)
    picture = Image.fromarray(np.random.default_rng(3).integers(0, 256, (16, 16, 3), dtype=np.uint8))
    visuals = {
        "texture.glb": trimesh.visual.TextureVisuals(
            uv=corners[:, :2], material=trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
        ),
        "factor.glb": trimesh.visual.TextureVisuals(
            uv=corners[:, :2],
            material=trimesh.visual.material.PBRMaterial(baseColorTexture=picture, baseColorFactor=[255, 128, 64, 255]),
        ),
    }
    paths = {"vertices": folder / "vertices.ply"}
    vertices.export(paths["vertices"])
    for name, visual in visuals.items():
        paths[name] = folder / name
        trimesh.Trimesh(corners, faces, visual=visual, process=False).export(paths[name])
    return paths


@pytest.mark.parametrize("kind", ["vertices", "texture.glb", "factor.glb"])
def test_meshes_have_their_colours(kind, tmp_path):
    mesh = {"kind": "mesh", "file": str(meshes(tmp_path)[kind]), "scale": 2.0, "position_m": [0.5, -0.5, 0.0]}
    scene = parse(Scene, {"name": "plate", "closed": False, "objects": [mesh]})
    pose = Pose(position_m=(0.0, 0.0, 1.0))
    grey, colours = (render(scene, SENSORS["central"], pose, 16, colour=each) for each in (False, True))
    np.testing.assert_allclose(luma(colours), grey, rtol=0, atol=ROUNDINGS)
    assert np.ptp(colours, axis=-1).max() > 60
    if kind != "vertices":
        return
    # Between three vertices colours are linear, so that a pixel within a triangle has that of its centre but for the
    # bend of the projection within it.
    rays, valid = pixel_directions(SENSORS["central"])
    seen = rays * truth(scene, pose, rays, valid, wrap_columns=False).range_m[..., None]
    x, y = np.moveaxis((seen[..., :2] - [0.5, -0.5]) / 2, -1, 0)
    within = (x > 0.1) & (y > 0.1) & (x < 0.9) & (y < 0.9) & (np.abs(x - y) > 0.1)
    assert within.sum() > 30
    # Of red (0, 0), green (1, 0), blue (1, 1) and yellow (0, 1): the same formula in both triangles.
    expected = 255 * np.stack([1 - x, np.abs(x - y), np.minimum(x, y)], axis=-1)
    np.testing.assert_allclose(colours[within], expected[within], rtol=0, atol=1.0)


def test_lens_and_chip_act_on_each_colour(tmp_path):
    sensor, chip = SENSORS["central"], Chip(bits=8, gamma=2.2)
    image = render(speckled(tmp_path), sensor, POSE, 4, colour=True)
    optics = Optics(vignetting=0.3, defocus_px=0.8, motion_px=2.0)

    def through(image: np.ndarray) -> np.ndarray:
        exposed = with_exposure(with_optics(image, sensor, optics), sensor, 1.1, 2.0)
        return captured(exposed, sensor, chip, 0.0, generator(1, "shot"), generator(1, "white"))

    together = through(image)
    for i in range(3):
        np.testing.assert_array_equal(together[..., i], through(np.ascontiguousarray(image[..., i])))


def test_each_colour_has_its_own_shot_noise_and_a_jpeg_is_of_all_three(tmp_path):
    sensor = SENSORS["central"]
    image = render(painted(tmp_path), sensor, POSE, 1, colour=True)
    chip = Chip(saturation_e=2000.0)
    seen = pixel_directions(sensor)[1]
    noise = (captured(image, sensor, chip, 0.0, generator(1, "shot"), generator(1, "white")) - image)[seen]
    share = noise / np.sqrt(np.maximum(image[seen], 1) * 255 / 2000)
    # Of 10,000 pixels: correlations of independent draws spread by 1 %, variances by 1.4 %.
    assert np.abs(np.corrcoef(share.T) - np.eye(3)).max() < 0.06
    assert share.var() == pytest.approx(1, rel=0.06)
    stored = captured(image, sensor, Chip(bits=8, jpeg_quality=90), 0.0, generator(1), generator(1))
    assert stored.shape == image.shape
    assert (stored[~seen] == 0).all()
    assert 0 < np.abs(stored - image)[seen].mean() < 6  # a picture of the same colours


def test_the_exported_scene_has_its_colours(tmp_path):
    scene = speckled(tmp_path)
    write_glb(scene, tmp_path / "scene.glb", colour=True)
    mesh = {"kind": "mesh", "file": str(tmp_path / "scene.glb"), "inward": True}
    again = parse(Scene, {"name": "again", "objects": [mesh]})
    ours, theirs = (render(each, SENSORS["central"], POSE, 4, colour=True) for each in (scene, again))
    # Texture coordinates are float32 there: 1e-7 of 128 texels that differ by up to 255. Pixels on an outline may fall
    # to the other side of it, and pixels that alias are sampled by the faces that they show, which are triangles there.
    apart = np.abs(ours - theirs).max(axis=-1)
    assert np.median(apart) < 0.01
    assert (apart > 0.1).mean() < 0.1


@pytest.mark.long
@pytest.mark.slow
def test_the_command_writes_pictures_in_colour(tmp_path):
    painted(tmp_path)
    scene = "\n".join(
        ['name = "painted"', "[[objects]]", 'kind = "box"', "inward = true", "size_m = [6, 6, 6]"]
        + [f'{side} = {{ kind = "image", file = "{side}.png", tile_m = 6.0 }}' for side in WALLS]
    )
    (tmp_path / "painted.toml").write_text(scene)
    ran = omnirange(
        tmp_path, "render", "painted.toml", "--at", 0, 0, 1, "--samples", 1, "--colour", "--out", tmp_path / "view"
    )
    assert ran.returncode == 0, ran.stderr
    for name in ("omni", "panorama"):
        with Image.open(tmp_path / "view" / f"{name}.png") as picture:
            assert picture.mode == "RGB"
            shown = np.asarray(picture)
        exact = np.nan_to_num(np.load(tmp_path / "view" / f"{name}.npy"))
        np.testing.assert_array_equal(shown, np.rint(exact).astype(np.uint8))
    # The middle of the panorama looks along x, at the horizon.
    assert shown[39, shown.shape[1] // 2].tolist() == list(WALLS["x_max"])


@pytest.mark.long
@pytest.mark.slow
def test_points_have_the_colours_of_the_image_where_they_are(tmp_path):
    scene = speckled(tmp_path)
    sensor = Sensor()
    views = [
        harness.render(scene, sensor=sensor, position_m=(x, 0, 1), samples=4, colour=True).image for x in (0.0, 0.4)
    ]
    for name, image in zip(("left", "right"), views, strict=True):
        Image.fromarray(np.rint(image).astype(np.uint8)).save(tmp_path / f"{name}.png")
    (tmp_path / "sensor.toml").write_text(dump_toml(sensor))
    ran = omnirange(
        tmp_path, "range", "left.png", "right.png", "--sensor", "sensor.toml", "--baseline", 0.4, 0, 0,
        "--matcher", "column", "--out", tmp_path / "out",
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    cloud = trimesh.load(tmp_path / "out" / "points.ply")
    colours = np.asarray(cloud.colors)[:, :3].astype(float)
    pixels, valid = project(sensor, np.asarray(cloud.vertices))
    assert valid.all()
    u, v = np.rint(pixels).astype(int).T
    close = np.abs(pixels - np.rint(pixels)).max(axis=-1) < 0.05
    assert close.sum() > 100
    # A twentieth of a pixel either way, of what the pixels around differ by, and half a level of rounding twice.
    photograph = np.asarray(Image.open(tmp_path / "left.png")).astype(float)
    around = np.stack(
        [photograph[np.clip(v + i, 0, 479), np.clip(u + j, 0, 639)] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    )
    bound = 0.1 * np.ptp(around, axis=0) + 1.0
    assert (np.abs(colours - photograph[v, u]) <= bound)[close].all()
    assert np.ptp(colours, axis=-1).mean() > 5
