"""Chessboards in rendered images, of which every corner is known: the scene's object, the circle, and the detector."""

import numpy as np
import pytest

import harness
from harness.calibration import detect
from harness.calibration.circle import find_circle
from harness.calibration.corners import Board
from harness.calibration.corners_in_images import find_corners
from harness.calibration.detect import find_board, rough_sensor
from harness.camera.sensor import Sensor, project
from harness.errors import InputError
from harness.geometry.pose import Pose
from harness.io.view_folder import png
from harness.simulation.scene import Chessboard, Scene, load_scene
from harness.simulation.targets import visible_boards

cv2 = pytest.importorskip("cv2")

BOARD = Board(columns=9, rows=6, square_m=0.04)
LARGE = {"camera": {"width_px": 1280, "height_px": 960, "focal_px": 1228, "cx_px": 639.5, "cy_px": 479.5}}


def scene(azimuth_deg: float, pitch_deg: float = 90, roll_deg: float = 0, *others: dict) -> Scene:
    """A grey room with a board 0.35 m from (0, 0, 1), a little below it."""
    azimuth = np.radians(azimuth_deg)
    board = {
        "kind": "chessboard",
        "name": "board",
        "position_m": [0.35 * np.cos(azimuth), 0.35 * np.sin(azimuth), 0.9],
        "yaw_deg": azimuth_deg,
        "pitch_deg": pitch_deg,
        "roll_deg": roll_deg,
    }
    room = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 120}}
    return load_scene({"name": "target", "objects": [room, board, *others]})


def view(of: Scene, samples: int = 16) -> np.ndarray:
    return harness.render(of, sensor=LARGE, position_m=(0, 0, 1), samples=samples).image


def same_board(corners: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Errors of corners, whichever way round the board was taken."""
    grid = corners.reshape(6, 9, 2)
    ways = [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    return min((way.reshape(-1, 2) - exact for way in ways), key=lambda error: np.abs(error).max())


class TestTarget:
    def test_grey_at_corners_and_squares(self):
        """In the board's own coordinates: dark and bright alternate, and a corner is where four of them meet."""
        board = Chessboard(kind="chessboard", columns=3, rows=2, square_m=0.1, margin_squares=1)
        texels = board.texture.texels()
        assert texels.shape == (5 * 32, 6 * 32)
        assert board.size_m == (pytest.approx(0.6), pytest.approx(0.5))
        squares = texels[16::32, 16::32]
        assert (squares[[0, -1]] == 235).all()
        assert (squares[:, [0, -1]] == 235).all()
        np.testing.assert_array_equal(squares[1:4, 1:5] == 20, (np.add.outer(range(3), range(4)) % 2) == 0)
        assert np.mean(texels[63:65, 63:65]) == pytest.approx((235 + 20) / 2)

    def test_corners_by_hand(self):
        """A board that lies flat 1 m below, its middle straight down: corners at (-1.5 .. 1.5, -0.5 .. 0.5) squares."""
        flat = Chessboard(kind="chessboard", columns=4, rows=2, square_m=0.1, position_m=(0.2, 0, 0))
        room = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 120}}
        place = {"position_m": [0, 0, -0.5]}
        whole = load_scene({"name": "a", "scale": 2.0, "objects": [room | place, flat.model_dump()]})
        (visible,) = visible_boards(whole, Sensor(), Pose(position_m=(0.4, 0, 1)))
        assert visible.points_world_m[0].tolist() == pytest.approx([0.4 - 0.3, -0.1, 0])
        assert visible.points_world_m[-1].tolist() == pytest.approx([0.4 + 0.3, 0.1, 0])
        np.testing.assert_allclose(visible.points_m[-1], [0.6, 0.2])
        expected, _ = project(Sensor(), [[-0.3, -0.1, -1.0], [0.3, 0.1, -1.0]])
        np.testing.assert_allclose(visible.pixels[[0, -1]], expected, rtol=0, atol=1e-9)
        # Within 15° of straight down the camera sees itself.
        off_axis = np.degrees(np.arctan(np.hypot(*(visible.points_world_m[:, :2] - [0.4, 0]).T)))
        np.testing.assert_array_equal(visible.visible, off_axis > 15)

    def test_hidden_corners_are_not_visible(self):
        pole = {
            "kind": "box",
            "size_m": [0.03, 0.03, 1.0],
            "position_m": [0.2, 0.0, 0.3],
            "texture": {"kind": "grey", "value": 50},
        }
        (free,) = visible_boards(scene(0), Sensor(), Pose(position_m=(0, 0, 1)))
        (hidden,) = visible_boards(scene(0, 90, 0, pole), Sensor(), Pose(position_m=(0, 0, 1)))
        assert free.visible.all()
        # Seen from 0.185 m the pole is 57 mm wide on the board: one row of nine corners, or two.
        assert np.count_nonzero(~hidden.visible) in {9, 18}

    @pytest.mark.slow
    def test_image_agrees_with_the_corners(self):
        """Turned by half a turn about a corner, a board's grey levels become 255 less themselves, if no square ends."""
        of = scene(40, 80, 10)
        image = view(of, 64)
        sensor = harness.load_sensor(LARGE)
        (visible,) = visible_boards(of, sensor, Pose(position_m=(0, 0, 1)))
        board = of.objects[1]
        for index in (10, 25, 40):
            corner = visible.points_world_m[index]
            sides = board.pose.R_world_from_view[:, :2] * 0.008
            offsets = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) @ sides.T
            at = np.rint(project(sensor, corner + offsets - [0, 0, 1])[0]).astype(int)
            levels = image[at[:, 1], at[:, 0]]
            assert abs(levels[0] - levels[2]) < 60
            assert abs(levels[1] - levels[3]) < 60
            assert abs(levels[0] - levels[1]) > 60


