"""Calibration of a sensor from images of a chessboard, or from corners."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from harness.api.loading import load_sensor
from harness.calibration.corner_files import read_corners
from harness.calibration.corners import Board, Corners, corners_of
from harness.calibration.corners_in_images import Search, find_corners
from harness.calibration.result_table import record_of
from harness.calibration.sensor_calibration import SensorCalibration, calibrate_sensor, check_choice
from harness.calibration.start import check_kind
from harness.camera.intrinsics import FieldOfView
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor
from harness.display import html_figure
from harness.errors import InputError
from harness.files import PAGE_MARK, OwnFiles, check_no_others, write
from harness.geometry.angles import Array
from harness.spec import dump_toml, parse

Places = Mapping[str, tuple[ArrayLike, ArrayLike]]
"""For each image the corners' positions on the board, metres, and their pixels."""
Given = str | Path | Corners | Places | None


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(SensorCalibration):
    """A calibrated sensor, the corners it was estimated from, and its uncertainty.

    `sensor`; `rms_px` and `rms_of_images_px` of the corners; `keys` with `uncertainty.values`, `.sigma`, `.covariance`;
    `ray_sigma_px` over `grid`; `halves`, two calibrations from half of the images; `central`, the best central sensor
    beside a misaligned one; `notes`.
    """

    def write(self, file: str | Path) -> tuple[Path, ...]:
        """Write the sensor file, and beside it the numbers with their covariance (JSON) and a page (HTML).

        Parameters
        ----------
        file
            The sensor file, TOML; the others have its name with `.json` and `.html`, and with `-central.toml` for the
            best central sensor beside a misaligned one.

        Returns
        -------
        tuple
            The three paths, or four.

        Raises
        ------
        InputError
            When one cannot be written.
        """
        from harness.report.calibration_page import build_page

        paths = files_of(Path(file), has_central=self.central is not None)
        check_beside(paths)
        page = build_page(self)
        if self.central is not None:
            write(paths[3], dump_toml(self.central.sensor))
        write(paths[2], page)
        write(paths[1], json.dumps(record_of(self), allow_nan=False) + "\n")
        write(paths[0], dump_toml(self.sensor))
        return paths

    def _repr_html_(self) -> str:
        """The numbers with their standard deviations."""
        rows = zip(self.keys, self.uncertainty.values.tolist(), self.uncertainty.sigma.tolist(), strict=True)
        body = "".join(f"<tr><td>{key}</td><td>{value:.7g}</td><td>{sigma:.2g}</td></tr>" for key, value, sigma in rows)
        table = f"<table><tr><th>key</th><th>value</th><th>standard deviation</th></tr>{body}</table>"
        caption = f"{len(self.corners.images)} images, {len(self.corners.image)} corners, RMS {self.rms_px:.3g} px"
        return html_figure({}, caption) + table


def files_of(toml: Path, *, has_central: bool) -> tuple[Path, ...]:
    """The files that `CalibrationResult.write` writes: sensor, numbers and page, and the best central sensor."""
    central = (toml.with_name(f"{toml.stem}-central.toml"),) if has_central else ()
    return (toml, toml.with_suffix(".json"), toml.with_suffix(".html"), *central)


def check_beside(files: Sequence[Path]) -> None:
    """Refuse to write over somebody else's files beside the sensor file, of whose names nobody has said anything.

    Parameters
    ----------
    files
        Those of `files_of`.

    Raises
    ------
    InputError
        Names one of them.
    """
    toml, numbers, *others = files
    marks = {numbers.name: b'{"program": "omnirange '} | {each.name: None for each in others}
    own = OwnFiles("calibration", marks, {others[0].name: PAGE_MARK})
    check_no_others(toml.parent, own, advice="give another name")


