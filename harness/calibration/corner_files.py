"""Files of corners: CSV, JSON and NPZ in our own layouts, and the points that OpenCV's calibration samples write."""

import csv
import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from harness.calibration.corners import Corners, check_size, corners_of
from harness.errors import InputError
from harness.files import read_regular
from harness.geometry.angles import Array
from harness.io.calibrations.parsing import read_content
from harness.io.calibrations.record import Content
from harness.io.calibrations.values import matrix, member, numbers, refusal

LAYOUT = """\
CSV   a line for each corner, under the header image,x_m,y_m,u_px,v_px: the image's name, the corner's position on the
      board in metres, and its pixel; or column,row instead of x_m,y_m, counted from 0 in squares. A first line such
      as "# 1280 x 960" gives the size of the images.
JSON  {"width_px": 1280, "height_px": 960, "images": [{"name": "a.png", "points_m": [[x, y], ...],
      "pixels": [[u, v], ...]}, ...]}
NPZ   arrays points_m [m, 2], pixels [m, 2] and image [m], a number for each corner; size [2], width and height.
XML, YAML or JSON of OpenCV, with objectPoints and imagePoints, one matrix for each image, and imageSize.
"""
"""A description of the layouts, for help texts and documentation."""

_LIMIT_BYTES = 64 * 2**20
_OWN, _SQUARES = ("image", "x_m", "y_m", "u_px", "v_px"), ("image", "column", "row", "u_px", "v_px")


def read_corners(file: Path, *, square_m: float | None = None, size: tuple[int, int] | None = None) -> Corners:
    """Read corners from a file in any layout of `LAYOUT`.

    Parameters
    ----------
    square_m
        Side of a square, metres; for files that give positions in squares.
    size
        Width and height of the images, pixels, for a file that does not contain them.

    Raises
    ------
    InputError
        Names the file and the error.
    """
    suffix = file.suffix.lower()
    if suffix == ".npz":
        views, own = _from_npz(file)
    elif suffix in {".csv", ".txt"}:
        views, own = _from_csv(file, square_m)
    else:
        content = read_content(file, "corner")
        views, own = _from_table(content) if "images" in content.table else _from_opencv(content)
    if own is None and size is None:
        raise InputError("does not contain the size of the images; give --size WIDTH HEIGHT", file=file)
    if own is not None and size is not None and own != size:
        raise InputError(f"has images of {own[0]} x {own[1]} pixels; --size says {size[0]} x {size[1]}", file=file)
    if own is None and size is not None:
        check_size(size, file="--size")
    width, height = own or size or (0, 0)
    return corners_of(views, width, height, file=str(file))


def corners_csv(corners: Corners) -> str:
    """Corners as CSV text that `read_corners` reads back bit for bit."""
    stream = io.StringIO()
    stream.write(f"# {corners.width_px} x {corners.height_px}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_OWN)
    names = [corners.images[i] for i in corners.image.tolist()]
    for name, point, pixel in zip(names, corners.points_m.tolist(), corners.pixels.tolist(), strict=True):
        writer.writerow([name, *map(repr, point), *map(repr, pixel)])
    return stream.getvalue()


ImageCorners = tuple[list[tuple[str, Array, Array]], tuple[int, int] | None]
"""(name, points, pixels) of each image, and the images' size if the file contains it."""


def _from_csv(file: Path, square_m: float | None) -> ImageCorners:
    try:
        lines = read_regular(file, _LIMIT_BYTES, "corner").decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"cannot be read as a text file ({error})", file=file) from error
    size = None
    if lines and lines[0].startswith("#"):
        comment = re.fullmatch(r"#\s*(\d{1,5})\s*x\s*(\d{1,5})\s*", lines[0])
        size = (int(comment[1]), int(comment[2])) if comment else None
    rows = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    header = tuple(each.strip() for each in rows[0][1].split(",")) if rows else ()
    if header not in (_OWN, _SQUARES):
        raise InputError(f"begins with '{','.join(header)}'; the header must be {','.join(_OWN)}", file=file)
    if header == _SQUARES and square_m is None:
        raise InputError("gives corners in squares; give the side of a square with --square-m", file=file)
    unit = square_m if header == _SQUARES and square_m else 1.0
    images: dict[str, list[list[float]]] = {}
    for number, cells in zip((i for i, _ in rows[1:]), csv.reader(line for _, line in rows[1:]), strict=False):
        try:
            name, *values = cells
            x, y, u, v = map(float, values)
        except ValueError:
            raise InputError(
                f"line {number} must be {','.join(header)}; found '{','.join(cells)}'", file=file
            ) from None
        images.setdefault(name.strip(), []).append([x * unit, y * unit, u, v])
    arrays = {name: np.array(each) for name, each in images.items()}
    return [(name, each[:, :2], each[:, 2:]) for name, each in arrays.items()], size


