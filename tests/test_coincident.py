"""Coincident faces: the later object is seen, in every view, in images and in truth; checked by brute force."""

import warnings

import numpy as np
import pytest
import trimesh

from harness import shipped
from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor, pixel_directions
from harness.cli import main
from harness.errors import InputError, Notice
from harness.geometry.pose import Pose
from harness.simulation.box_tree import LEAF, box_tree
from harness.simulation.coincident import enclosed, encloses
from harness.simulation.render import render, render_every_sample
from harness.simulation.scene import Box, Mesh, Plane, Scene, load_scene
from harness.simulation.scene_geometry import geometry_of
from harness.simulation.texture import GreyTexture
from harness.simulation.truth import ranges, truth

SMALL = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
VIEWS = (Pose(position_m=(0.1, 0.2, 1.0)), Pose(position_m=(0.6, -0.3, 1.3), yaw_deg=33, roll_deg=4))


def grey(value):
    return GreyTexture(kind="grey", value=value)


def room(*things, yaw_deg=0.0):
    """A room with things in it."""
    walls = Box(kind="box", name="room", inward=True, size_m=(6, 6, 3), yaw_deg=yaw_deg, texture=grey(10))
    return Scene(name="coincident", objects=(walls, *things))


def rug(value, x=0.0, y=0.0, size=(2, 2), yaw_deg=0.0, height=0.0, name=""):
    return Plane(kind="plane", name=name, size_m=size, position_m=(x, y, height), yaw_deg=yaw_deg, texture=grey(value))


def brute_force(scene, pose, directions):
    """The grey of the nearest surface along rays, the later of those within 1e-8 m, from all triangles."""
    geometry = geometry_of(scene)
    origin = np.array(pose.position_m)
    d = directions @ pose.R_world_from_view.T
    best, value = np.full(len(d), np.inf), np.zeros(len(d))
    greys = [texels[0, 0] for texels in geometry.textures]
    edge = np.zeros(len(d), dtype=bool)
    for triangle, face in zip(geometry.corners, geometry.face_of_triangle, strict=False):
        a, b, c = triangle - origin
        w = np.stack([d @ np.cross(b, c), d @ np.cross(c, a), d @ np.cross(a, b)])
        w = w / np.abs(w).sum(axis=0)
        edge |= (np.abs(w).min(axis=0) < 1e-6) & ((w > -1e-6).all(axis=0) | (w < 1e-6).all(axis=0))
        with np.errstate(divide="ignore"):
            s = np.dot(np.cross(b - a, c - a), a) / (d @ np.cross(b - a, c - a))
        meets = ((w >= 0).all(axis=0) | (w <= 0).all(axis=0)) & (s > 0) & (s <= best + 1e-8)
        best = np.where(meets, np.minimum(s, best), best)
        value[meets] = greys[geometry.texture_of_face[face]]
    return value, best, edge


def random_scene(seed):
    """Rugs on the floor and posters on a wall, at all angles in their planes, some touching."""
    rng = np.random.default_rng(seed)
    yaw = float(rng.uniform(-180, 180)) if seed % 2 else 0.0
    things = [
        rug(20 + 10 * i, *rng.uniform(-1.5, 1.5, 2), size=tuple(rng.uniform(0.5, 2, 2)), yaw_deg=rng.uniform(0, 90))
        for i in range(6)
    ]
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    for i in range(4):
        along, up = rng.uniform(-1, 1), rng.uniform(1, 2)
        things.append(
            Plane(
                kind="plane",
                size_m=tuple(rng.uniform(0.5, 1.5, 2)),
                position_m=(3 * c - along * s, 3 * s + along * c, up),
                yaw_deg=yaw,
                pitch_deg=90,
                texture=grey(100 + 10 * i),
            )
        )
    return room(*things, yaw_deg=yaw)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::harness.errors.Notice")