class TestCircle:
    @pytest.mark.parametrize("centre", [(320.0, 240.0), (300.5, 251.25)])
    def test_is_found_where_it_is(self, centre):
        v, u = np.mgrid[:480, :640]
        rng = np.random.default_rng(0)
        inside = np.hypot(u - centre[0], v - centre[1]) < 230
        image = np.where(inside, 150.0 + 40 * np.sin(u / 20), 8.0) + rng.normal(0, 3, u.shape)
        image[200:260, 100:200] = 5  # something dark inside
        circle = find_circle(image)
        # It is the hull of whole pixels, smoothed over 1.6 px, at a fifth of the step.
        assert (circle.u, circle.v) == pytest.approx(centre, abs=1.0)
        assert circle.radius_px == pytest.approx(230, abs=3)

    def test_may_be_cut_off_by_the_image(self):
        v, u = np.mgrid[:480, :640]
        circle = find_circle(np.where(np.hypot(u - 320, v - 240) < 300, 200.0, 5.0))
        assert (circle.u, circle.v, circle.radius_px) == pytest.approx((320, 240, 300), abs=2)

    def test_an_image_without_one(self):
        rng = np.random.default_rng(0)
        assert find_circle(np.full((120, 160), 100.0)) is None
        assert find_circle(rng.uniform(0, 255, (120, 160))) is None


class TestDetector:
    @pytest.fixture(scope="class")
    @classmethod
    def images(cls):
        scenes = [scene(10, 75, 5), scene(130, 100, -12), scene(250, 90, 15)]
        corners = [visible_boards(each, harness.load_sensor(LARGE), Pose(position_m=(0, 0, 1)))[0] for each in scenes]
        return [view(each) for each in scenes], corners

    @pytest.mark.slow
    def test_boards_are_found_and_their_corners_good_to_a_twentieth_of_a_pixel(self, images):
        for image, visible in zip(*images, strict=True):
            assert visible.visible.all()
            grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            corners = find_board(cv2, grey, BOARD, rough_sensor(1280, 960, find_circle(grey)))
            error = same_board(corners, visible.pixels)
            # Squares are 10 to 40 px wide and bent, pixels are areas: 0.03 to 0.04 px, and less on one side.
            assert np.sqrt(np.mean(np.sum(error**2, axis=-1))) < 0.05
            assert np.abs(error.mean(axis=0)).max() < 0.025

    @pytest.mark.slow
    def test_through_windows_alone(self, images, monkeypatch):
        """What bends too much for the detector is found in a perspective window; here it is refused the image."""
        image, visible = images[0][1], images[1][1]
        grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        inner = detect._detect
        monkeypatch.setattr(
            detect, "_detect", lambda cv2, patch, board: None if patch is grey else inner(cv2, patch, board)
        )
        corners = find_board(cv2, grey, BOARD, rough_sensor(1280, 960, find_circle(grey)))
        assert np.sqrt(np.mean(np.sum(same_board(corners, visible.pixels) ** 2, axis=-1))) < 0.05

    def test_a_grid_with_one_corner_astray_is_refused(self):
        grid = BOARD.points_m * 500 + 100
        assert detect._is_grid(grid, BOARD)
        astray = grid.copy()
        astray[20] += [11.0, 0.0]
        assert not detect._is_grid(astray, BOARD)
        assert not detect._is_grid(grid * 0.1, BOARD)

    @pytest.mark.slow
    def test_all_images_of_one_camera(self, images, tmp_path):
        files = []
        for i, image in enumerate([*images[0], np.full_like(images[0][0], 90)]):
            files.append(tmp_path / f"{i}.png")
            files[-1].write_bytes(png(image))
        lines: list[str] = []
        search = find_corners(files, BOARD, lines.append)
        assert search.corners.images == ("0.png", "1.png", "2.png")
        assert search.without == ("3.png",)
        assert search.circle.radius_px == pytest.approx(477, abs=3)
        assert lines[0] == "0.png (1 of 4): 54 corners"
        assert "3.png" in lines[-1]
        with pytest.raises(InputError, match=r"no board of 9 x 6 inner corners was found in any of 1 images\. Count"):
            find_corners(files[3:], BOARD)

    def test_images_of_two_sizes_are_refused(self, tmp_path):
        for name, size in (("a", (20, 30)), ("b", (30, 20))):
            (tmp_path / f"{name}.png").write_bytes(png(np.zeros(size, dtype=np.float32)))
        with pytest.raises(InputError, match=r"b.png: has 20 x 30 pixels, the first image 30 x 20"):
            find_corners([tmp_path / "a.png", tmp_path / "b.png"], BOARD)
