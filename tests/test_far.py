"""Scenes far from the world's origin: images and ranges are those of the same scene at the origin."""

import numpy as np
import pytest
import trimesh

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor, pixel_directions
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.simulation.export import write_glb
from harness.simulation.render import render, render_with_range
from harness.simulation.scene import Box, Plane, Scene
from harness.simulation.texture import BundledTexture, GreyTexture
from harness.simulation.truth import ranges, truth

SMALL = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
GRAVEL = BundledTexture(kind="bundled", name="gravel", tile_m=6.0)
YAW = 17.0
POLE = (1.90625, 0.59375)
"""From the room's middle; like the places, in binary fractions that a float64 holds far away too."""
PLACES = ((64.5, 0, 0), (-1e4 + 0.375, 2e4 + 0.625, 100), (5e5 + 0.375, 4e6 + 0.625, 100), (-4e6 - 0.125, 3e5, -2e3))


def room(x, y, z, scale=1.0, texture=GRAVEL):
    """A room of 6 m, turned, with a pole of 10 cm at 2 m."""
    turned = {"yaw_deg": YAW, "texture": texture}
    return Scene(
        name="far",
        scale=scale,
        objects=(
            Box(kind="box", inward=True, size_m=(6, 6, 6), position_m=(x, y, z), **turned),
            Box(kind="box", size_m=(0.1, 0.1, 2), position_m=(x + POLE[0], y + POLE[1], z), **turned),
        ),
    )


def view(x, y, z):
    return Pose(position_m=(x, y, z + 1))


def box_ranges(directions, middle, half):
    """Where rays from the origin enter and leave an upright box turned by YAW, closed form."""
    c, s = np.cos(np.radians(YAW)), np.sin(np.radians(YAW))
    to_box = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    d, middle = directions @ to_box.T, to_box @ middle
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (middle - half) / d, (middle + half) / d
    return np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)


def expected_ranges(directions):
    _, wall = box_ranges(directions, np.array([0, 0, 2.0]), np.array([3, 3, 3.0]))
    enter, leave = box_ranges(directions, np.array([*POLE, 0.0]), np.array([0.05, 0.05, 1.0]))
    on_pole = (enter < leave) & (enter > 0)
    return np.where(on_pole, enter, wall), on_pole


@pytest.mark.parametrize("place", PLACES)
def test_ranges_are_the_closed_form_far_away(place):
    directions, valid = pixel_directions(SMALL)
    visible = truth(room(*place), view(*place), directions, valid, wrap_columns=False)
    expected, on_pole = expected_ranges(directions)
    assert on_pole[valid].sum() > 50
    # The step of a float64 at 4e6 m is 4.7e-10 m; the places are exact, so that only the maths could add to it.
    np.testing.assert_allclose(visible.range_m[valid], expected[valid], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ranges(room(*place), view(*place), directions, valid), visible.range_m, atol=1e-12)


def test_ranges_of_places_that_a_float64_rounds_are_within_its_step():
    place = (500000.1, 4000000.3, 99.7)
    directions, valid = pixel_directions(SMALL)
    visible = truth(room(*place), view(*place), directions, valid, wrap_columns=False)
    expected, _ = expected_ranges(directions)
    # The pole's place is rounded by half a step, 2.3e-10 m, and its sides are seen at up to 70 degrees.
    off = np.abs(visible.range_m - expected)[valid]
    assert np.quantile(off, 0.999) < 1e-9
    # A pixel within a step of the outline may fall on either side of it: none does here.
    assert off.max() < 1e-8


@pytest.mark.parametrize("place", PLACES)
def test_image_and_second_view_far_away_are_those_at_the_origin(place):
    directions, valid = pixel_directions(SMALL)
    image, range_m = render_with_range(room(*place), SMALL, view(*place), 4)
    near_image, near_range = render_with_range(room(0, 0, 0), SMALL, view(0, 0, 0), 4)
    np.testing.assert_allclose(range_m, near_range, rtol=0, atol=1e-9)
    # A texture coordinate moves by 1e-9 m of a 6 m tile at most; float32 rounds to 1.5e-5.
    np.testing.assert_allclose(image, near_image, rtol=0, atol=1e-3)
    x, y, z = place
    far, near = (
        truth(
            room(*at),
            view(*at),
            directions,
            valid,
            pose_2=Pose(position_m=(at[0] + 0.5, at[1] + 0.25, at[2] + 1.5)),
            sensor_2=SMALL,
            wrap_columns=False,
        )
        for at in ((x, y, z), (0, 0, 0))
    )
    assert not near.unoccluded[valid].all()
    np.testing.assert_array_equal(far.visible, near.visible)
    np.testing.assert_array_equal(far.unoccluded, near.unoccluded)
    np.testing.assert_array_equal(far.discontinuity, near.discontinuity)


def test_a_scaled_scene_far_away():
    # Twice as large: the room stands at (1e6, 8e6) m and measures 12 m.
    directions, valid = pixel_directions(SMALL)
    pose = Pose(position_m=(1e6 + 0.75, 8e6 + 1.25, 202))
    visible = ranges(room(5e5 + 0.375, 4e6 + 0.625, 100, scale=2.0), pose, directions, valid)
    np.testing.assert_allclose(visible[valid], 2 * expected_ranges(directions)[0][valid], rtol=0, atol=2e-9)


def test_things_four_thousand_kilometres_apart_are_each_exact_from_nearby():
    x, y, z = PLACES[2]
    scene = Scene(
        name="both",
        closed=False,
        objects=(
            *room(x, y, z).objects,
            Plane(kind="plane", size_m=(4, 4), position_m=(0.1, 0.2, 0.3), texture=GRAVEL),
        ),
    )
    directions, valid = pixel_directions(SMALL)
    visible = ranges(scene, view(x, y, z), directions, valid)
    np.testing.assert_allclose(visible[valid], expected_ranges(directions)[0][valid], rtol=0, atol=1e-9)
    down = np.array([[[0.0, 0.0, -1.0]]])
    at_origin = ranges(scene, Pose(position_m=(0, 0, 1)), down, np.array([[True]]))
    np.testing.assert_allclose(at_origin, 0.7, rtol=0, atol=1e-15)


def test_messages_say_where_far_away():
    x, y, z = PLACES[2]
    with pytest.raises(InputError, match=r"\(500000\.375, 4000010\.625, 101\) m is outside.*y 3999996\.8"):
        render(room(x, y, z), SMALL, Pose(position_m=(x, y + 10, z + 1)))


def test_a_file_of_a_scene_far_away_keeps_its_shape(tmp_path):
    write_glb(room(*PLACES[2], texture=GreyTexture(kind="grey", value=9)), tmp_path / "far.glb")
    vertices = trimesh.load_scene(tmp_path / "far.glb").to_geometry().vertices
    pole = np.abs(vertices - [PLACES[2][0] + POLE[0], 101, -PLACES[2][1] - POLE[1]]).max(axis=1) < 1.01
    pole &= np.hypot(vertices[:, 0] - PLACES[2][0] - POLE[0], vertices[:, 2] + PLACES[2][1] + POLE[1]) < 0.2
    sides = np.linalg.norm(vertices[pole][:, None] - vertices[pole], axis=-1)
    # The pole is 10 cm wide: float32 within 16 m is good to 1e-6 m, at 4,000 km to 0.25 m.
    assert np.abs(sides[sides > 1e-3].min() - 0.1) < 2e-6