@pytest.mark.parametrize("seed", range(6))
def test_the_later_object_is_seen_in_both_views_and_in_truth(seed):
    scene = random_scene(seed)
    directions, valid = pixel_directions(SMALL)
    for pose in VIEWS:
        expected, range_m, edge = brute_force(scene, pose, directions[valid])
        visible = truth(scene, pose, directions, valid, wrap_columns=False)
        geometry = geometry_of(scene)
        greys = np.array([texels[0, 0] for texels in geometry.textures])
        result = greys[geometry.texture_of_face[visible.face[valid]]]
        # A ray within 1e-6 of a triangle's side may fall on either side of it.
        assert edge.mean() < 0.01
        np.testing.assert_array_equal(result[~edge], expected[~edge])
        np.testing.assert_allclose(visible.range_m[valid], range_m, rtol=0, atol=1e-8)
        one = render(scene, SMALL, pose, 1)[valid]
        np.testing.assert_array_equal(one[~edge], expected[~edge])
        np.testing.assert_array_equal(render(scene, SMALL, pose, 4), render_every_sample(scene, SMALL, pose, 4))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::harness.errors.Notice")
def test_a_point_on_a_rug_is_visible_from_the_other_view():
    directions, valid = pixel_directions(SMALL)
    scene = room(rug(20), rug(30, 0.5, 0.3))
    visible = truth(scene, VIEWS[0], directions, valid, pose_2=VIEWS[1], wrap_columns=False)
    assert visible.unoccluded[valid].all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::harness.errors.Notice")
def test_faces_that_float32_cannot_part_are_parted_by_range():
    # The first rug lies a tenth of a micrometre above the second: float32 has steps of 2e-7 m there.
    scene = room(rug(20, height=1e-6 + 1e-7), rug(30, height=1e-6))
    directions, valid = pixel_directions(SMALL)
    image = render(scene, SMALL, VIEWS[0], 1)
    on_rug = ranges(scene, VIEWS[0], directions, valid)
    points = VIEWS[0].position_m + on_rug[..., None] * directions
    inside = valid & (np.abs(points[..., :2]) < 0.99).all(axis=-1) & (points[..., 2] < 1e-3)
    assert inside.sum() > 500
    assert (image[inside] == 20).all()


def test_it_is_said_once_and_by_name():
    with pytest.warns(Notice, match=r"coincident: faces of 'room' and 'rug' coincide; the later one is visible"):
        render(room(rug(20, name="rug")), SMALL, VIEWS[0], 1)
    with pytest.warns(Notice, match=r"'object 1 \(plane\)' and 'object 2 \(plane\)'"):
        ranges(room(rug(20, height=0.1), rug(30, 0.7, height=0.1)), VIEWS[0], np.array([[[0, 0, -1.0]]]), [[True]])


@pytest.mark.parametrize(
    "things",
    [
        (Box(kind="box", size_m=(0.5, 0.5, 1), position_m=(2, 0, 0), texture=grey(20)),),  # stands on the floor
        (
            Box(kind="box", size_m=(0.5, 0.5, 0.5), position_m=(2, 0, 0), texture=grey(20)),
            Box(kind="box", size_m=(0.5, 0.5, 0.5), position_m=(2, 0, 0.5), texture=grey(30)),  # stands on it
            Box(kind="box", size_m=(0.5, 0.5, 0.5), position_m=(2, 0.5, 0), texture=grey(40)),  # beside it
        ),
        (rug(20, x=-1.0, height=0.1), rug(30, x=1.0, height=0.1)),  # side by side
        (rug(20, height=0.001),),
    ],
    ids=["on the floor", "stacked", "side by side", "a millimetre"],
)
def test_what_only_touches_is_not_coincident(things):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for pose in VIEWS:
            render(room(*things), SMALL, pose, 1)


