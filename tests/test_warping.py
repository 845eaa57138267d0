"""Views warped from ranges: the surface of a map, what rays meet of it, and what images show there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import harness
from harness.camera.sensor import Sensor, in_use
from harness.camera.unwrap import sample, unwrap
from harness.geometry.angles import normalise
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import AT_REST, Pose, relative_motion
from harness.simulation.render import render
from harness.simulation.truth import truth
from harness.warping.surface import RangeSurface
from harness.warping.warp import Image, PixelState, Source, warp

GRID = Grid(width_px=180, height_px=50)
LOOKING = directions(GRID)
SENSOR = Sensor.model_validate(
    {"camera": {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}}
)


def ranges_of_room(size_m, height_m=1.0):
    """Ranges in a closed box around the viewpoint, by intersecting its six planes one by one."""
    half = np.array([size_m[0] / 2, size_m[1] / 2])
    with np.errstate(divide="ignore"):
        walls = np.min(half / np.abs(LOOKING[..., :2]), axis=-1)
        floor = np.where(LOOKING[..., 2] < 0, -height_m / LOOKING[..., 2], np.inf)
        ceiling = np.where(LOOKING[..., 2] > 0, (size_m[2] - height_m) / LOOKING[..., 2], np.inf)
    return np.minimum(walls, np.minimum(floor, ceiling))


def surface(range_m, sigma_m=0.0):
    return RangeSurface(GRID, range_m, np.broadcast_to(sigma_m, GRID.shape).astype(float))


# --- The surface ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(
    azimuth=st.floats(-3.1, 3.1), tilt=st.floats(-0.5, 0.5), height=st.floats(0.5, 5.0),
    x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), z=st.floats(-0.3, 0.3),
)  # fmt: skip
def test_a_plane_is_met_where_it_is(azimuth, tilt, height, x, y, z):
    normal = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    towards = LOOKING @ normal
    range_m = np.where(towards > 0.2, height / np.where(towards > 0.2, towards, 1.0), np.nan)
    viewpoint = height * np.array([x, y, z])
    rays = LOOKING[10:40:3, ::5].reshape(-1, 3)
    distance, pixel = surface(range_m).meet(viewpoint, rays)
    hit = pixel >= 0
    assert hit.sum() > 20
    exact = (height - normal @ viewpoint) / (rays[hit] @ normal)
    # 1/s is linear in z and a sinusoid in azimuth: between pixels it is off by pitch^2/8 of its amplitude, which is
    # 1/(n . d) times the value itself; the new ray may be five times as slanted. Float32 adds 1e-6.
    assert np.abs(distance[hit] / exact - 1).max() < 5 * 5 * GRID.phi_pitch**2 / 8 + 1e-5


def test_a_room_has_no_gap():
    inside = surface(ranges_of_room((6.0, 4.0, 3.0)))
    distance, pixel = inside.meet(np.array([0.4, -0.3, 0.1]), LOOKING[12:30].reshape(-1, 3))
    assert (pixel >= 0).all()
    assert np.isfinite(distance).all()


def test_what_is_behind_an_outline_is_told_from_what_has_no_range():
    range_m = ranges_of_room((6.0, 6.0, 3.0))
    plate = np.abs(GRID.phi) < 0.3
    range_m[:, plate] = np.minimum(range_m[:, plate], 1.0)  # in front of the wall
    gap = np.abs(GRID.phi - 2.0) < 0.2
    range_m[:, gap] = np.nan
    seen = surface(range_m)
    viewpoint = np.array([0.0, 0.5, 0.0])
    rays = LOOKING[12:20].reshape(-1, 3)
    _, pixel = seen.meet(viewpoint, rays)
    distance, behind, unmatched = seen.in_a_gap(viewpoint, rays[pixel < 0])
    assert (behind | unmatched).all()
    assert np.isfinite(distance).all()
    # The shadow lies between the plate's left edge and the point of the wall at x = 3 that this hides from the origin,
    # as they are seen from the new viewpoint.
    edge = np.array([np.cos(0.3), np.sin(0.3)])
    shade = 3.0 * np.array([1.0, np.tan(0.3)])
    first, last = (np.arctan2(*(point - viewpoint[:2])[::-1]) for point in (edge, shade))
    azimuth = np.arctan2(rays[pixel < 0, 1], rays[pixel < 0, 0])
    margin = 2 * GRID.phi_pitch
    assert ((azimuth[behind] > min(first, last) - margin) & (azimuth[behind] < max(first, last) + margin)).all()
    assert behind.sum() > 8 * (abs(first - last) / GRID.phi_pitch - 4)
    assert (azimuth[unmatched] > 1.4).all()


def test_what_is_unsure_does_not_tear_the_surface():
    rng = np.random.default_rng(1)
    exact = ranges_of_room((6.0, 6.0, 3.0))
    sigma = np.full(GRID.shape, 0.08) * exact
    noisy = exact + sigma * rng.standard_normal(GRID.shape)
    rays = LOOKING[12:30].reshape(-1, 3)
    missed = [(each.meet(np.array([0.2, 0.1, 0.0]), rays)[1] < 0).mean()
              for each in (surface(noisy), RangeSurface(GRID, noisy, sigma))]  # fmt: skip
    # Steps of three standard deviations occur: at one in a hundred of the patches' sides.
    assert missed[1] < 0.02
    assert missed[0] > 0.05


@pytest.mark.parametrize("wrong", [np.full(GRID.shape, np.nan), np.ones((3, 4))])
def test_a_map_without_ranges_is_refused(wrong):
    with pytest.raises(ValueError, match=r"no range|ranges and sigmas must be"):
        RangeSurface(GRID, wrong, np.zeros(GRID.shape))


# --- The picture ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def room():
    """Two views of the box, and the first one's ranges."""
    scene = harness.load_scene("box")
    poses = Pose(position_m=(0.0, 0.0, 1.0)), Pose(position_m=(0.4, 0.1, 1.0), yaw_deg=20.0)
    images = [render(scene, SENSOR, pose) for pose in poses]
    seen = truth(scene, poses[0], LOOKING, in_use(SENSOR, LOOKING))
    return scene, poses, images, seen.range_m


