"""The renderer against closed forms, and its shortcut against tracing every sample."""

import math

import numpy as np
import pytest
from repeats import few

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor, field_of, parameters_of, pixel_directions, project, unproject
from harness.geometry.pose import Pose
from harness.simulation import render as rendering
from harness.simulation._rendering_kernels import INVALID, TRACE, mark_edges
from harness.simulation.render import render, render_every_sample, render_with_range
from harness.simulation.scene import Box, Plane, Scene, load_scene
from harness.simulation.shading import view_from
from harness.simulation.texture import GreyTexture, NoiseTexture, lookup, texels_of
from harness.simulation.truth import ranges

SHIPPED = ("box", "corridor", "room")
DEFAULT = Sensor()
SMALL = Sensor(camera=Camera(width_px=320, height_px=240, focal_px=307, cx_px=159.5, cy_px=119.5))
TILTED = SMALL.model_copy(
    update={
        "mount": Mount(yaw_deg=15, pitch_deg=35, roll_deg=-20),
        "field": FieldOfView(elevation_min_deg=-90, elevation_max_deg=20, angle_max_deg=80),
    }
)
DISTORTED = SMALL.model_copy(update={"lens": Lens(k1=-0.12, k2=0.03, p1=2e-3, p2=-1e-3)})
POSES = (
    Pose(position_m=(0, 0, 1)),
    Pose(position_m=(0.5, 0, 1)),
    Pose(position_m=(0.2, 0.1, 1.2), yaw_deg=37, pitch_deg=9, roll_deg=-6),
)

# In grey levels of 255. The two ways sum the same float64 samples; a single sample of 16 on a wrong face would
# show as 1/16 of the contrast there, a hundred times as much even on the faintest one.
SHORTCUT_TOLERANCE = 1e-3


def noise(seed, tile_m=4.0):
    return NoiseTexture(kind="noise", seed=seed, tile_m=tile_m, shortest_m=0.1, longest_m=1.0, size_px=256)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("pose", POSES, ids=["first", "second", "turned"])
def test_shortcut_equals_every_sample(name, pose):
    scene = load_scene(name)
    difference = np.abs(render(scene, DEFAULT, pose) - render_every_sample(scene, DEFAULT, pose))
    assert difference.max() <= SHORTCUT_TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [SMALL, DISTORTED], ids=["small", "distorted"])
@pytest.mark.parametrize("samples", [1, 4, 64])
def test_shortcut_equals_every_sample_through_any_lens(sensor, samples):
    scene = load_scene("room")
    difference = np.abs(
        render(scene, sensor, POSES[2], samples) - render_every_sample(scene, sensor, POSES[2], samples)
    )
    assert difference.max() <= SHORTCUT_TOLERANCE


def random_scene(seed):
    """A room full of small boxes, slabs and poles at all angles, some cutting through each other."""
    rng = np.random.default_rng(seed)
    objects = [Box(kind="box", inward=True, size_m=(6, 6, 3), texture=noise(seed))]
    while len(objects) < 25:
        position = rng.uniform([-2.5, -2.5, 0.2], [2.5, 2.5, 2.5])
        if np.linalg.norm(position - [0, 0, 1]) < 1:
            continue
        size = np.exp(rng.uniform(np.log(0.003), np.log(0.7), 3))
        yaw, pitch, roll = rng.uniform(-180, 180, 3)
        texture = noise(int(rng.integers(3))) if rng.random() < 0.5 else None
        texture = texture or GreyTexture(kind="grey", value=float(rng.uniform(0, 255)))
        placed = {
            "position_m": tuple(position),
            "yaw_deg": yaw,
            "pitch_deg": pitch,
            "roll_deg": roll,
            "texture": texture,
        }
        if rng.random() < 0.3:
            objects.append(Plane(kind="plane", size_m=tuple(size[:2]), **placed))
        else:
            objects.append(Box(kind="box", size_m=tuple(size), **placed))
    return Scene(name=f"random {seed}", objects=tuple(objects))


