"""Range profiles against distances worked out by hand, and their files read back."""

import io
import json

import numpy as np
import pandas as pd
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import harness
from harness.cli.parser import main
from harness.errors import InputError
from harness.evaluation.scan_scores import obstacles_of, score_scan
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Pose
from harness.mapping.range_profile import RangeProfile, bearings, level_frame, range_profile
from harness.mapping.scan_files import as_csv, as_pcd, as_ply, from_laser_scan, laser_scan
from harness.mapping.settings import Scan
from harness.pipeline.scan import layers, true_scan
from harness.pipeline.specification import Trial
from harness.runs.scans import scans_conclusions, scans_of

GRID = Grid(width_px=90, height_px=60)
SCAN = Scan(bearings=90, support_px=3)
HALF = np.array([3.0, 2.0])  # of the box's sides


def box_ranges(rays, position, turn):
    """Where rays of a view meet a box of 6 m x 4 m x 3 m, from inside: the nearest of six planes."""
    world = rays @ turn.T
    low, high = np.array([-3.0, -2.0, 0.0]), np.array([3.0, 2.0, 3.0])
    with np.errstate(divide="ignore"):
        return np.where(world > 0, (high - position) / world, (low - position) / world).min(axis=-1)


def wall_m(azimuth, position):
    """Horizontal distance of the box's walls in a direction of the world."""
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    with np.errstate(divide="ignore"):
        return ((np.sign(towards) * HALF - position[:2]) / towards).min(axis=-1)


def made(pose, sigma_share=0.01, scan=SCAN, grid=GRID):
    rays = directions(grid)
    position, turn = np.asarray(pose.position_m), pose.R_world_from_view
    range_m = box_ranges(rays, position, turn)
    return range_profile(rays, range_m, sigma_share * range_m, turn, position[2], scan)


@settings(deadline=None, max_examples=10)
@given(x=st.floats(-2.5, 2.5), y=st.floats(-1.5, 1.5), yaw=st.floats(-180, 180))
def test_a_box_seen_level_has_its_walls_distances(x, y, yaw):
    profile = made(Pose(position_m=(x, y, 1.0), yaw_deg=yaw))
    expected = wall_m(profile.bearing + np.radians(yaw), np.array([x, y]))
    assert profile.range_m == pytest.approx(expected, rel=1e-9)  # all pixels of a bearing are at one distance
    # Of exact ranges sigma is that of the pixels: a hundredth of the range, which is longer than the distance.
    assert (profile.sigma_m >= 0.01 * expected * np.cos(np.arctan(1.5))).all()
    assert (profile.sigma_m <= 0.01 * expected * 1.0001).all()