def test_without_a_motion_the_picture_is_the_panorama(room):
    _, _, images, range_m = room
    view = warp([Source(surface(range_m), AT_REST)], [Image(images[0], SENSOR, AT_REST)], np.zeros(3), LOOKING)
    expected = unwrap(images[0], SENSOR, GRID, interpolation="cubic")
    both = expected.valid & ~view.holes
    assert both.mean() > 0.95
    # A patch's point is on its pixel's ray to float32.
    np.testing.assert_allclose(view.grey[both], expected.values[both], atol=0.02)
    np.testing.assert_allclose(view.range_m[both], range_m[both], rtol=2e-4)  # pitch^2/8


def test_another_viewpoint_shows_what_is_rendered_there(room):
    scene, poses, images, range_m = room
    pose = Pose(position_m=(0.1, 0.25, 1.1))
    motion = relative_motion(*poses)
    sources = [Image(images[0], SENSOR, AT_REST), Image(images[1], SENSOR, motion)]
    viewpoint = relative_motion(poses[0], pose).t_v1
    view = warp([Source(surface(range_m), AT_REST)], sources, viewpoint, LOOKING)
    there = truth(scene, pose, LOOKING, in_use(SENSOR, LOOKING))
    both = ~view.holes & np.isfinite(there.range_m)
    assert both.mean() > 0.8
    assert np.nanmedian(np.abs(view.range_m / there.range_m - 1)[both]) < 1e-3
    expected, valid = sample(render(scene, SENSOR, pose), SENSOR, LOOKING)
    nearest, _ = sample(images[0], SENSOR, LOOKING)
    both &= valid
    rms = [np.sqrt(np.mean((each - expected)[both] ** 2)) for each in (view.grey, nearest)]
    assert rms[0] < 0.4 * rms[1]


def test_the_second_image_shows_the_same_as_the_first(room):
    """Also with a rotation between the views: each image alone gives nearly the same picture."""
    _, poses, images, range_m = room
    motion = relative_motion(*poses)
    source = [Source(surface(range_m), AT_REST)]
    alone = [
        warp(source, [image], np.array([0.2, 0.05, 0.0]), LOOKING)
        for image in (Image(images[0], SENSOR, AT_REST), Image(images[1], SENSOR, motion))
    ]
    both = ~alone[0].holes & ~alone[1].holes
    assert both.mean() > 0.7
    correlation = np.corrcoef(alone[0].grey[both], alone[1].grey[both])[0, 1]
    assert correlation > 0.9  # of two samplings of a texture that is fine for this sensor


def test_the_surer_map_counts_more():
    exact = ranges_of_room((6.0, 6.0, 3.0))
    maps = [surface(exact, 0.01), surface(1.02 * exact, 0.1)]
    flat = np.full((120, 160), 100.0, dtype=np.float32)
    view = warp([Source(each, AT_REST) for each in maps], [Image(flat, SENSOR, AT_REST)], np.zeros(3), LOOKING)
    met = np.isfinite(view.range_m)
    weights = 1 / np.array([0.01**2, 0.1**2])
    mean = exact * (weights[0] + 1.02 * weights[1]) / weights.sum()
    np.testing.assert_allclose(view.range_m[met], mean[met], rtol=1e-3)  # patches: pitch^2/8
    np.testing.assert_allclose(view.sigma_m[met], weights.sum() ** -0.5, rtol=1e-3)


def test_holes_are_filled_on_request_and_stay_known(room):
    _, _, images, range_m = room
    holed = np.where(np.abs(GRID.phi) < 0.2, np.nan, range_m)
    arguments = [Source(surface(holed), AT_REST)], [Image(images[0], SENSOR, AT_REST)], np.zeros(3), LOOKING
    open_view, filled = warp(*arguments), warp(*arguments, fill=True)
    assert (open_view.state == PixelState.UNMATCHED).any()
    np.testing.assert_array_equal(open_view.state, filled.state)
    assert np.isnan(open_view.grey[open_view.holes]).all()
    assert np.isfinite(filled.grey).all()


def test_nothing_is_warped_from_nothing():
    with pytest.raises(ValueError, match="one map of ranges and one image"):
        warp([], [], np.zeros(3), LOOKING)


def test_rays_without_a_direction_are_outside(room):
    _, _, images, range_m = room
    rays = normalise(LOOKING.copy())
    rays[0] = np.nan
    view = warp([Source(surface(range_m), AT_REST)], [Image(images[0], SENSOR, AT_REST)], np.zeros(3), rays)
    assert (view.state[0] == PixelState.OUTSIDE).all()