@pytest.mark.slow
@pytest.mark.parametrize("seed", few(4, range(8)))
def test_shortcut_equals_every_sample_in_random_scenes(seed):
    scene = random_scene(seed)
    pose = Pose(position_m=(0, 0, 1), yaw_deg=11.0 * seed, roll_deg=3)
    sensor = DISTORTED if seed % 2 else SMALL
    difference = np.abs(render(scene, sensor, pose) - render_every_sample(scene, sensor, pose))
    assert difference.max() <= SHORTCUT_TOLERANCE


@pytest.mark.slow
def test_without_the_edges_the_thin_pole_would_be_lost():
    scene, pose = load_scene("room"), POSES[0]
    view = view_from(scene, pose)
    careless = rendering._face_of_pixels(view, DEFAULT, None, with_edges=False)
    difference = np.abs(
        rendering._shaded(view, DEFAULT, careless, 16, None) - render_every_sample(scene, DEFAULT, pose)
    )
    wrong = difference > SHORTCUT_TOLERANCE
    pole = project(DEFAULT, np.array([1.7, -1.1, -0.2]))[0]
    v, u = np.nonzero(wrong)
    assert wrong.sum() > 10
    assert difference.max() > 5
    assert np.hypot(u - pole[0], v - pole[1]).min() < 5


def test_few_pixels_are_traced():
    _, valid = pixel_directions(DEFAULT)
    for name, share in (("box", 0.03), ("room", 0.1)):
        view = view_from(load_scene(name), POSES[0])
        faces = rendering._face_of_pixels(view, DEFAULT, None)
        assert np.count_nonzero(faces == TRACE) < share * valid.sum()


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [SMALL, DISTORTED, TILTED], ids=["small", "distorted", "tilted"])
def test_edges_are_marked_where_the_sensor_projects_them(sensor):
    rng = np.random.default_rng(7)
    pose = POSES[2]
    rotation, origin = pose.R_world_from_view, np.array(pose.position_m)
    edges = origin + rng.standard_normal((40, 2, 3)) * [1, 1, 0.6]
    marks = np.zeros((240, 320), dtype=bool)
    step = 0.9 * rendering._corners_of(sensor).finest_rad
    field = field_of(sensor, math.radians(2))
    mark_edges(edges, origin, rotation, parameters_of(sensor), field, step, False, marks)
    share = np.linspace(0, 1, 20_000)[:, None, None]
    points = (edges[:, 0] * (1 - share) + edges[:, 1] * share).reshape(-1, 3)
    pixels, valid = project(sensor, (points - origin) @ rotation)
    u, v = np.rint(pixels[valid]).astype(int).T
    assert valid.sum() > 1000
    assert marks[v.clip(0, 239), u.clip(0, 319)].all()
    # Not more than a band about two and a half pixels wide.
    passed = np.zeros_like(marks)
    passed[v.clip(0, 239), u.clip(0, 319)] = True
    _, in_field = pixel_directions(sensor)
    assert np.count_nonzero(marks & in_field) < 3 * np.count_nonzero(passed)


SIDES = (("x_min", "x_max"), ("y_min", "y_max"), ("bottom", "top"))
LEVEL_AND_UPRIGHT = ((1, 2), (0, 2), (0, 1))
"""The axes along which u and v of a side run, by the axis that the side is across."""


