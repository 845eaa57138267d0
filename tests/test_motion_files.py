"""The motion between two views is the same whichever file says it: a pose, a rig or a trajectory."""

import json
import shutil
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import harness
from harness.camera.sensor import Sensor, lens_from_sensor, unproject
from harness.cli import main
from harness.errors import InputError
from harness.io.motions import motion_of, motions_of_poses
from harness.spec import dump_toml, parse

angles = st.floats(-180, 180)
positions = st.tuples(*[st.floats(-10, 10)] * 3)
poses = st.builds(
    lambda p, yaw, pitch, roll: harness.Pose(position_m=p, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll),
    positions,
    angles,
    angles,
    angles,
)
MIRROR = Sensor()
FORWARD = harness.load_sensor(
    {
        "model": {"kind": "kannala_brandt"},
        "camera": {"focal_px": 200.0, "skew_px": 0.0},
        "field": {"angle_max_deg": 80.0, "elevation_min_deg": -90.0, "elevation_max_deg": 90.0},
        "mount": {"looks": "forward", "yaw_deg": 30.0, "pitch_deg": -10.0},
    }
)


def transform(pose, lens_from_sensor=None):
    """`[4, 4]`: a point of the view's frame, or of a lens's in it, in the world."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pose.R_world_from_view, pose.position_m
    if lens_from_sensor is not None:
        T[:3, :3] = T[:3, :3] @ lens_from_sensor.T
    return T


def tum(path, transforms):
    lines = [
        " ".join(map(repr, [float(i), *T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]))
        for i, T in enumerate(transforms)
    ]
    path.write_text("# time x y z qx qy qz qw\n\n" + "\n".join(lines) + "\n")
    return path


def kitti(path, transforms):
    path.write_text("\n".join(" ".join(map(repr, T[:3].ravel().tolist())) for T in transforms) + "\n")
    return path


def same(one, two):
    # Positions of up to 20 m between views, quaternions and matrices written to the last digit.
    assert one.R_v2_from_v1 == pytest.approx(two.R_v2_from_v1, abs=1e-12)
    assert one.t_v1 == pytest.approx(two.t_v1, abs=1e-11)


@pytest.mark.parametrize("write", [tum, kitti])
@given(first=poses, second=poses)
def test_a_trajectory_of_the_sensor(tmp_path_factory, write, first, second):
    file = write(tmp_path_factory.getbasetemp() / f"{write.__name__}.txt", [transform(first), transform(second)])
    same(harness.load_motion(file, frame="sensor"), harness.relative_motion(first, second))


@pytest.mark.parametrize("sensor", [MIRROR, FORWARD], ids=["mirror", "forward"])
def test_a_trajectory_of_the_lens(tmp_path, sensor):
    """The lens's axes in the sensor's frame are what the sensor itself makes of its image: u, v and the axis."""
    views = [
        harness.Pose(position_m=(1, 2, 3), yaw_deg=20, pitch_deg=5, roll_deg=-3),
        harness.Pose(position_m=(1.5, 1.8, 3.1), yaw_deg=75, pitch_deg=-4, roll_deg=6),
    ]
    lens = lens_of(sensor)
    # Of mirror images, programs that know no mirrors make rotations in a mirrored world.
    world = np.diag([1.0, 1.0, np.linalg.det(lens), 1.0])
    file = kitti(tmp_path / "t.txt", [world @ transform(each, lens) for each in views])
    same(harness.load_motion(file, sensor=sensor, frame="lens"), harness.relative_motion(*views))


def lens_of(sensor):
    """`[3, 3]`, rows X, Y, Z in the sensor's frame: X along u and Y along v from what pixels see, Z along the axis."""
    u, v = sensor.camera.cx_px, sensor.camera.cy_px
    around = np.array([[u + 60, v], [u - 60, v], [u, v + 60], [u, v - 60]])
    rays, valid = unproject(sensor, around)
    assert valid.all()
    axis = np.cross(rays[0] - rays[1], rays[2] - rays[3])
    axis *= np.sign(axis @ rays.sum(axis=0))
    rows = [rays[0] - rays[1], rays[2] - rays[3], axis]
    return np.array([row / np.linalg.norm(row) for row in rows])


