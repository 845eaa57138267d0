"""Corners read from files, and what is said of files that hold none."""

import json
from itertools import pairwise

import numpy as np
import pytest
from boards import MIRROR, visible_boards

from harness.calibration.corner_files import corner_tables, corners_csv, read_corners
from harness.errors import InputError


@pytest.fixture(scope="module")
def corners():
    return visible_boards(MIRROR, 3, 20)[0]


def same(one, other):
    assert one.images == other.images
    assert (one.width_px, one.height_px) == (other.width_px, other.height_px)
    np.testing.assert_array_equal(one.image, other.image)
    np.testing.assert_array_equal(one.points_m, other.points_m)
    np.testing.assert_array_equal(one.pixels, other.pixels)


def opencv_xml(corners):
    """As cv2.FileStorage writes vectors of points."""
    ends = [*corners.starts, len(corners.image)]

    def matrices(points, channels):
        parts = [points[a:b] for a, b in pairwise(ends)]
        return "".join(
            f'<_ type_id="opencv-matrix"><rows>{len(each)}</rows><cols>1</cols><dt>"{channels}d"</dt>'
            f"<data>{' '.join(map(repr, each.ravel().tolist()))}</data></_>"
            for each in parts
        )

    flat = np.concatenate([corners.points_m, np.zeros((len(corners.image), 1))], axis=1)
    return (
        f'<?xml version="1.0"?><opencv_storage><imagePoints>{matrices(corners.pixels, 2)}</imagePoints>'
        f"<objectPoints>{matrices(flat, 3)}</objectPoints></opencv_storage>"
    )


class TestRead:
    def test_csv_is_read_back_bit_for_bit(self, corners, tmp_path):
        (tmp_path / "a.csv").write_text(corners_csv(corners), encoding="utf-8")
        same(read_corners(tmp_path / "a.csv"), corners)

    def test_csv_that_counts_squares(self, tmp_path):
        lines = [f"a.png, {i % 3}, {i // 3}, {100 + 10 * (i % 3)}, {50 + 10 * (i // 3)}" for i in range(6)]
        (tmp_path / "a.csv").write_text("\n".join(["image,column,row,u_px,v_px", *lines]), encoding="utf-8")
        corners = read_corners(tmp_path / "a.csv", square_m=0.03, size=(640, 480))
        np.testing.assert_allclose(corners.points_m[-1], [0.06, 0.03])
        assert corners.pixels[-1].tolist() == [120, 60]
        with pytest.raises(InputError, match="gives corners in squares; give the side of a square with --square-m"):
            read_corners(tmp_path / "a.csv", size=(640, 480))
        with pytest.raises(InputError, match="does not contain the size of the images; give --size"):
            read_corners(tmp_path / "a.csv", square_m=0.03)

    def test_json(self, corners, tmp_path):
        table = {"width_px": 640, "height_px": 480, "images": corner_tables(corners)}
        (tmp_path / "a.json").write_text(json.dumps(table), encoding="utf-8")
        same(read_corners(tmp_path / "a.json"), corners)

    def test_npz(self, corners, tmp_path):
        arrays = {"points_m": corners.points_m, "pixels": corners.pixels, "image": corners.image}
        np.savez(tmp_path / "a.npz", size=[640, 480], **arrays)
        read = read_corners(tmp_path / "a.npz")
        np.testing.assert_array_equal(read.pixels, corners.pixels)
        assert read.images == ("0", "1", "2")

    def test_opencv_xml(self, corners, tmp_path):
        (tmp_path / "a.xml").write_text(opencv_xml(corners), encoding="utf-8")
        read = read_corners(tmp_path / "a.xml", size=(640, 480))
        np.testing.assert_array_equal(read.pixels, corners.pixels)
        np.testing.assert_array_equal(read.points_m, corners.points_m)
        sized = opencv_xml(corners).replace("</opencv_storage>", "<imageSize>\n  640 480</imageSize></opencv_storage>")
        (tmp_path / "b.xml").write_text(sized, encoding="utf-8")
        read = read_corners(tmp_path / "b.xml")
        assert (read.width_px, read.height_px) == (640, 480)