class InsideABox:
    """A room that is one axis-aligned box, from slabs and `lookup` alone."""

    def __init__(self, scene, sensor, pose):
        self.box, self.sensor, self.pose = scene.objects[0], sensor, pose
        self.low = np.array([-self.box.size_m[0] / 2, -self.box.size_m[1] / 2, 0]) + self.box.position_m
        self.high = self.low + self.box.size_m

    def directions(self, pixels):
        return unproject(self.sensor, pixels)[0] @ self.pose.R_world_from_view.T

    def hits(self, pixels):
        """The side that each pixel position `[..., 2]` sees, as twice its axis and one if it is the upper, and the
        grey there."""
        directions = self.directions(pixels)
        reach = np.where(directions > 0, self.high - self.pose.position_m, self.low - self.pose.position_m) / directions
        axis = np.argmin(reach, axis=-1)
        side = 2 * axis + (np.take_along_axis(directions, axis[..., None], -1)[..., 0] > 0)
        points = self.pose.position_m + reach.min(axis=-1)[..., None] * directions - self.low
        grey = np.empty(side.shape)
        for each in range(6):
            here, texture = side == each, self.texture(each)
            uv = points[here][:, LEVEL_AND_UPRIGHT[each // 2]] / texture.tile_m
            grey[here] = lookup(texels_of(texture), uv)
        return side, grey

    def texture(self, side):
        return self.box.texture_of(SIDES[side // 2][side % 2])

    def longest_side(self, pixels, side):
        """The longest side of whole pixels `[n, 2]` on the planes of a room's sides `[n]`, in texels."""
        corners = pixels[:, None, :] + [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
        directions = self.directions(corners)
        longest = np.empty(len(pixels))
        for each in range(6):
            here, axis, texture = side == each, each // 2, self.texture(each)
            wall = (self.high if each % 2 else self.low)[axis] - self.pose.position_m[axis]
            reach = wall / directions[here][..., axis]
            points = (reach[..., None] * directions[here])[..., LEVEL_AND_UPRIGHT[axis]]
            texels = points / texture.tile_m * texels_of(texture).shape[::-1]
            length = np.linalg.norm(texels - np.roll(texels, 1, axis=1), axis=-1).max(axis=1)
            longest[here] = np.where((reach > 0).all(axis=1), length, np.inf)
        return longest

    def mean_grey(self, pixels, per_side):
        """The side of each sample of pixels `[n, 2]`, and the mean grey of each pixel."""
        offsets = (np.arange(per_side) + 0.5) / per_side - 0.5
        dv, du = np.meshgrid(offsets, offsets, indexing="ij")
        side, grey = self.hits(pixels[:, None, :] + np.stack([du.ravel(), dv.ravel()], axis=-1))
        return side, grey.mean(axis=1)


@pytest.mark.parametrize("name", ["box", "corridor"])
@pytest.mark.parametrize("sensor", [DEFAULT, DISTORTED], ids=["default", "distorted"])
def test_pixels_are_the_mean_of_the_textures_greys(name, sensor):
    scene, pose = load_scene(name), POSES[2]
    _, valid = pixel_directions(sensor)
    v, u = np.nonzero(valid)
    some = np.random.default_rng(8).choice(u.size, 3000, replace=False)
    pixels = np.stack([u[some], v[some]], axis=-1).astype(float)
    room = InsideABox(scene, sensor, pose)
    side, expected = room.mean_grey(pixels, 4)
    # The rule of `render`: twice as closely where several sides are seen, else by the texels between two samples.
    spacing = room.longest_side(pixels, side[:, 0]) / 4
    several = (side != side[:, :1]).any(axis=1)
    doubled = np.where(several, 1, np.select([spacing > 8, spacing > 1.5], [2, 1], 0))
    assert (np.bincount(doubled, minlength=3)[: 2 if name == "box" else 3] >= 10).all()
    for times in (1, 2):
        here = doubled == times
        expected[here] = room.mean_grey(pixels[here], 4 * 2**times)[1]
    image = render(scene, sensor, pose)
    # The image is float32, whose step at 255 is 1.5e-5. A sample within 1e-7 of a crease may fall on either side
    # of it.
    np.testing.assert_allclose(image[v[some], u[some]], expected, rtol=0, atol=5e-5)


def test_threads_change_no_bit():
    scene = load_scene("room")
    images = [render(scene, DEFAULT, POSES[2], threads=n) for n in (1, 2, 3)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_sixteen_samples_leave_little_aliasing(name):
    # Against 1,024 samples, which are off by 0.01 themselves (their error falls with the cube of the samples along a
    # side). Sixteen samples everywhere would leave 0.33, 0.75 and 0.44; a camera of 8 bits rounds by 0.29.
    view = view_from(load_scene(name), POSES[0])
    faces = rendering._face_of_pixels(view, DEFAULT, None)
    # Pixels of a grid of its own: one in nine of each row, with 20,000 in all.
    some = np.where(np.arange(faces.size).reshape(faces.shape) % 9 == 0, faces, INVALID)
    coarse, fine = (rendering._shaded(view, DEFAULT, some, samples, None) for samples in (16, 1024))
    assert np.sqrt(np.mean((coarse - fine)[some != INVALID] ** 2)) <= 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_sixteen_samples_are_enough(name):
    scene = load_scene(name)
    _, valid = pixel_directions(DEFAULT)
    for pose in POSES[:2]:
        change = render(scene, DEFAULT, pose, 16) - render(scene, DEFAULT, pose, 64)
        assert np.sqrt(np.mean(change[valid] ** 2)) <= 1


def test_image_is_black_outside_the_field_and_within_0_to_255():
    _, valid = pixel_directions(DEFAULT)
    image = render(load_scene("room"), DEFAULT, POSES[0])
    assert image.dtype == np.float32
    assert image.shape == valid.shape
    assert (image[~valid] == 0).all()
    assert (image[valid] > 0).mean() > 0.99
    assert image.min() >= 0
    assert image.max() <= 255


def test_a_constant_world_is_constant_to_the_rim():
    # Also where a pixel's samples fall a hair beyond the rim's cone: the image does not darken there.
    scene = Scene(
        name="grey",
        objects=(Box(kind="box", inward=True, size_m=(4, 4, 4), texture=GreyTexture(kind="grey", value=99)),),
    )
    _, valid = pixel_directions(DEFAULT)
    image = render(scene, DEFAULT, POSES[2])
    np.testing.assert_array_equal(image, np.where(valid, np.float32(99), np.float32(0)))


@pytest.mark.parametrize("name", SHIPPED)
def test_ranges_beside_the_image_are_the_truth(name):
    scene = load_scene(name)
    directions, valid = pixel_directions(DEFAULT)
    image, range_m = render_with_range(scene, DEFAULT, POSES[2])
    np.testing.assert_array_equal(image, render(scene, DEFAULT, POSES[2]))
    expected = ranges(scene, POSES[2], directions, valid)
    # The same plane, intersected in float64 in another frame.
    np.testing.assert_allclose(range_m, expected, rtol=0, atol=1e-11)


def test_open_scene_shows_its_background():
    floor = Plane(kind="plane", size_m=(4, 4), texture=noise(1))
    scene = Scene(name="floor", closed=False, background_grey=33, objects=(floor,))
    image, range_m = render_with_range(scene, SMALL, POSES[0])
    np.testing.assert_allclose(image, render_every_sample(scene, SMALL, POSES[0]), atol=SHORTCUT_TOLERANCE)
    directions, valid = pixel_directions(SMALL)
    up = valid & (directions[..., 2] > 0)
    assert up.any()
    assert (image[up] == 33).all()
    assert np.isnan(range_m[up]).all()


def test_image_does_not_change_when_the_world_is_scaled():
    scene = load_scene("room")
    once = render(scene, SMALL, Pose(position_m=(0.25, 0, 1)))
    twice = render(scene.model_copy(update={"scale": 2.0}), SMALL, Pose(position_m=(0.5, 0, 2)))
    # Doubling is exact; only the homographies' products may round differently.
    np.testing.assert_allclose(twice, once, rtol=0, atol=SHORTCUT_TOLERANCE)


def test_turning_the_view_turns_the_picture():
    scene = load_scene("room")
    square = Sensor(camera=Camera(width_px=480, height_px=480, cx_px=239.5, cy_px=239.5))
    straight = render(scene, square, Pose(position_m=(0, 0, 1)))
    turned = render(scene, square, Pose(position_m=(0, 0, 1), yaw_deg=90))
    # What lies at phi lies at phi - 90 degrees when the view is turned by +90. phi runs from u to v, clockwise in
    # the picture as it is printed, so that the picture turns anticlockwise: what was below is on the right.
    # The grid of samples is turned onto itself: only samples on an outline may change sides.
    difference = np.abs(turned - np.rot90(straight))
    assert np.median(difference) < 1e-3
    assert difference.mean() < 0.01


def test_a_narrow_field_renders():
    sensor = SMALL.model_copy(update={"field": FieldOfView(elevation_min_deg=-30, elevation_max_deg=-10)})
    image = render(load_scene("box"), sensor, POSES[0])
    _, valid = pixel_directions(sensor)
    assert (image[~valid] == 0).all()
    assert (image[valid] > 0).mean() > 0.99


@pytest.mark.parametrize("samples", [0, 2, 15, -4])
def test_samples_must_be_a_square_number(samples):
    with pytest.raises(ValueError, match="square number"):
        render(load_scene("box"), SMALL, POSES[0], samples)