def test_two_poses_of_many(tmp_path):
    views = [harness.Pose(position_m=(0.1 * i, 0, 1), yaw_deg=7 * i) for i in range(12)]
    file = tum(tmp_path / "t.txt", [transform(each) for each in views])
    same(harness.load_motion(file, 2, 9, frame="sensor"), harness.relative_motion(views[2], views[9]))
    same(harness.load_motion(file, 9, 2, frame="sensor"), harness.relative_motion(views[9], views[2]))
    with pytest.raises(InputError, match=r"t\.txt: views: the trajectory has 12 poses; say which two"):
        harness.load_motion(file, frame="sensor")
    with pytest.raises(InputError, match="there is no pose 12; the file has 0 to 11"):
        harness.load_motion(file, 0, 12, frame="sensor")
    with pytest.raises(InputError, match=r"t\.txt: frame: a trajectory does not say which frame it moves"):
        harness.load_motion(file, 2, 9)
    with pytest.raises(InputError, match="second: give both views' numbers or none"):
        harness.load_motion(file, 2)


def test_the_pose_that_omnirange_motion_writes(tmp_path):
    pose = harness.Pose(position_m=(0.3, 0.1, 0), yaw_deg=20)
    (tmp_path / "pose.toml").write_text(dump_toml(pose))
    same(harness.load_motion(tmp_path / "pose.toml"), harness.relative_motion(harness.Pose(), pose))
    with pytest.raises(InputError, match=r"pose.toml: views: are for rigs and trajectories"):
        harness.load_motion(tmp_path / "pose.toml", 0, 1)
    with pytest.raises(InputError, match=r"pose.toml: frame: is for trajectories"):
        harness.load_motion(tmp_path / "pose.toml", frame="lens")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", "t.txt: line 2: must hold 8 numbers, as the first line does; found 7"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 nan 1\n", "t.txt: line 2: 'nan' is not a finite number"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n", "line 2: must hold a rotation: the quaternion's length is off 1 by 1"),
        ("# none\n", "t.txt: holds no pose, no rig and no trajectory; known are"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 2: must hold a rotation"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, message):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        harness.load_motion(tmp_path / "t.txt", frame="sensor")


def test_no_rotation_between_an_image_and_a_mirror_image():
    with pytest.raises(InputError, match="one view's image is mirrored and the other's is not"):
        motion_of(np.eye(4), (lens_from_sensor(FORWARD), lens_from_sensor(MIRROR)))


@pytest.mark.usefixtures("undrawn")
def test_options_of_range(tmp_path, capsys):
    file = str(tum(tmp_path / "t.txt", [np.eye(4)] * 3))
    images = ["range", "a.png", "b.png", "--sensor", "shipped.toml", "--out", str(tmp_path / "out")]
    (tmp_path / "sensor.toml").write_text("[camera]\nwidth_px = 640\n")
    images[4] = str(tmp_path / "sensor.toml")
    for options, message in (
        (["--pose", file], "t.txt: --views: the trajectory has 3 poses"),
        (["--pose", file, "--views", "0", "1"], "t.txt: --frame: a trajectory does not say which frame it moves"),
        (
            ["--pose", file, "--views", "0", "1", "--frame", "sensor"],
            "t.txt: both views are in one place, which determines",
        ),
        (["--baseline", "1", "0", "0", "--frame", "lens"], "--frame: belongs to --pose"),
    ):
        assert main([*images, *options]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_a_motion_is_not_written_over_its_sensor(option, tmp_path, capsys):
    sensor = tmp_path / "sensor.toml"
    sensor.write_text("kept")
    assert main(["motion", "left.png", "right.png", "--sensor", str(sensor), option, str(sensor)]) == 2
    assert f"{sensor}: {option}: would be written over, and is read; give another name" in capsys.readouterr().err
    assert sensor.read_text() == "kept"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Folders as `omnirange render` writes them, small: where they stand in the world is far from each other."""
    camera = {"width_px": 160, "height_px": 120, "focal_px": 153.53, "cx_px": 79.5, "cy_px": 59.5}
    sensor = parse(Sensor, {"camera": camera})
    poses = [harness.Pose(position_m=(x, 0.2, 1.0), yaw_deg=30.0) for x in (0.0, 0.4, 0.9)]
    folder = tmp_path_factory.mktemp("views")
    for number, pose in enumerate(poses):
        grid = harness.Grid(width_px=180, height_px=50, z_min=-1.0, z_max=0.3)
        view = harness.render(
            "box",
            position_m=pose.position_m,
            yaw_deg=pose.yaw_deg,
            sensor=sensor,
            samples=1,
            grid=grid,
        )
        view.write(folder / f"v{number}")
    return folder, poses


class TestPoseOfEachView:
    """`--pose` repeated, and files of one pose where that says no motion."""

    @pytest.fixture
    def views(self, rendered, tmp_path):
        """Each test's own copy, which it may write beside."""
        folder, poses = rendered
        shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
        return [tmp_path / f"v{number}" for number in range(3)], poses

    def command(self, name, views, *options):
        images = [str(each / "omni.png") for each in views]
        sensor, out = str(views[0] / "sensor.toml"), str(views[0].parent / "out")
        return main([name, *images, "--sensor", sensor, "--out", out, *map(str, options)])

    def test_poses_in_the_world(self, views):
        folders, poses = views
        files = [each / "pose.toml" for each in folders]
        for motion, pair in zip(motions_of_poses(files, 3), pairwise(poses), strict=True):
            same(motion, harness.relative_motion(*pair))

    def test_poses_in_the_frame_before(self, tmp_path):
        pose = harness.Pose(position_m=(0.3, 0.1, 0), yaw_deg=20)
        (tmp_path / "pose.toml").write_text(dump_toml(pose))
        for motion in motions_of_poses([tmp_path / "pose.toml"] * 2, 3):
            same(motion, harness.relative_motion(harness.Pose(), pose))

    @pytest.mark.slow
    @pytest.mark.usefixtures("undrawn")
    def test_of_a_command(self, views, tmp_path):
        folders, poses = views
        given = [word for each in folders[:2] for word in ("--pose", each / "pose.toml")]
        x, y, _ = harness.relative_motion(*poses[:2]).t_v1
        medians = []
        for options in (given, ["--baseline", x, y, 0.0]):
            assert self.command("range", folders[:2], *options, "--matcher", "column") == 0
            medians.append(json.loads((tmp_path / "out" / "range.json").read_text())["range_median_m"])
        assert medians[0] == pytest.approx(medians[1], rel=1e-9)  # motions differ by roundings

    @pytest.mark.parametrize(
        ("name", "count", "given", "message"),
        [
            (
                "range",
                2,
                (0,),
                "no motion between two views; give the pose of each view: --pose FIRST --pose SECOND\n",
            ),
            ("map", 3, (0,), "pose.toml: holds one pose; more than two images need a trajectory in TUM's"),
            ("map", 3, (0, 1), "v0/pose.toml: is a view's pose in the world"),
            ("map", 2, (0, 1, 2), "--pose: must be one trajectory or rig, or a pose for each of the 2 images; found 3"),
            ("map", 3, (0, 1, 1), "v1/pose.toml is given for views 1 and 2; give the pose of each"),
            ("range", 2, (0, 0), "v0/pose.toml is given for both views; give the pose of each"),
        ],
    )
    def test_what_is_refused(self, name, count, given, message, views, capsys):
        folders, _ = views
        options = [word for each in given for word in ("--pose", folders[each] / "pose.toml")]
        height = ["--height", 1.0] if name == "map" else []
        assert self.command(name, folders[:count], *options, *height) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1

    def test_poses_in_one_place(self, views, tmp_path, capsys):
        folders, _ = views
        again = tmp_path / "again.toml"
        again.write_bytes((folders[1] / "pose.toml").read_bytes())
        poses = [each / "pose.toml" for each in folders[:2]]
        for name, count, files, which in (
            ("range", 2, [poses[1], again], "both views"),
            ("map", 3, [*poses, again], "views 1 and 2"),
        ):
            options = [word for each in files for word in ("--pose", each)]
            height = ["--height", 1.0] if name == "map" else []
            assert self.command(name, folders[:count], *options, *height) == 2
            said = f"omnirange: --pose: {which} are in one place, which determines no range\n"
            assert capsys.readouterr().err == said

    def test_python_is_told_a_function_where_the_command_is_told_an_option(self, views):
        folders, _ = views
        with pytest.raises(InputError, match=r"give the pose of each view: relative_motion\(first, second\)$"):
            harness.load_motion(folders[0] / "pose.toml")

    def test_an_image_for_a_pose(self, views, capsys):
        folders, _ = views
        image = folders[0] / "omni.png"
        assert self.command("range", folders[:2], "--pose", image) == 2
        assert capsys.readouterr().err == f"omnirange: {image}: is a PNG image; a text file is read here\n"

    @pytest.mark.parametrize("option", [("--rotation-deg", 1, 0, 0), ("--baseline-length", 1), ("--views", 0, 1)])
    def test_what_poses_do_not_need(self, option, views, capsys):
        folders, _ = views
        options = [word for each in folders for word in ("--pose", each / "pose.toml")]
        assert self.command("range", folders, *options, *option) == 2
        assert capsys.readouterr().err.startswith(f"omnirange: {option[0]}: ")
