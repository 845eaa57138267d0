"""What is said when a scene is wrong: one line that names the file, the key and what would be right."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from sweeps import write_small

import harness
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.simulation.render import render
from harness.simulation.scene import Box, Mesh, Plane, Scene, load_scene
from harness.simulation.scene_geometry import geometry_of
from harness.simulation.texture import GreyTexture
from harness.simulation.truth import ranges, truth

GREY = GreyTexture(kind="grey", value=100)
SENSOR = Sensor()
BOX = '[[objects]]\nkind = "box"\nsize_m = [1, 1, 1]\n'
PLANE = '[[objects]]\nkind = "plane"\nsize_m = [8, 8]\n'
GREY_TOML = 'texture = { kind = "grey", value = 1 }\n'


def refused(text, folder):
    """The message for a scene file of this text."""
    path = folder / "scene.toml"
    path.write_text('name = "bad"\n' + text)
    with pytest.raises(InputError) as caught:
        geometry_of(load_scene(str(path)))
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["objects", "missing"]),
        ("objects = []\n", ["objects", "at least 1"]),
        ('[[objects]]\nkind = "bx"\n', ["objects[0]", "'bx'", "did you mean 'box'"]),
        ("[[objects]]\nsize_m = [1, 1, 1]\n", ["objects[0]", "kind"]),
        (BOX, ["objects[0]", "x_min", "texture"]),
        (BOX.replace("1, 1, 1", "1, 0, 1") + GREY_TOML, ["objects[0]", "size_m[1]", "above 0"]),
        (BOX.replace("1, 1, 1", "1, -2, 1") + GREY_TOML, ["size_m[1]", "above 0", "-2"]),
        (BOX.replace("1, 1, 1", "1, nan, 1") + GREY_TOML, ["size_m[1]"]),
        (BOX + 'texture = { kind = "gray", value = 1 }\n', ["texture", "'gray'", "did you mean 'grey'"]),
        (BOX + 'texture = { kind = "grey", value = 256 }\n', ["texture", "value", "256"]),
        (BOX + 'texture = { kind = "bundled", name = "gras", tile_m = 1 }\n', ["name", "did you mean 'grass'"]),
        (BOX + 'texture = { kind = "bundled", name = "grass", tile_m = 0 }\n', ["tile_m", "above 0"]),
        (BOX + 'texture = { kind = "bundled", name = "grass" }\n', ["tile_m", "missing"]),
        (
            BOX + 'texture = { kind = "noise", seed = 1, tile_m = 1, shortest_m = 0.5, longest_m = 2 }\n',
            ["texture", "longest_m", "tile_m"],
        ),
        (BOX + GREY_TOML + "colour = 3\n", ["objects[0]", "unknown key 'colour'"]),
        (BOX + GREY_TOML + "yaw_dg = 3\n", ["unknown key 'yaw_dg'", "did you mean 'yaw_deg'"]),
        ("closd = true\n" + BOX + GREY_TOML, ["unknown key 'closd'", "did you mean 'closed'"]),
        ("scale = 0\n" + BOX + GREY_TOML, ["scale", "above 0"]),
    ],
)
def test_wrong_text(text, parts, tmp_path):
    message = refused(text, tmp_path)
    assert "scene.toml" in message
    for part in parts:
        assert part in message


def test_unknown_scene_lists_the_shipped_ones():
    with pytest.raises(InputError, match="box, corridor, poles, room"):
        load_scene("bx")


def test_missing_mesh_names_a_near_one(tmp_path):
    (tmp_path / "vase.glb").touch()
    message = refused('[[objects]]\nkind = "mesh"\nfile = "vas.glb"\n', tmp_path)
    assert "objects[0].file" in message
    assert "did you mean 'vase.glb'" in message


def test_missing_texture_names_where_it_was_looked_for(tmp_path):
    message = refused(BOX + 'texture = { kind = "image", file = "no/wall.png", tile_m = 1 }\n', tmp_path)
    assert "objects[0].texture.file" in message
    assert str(tmp_path / "no" / "wall.png") in message


def test_image_that_is_none(tmp_path):
    (tmp_path / "wall.png").write_text("not a picture")
    message = refused(BOX + 'texture = { kind = "image", file = "wall.png", tile_m = 1 }\n', tmp_path)
    assert "wall.png" in message
    assert "image" in message


def test_image_cut_short(tmp_path):
    whole = tmp_path / "whole.png"
    noise = np.random.default_rng(1).integers(0, 255, (64, 64)).astype(np.uint8)
    Image.fromarray(noise).save(whole)
    (tmp_path / "wall.png").write_bytes(whole.read_bytes()[:600])
    message = refused(BOX + 'texture = { kind = "image", file = "wall.png", tile_m = 1 }\n', tmp_path)
    assert "wall.png" in message


def mesh_toml(file, extra=""):
    return f'[[objects]]\nkind = "mesh"\nfile = "{file}"\n{extra}'


@pytest.mark.parametrize("name", ["m.glb", "m.obj", "m.ply"])
def test_mesh_that_is_none(name, tmp_path):
    (tmp_path / name).write_bytes(b"\x00\x01 this is not a mesh")
    message = refused(mesh_toml(name), tmp_path)
    assert name in message
    assert "mesh" in message


def test_mesh_of_an_unknown_format(tmp_path):
    (tmp_path / "m.xyzw").write_text("1 2 3")
    assert ".glb, .gltf, .obj, .ply" in refused(mesh_toml("m.xyzw"), tmp_path)


def test_mesh_with_a_vertex_that_is_no_number(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    message = refused(mesh_toml("m.obj", GREY_TOML), tmp_path)
    assert "m.obj" in message
    assert "not finite" in message


def test_mesh_without_triangles(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert "no triangles" in refused(mesh_toml("m.obj", GREY_TOML), tmp_path)


def test_mesh_without_area(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    assert "no triangle with an area" in refused(mesh_toml("m.obj", GREY_TOML), tmp_path)


def test_mesh_without_texture_coordinates_needs_a_texture(tmp_path):
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "m.ply")
    message = refused(mesh_toml("m.ply"), tmp_path)
    assert "m.ply" in message
    assert "give the object a texture" in message
    path = tmp_path / "good.toml"
    path.write_text('name = "good"\n' + mesh_toml("m.ply", GREY_TOML))
    assert len(geometry_of(load_scene(str(path))).corners) == 12


def room(*things, closed=True):
    walls = Box(kind="box", inward=True, size_m=(4, 4, 4), texture=GREY)
    return Scene(name="my room", closed=closed, objects=(walls, *things))


@pytest.mark.parametrize("position", [(0, 0, 5), (2.5, 0, 1), (0, 0, -0.1), (2, 0, 1), (0, float("nan"), 1)])
def test_view_outside_the_scene(position):
    if np.isnan(position).any():
        pose = Pose.model_construct(position_m=position, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0)
    else:
        pose = Pose(position_m=position)
    with pytest.raises(InputError, match=r"my room.*outside the scene.*x -2 .. 2"):
        render(room(), SENSOR, pose)


def test_view_inside_a_box():
    pillar = Box(kind="box", name="pillar", size_m=(1, 1, 3), position_m=(1, 0, 0), yaw_deg=30, texture=GREY)
    scene = room(pillar)
    with pytest.raises(InputError, match=r"my room.*inside 'pillar'"):
        render(scene, SENSOR, Pose(position_m=(1.2, 0.3, 1)))
    # In the corner of the pillar's bounds, but not in the pillar.
    render(scene, SENSOR, Pose(position_m=(1.64, 0.64, 1)))


def test_second_view_inside_a_box():
    scene = room(Box(kind="box", name="pillar", size_m=(1, 1, 3), position_m=(1, 0, 0), texture=GREY))
    directions, valid = np.array([[[0.0, 0, -1]]]), np.array([[True]])
    with pytest.raises(InputError, match="inside 'pillar'"):
        truth(scene, Pose(position_m=(0, 0, 1)), directions, valid, pose_2=Pose(position_m=(1, 0, 1)))


def test_view_inside_a_mesh(tmp_path):
    trimesh.creation.icosphere(subdivisions=3, radius=0.5).export(tmp_path / "ball.ply")
    ball = Mesh(kind="mesh", file=str(tmp_path / "ball.ply"), position_m=(1, 0, 1), texture=GREY)
    with pytest.raises(InputError, match="inside 'object 1 \\(mesh\\)'"):
        render(room(ball), SENSOR, Pose(position_m=(1.3, 0, 1.2)))
    render(room(ball), SENSOR, Pose(position_m=(1.35, 0.35, 1.2)))
    render(room(ball.model_copy(update={"inward": True})), SENSOR, Pose(position_m=(1.3, 0, 1.2)))


def test_a_face_that_is_lost_beside_its_position():
    scene = room(Plane(kind="plane", name="far", size_m=(4e-9, 4e-9), position_m=(1e9, 0, 0), texture=GREY))
    with pytest.raises(InputError, match="'far' has a face without area; its size is below"):
        geometry_of(scene)


@pytest.mark.parametrize(
    ("text", "at", "words"),
    [
        (BOX + "inward = true\n" + GREY_TOML, (3, 0, 1), "outside the scene"),
        (BOX + GREY_TOML, (0, 0, 0.5), "is inside"),
        (PLANE + GREY_TOML + BOX + GREY_TOML, (2, 0, 0.5), "rays or more escape"),
    ],
)
def test_a_view_that_cannot_be_names_the_scenes_file(text, at, words, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('name = "bad"\n' + text)
    with pytest.raises(InputError, match=words) as caught:
        harness.render(path, position_m=at, samples=1)
    assert caught.value.file == str(path)
    with pytest.raises(InputError, match=words) as caught:
        harness.render(load_scene(path), position_m=at, samples=1)
    assert caught.value.file == "bad"


def test_open_scene_declared_closed():
    floor = Plane(kind="plane", size_m=(4, 4), position_m=(0, 0, 0), texture=GREY)
    wall = Plane(kind="plane", size_m=(4, 4), position_m=(-2, 0, 2), pitch_deg=90, texture=GREY)
    scene = Scene(name="two planes", objects=(floor, wall))
    pose = Pose(position_m=(0, 0, 1))
    message = r"two planes: \d+ rays or more escape.*\(0, 0, 1\).*closed = false"
    with pytest.raises(InputError, match=message):
        render(scene, SENSOR, pose)
    with pytest.raises(InputError, match=message):
        ranges(scene, pose, np.array([[[0.0, 0, 1]]]), np.array([[True]]))
    render(scene.model_copy(update={"closed": False}), SENSOR, pose)


def test_escaped_rays_are_counted():
    floor = Plane(kind="plane", size_m=(4, 4), texture=GREY)
    wall = Plane(kind="plane", size_m=(1, 1), position_m=(0, 0, 3), texture=GREY)
    directions = np.array([[[0.0, 0, -1], [0, 0, 1], [1, 0, 0], [0, 1, 0]]])
    with pytest.raises(InputError, match=r"2 rays or more escape.*direction \(1\.0000, 0\.0000, 0\.0000\)"):
        ranges(
            Scene(name="s", objects=(floor, wall)),
            Pose(position_m=(0, 0, 1)),
            directions,
            np.ones((1, 4), dtype=bool),
        )


PILLAR = BOX.replace("1, 1, 1", "1, 1, 3") + 'name = "pillar"\n' + GREY_TOML


@pytest.mark.parametrize("scene", ["trial", "--set", "--axis", "changed"])
def test_a_run_names_the_file_of_a_scene_in_which_a_view_cannot_be(tmp_path, capsys, scene):
    """The experiment's file, the key, the scene and its own file."""
    path, file = tmp_path / "scene.toml", tmp_path / "e.toml"
    path.write_text('name = "inside"\nclosed = false\n' + PILLAR)
    base = f'scene = "{path.name if scene in ("trial", "changed") else "box"}"\n'
    write_small(file)
    file.write_text(file.read_text().replace('scene = "box"\n', base))
    options = {"changed": ["--set", "scene.objects.0.texture.value=9"], "trial": []}.get(
        scene, [scene, f"scene={path}"]
    )
    assert main(["run", str(file), "--out", str(tmp_path / "o"), "--workers", "1", *options]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(
        f"omnirange: {file}: trial.view_1.position_m: scene inside ({path}): the view at (0, 0, 1) m"
    )


def test_a_run_names_the_file_of_a_scene_with_a_hole(tmp_path, capsys):
    """Rays escape from what is said to be closed: it is noticed while the image is made."""
    path, file = tmp_path / "scene.toml", write_small(tmp_path / "e.toml")
    floor, ceiling = PLANE + GREY_TOML, PLANE + "position_m = [0, 0, 2]\n" + GREY_TOML
    path.write_text('name = "open"\n' + floor + ceiling)
    assert main(["run", str(file), "--out", str(tmp_path / "o"), "--workers", "1", "--set", f"scene={path}"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(f"omnirange: {file}: trial.scene: scene open ({path}): ")
    assert "escape" in said


def test_a_run_names_the_file_of_a_scene_that_cannot_be_built(tmp_path, capsys):
    """A size that is lost in the rounding of its position."""
    path, file = tmp_path / "scene.toml", write_small(tmp_path / "e.toml")
    path.write_text(
        'name = "far"\nclosed = false\n'
        + BOX.replace("1, 1, 1", "1e-9, 1, 1")
        + GREY_TOML
        + "position_m = [1e9, 0, 0]\n"
    )
    assert main(["run", str(file), "--out", str(tmp_path / "o"), "--workers", "1", "--set", f"scene={path}"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(f"omnirange: {file}: trial.scene: scene far ({path}): ")
    assert "without area" in said