@settings(deadline=None, max_examples=10)
@given(yaw=st.floats(-180, 180), pitch=st.floats(-15, 15), roll=st.floats(-15, 15))
def test_a_tilted_view_has_the_same_profile(yaw, pitch, roll):
    """In the level frame whose x is above the view's; within what a bearing spans."""
    pose = Pose(position_m=(0.4, -0.3, 1.2), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    profile = made(pose)
    edges = profile.bearing[:, None] + np.linspace(-0.5, 0.5, 201) * profile.increment + np.radians(yaw)
    there = wall_m(edges, np.array([0.4, -0.3]))
    assert profile.known.mean() > 0.9
    known = profile.known
    slack = 0.002  # a corner between two of the 0.02 degrees at which the wall is looked up
    assert (profile.range_m[known] >= there.min(axis=1)[known] - slack).all()
    assert (profile.range_m[known] <= there.max(axis=1)[known] + slack).all()


def test_a_frame_has_x_above_the_views():
    pose = Pose(yaw_deg=40, pitch_deg=20, roll_deg=-10)
    x = level_frame(pose.R_world_from_view) @ [1, 0, 0]
    assert x[1] == pytest.approx(0, abs=1e-12)
    assert x[0] > 0
    assert level_frame(pose.R_world_from_view) @ pose.R_world_from_view.T @ [0, 0, 1] == pytest.approx([0, 0, 1])
    assert np.allclose(level_frame(Pose(pitch_deg=90).R_world_from_view) @ Pose(pitch_deg=90).R_world_from_view.T,
                       np.eye(3))  # fmt: skip


def of_points(rho, bearing, height, sigma, scan):
    """The profile of single points, seen from 1 m of height."""
    rays = np.stack([rho * np.cos(bearing), rho * np.sin(bearing), height - 1.0], axis=-1)
    range_m = np.linalg.norm(rays, axis=-1)
    return range_profile(rays / range_m[:, None], range_m, sigma, np.eye(3), 1.0, scan)


def test_noise_does_not_pull_obstacles_nearer():
    """The nearest of many noisy distances lies 2.4 standard deviations too near; their group does not."""
    rng = np.random.default_rng(1)
    scan = Scan(bearings=60)
    bearing = np.repeat(bearings(60), 40)
    rho = 3 + 0.1 * rng.standard_normal(bearing.size)
    profile = of_points(rho, bearing, np.full(bearing.size, 1.0), np.full(bearing.size, 0.1), scan)
    # The mean of 2400 errors is good to 0.1/49 = 2 mm, four times which is chance no more.
    assert profile.range_m.mean() == pytest.approx(3, abs=0.008)
    assert rho.reshape(60, 40).min(axis=1).mean() < 2.8


def test_few_pixels_are_no_obstacle_and_the_nearest_group_is():
    scan = Scan(bearings=4, support_px=3)
    rho = np.array([1.0, 1.0, 2.0, 2.01, 1.99, 4.0, 4.0, 4.0, 4.0, 4.0])
    profile = of_points(rho, np.full(10, 0.1), np.ones(10), np.full(10, 0.01), scan)
    assert profile.range_m[2] == pytest.approx(2.0, abs=1e-5)  # weights differ by a hundred-thousandth
    assert np.flatnonzero(profile.known).tolist() == [2]
    assert not of_points(
        rho, np.full(10, 0.1), np.ones(10), np.full(10, 0.01), Scan(bearings=4, support_px=6)
    ).known.any()


def test_floor_that_may_be_no_obstacle_is_none():
    """Floor points 0.15 m too high: an obstacle if their heights are sure, none if they are good to 0.1 m."""
    rho, height, bearing = np.full(20, 2.0), np.full(20, 0.15), np.zeros(20)
    along = 0.85 / np.hypot(2.0, 0.85)  # |sin| of the elevation
    for sigma, seen in ((0.01, True), (0.1 / along, False)):
        assert of_points(rho, bearing, height, np.full(20, sigma), Scan(bearings=4)).known.any() == seen


def test_what_is_beyond_the_band_or_the_range_does_not_count():
    for height, rho in ((2.5, 2.0), (0.05, 2.0), (1.0, 31.0)):
        assert not of_points(
            np.full(20, rho), np.zeros(20), np.full(20, height), np.zeros(20), Scan(bearings=4)
        ).known.any()


def test_unknown_sigmas_stay_unknown():
    profile = of_points(np.full(20, 2.0), np.full(20, np.pi - 1e-9), np.ones(20), np.full(20, np.nan), Scan(bearings=8))
    assert profile.range_m[-1] == pytest.approx(2)
    assert np.isnan(profile.sigma_m).all()


# --- The truth and the score --------------------------------------------------------------------------------------

WALLS = {"kind": "box", "name": "walls", "size_m": [6, 4, 3], "inward": True, "texture": {"kind": "grey", "value": 100}}
POLE = {"kind": "box", "name": "pole", "size_m": [0.02, 0.02, 3.0], "position_m": [1.0, 0.0, 0.0],
        "texture": {"kind": "grey", "value": 20}}  # fmt: skip
STEP = {"kind": "box", "name": "step", "size_m": [0.5, 0.5, 0.2], "position_m": [-1.0, 0.0, 0.0],
        "texture": {"kind": "grey", "value": 20}}  # fmt: skip


def scene(*objects):
    return harness.load_scene({"name": "s", "objects": [WALLS, *objects]})


def test_the_true_profile_is_cut_from_the_scene():
    """A box's walls in closed form; a pole of 2 cm between two bearings; a step where the band is low enough."""
    pose, scan = Pose(position_m=(0.0, 0.1, 1.0), yaw_deg=30), Scan(bearings=36)
    true = true_scan(scene(POLE, STEP), pose, scan)
    expected = wall_m(bearings(36) + np.radians(30), np.array([0.0, 0.1]))
    clear = true.which[true.fine // 2 :: true.fine] == 0
    assert true.range_m[clear] == pytest.approx(expected[clear], abs=1e-6)  # Embree's single precision
    by_name = {each.name: each for each in true.obstacles}
    assert set(by_name) == {"pole", "step"}
    assert by_name["pole"].range_m == pytest.approx(np.hypot(0.99, 0.09), abs=1e-4)
    # Seen a tenth of a radian off its face's normal, it spans nearly its side over its distance.
    assert by_name["pole"].width_deg == pytest.approx(np.degrees(0.02 / 1.0), abs=0.2)
    assert [each.name for each in true_scan(scene(POLE, STEP), pose, Scan(bearings=36, low_m=0.25)).obstacles] == [
        "pole"
    ]


def test_a_band_has_layers_inside_the_scene():
    assert layers(Scan(low_m=-1.0, high_m=9.0), np.array([0.0, 3.0]), "s").min() > 0
    assert layers(Scan(low_m=0.5, high_m=0.51), None, "s") == pytest.approx([0.505])
    with pytest.raises(InputError, match=r"s: scan: the band from 4 to 5 m lies outside of the scene"):
        layers(Scan(low_m=4.0, high_m=5.0), np.array([0.0, 3.0]), "s")


def profile_with(range_m, sigma_m=0.1):
    range_m = np.asarray(range_m, dtype=float)
    return RangeProfile(bearings(range_m.size), range_m, np.where(np.isfinite(range_m), sigma_m, np.nan))


def test_a_score_counts_what_is_right_missed_and_false():
    true = np.array([2.0, 2.0, 2.0, 2.0, 2.0, np.nan])
    estimate = profile_with([2.05, 1.85, 2.5, 1.0, np.nan, 1.0])
    score, _ = score_scan(estimate, true, [], Scan(bearings=6), 1)
    assert (score.bearings, score.density) == (5, 0.8)
    assert score.bias_m == pytest.approx(-0.05)
    assert score.rms_m == pytest.approx(np.sqrt((0.05**2 + 0.15**2) / 2))
    assert score.median_abs_m == pytest.approx((0.15 + 0.5) / 2)
    assert (score.within_1_sigma, score.within_2_sigma) == (0.25, 0.5)
    assert (score.missed, score.false) == (0.2, 0.4)


def test_obstacles_are_in_front_of_both_sides_and_found_where_they_stand():
    which = np.array([1, 0, 0, 2, 2, 0, 3, 3, -1, 0, 0, 1])
    range_m = np.array([1.0, 3, 3, 2, 2.1, 3, 2.9, 2.9, np.nan, 3, 3, 1.0])
    found = obstacles_of(range_m, which, ("wall", "over the seam", "in front", "flush with the wall"))
    assert [(each.name, each.begin, each.end, each.range_m) for each in found] == [
        ("in front", 3, 5, 2.0), ("over the seam", 11, 13, 1.0),
    ]  # fmt: skip
    assert [each.width_deg for each in found] == [60.0, 60.0]
    scan = Scan(bearings=4, thin_deg=90)
    score, marked = score_scan(profile_with([3.0, 2.1, 3.0, 1.2]), np.full(4, 3.0), found, scan, 3)
    assert [each.found for each in marked] == [True, False]
    assert (score.obstacles, score.obstacles_found, score.thin, score.thin_found) == (2, 1, 2, 1)


def test_a_wall_all_around_is_no_obstacle():
    assert obstacles_of(np.ones(8), np.zeros(8, int), ("wall",)) == []


def test_true_ranges_have_a_perfect_score():
    pose, scan = Pose(position_m=(0.3, 0.1, 1.0)), Scan(bearings=90)
    true = true_scan(scene(), pose, scan)
    score, _ = score_scan(true.profile(), true.range_m, list(true.obstacles), scan, true.fine)
    assert (score.density, score.rms_m, score.missed, score.false) == (1.0, 0.0, 0.0, 0.0)


def test_without_a_profile_a_trial_keeps_its_key():
    plain = Trial(scene={"name": "b", "objects": [WALLS]})
    assert plain.key == plain.model_copy(update={"scan": Scan(bearings=0)}).key
    assert plain.key != plain.model_copy(update={"scan": Scan(bearings=36)}).key


def test_of_one_seed_nothing_is_concluded():
    assert scans_of([]) == []
    assert scans_conclusions([{"condition": "", "seeds": 1}], {}) == []


# --- Files --------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=10)
@given(
    ranges=st.lists(st.one_of(st.just(float("nan")), st.floats(0.01, 30)), min_size=1, max_size=40),
)
def test_a_laser_scan_comes_back(ranges):
    profile = profile_with(ranges)
    table = json.loads(json.dumps(laser_scan(profile, 30.0), allow_nan=False))
    assert table["angle_max"] == pytest.approx(table["angle_min"] + table["angle_increment"] * (len(ranges) - 1))
    back = from_laser_scan(table)
    assert back.bearing == pytest.approx(profile.bearing)
    assert np.array_equal(back.range_m, profile.range_m, equal_nan=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ranges": None}, "is no LaserScan"),
        ({"ranges": []}, "ranges: must be 1 to 7200 ranges; found 0"),
        ({"angle_min": 0.0}, "angle_min: must begin at -2.35619 and go round once in 4 steps"),
    ],
)
def test_a_laser_scan_that_is_none_is_refused(change, said):
    with pytest.raises(InputError, match=said):
        from_laser_scan(laser_scan(profile_with([1, 2, 3, 4]), 30.0) | change)


def test_points_of_all_files_are_the_same():
    profile = profile_with([1.0, np.nan, 2.0, 3.0], 0.25)
    expected = np.column_stack([profile.points_m, np.zeros(3), np.full(3, 0.25)])
    cloud = trimesh.load(io.BytesIO(as_ply(profile)), file_type="ply", process=False)
    assert np.asarray(cloud.vertices) == pytest.approx(expected[:, :3], abs=1e-6)
    head, _, body = as_pcd(profile).partition("DATA ascii\n")
    assert "FIELDS x y z sigma\n" in head
    assert "POINTS 3\n" in head
    assert np.loadtxt(io.StringIO(body)) == pytest.approx(expected, abs=1e-6)
    table = pd.read_csv(io.StringIO(as_csv(profile)))
    assert table["bearing_deg"].tolist() == [-135, -45, 45, 135]
    assert np.array_equal(table["range_m"], profile.range_m, equal_nan=True)


# --- From the command ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_photographs_become_a_scan(tmp_path, capsys):
    sensor = {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5}}
    for name, x in (("left", 0.0), ("right", 0.3)):
        harness.render("box", sensor=sensor, position_m=(x, 0.0, 1.0), samples=4).write(tmp_path / name)
    images = [str(tmp_path / name / "omni.png") for name in ("left", "right")]
    given_sensor = ["--sensor", str(tmp_path / "left" / "sensor.toml"), "--matcher", "sgm"]
    options = ["--height", "1", "--bearings", "72", "--baseline", "0.3", "0", "0", "--out", str(tmp_path / "scan")]
    assert main(["scan", *images, *given_sensor, *options]) == 0
    said = capsys.readouterr().out
    assert "of 72 bearings have an obstacle" in said
    assert "\ngeometry ok: " in said
    back = from_laser_scan(json.loads((tmp_path / "scan" / "scan.json").read_text()))
    expected = 3 / np.maximum(np.abs(np.cos(back.bearing)), np.abs(np.sin(back.bearing)))
    aside = np.abs(np.sin(back.bearing)) > 0.5  # 30 degrees off the baseline
    error = np.abs(back.range_m / expected - 1)[aside]
    assert np.nanmedian(error) < 0.03  # a tenth of a pixel of 3 degrees' parallax in 6
    assert {each.name for each in (tmp_path / "scan").iterdir()} == {"scan.csv", "scan.json", "scan.pcd", "scan.ply"}