BENT = """<?xml version='1.0'?><opencv_storage>
<objectPoints>
<_ type_id="opencv-matrix"><rows>2</rows><cols>1</cols><dt>"3d"</dt><data>0 0 0 1 1 1</data></_>
</objectPoints>
<imagePoints><_ type_id="opencv-matrix"><rows>2</rows><cols>1</cols><dt>"2d"</dt><data>1 1 2 2</data></_></imagePoints>
</opencv_storage>"""
BAD = {
    "empty.csv": ("", "begins with ''; the header must be image,x_m,y_m,u_px,v_px"),
    "head.csv": ("image,u,v\n", "begins with 'image,u,v'; the header must be"),
    "line.csv": ("image,x_m,y_m,u_px,v_px\na,1,2,x,4\n", "line 2 must be image,x_m,y_m,u_px,v_px; found 'a,1,2,x,4'"),
    "none.csv": ("image,x_m,y_m,u_px,v_px\n", "contains no corners"),
    "few.csv": ("image,x_m,y_m,u_px,v_px\na,0,0,1,1\n", "image 'a' has 1 corners; a board needs at least 6"),
    "nan.csv": (
        "image,x_m,y_m,u_px,v_px\n" + "".join(f"a,{i % 3},{i // 3},nan,1\n" for i in range(6)),
        "image 'a' has corners that are not finite numbers",
    ),
    "off.csv": (
        "image,x_m,y_m,u_px,v_px\n" + "".join(f"a,{i % 3},{i // 3},{i},{900 + i}\n" for i in range(6)),
        r"a corner of image 'a' is at \(0, 900\), outside an image of 640 x 480 pixels",
    ),
    "list.json": ('{"images": 3}', "images: must be a list of tables"),
    "half.json": ('{"images": [{"name": "a", "pixels": [[1, 2]]}]}', "images.0.*points_m.*missing"),
    "cut.json": ('{"images": [', "not valid JSON"),
    "other.xml": ("<?xml version='1.0'?><opencv_storage><a>1</a></opencv_storage>", "objectPoints.*missing"),
    "bent.xml": (BENT, "objectPoints.0.: must lie in the plane z = 0"),
    "bad.npz": ("not an archive", "cannot be read as an NPZ archive"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_said_in_one_line(name, tmp_path):
    text, message = BAD[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_corners(tmp_path / name, size=(640, 480))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_npz_without_an_array_or_of_other_shapes(tmp_path):
    np.savez(tmp_path / "a.npz", pixels=np.zeros((6, 2)))
    with pytest.raises(InputError, match="the array 'points_m' is missing; there are: pixels"):
        read_corners(tmp_path / "a.npz", size=(640, 480))
    np.savez(tmp_path / "b.npz", pixels=np.zeros((6, 2)), points_m=np.zeros((5, 2)), image=np.zeros(6))
    with pytest.raises(InputError, match=r"must be \[m, 2\], \[m, 2\] and \[m\]; found \(5, 2\)"):
        read_corners(tmp_path / "b.npz", size=(640, 480))
    np.savez(tmp_path / "c.npz", pixels=np.full((6, 2), "x"), points_m=np.zeros((6, 2)), image=np.zeros(6))
    with pytest.raises(InputError, match="points_m and pixels must be numbers"):
        read_corners(tmp_path / "c.npz", size=(640, 480))


def test_size_that_contradicts_the_file(corners, tmp_path):
    (tmp_path / "a.csv").write_text(corners_csv(corners), encoding="utf-8")
    with pytest.raises(InputError, match="has images of 640 x 480 pixels; --size says 800 x 600"):
        read_corners(tmp_path / "a.csv", size=(800, 600))


@pytest.mark.parametrize("size", [(20000, 768), (1024, 7), (10**8, 10**8)])
def test_a_size_that_no_camera_has_names_the_option(size, tmp_path):
    lines = [f"a,{0.04 * (i % 3)},{0.04 * (i // 3)},{100 + 10 * (i % 3)},{50 + 10 * (i // 3)}" for i in range(9)]
    (tmp_path / "a.csv").write_text("\n".join(["image,x_m,y_m,u_px,v_px", *lines]), encoding="utf-8")
    with pytest.raises(InputError, match=r"^--size: images of \d+ x \d+ pixels; sides must be 8 to 16384 pixels long$"):
        read_corners(tmp_path / "a.csv", size=size)


@pytest.mark.parametrize("width", ["a", 1024.5, True, None])
def test_a_width_in_a_file_that_is_no_number_names_the_key(width, corners, tmp_path):
    table = {"width_px": width, "height_px": 480, "images": corner_tables(corners)}
    (tmp_path / "a.json").write_text(json.dumps(table), encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.json: width_px: (must be a whole number; found|is missing)"):
        read_corners(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-20, 0), (1e59, 0), (1e155, 0), (1e-300, 0), (1, 1e300), (1e308, -1e308), (0, 5)]
)
def test_positions_that_are_no_board(scale, offset, tmp_path):
    points = np.array([[c, r] for r in range(6) for c in range(9)])
    with np.errstate(over="ignore"):
        places = np.clip(0.04 * scale * points + offset, -1e308, 1e308)
    images = [{"name": "a", "points_m": places.tolist(), "pixels": (300 + 10 * points).tolist()}]
    (tmp_path / "a.json").write_text(json.dumps({"width_px": 640, "height_px": 480, "images": images}))
    board = "the corners of image 'a' (span .* m of|lie on one line of the board)"
    with pytest.raises(InputError, match=rf"a\.json: ({board}|images\[0\]\.points_m.* at most 1e.60; found)"):
        read_corners(tmp_path / "a.json")


def test_corners_at_one_pixel(tmp_path):
    points = np.array([[0.04 * c, 0.04 * r] for r in range(6) for c in range(9)])
    images = [{"name": "a", "points_m": points.tolist(), "pixels": np.full((54, 2), 5.0).tolist()}]
    (tmp_path / "a.json").write_text(json.dumps({"width_px": 640, "height_px": 480, "images": images}))
    with pytest.raises(InputError, match="the corners of image 'a' lie on one line of the image"):
        read_corners(tmp_path / "a.json")