def _from_npz(file: Path) -> ImageCorners:
    data = read_regular(file, _LIMIT_BYTES, "corner")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays: dict[str, NDArray[Any]] = {name: stored[name] for name in stored.files}
    except (ValueError, OSError, BadZipFile, EOFError) as error:
        raise InputError(f"cannot be read as an NPZ archive ({error})", file=file) from error
    for name in ("points_m", "pixels", "image"):
        if name not in arrays:
            available = ", ".join(arrays) or "none"
            raise InputError(f"the array '{name}' is missing; there are: {available}", file=file)
    points, pixels, image = arrays["points_m"], arrays["pixels"], arrays["image"]
    if points.shape != pixels.shape or points.ndim != 2 or points.shape[1] != 2 or image.shape != points.shape[:1]:
        raise InputError(
            f"points_m, pixels and image must be [m, 2], [m, 2] and [m]; found {points.shape}, {pixels.shape} and "
            f"{image.shape}",
            file=file,
        )
    if not all(np.issubdtype(each.dtype, np.number) for each in (points, pixels)):
        raise InputError("points_m and pixels must be numbers", file=file)
    size = arrays.get("size")
    if size is not None and not (size.shape == (2,) and np.issubdtype(size.dtype, np.integer)):
        raise InputError(f"size must be two whole numbers, width and height; found {size!r}", file=file)
    image_size = None if size is None else (int(size[0]), int(size[1]))
    return [(str(each), points[image == each], pixels[image == each]) for each in np.unique(image)], image_size


def _from_table(content: Content) -> ImageCorners:
    images, key = member(content, content.table, "images")
    if not isinstance(images, list):
        raise refusal(content, key, "must be a list of tables")
    views = []
    for i, entry in enumerate(images):
        if not isinstance(entry, Mapping):
            raise refusal(content, f"{key}[{i}]", "must be a table")
        points, pixels = (
            matrix(content, *member(content, entry, each, f"{key}[{i}]")) for each in ("points_m", "pixels")
        )
        if points.shape[1] != 2 or points.shape != pixels.shape:
            raise refusal(content, f"{key}[{i}]", "points_m and pixels must be equally many pairs of numbers")
        views.append((str(entry.get("name", i)), points, pixels))
    size = tuple(content.table.get(each) for each in ("width_px", "height_px"))
    for key, each in zip(("width_px", "height_px"), size, strict=True):
        if size != (None, None) and (not isinstance(each, int) or isinstance(each, bool)):
            raise refusal(content, key, "is missing" if each is None else f"must be a whole number; found {each!r}")
    return views, None if size == (None, None) else (size[0], size[1])  # type: ignore[return-value]


def _from_opencv(content: Content) -> ImageCorners:
    root = content.table.get("opencv_storage", content.table)
    lists = {}
    for name in ("objectPoints", "imagePoints"):
        value, key = member(content, root, name)
        if not isinstance(value, list):
            raise refusal(content, key, "must be a list of matrices, one for each image")
        lists[name] = [_points(content, each, f"{key}[{i}]") for i, each in enumerate(value)]
    if len(lists["objectPoints"]) != len(lists["imagePoints"]):
        raise refusal(content, "imagePoints", "must be as many matrices as objectPoints")
    views = []
    for i, (points, pixels) in enumerate(zip(lists["objectPoints"], lists["imagePoints"], strict=True)):
        if pixels.shape[1] != 2 or len(points) != len(pixels):
            raise refusal(content, f"imagePoints[{i}]", f"must be {len(points)} pairs of numbers")
        if points.shape[1] == 3 and np.ptp(points[:, 2]) > 0:
            raise refusal(content, f"objectPoints[{i}]", "must lie in the plane z = 0: boards are planar")
        views.append((str(i), points[:, :2], pixels))
    if "imageSize" not in root:
        return views, None
    size = [int(each) for each in numbers(content, root["imageSize"], "imageSize", "width height")]
    return views, (size[0], size[1])


def _points(content: Content, value: Any, key: str) -> Array:
    """The points of a matrix with one column and several channels, or with one channel."""
    if isinstance(value, Mapping):
        data, data_key = member(content, value, "data", key)
        flat = np.array(numbers(content, data, data_key))
        kind = str(value.get("dt", "")).strip('"')
        channels = int(kind[0]) if kind[:1].isdigit() else int(value.get("cols", 1))
        if channels in {2, 3} and flat.size % channels == 0:
            return flat.reshape(-1, channels)
    raise refusal(content, key, "must be a matrix of points of two or three numbers")


def corner_tables(corners: Corners) -> list[dict[str, Any]]:
    """The list `images` of the JSON layout."""
    ends = [*corners.starts.tolist(), len(corners.image)]
    return [
        {
            "name": name,
            "points_m": corners.points_m[ends[i] : ends[i + 1]].tolist(),
            "pixels": corners.pixels[ends[i] : ends[i + 1]].tolist(),
        }
        for i, name in enumerate(corners.images)
    ]
