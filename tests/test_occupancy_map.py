"""Maps against floor plans drawn by hand, the single-beam posterior, and files read back."""

import csv
from itertools import pairwise

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial import cKDTree
from sweeps import write_small

import harness
from harness.api.mapping import RangeScan, level_poses
from harness.api.motion import MotionEstimate
from harness.cli.parser import main
from harness.errors import InputError
from harness.evaluation.map_scores import points_on, score_map, true_states
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.mapping.map_files import read_map, write_map
from harness.mapping.occupancy import Cell, GridFrame, Place, frame_around, map_of_profiles
from harness.mapping.packed import packed, unpacked
from harness.mapping.range_profile import RangeProfile, bearings
from harness.mapping.settings import OccupancyMap, Scan
from harness.pipeline.floor_plan import floor_plan
from harness.pipeline.path_map import trials_along
from harness.pipeline.specification import Trial
from harness.runs.path_maps import path_maps_conclusions

UNKNOWN, FREE, OCCUPIED = Cell.UNKNOWN, Cell.FREE, Cell.OCCUPIED
WALLS = {"kind": "box", "name": "walls", "size_m": [4, 3, 3], "inward": True, "texture": {"kind": "grey", "value": 100}}
BLOCK = {"kind": "box", "name": "block", "size_m": [0.6, 0.4, 1.0], "position_m": [1.0, 0.5, 0.0],
         "texture": {"kind": "grey", "value": 20}}  # fmt: skip