@pytest.mark.slow
def test_a_scan_of_a_wrong_geometry_says_so_last(tmp_path, capsys):
    sensor = {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5}}
    for name, x in (("left", 0.0), ("right", 0.3)):
        harness.render("box", sensor=sensor, position_m=(x, 0.0, 1.0), samples=4).write(tmp_path / name)
    images = [str(tmp_path / name / "omni.png") for name in ("left", "right")]
    options = ["--sensor", str(tmp_path / "left" / "sensor.toml"), "--matcher", "sgm", "--height", "1"]
    elsewhere = ["--baseline", "0", "0.3", "0", "--support", "1", "--out", str(tmp_path / "scan")]
    assert main(["scan", *images, *options, *elsewhere]) == 0
    assert capsys.readouterr().err.splitlines()[-1].endswith(": do not trust it")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--height", "1", "--band", "2", "1"), "--band: the first must be below the second; found 2 and 1"),
        (("--height", "1", "--bearings", "0"), "--bearings: must be at least 1; found 0"),
        (("--height", "nan"), "--height: must be a number above 0; found 'nan'"),
        (("--height", "-1"), "--height: must be a number above 0; found '-1'"),
    ],
)
def test_a_scan_that_cannot_be_is_refused_before_anything_is_matched(options, said, tmp_path, capsys):
    arguments = ["scan", "no.png", "no.png", "--sensor", "mirror", *options, "--out", str(tmp_path / "s")]
    try:
        code = main(arguments)
    except SystemExit as error:  # what the parser refuses itself
        code = error.code
    assert code == 2
    assert said in capsys.readouterr().err