@pytest.mark.parametrize("name", shipped.names("scenes"))
def test_shipped_scenes_have_none(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        render(load_scene(name), SMALL, Pose(position_m=(0, 0, 1)), 1)


def test_the_command_line_says_it_in_one_line(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(
        'name = "two rugs"\n[[objects]]\nkind = "box"\nname = "walls"\ninward = true\nsize_m = [4, 4, 3]\n'
        'texture = { kind = "grey", value = 9 }\n'
        '[[objects]]\nkind = "plane"\nname = "rug"\nsize_m = [1, 1]\ntexture = { kind = "grey", value = 99 }\n'
    )
    arguments = ["render", str(tmp_path / "scene.toml"), "--at", "0", "0", "1", "--samples", "1"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "coincide" in line]
    assert len(lines) == 1
    assert "'walls' and 'rug'" in lines[0]


def test_a_thing_that_is_there_a_thousand_times_is_refused(monkeypatch):
    """Without a limit, the number of pairs would be the square of theirs, in time and in memory."""
    monkeypatch.setattr("harness.simulation.coincident.MOST_PAIRS", 20)
    few, many = (room(*(rug(20 + i, name=f"{n} rugs") for i in range(n))) for n in (3, 8))
    assert len(geometry_of(few).rivals.pairs) == 6  # each rug with the floor and with each other
    with pytest.raises(InputError, match="coincident: more than a million pairs of its triangles"):
        geometry_of(many)


def test_encloses_agrees_with_a_ball():
    """An icosphere of radius 1 goes round what is within the ball that touches its faces, and nothing beyond 1."""
    corners = np.array(trimesh.creation.icosphere(subdivisions=3, radius=1.0).triangles)
    innermost = np.abs(np.einsum("ij,ij->i", corners[:, 0], trimesh.triangles.normals(corners)[0])).min()
    points = np.random.default_rng(5).uniform(-1.2, 1.2, (400, 3))
    radius = np.linalg.norm(points, axis=1)
    for p, r in zip(points, radius, strict=True):
        if r < innermost or r > 1:
            assert encloses(corners, p) == (r < 1)


# --- Many faces: what a tree of boxes finds is what brute force finds ----------------------------------------------


def cross(p, q):
    return float(p[0] * q[1] - p[1] * q[0])


def shared_area(a, b, normal):
    """The area that two triangles `[3, 3]` in one plane share: one is clipped by the sides of the other."""
    e1 = (a[1] - a[0]) / np.linalg.norm(a[1] - a[0])
    e2 = np.cross(normal, e1)
    polygon, window = [np.stack([(each - a[0]) @ e1, (each - a[0]) @ e2], axis=1) for each in (a, b)]
    if cross(window[1] - window[0], window[2] - window[0]) < 0:
        window = window[::-1]
    for p, q in zip(window, np.roll(window, -1, axis=0), strict=True):
        clipped = []
        for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            s, e = cross(q - p, start - p), cross(q - p, end - p)
            if s >= 0:
                clipped.append(start)
            if (s < 0) != (e < 0):
                clipped.append(start + (end - start) * s / (s - e))
        polygon = np.array(clipped)
        if not len(polygon):
            return 0.0
    return abs(sum(cross(p, q) for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True))) / 2


def brute_force_pairs(geometry):
    """Pairs of faces, from every pair of triangles."""
    corners, face = geometry.corners, geometry.face_of_triangle[:-1]
    pairs = set()
    for i, triangle in enumerate(corners):
        normal, offset = geometry.normals[face[i]], geometry.offsets[face[i]]
        in_plane = (np.abs(corners @ normal - offset) < 1e-6 * np.abs(corners).max()).all(axis=1)
        near = (corners.max(axis=1) >= triangle.min(axis=0)).all(axis=1) & (
            corners.min(axis=1) <= triangle.max(axis=0)
        ).all(axis=1)
        for j in np.flatnonzero(in_plane & near & (face > face[i])).tolist():
            if shared_area(triangle, corners[j], normal) > 1e-6:  # m^2, of triangles of 1e-2 m^2: touching is none
                pairs.add((int(face[i]), int(face[j])))
    return sorted(pairs)


def solids(tmp_path, kind, seed):
    """Two meshes that lie on each other in part, one of them with its winding upset, and a rug or poster on each."""
    rng = np.random.default_rng(seed)
    first = trimesh.creation.icosphere(subdivisions=2, radius=0.5) if kind == "balls" else trimesh.creation.box()
    for _ in range(3 if kind == "boxes" else 0):
        first = first.subdivide()
    second = first.copy()
    if kind == "boxes":
        second.apply_translation([0.0, 0.37, 0.21])  # its sides slide along those of the first
    upset = rng.random(len(second.faces)) < 0.5
    second.faces[upset] = second.faces[upset][:, ::-1]
    things = []
    for name, mesh in (("first", first), ("second", second)):
        mesh.export(tmp_path / f"{name}.ply")
        file = str(tmp_path / f"{name}.ply")
        things.append(Mesh(kind="mesh", name=name, file=file, position_m=(1.5, 0, 1.5), texture=grey(20)))
    return room(*things, rug(30, height=1.0, x=1.5), rug(40, size=(0.3, 0.3), height=1.0, x=1.5))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["balls", "boxes"])