def calibrate(
    images: Sequence[str | Path] = (),
    *,
    board: Board | Mapping[str, Any] | None = None,
    corners: Given = None,
    size: tuple[int, int] | None = None,
    model: str = "unified",
    lens: Sequence[str] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float | None] | Sequence[str] = (),
    start: str | Path | Mapping[str, Any] | Sensor | None = None,
    mount: Mapping[str, Any] | Mount | None = None,
    field: Mapping[str, Any] | FieldOfView | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> CalibrationResult:
    """Calibrate a sensor from images of a chessboard, or from corners.

    Parameters
    ----------
    images
        Image files from one camera, each of a whole board. They need the extra `calibration`.
    board
        The board's inner corners and the side of its squares: `{"columns": 9, "rows": 6, "square_m": 0.04}`.
    corners, size
        Instead of images: a file of corners (CSV, JSON, NPZ, or OpenCV's), or for each image by its name the corners'
        positions on the board, metres, and their pixels, both `[n, 2]`; and the images' width and height if not in it.
    model
        The kind of camera model.
    lens, free, fix
        Lens terms to estimate, such as `["k1", "k2"]`, by default the usual ones of the model; keys to estimate in
        addition to the usual ones, `["misalignment"]` for all of a mirror's; and keys not to estimate, with their
        values, or None for that of `start`.
    start
        An initial sensor of that kind: a file, a table or a sensor.
    mount
        The camera's mount, which boards do not determine: `{"looks": "down", "mirrored": True}`.
    field
        The sensor's field of view; by default what the boards cover.
    tell
        Called with a line of text to report progress.

    Returns
    -------
    CalibrationResult
        `sensor`, `rms_px`, `uncertainty`, `ray_sigma_px`, `notes`; `write(file)`.

    Raises
    ------
    InputError
        One line that names the argument or the file and what would be right.

    Examples
    --------
    >>> import harness
    >>> from harness.simulation.targets import visible_boards
    >>> room = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 90}}
    >>> corners = {}
    >>> for yaw in range(0, 360, 45):
    ...     board = {"kind": "chessboard", "position_m": [0.3, 0, 0.9], "pitch_deg": 70 + yaw / 12, "roll_deg": yaw / 9}
    ...     scene, pose = {"name": "target", "objects": [room, board]}, harness.Pose(position_m=(0, 0, 1), yaw_deg=yaw)
    ...     (one,) = visible_boards(harness.load_scene(scene), harness.Sensor(), pose)
    ...     corners[f"turned by {yaw}"] = one.points_m, one.pixels
    >>> found = harness.calibrate(corners=corners, size=(640, 480), model="hyperboloid")
    >>> round(found.sensor.camera.focal_px, 2), round(found.sensor.model.b_m, 5)
    (614.12, 0.0234)
    """
    checked = _checked(model, mount, field)  # finding corners takes long
    chosen = _chosen(model, lens, free, fix, start)
    search = _search(images, board, corners, size, tell)
    calibration = calibrate_sensor(
        search.corners,
        model,
        **chosen,
        **checked,
        circle=search.circle,
        tell=tell,
    )
    return CalibrationResult(**{each.name: getattr(calibration, each.name) for each in fields(calibration)})


def _checked(
    model: str, mount: Mount | Mapping[str, Any] | None, field: FieldOfView | Mapping[str, Any] | None
) -> dict[str, Any]:
    """The mount and the field as specifications; refuses a kind of model that cannot be calibrated."""
    check_kind(model)
    return {
        "mount": mount if mount is None or isinstance(mount, Mount) else parse(Mount, mount, file="mount"),
        "field": field if field is None or isinstance(field, FieldOfView) else parse(FieldOfView, field, file="field"),
    }


def _chosen(
    model: str,
    lens: Sequence[str] | None,
    free: Sequence[str],
    fix: Mapping[str, float | None] | Sequence[str],
    start: str | Path | Mapping[str, Any] | Sensor | None,
) -> dict[str, Any]:
    """What is to be estimated, and from where, as `calibrate_sensor` takes it; refuses what cannot be."""
    chosen: dict[str, Any] = {
        "lens": lens,
        "free": free,
        "fix": dict(fix) if isinstance(fix, Mapping) else dict.fromkeys(fix),
        "start": None if start is None else load_sensor(start),
    }
    check_choice(model, **chosen)
    return chosen


def _search(
    images: Sequence[str | Path],
    board: Board | Mapping[str, Any] | None,
    corners: Given,
    size: tuple[int, int] | None,
    tell: Callable[[str], None],
) -> Search:
    if isinstance(board, Mapping):
        board = parse(Board, board, file="board")
    if corners is not None:
        if images:
            raise InputError("give images or corners, not both", key="corners")
        return Search(_corners(corners, board, size), None, ())
    if not images:
        raise InputError("give images of a board, or corners", key="images")
    if board is None:
        raise InputError("give the board's inner corners and the side of its squares", key="board")
    return find_corners([Path(each) for each in images], board, tell)


def _corners(given: str | Path | Corners | Places, board: Board | None, size: tuple[int, int] | None) -> Corners:
    if isinstance(given, Corners):
        return given
    if isinstance(given, str | Path):
        return read_corners(Path(given), square_m=None if board is None else board.square_m, size=size)
    if size is None:
        raise InputError("give the width and height of the images, pixels", key="size")
    corners: list[tuple[str, Array, Array]] = []
    try:
        for name, pair in given.items():
            points, pixels = (np.asarray(each, dtype=np.float64).reshape(-1, 2) for each in pair)
            corners.append((str(name), points, pixels))
    except (AttributeError, TypeError, ValueError):
        problem = "must be a file, or points on the board [n, 2] and pixels [n, 2] for each image"
        raise InputError(problem, key="corners") from None
    return corners_of(corners, *size, file="corners")
