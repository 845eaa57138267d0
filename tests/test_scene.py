"""Scenes as data, textures and the arrays made of them."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy import ndimage

from harness import shipped
from harness.geometry.pose import Pose
from harness.simulation.cast import cast
from harness.simulation.scene import BOX_SIDES, Box, Mesh, Scene, assets, load_scene
from harness.simulation.scene_geometry import check_viewpoint, geometry_of, homographies
from harness.simulation.texture import (
    BundledTexture,
    GreyTexture,
    ImageTexture,
    NoiseTexture,
    lookup,
    texels_of,
)
from harness.spec import dump_toml, parse
from harness.toml import read_toml

GREY = GreyTexture(kind="grey", value=100)
SHIPPED = ("box", "corridor", "poles", "room")


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_round_trip_and_are_hashable(name, tmp_path):
    scene = load_scene(name)
    assert scene.name == name
    copy = tmp_path / "copy.toml"
    copy.write_text(dump_toml(scene))
    assert parse(Scene, read_toml(copy)) == scene
    # Paths are absolute in what was written, so the copy may lie anywhere.
    assert load_scene(str(copy)) == scene
    assert hash(load_scene(str(copy))) == hash(scene)


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("position", [(0, 0, 1), (0.5, 0, 1)])
def test_the_usual_views_are_free(name, position):
    geometry = geometry_of(load_scene(name))
    check_viewpoint(geometry, position)
    # And not within a hand's breadth of anything either.
    assert np.linalg.norm(geometry.corners.mean(axis=1) - position, axis=-1).min() > 0.1


def test_every_shipped_scene_is_tested():
    assert tuple(shipped.names("scenes")) == SHIPPED


def test_assets_are_the_files_a_scene_is_made_of(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "a.png")
    texture = ImageTexture(kind="image", file=str(tmp_path / "a.png"), tile_m=1)
    scene = Scene(
        name="s",
        objects=(
            Box(kind="box", size_m=(1, 1, 1), texture=GREY, top=texture),
            Mesh(kind="mesh", file=str(tmp_path / "m.glb")),
        ),
    )
    assert assets(scene) == (tmp_path / "a.png", tmp_path / "m.glb")


def test_files_are_relative_to_the_scene_file(tmp_path):
    (tmp_path / "world").mkdir()
    Image.fromarray(np.full((4, 4), 77, np.uint8)).save(tmp_path / "wall.png")
    (tmp_path / "world" / "scene.toml").write_text(
        'name = "s"\n[[objects]]\nkind = "box"\nsize_m = [1, 1, 1]\n'
        'texture = { kind = "image", file = "../wall.png", tile_m = 1.0 }\n'
    )
    scene = load_scene(str(tmp_path / "world" / "scene.toml"))
    assert assets(scene) == (tmp_path / "wall.png",)
    assert geometry_of(scene).textures[0][0, 0] == 77


@pytest.mark.parametrize("name", ["brick", "grass", "gravel"])
def test_bundled_textures(name):
    texels = texels_of(BundledTexture(kind="bundled", name=name, tile_m=1))
    assert texels.shape == (512, 512)
    assert texels.dtype == np.float32
    assert 10 < texels.std() < 80
    assert not texels.flags.writeable


def test_noise_keeps_its_band_its_mean_and_its_seed():
    noise = NoiseTexture(
        kind="noise", seed=3, tile_m=4, shortest_m=0.1, longest_m=1, mean=120, contrast=20, size_px=256
    )
    texels = texels_of(noise)
    np.testing.assert_array_equal(texels, noise.texels())
    assert (texels != noise.model_copy(update={"seed": 4}).texels()).any()
    # 20 grey levels of contrast about 120 never reach 0 or 255: nothing is cut off, so float32 rounding is all.
    assert texels.mean() == pytest.approx(120, abs=1e-3)
    assert texels.std() == pytest.approx(20, abs=1e-3)
    spectrum = np.abs(np.fft.fft2(texels.astype(float) - texels.mean()))
    cycles = np.fft.fftfreq(256, 1 / 256)
    per_metre = np.hypot(cycles[:, None], cycles) / 4
    outside = (per_metre > 1 / 0.1 + 1e-9) | (per_metre < 1 / 1 - 1e-9)
    assert spectrum[outside].max() < 1e-4 * spectrum.max()


def test_lookup_is_scipys_bilinear_with_wrapping():
    rng = np.random.default_rng(5)
    texels = rng.uniform(0, 255, (7, 11)).astype(np.float32)
    uv = rng.uniform(-3, 3, (5000, 2))
    rows, columns = (1 - uv[:, 1]) * 7 - 0.5, uv[:, 0] * 11 - 0.5
    expected = ndimage.map_coordinates(texels.astype(float), [rows, columns], order=1, mode="grid-wrap")
    # Both are float64 on values of 255.
    np.testing.assert_allclose(lookup(texels, uv), expected, rtol=0, atol=1e-9)


def test_lookup_at_texel_centres_and_upright():
    texels = np.array([[10, 20], [30, 40]], dtype=np.float32)
    # v points up: the upper row of the image is at v = 0.75.
    uv = np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]])
    np.testing.assert_array_equal(lookup(texels, uv), [10, 20, 30, 40])


def test_colour_becomes_luma(tmp_path):
    rgb = np.zeros((2, 2, 3), np.uint8)
    rgb[0, 0], rgb[0, 1], rgb[1, 0], rgb[1, 1] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 200, 200)
    Image.fromarray(rgb).save(tmp_path / "c.png")
    texels = texels_of(ImageTexture(kind="image", file=str(tmp_path / "c.png"), tile_m=1))
    # ITU-R BT.601, in float32.
    np.testing.assert_allclose(texels, [[76.245, 149.685], [29.07, 200]], rtol=0, atol=1e-4)


def test_sixteen_bit_grey_is_scaled(tmp_path):
    Image.fromarray(np.array([[0, 65535]], dtype=np.uint16)).save(tmp_path / "c.png")
    texels = texels_of(ImageTexture(kind="image", file=str(tmp_path / "c.png"), tile_m=1))
    np.testing.assert_allclose(texels, [[0, 255]])


def test_a_box_is_six_faces_with_level_and_upright_textures():
    box = Box(kind="box", size_m=(4, 3, 2), position_m=(1, 0, 0.5), texture=GREY)
    geometry = geometry_of(Scene(name="b", objects=(box,)))
    assert len(geometry.normals) == 6
    assert len(geometry.corners) == 12
    assert len(geometry.edges) == 12
    np.testing.assert_array_equal(geometry.bounds, [[-1, -1.5, 0.5], [3, 1.5, 2.5]])
    for side, normal, uv_map in zip(BOX_SIDES, geometry.normals, geometry.uv_maps, strict=True):
        if side not in {"bottom", "top"}:
            np.testing.assert_allclose(uv_map[1, :3], [0, 0, 1], atol=1e-15)  # v is up, one repetition a metre
            assert normal[2] == 0
            assert uv_map[0, 2] == 0


def test_the_most_particular_texture_of_a_side_counts():
    a, b, c = (GreyTexture(kind="grey", value=v) for v in (1, 2, 3))
    box = Box(kind="box", size_m=(1, 1, 1), texture=a, sides=b, x_min=c)
    greys = {side: box.texture_of(side).value for side in BOX_SIDES}
    assert greys == {"x_min": 3, "x_max": 2, "y_min": 2, "y_max": 2, "bottom": 1, "top": 1}


def test_homography_is_the_texture_map_of_the_point_hit():
    rng = np.random.default_rng(6)
    geometry = geometry_of(load_scene("room"))
    origin = np.array([0.3, -0.2, 1.1])
    rotation = Pose(yaw_deg=20, pitch_deg=-10, roll_deg=35).R_world_from_view
    H = homographies(geometry, geometry.uv_maps, origin, rotation)
    for face in range(0, len(H), 37):
        d = rng.standard_normal((50, 3)) * 2
        world = d @ rotation.T
        s = (geometry.offsets[face] - geometry.normals[face] @ origin) / (world @ geometry.normals[face])
        points = origin + s[:, None] * world
        expected = points @ geometry.uv_maps[face, :, :3].T + geometry.uv_maps[face, :, 3]
        uvw = d @ H[face].T
        # Both are float64; near-parallel rays have coordinates of thousands.
        np.testing.assert_allclose(uvw[:, :2] / uvw[:, 2:], expected, rtol=1e-9, atol=1e-9)


def test_scale_enlarges_geometry_and_textures_together():
    scene = load_scene("room")
    once, twice = geometry_of(scene), geometry_of(scene.model_copy(update={"scale": 2.0}))
    np.testing.assert_array_equal(twice.corners, 2 * once.corners)
    np.testing.assert_array_equal(twice.edges, 2 * once.edges)
    uv = [
        np.einsum(
            "tij,tkj->tki", g.uv_maps[g.face_of_triangle[:-1], :, :3], g.corners
        ) for g in (once, twice)
    ]  # fmt: skip
    np.testing.assert_allclose(uv[0], uv[1], rtol=1e-12, atol=1e-9)


def test_edges_inside_a_face_are_not_edges_and_shared_ones_count_once():
    geometry = geometry_of(load_scene("box"))
    lengths = np.linalg.norm(geometry.edges[:, 1] - geometry.edges[:, 0], axis=-1)
    np.testing.assert_array_equal(lengths, np.full(12, 6.0))


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        geometry_of(load_scene("box")).corners[0] = 0


def grey_towards(scene, origin, directions):
    """The grey that rays see, through hits, texture maps and `lookup`."""
    geometry = geometry_of(scene)
    hits = cast(geometry, origin, directions)
    face = geometry.face_of_triangle[hits.triangle]
    points = np.asarray(origin) + hits.range_m[:, None] * directions
    maps = geometry.uv_maps[face]
    uv = np.einsum("nij,nj->ni", maps[..., :3], points) + maps[..., 3]
    return np.array([lookup(geometry.textures[geometry.texture_of_face[f]], c) for f, c in zip(face, uv, strict=True)])


def test_mesh_files_show_their_texture_upright(tmp_path):
    Image.fromarray(np.array([[10, 20], [30, 40]], np.uint8)).save(tmp_path / "t.png")
    (tmp_path / "m.mtl").write_text("newmtl wall\nmap_Kd t.png\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 2 1 0\nv 2 -1 0\nv 2 -1 2\nv 2 1 2\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl wall\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    scene = Scene(name="s", closed=False, objects=(Mesh(kind="mesh", file=str(tmp_path / "m.obj")),))
    # Seen along x with z up, +y is on the left: the four quarters of the wall are the four texels.
    corners = np.array([[2, 0.5, 1.5], [2, -0.5, 1.5], [2, 0.5, 0.5], [2, -0.5, 0.5]]) - [0, 0, 1]
    directions = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    # Each ray meets the middle of a texel, where bilinear is exact.
    np.testing.assert_allclose(grey_towards(scene, (0, 0, 1), directions), [10, 20, 30, 40], atol=1e-9)


def test_a_texture_projected_on_a_mesh_is_that_of_a_box(tmp_path):
    noise = NoiseTexture(kind="noise", seed=1, tile_m=2, shortest_m=0.1, longest_m=1, size_px=128)
    shape = trimesh.creation.box(bounds=[[0, 0, 0], [3, 4, 2]])
    shape.export(tmp_path / "m.ply")
    placed = {"position_m": (-1.5, -2.0, 0.0)}
    mesh = Mesh(kind="mesh", file=str(tmp_path / "m.ply"), inward=True, texture=noise, **placed)
    box = Box(kind="box", size_m=(3, 4, 2), inward=True, texture=noise)
    d = np.random.default_rng(9).standard_normal((500, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    greys = [grey_towards(Scene(name="s", objects=(thing,)), (0.1, 0.2, 0.9), d) for thing in (mesh, box)]
    # Float64 texture coordinates of a few tiles.
    np.testing.assert_allclose(greys[0], greys[1], rtol=0, atol=1e-9)