def test_pairs_and_sides_are_those_of_brute_force(tmp_path, kind):
    geometry = geometry_of(solids(tmp_path, kind, 3))
    pairs = geometry.rivals.pairs
    assert pairs.tolist() == [list(each) for each in brute_force_pairs(geometry)]
    assert len(pairs) > 300
    corners_of = {solid.name: solid.corners for solid in geometry.solids}
    first_triangle = np.unique(geometry.face_of_triangle[:-1], return_index=True)[1]
    for faces, sides in zip(pairs.tolist(), geometry.rivals.visible_from.tolist(), strict=True):
        for face, side in zip(faces, sides, strict=True):
            solid = corners_of.get(geometry.object_names[geometry.object_of_face[face]])
            if solid is None:
                continue
            middle = geometry.corners[first_triangle[face]].mean(axis=0)
            assert side == (-1 if encloses(solid, middle + 1e-4 * geometry.normals[face]) else 1)


@pytest.mark.parametrize("boxes", [1, LEAF, LEAF + 1, 1000])
@pytest.mark.parametrize("kind", ["anywhere", "flat", "one place", "far"])
def test_every_box_lies_in_its_leaf_and_in_all_nodes_above(boxes, kind):
    rng = np.random.default_rng(boxes)
    low = rng.normal(size=(boxes, 3)) * {"anywhere": [1, 1, 1], "flat": [1, 1, 0], "one place": 0, "far": 1e-9}[kind]
    low += 1e6 * (kind == "far")
    high = low + rng.random((boxes, 3)) ** 8  # most of them small, some as large as all
    tree = box_tree(low, high)
    assert sorted(tree.order) == list(range(boxes))
    for place, box in enumerate(tree.order):
        node = len(tree.low) // 2 + place // LEAF
        while node:
            assert (tree.low[node] <= low[box]).all()
            assert (tree.high[node] >= high[box]).all()
            node //= 2


def test_points_are_enclosed_as_one_by_one():
    rng = np.random.default_rng(8)
    ball = np.array(trimesh.creation.icosphere(subdivisions=3, radius=1.0).triangles)
    shell = np.concatenate([ball, 0.6 * ball[::-1], rng.permutation(0.3 * ball) + 0.1])
    points = np.concatenate([rng.uniform(-1.2, 1.2, (500, 3)), ball.mean(axis=1)[:200] * (1 + 1e-5)])
    inside = enclosed(shell, points)
    assert inside.tolist() == [encloses(shell, p) for p in points]
    assert 50 < inside.sum() < 450
    assert enclosed(shell, points[:0]).shape == (0,)


@pytest.mark.slow
def test_two_meshes_of_thousands_of_triangles_in_one_place(tmp_path):
    """A hundred times as fast as every face against every triangle: slow would be noticed by `make quick`."""
    trimesh.creation.icosphere(subdivisions=5, radius=0.5).export(tmp_path / "ball.ply")
    ball = {"kind": "mesh", "file": str(tmp_path / "ball.ply"), "position_m": (1, 0, 1), "texture": grey(20)}
    geometry = geometry_of(room(Mesh(name="one", **ball), Mesh(name="two", **ball)))
    triangles = 20 * 4**5
    assert geometry.rivals.pairs.tolist() == [[6 + i, 6 + triangles + i] for i in range(triangles)]
    assert (geometry.rivals.visible_from == 1).all()  # the file's normals point outwards