def box(low, high):
    """The four lines of a rectangle, `[4, 2, 2]`."""
    (a, b), (c, d) = low, high
    corners = np.array([[a, b], [c, b], [c, d], [a, d]], dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def exact_profile(lines, x, y, count=720, sigma=1e-4):
    """Where rays from a place meet the first of some lines: each ray against each line, in closed form."""
    phi = bearings(count)
    along = np.stack([np.cos(phi), np.sin(phi)], axis=-1)[:, None]
    a, edge = lines[:, 0] - [x, y], lines[:, 1] - lines[:, 0]
    cross = along[..., 0] * edge[:, 1] - along[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (a[:, 0] * edge[:, 1] - a[:, 1] * edge[:, 0]) / cross
        part = (a[:, 0] * along[..., 1] - a[:, 1] * along[..., 0]) / cross
    hit = (distance > 0) & (part >= 0) & (part <= 1)
    return RangeProfile(phi, np.where(hit, distance, np.inf).min(axis=1), np.full(count, sigma))


def made(profiles, frame):
    return map_of_profiles(profiles, frame, prior=0.2, false_share=0.05)


@settings(deadline=None, max_examples=4)
@given(x=st.floats(-1.2, 0.3), y=st.floats(-0.9, 0.9), yaw=st.floats(-3, 3))
def test_truth_in_truth_out(x, y, yaw):
    """Exact distances to a room and a pillar, from two places: all free cells, and the borders that are seen."""
    lines = np.concatenate([box((-2, -1.5), (2, 1.5)), box((0.7, 0.3), (1.3, 0.7))])
    frame = frame_around(lines.reshape(-1, 2).min(axis=0), lines.reshape(-1, 2).max(axis=0), 0.05)
    places = [(x, y), (1.6, -1.2), (1.7, 1.2)]
    profiles = []
    for at in places:
        profile = exact_profile(lines, *at)
        shift = round(yaw / profile.increment)  # a frame that is turned by whole bearings has the same answers
        turned = RangeProfile(profile.bearing, np.roll(profile.range_m, -shift), profile.sigma_m)
        profiles.append((turned, Place(*at, shift * profile.increment)))
    true = true_states(lines, np.array(places), frame)
    score = score_map(made(profiles, frame).state, true, lines, frame)
    assert score.iou_free > 0.985
    assert score.iou_occupied > 0.9  # lines that cut off a cell's corner, and a side of the pillar at a grazing angle
    assert score.known > 0.985
    assert score.border_m < 0.01
    assert score.missed_borders < 0.03


def test_a_room_without_anything_in_it_is_mapped_to_the_cell():
    lines = box((-2, -1.5), (2, 1.5))
    frame = frame_around([-2, -1.5], [2, 1.5], 0.05)
    true = true_states(lines, np.zeros((1, 2)), frame)
    assert (true == OCCUPIED).sum() == 2 * 81 + 2 * 59  # the cells whose middles are on the lines
    assert (true == FREE).sum() == 79 * 59
    state = made([(exact_profile(lines, 0.0, 0.0), Place(0.0, 0.0, 0.0))], frame).state
    score = score_map(state, true, lines, frame)
    assert (score.iou_free, score.missed_borders) == (1.0, 0.0)
    assert score.iou_occupied > 0.98  # a corner's cell is seen along a hair
    assert score.border_p95_m == pytest.approx(0, abs=1e-6)


def test_one_answer_is_the_exact_posterior():
    """A cell in front, one that the surface is in, and one behind, of a beam along x: by counting hypotheses."""
    sigma, rho, prior, false = 0.08, 1.0, 0.2, 0.05
    frame = GridFrame((0.0, -0.05), 0.1, (1, 30))
    profile = RangeProfile(bearings(8), np.full(8, rho), np.full(8, sigma))
    got = map_of_profiles([(profile, Place(-1e-9, 0.0, np.pi / 8))], frame, prior=prior, false_share=false)
    # Surfaces at 100000 places, each as likely as the answer makes it.
    spread = np.hypot(sigma, 0.25 * 0.05)
    at = np.linspace(-1, 4, 100001)
    weight = np.exp(-0.5 * ((at - rho) / spread) ** 2)
    weight /= weight.sum()
    for column in (3, 8, 9, 10, 11, 20):
        low, high = 0.1 * column, 0.1 * (column + 1)
        inside, before = weight[(at >= low) & (at < high)].sum(), weight[at < low].sum()
        expected = (1 - false) * (inside + prior * before) + false * prior
        # The corners' rays pass at other bearings of the same distance: they say the same.
        assert got.probability[0, column] == pytest.approx(expected, abs=1e-4)


def test_what_is_surer_weighs_more():
    """Two profiles, 30 cm apart: the map follows the one of 1 cm, not that of 30 cm."""
    frame = frame_around([-2, -2], [2, 2], 0.05)
    sure, unsure = (RangeProfile(bearings(360), np.full(360, r), np.full(360, s)) for r, s in ((1.0, 0.01), (1.3, 0.3)))
    state = made([(sure, Place(0, 0, 0)), (unsure, Place(0, 0, 0))], frame).state
    x, y = frame.centres()
    distance = np.hypot(*np.meshgrid(x, y))
    assert (state[np.abs(distance - 1) < 0.01] == OCCUPIED).all()
    assert (state[distance < 0.9] == FREE).all()
    assert not (state[np.abs(distance - 1.3) < 0.1] == OCCUPIED).any()


def test_without_an_answer_nothing_is_known():
    frame = frame_around([-1, -1], [1, 1], 0.1)
    nothing = RangeProfile(bearings(4), np.full(4, np.nan), np.full(4, np.nan))
    assert (made([(nothing, Place(0, 0, 0))], frame).state == UNKNOWN).all()


def test_a_score_of_hand_made_maps():
    lines = box((0.5, 0.5), (4.5, 3.5))
    frame = GridFrame((0.0, 0.0), 1.0, (4, 5))
    true = true_states(lines, np.array([[2.5, 2.5]]), frame)
    F, X, U = FREE, OCCUPIED, UNKNOWN
    assert true.tolist() == [[X, X, X, X, X], [X, F, F, F, X], [X, F, F, F, X], [X, X, X, X, X]]
    assert score_map(true, true, lines, frame).iou_free == 1
    state = np.array([[X, X, X, X, X], [X, F, F, X, X], [X, F, U, F, X], [U, U, U, U, U]], dtype=np.uint8)
    score = score_map(state, true, lines, frame)
    assert score.iou_free == 4 / 6
    assert score.iou_occupied == 9 / 15
    assert score.known == 14 / 20
    assert score.border_m == pytest.approx(1 / 10)  # one of ten stands a metre off
    assert score.missed_borders == 1 / 14  # in the lowest row's middle; the others are within two cells
    empty = score_map(np.full(true.shape, U), true, lines, frame)
    assert (empty.border_m, empty.missed_borders, empty.iou_free) == (None, 1.0, 0.0)


def test_what_cannot_be_reached_is_not_scored():
    lines = np.concatenate([box((0, 0), (6, 6)), box((2.4, 2.4), (3.6, 3.6))])
    frame = frame_around([0, 0], [6, 6], 0.25)
    true = true_states(lines, np.array([[1.0, 1.0]]), frame)
    row, column, _ = frame.cells_of(np.array([[3.0, 3.0], [1.0, 5.0], [3.6, 3.0]]))
    assert true[row, column].tolist() == [UNKNOWN, FREE, OCCUPIED]


def test_points_on_lines_are_close_together_and_have_the_ends():
    points = points_on(np.array([[[0, 0], [1, 0]], [[2, 2], [2, 2]]], dtype=float), 0.3)
    assert points.tolist() == [[0, 0], [0.25, 0], [0.5, 0], [0.75, 0], [1, 0], [2, 2]]


def test_the_floor_plan_is_cut_from_the_scene():
    """Walls and a block of 1 m: its lines where the band is lower than that, none above."""
    scene = harness.load_scene({"name": "s", "objects": [WALLS, BLOCK]})
    plan = floor_plan(scene, (0.0, 0.0, 1.0), Scan())
    lines = np.concatenate([box((-2, -1.5), (2, 1.5)), box((0.7, 0.3), (1.3, 0.7))])
    for some, others in ((plan, lines), (lines, plan)):  # each all along the other; points are 0.01 m apart
        distance, _ = cKDTree(points_on(others, 0.01)).query(points_on(some, 0.05))
        assert distance.max() < 0.0051
    higher = floor_plan(scene, (0.0, 0.0, 1.0), Scan(low_m=1.1))
    assert np.abs(higher).max(axis=(0, 1)) == pytest.approx([2, 1.5])
    assert (np.abs(np.abs(higher) - [2, 1.5]).min(axis=-1) < 1e-9).all()  # all on the walls


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 1000), rows=st.integers(1, 9), columns=st.integers(1, 9))
def test_a_map_comes_back(seed, rows, columns, tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    state = np.random.default_rng(seed).integers(0, 3, (rows, columns)).astype(np.uint8)
    frame = GridFrame((-1.025, 0.475), 0.05, (rows, columns))
    write_map(state, frame, folder)
    back, same = read_map(folder / "map.yaml")
    assert np.array_equal(back, state)
    assert same == frame
    assert np.array_equal(unpacked(packed(state), frame.shape), state)


def test_a_map_is_what_map_server_reads(tmp_path):
    """Grey levels, thresholds and order of rows as in its documentation: (255 - level)/255, first row at the top."""
    state = np.array([[FREE, OCCUPIED], [UNKNOWN, UNKNOWN]], dtype=np.uint8)
    write_map(state, GridFrame((1.0, 2.0), 0.1, (2, 2)), tmp_path, "room")
    assert np.asarray(Image.open(tmp_path / "room.png")).tolist() == [[205, 205], [254, 0]]
    table = yaml.safe_load((tmp_path / "room.yaml").read_text())
    assert table == {
        "image": "room.png", "mode": "trinary", "resolution": 0.1, "origin": [1.0, 2.0, 0.0], "negate": 0,
        "occupied_thresh": 0.65, "free_thresh": 0.196,
    }  # fmt: skip
    assert not table["free_thresh"] > (255 - 205) / 255
    other = tmp_path / "other.yaml"
    other.write_text("a: 1")
    with pytest.raises(InputError, match=r"other.yaml: is no map"):
        read_map(other)


def test_stations_are_evenly_spaced_and_look_along_the_path():
    stations = OccupancyMap(path_m=((0, 0), (1, 0), (1, 0), (1, 1)), every_m=0.5).stations()
    along = [(0, 0, 0), (0.5, 0, 0), (1, 0, np.pi / 2), (1, 0.5, np.pi / 2), (1, 1, np.pi / 2)]
    assert np.array(stations) == pytest.approx(np.array(along))
    assert OccupancyMap(path_m=((2, 3),)).stations() == [(2.0, 3.0, 0.0)]
    assert OccupancyMap(path_m=((2, 3), (2, 3))).stations() == [(2.0, 3.0, 0.0)]
    assert OccupancyMap().stations() == []
    with pytest.raises(ValueError, match="has more than 1000 pairs"):
        OccupancyMap(path_m=((0, 0), (600, 0)))


def test_the_rig_turns_with_the_path():
    """The baseline keeps its direction to it, both views turn alike, and every pair has noise of its own."""
    trial = Trial(
        scene={"name": "s", "objects": [WALLS]},
        view_1={"position_m": (0, 0, 1.2), "yaw_deg": 10},
        view_2={"baseline_m": 0.2, "azimuth_deg": 15, "yaw_deg": 25},
        placement={"offset_m": 0.1, "random_yaw": True},
        map={"path_m": [(-1, 0), (-1, 1)]},
        seed=3,
    )
    there = trial.true_motion
    first, second, _ = trials_along(trial)
    moved = np.subtract(trial.poses[0].position_m, (0, 0, 1.2))
    assert first.poses[0].position_m == pytest.approx((-1 + moved[0], moved[1], 1.2 + moved[2]))
    assert second.poses[0].position_m == pytest.approx((-1 + moved[0], 0.5 + moved[1], 1.2 + moved[2]))
    for each in (first, second):
        assert each.true_motion.t_v1 == pytest.approx(there.t_v1)
        assert each.true_motion.R_v2_from_v1 == pytest.approx(there.R_v2_from_v1)
    assert first.poses[0].yaw_deg == pytest.approx(trial.poses[0].yaw_deg + 90)
    assert first.seed != second.seed


def test_views_of_a_sequence_are_where_their_motions_lead():
    poses = [Pose(position_m=(0, 0, 1), pitch_deg=5, roll_deg=-3), Pose(position_m=(1, 0.5, 1.1), yaw_deg=40),
             Pose(position_m=(1, 1.5, 1), yaw_deg=90, pitch_deg=2)]  # fmt: skip
    motions = [relative_motion(a, b) for a, b in pairwise(poses)]
    for pose, (tilt, place) in zip(poses, level_poses(motions, poses[0]), strict=True):
        assert place == pytest.approx((*pose.position_m[:2], pose.yaw_deg), abs=1e-9)
        assert (tilt.position_m[2], tilt.pitch_deg, tilt.roll_deg) == pytest.approx(
            (pose.position_m[2], pose.pitch_deg, pose.roll_deg), abs=1e-9
        )


def test_scans_of_one_room_make_one_map():
    lines = box((-2, -1.5), (2, 1.5))
    places = [(0.0, 0.0, 0.0), (1.0, 0.5, 90.0)]
    scans = []
    for x, y, turn in places:
        profile = exact_profile(lines, x, y, 360)
        turned = np.roll(profile.range_m, -round(turn))
        scans.append(RangeScan(RangeProfile(profile.bearing, turned, profile.sigma_m), Scan(bearings=360)))
    room = harness.range_map(scans, places)
    assert (room.state == FREE).sum() * 0.05**2 == pytest.approx(12, rel=0.05)  # of 12 m2, less half the border cells
    assert room.origin_m == pytest.approx((-2.075, -1.575), abs=0.051)
    for given_places, said in (([], "places: must be one for each"), ([(0, 0, np.nan)] * 2, "must be a finite number")):
        with pytest.raises(InputError, match=said):
            harness.range_map(scans, given_places)
    with pytest.raises(InputError, match="cells"):
        harness.range_map([*scans, scans[0]], [*places, (1e5, 1e5, 0)])


def test_of_one_seed_nothing_is_concluded():
    assert path_maps_conclusions([{"condition": "", "seeds": 1}], {}) == []


def test_without_a_map_a_trial_keeps_its_key():
    plain = Trial(scene={"name": "s", "objects": [WALLS]})
    assert plain.key == plain.model_copy(update={"map": OccupancyMap(cell_m=0.05)}).key
    assert plain.key != plain.model_copy(update={"map": OccupancyMap(path_m=((0, 0),))}).key


@pytest.mark.slow
def test_a_path_through_a_wall_is_named(tmp_path, capsys):
    given_file = write_small(tmp_path / "small.toml")
    assert main(["run", str(given_file), "--set", "map.path_m=[[9.0, 0.0]]", "--out", str(tmp_path / "out")]) == 2
    assert "trial.map.path_m: scene box: the view at (9, 0, 1) m is outside the scene" in capsys.readouterr().err


@pytest.mark.slow
def test_photographs_become_a_map(tmp_path, capsys):
    sensor = {"camera": {"width_px": 200, "height_px": 150, "focal_px": 191.9, "cx_px": 99.5, "cy_px": 74.5}}
    images = []
    for i, x in enumerate((-0.5, 0.0, 0.5)):
        harness.render("box", sensor=sensor, position_m=(x, 0.0, 1.0), samples=4).write(tmp_path / str(i))
        images.append(str(tmp_path / str(i) / "omni.png"))
    options = ["--sensor", str(tmp_path / "0" / "sensor.toml"), "--baseline", "0.5", "0", "0", "--matcher", "sgm",
               "--height", "1", "--support", "2", "--cell", "0.1", "--out", str(tmp_path / "map")]  # fmt: skip
    Image.new("L", (200, 150), 128).save(tmp_path / "blank.png")
    assert main(["map", *images, str(tmp_path / "blank.png"), *options]) == 0
    printed = capsys.readouterr()
    pairs = list(csv.DictReader((tmp_path / "map" / "pairs.csv").read_text(encoding="utf-8").splitlines()))
    assert [each["geometry"] for each in pairs] == ["ok", "ok", "unknown"]
    assert [float(each["x_m"]) for each in pairs] == pytest.approx([0.0, 0.5, 1.0])
    last = f"the geometry of 1 pair of 3 is unknown ({images[2]}, {tmp_path / 'blank.png'}): do not trust it"
    assert printed.err.splitlines()[-1].endswith(last)
    said = printed.out
    assert "m2 free" in said
    assert said.count("\n  geometry ") == 3  # the verdict of each pair
    assert f"{images[1]}, {images[2]}: " in said
    state, frame = read_map(tmp_path / "map" / "map.yaml")
    x, y = frame.centres()
    # The first view stands half a metre from the middle.
    inside = (np.abs(x - 0.5)[None] < 2.7) & (np.abs(y)[:, None] < 2.7)
    assert (state[inside] == FREE).mean() > 0.85
    assert (state[~inside] == OCCUPIED).sum() > 0.3 * 4 * 60  # of the four walls' cells
    assert main(["map", *images, *options, "--band", "5", "6"]) == 1  # the box is 3 m high
    file = tmp_path / "map" / "map.yaml"
    assert f"the map is empty: no bearing has an obstacle between 5 and 6 m; {file}\n" in capsys.readouterr().out


def test_a_map_of_estimated_motions_counts_their_covariances(tmp_path, monkeypatch):
    """And takes the pose of two images as `range` does."""
    pose = tmp_path / "pose.toml"
    pose.write_text("position_m = [0.5, 0.0, 0.0]\n")
    estimated = object.__new__(MotionEstimate)
    vars(estimated).update(direction_v1=np.array([1.0, 0, 0]))
    monkeypatch.setattr(harness, "estimate_motion", lambda *_, **__: estimated)
    monkeypatch.setattr(MotionEstimate, "motion", Motion(np.eye(3), np.array([0.5, 0.0, 0.0])))
    motions = []

    def matched(*arguments, **_):
        motions.append(arguments[3])
        raise InputError("far enough")

    monkeypatch.setattr(harness, "estimate_range", matched)
    command = ["map", "a.png", "b.png", "--sensor", "mirror", "--height", "1", "--out", str(tmp_path / "m")]
    for options in (["--baseline-length", "0.5"], ["--pose", str(pose)]):
        assert main([*command, *options]) == 2
    assert motions[0] is estimated
    assert motions[1].t_v1 == pytest.approx([0.5, 0, 0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--cell", "0"), "--cell: "),
        (("--baseline-length", "0.3", "--sensor-2", "mirror"), "--sensor-2"),
        ((), "--height: a map needs metres"),
    ],
)
def test_a_map_that_cannot_be_is_refused_before_anything_is_matched(options, said, tmp_path, capsys):
    command = ["map", "a.png", "b.png", "--sensor", "mirror", "--height", "1", "--out", str(tmp_path / "m")]
    assert main([*command, *options]) == 2
    assert said in capsys.readouterr().err


def test_the_folder_of_a_map_is_tried_before_anything_is_matched(tmp_path, monkeypatch, capsys):
    pose, out = tmp_path / "pose.toml", tmp_path / "map"
    pose.write_text("position_m = [0.5, 0.0, 0.0]\n", encoding="utf-8")
    out.write_text("mine", encoding="utf-8")
    monkeypatch.setattr(harness, "estimate_range", lambda *_, **__: pytest.fail("matched"))
    command = ["map", "a.png", "b.png", "--sensor", "mirror", "--height", "1", "--pose", str(pose), "--out", str(out)]
    assert main(command) == 2
    assert capsys.readouterr().err.startswith(f"omnirange: {out}: --out: cannot be used as the output folder")
    assert out.read_text(encoding="utf-8") == "mine"
