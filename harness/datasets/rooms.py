"""Random rooms: walls with windows, furniture, curved bodies, poles and boards, by the distribution of a data set.

The room's middle is the world's origin, its floor at z = 0. What stands in it keeps apart, so that no two faces of
different things coincide.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np

from harness.datasets.specification import Counts, DatasetSpec, Furniture, Room, number_between
from harness.datasets.surfaces import Painter
from harness.files import cache_folder, make_folder, replace_file
from harness.simulation.noise import generator
from harness.simulation.scene import Scene, load_scene
from harness.spec import dump_toml

_GAP_M = 0.03
"""Least distance of things from each other and from walls."""
_TRIES = 20
_LAP_M = 0.01
"""Overhang of walls beyond the room's edges, metres, so that no ray slips out between them."""
_STEP_M = 0.002
"""Offset of the strips above and below a window behind those beside it, metres: nothing overlaps in one plane."""


@dataclass(frozen=True)
class Obstacle:
    """An upright cylinder around a thing that stands in the room, metres."""

    x: float
    y: float
    radius: float
    low: float
    high: float


@dataclass(frozen=True)
class DrawnRoom:
    """A random scene, as a table and files, before anything is written."""

    table: dict[str, Any]
    """The table of the scene's file, which refers to other files by their bare names."""
    files: dict[str, bytes]
    """Contents of the files that it refers to, by name."""
    size_m: tuple[float, float, float]
    obstacles: tuple[Obstacle, ...]

    def scene(self) -> Scene:
        """The scene, its files laid down in the cache."""
        return load_scene(_with_files(self.table, _laid_down(self.files)))

    def toml(self) -> bytes:
        """The scene's own file, beside which its files lie under their bare names."""
        scene = self.scene()
        text = dump_toml(scene)
        for name, path in _laid_down(self.files).items():
            text = text.replace(path, name)
        return text.encode()


@dataclass
class _Builder:
    draws: np.random.Generator
    painter: Painter
    size_m: tuple[float, float, float]
    objects: list[dict[str, Any]] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)

    def between(self, low_high: tuple[float, float]) -> float:
        return float(number_between(low_high, self.draws.random()))

    def count(self, low_high: Counts) -> int:
        return int(self.draws.integers(low_high[0], low_high[1] + 1))

    def place(self, radius: float, low: float, high: float) -> tuple[float, float] | None:
        """A free position (x, y) for an upright cylinder, which it then occupies; None if no try finds one."""
        length, width, _ = self.size_m
        reach_x, reach_y = (each / 2 - radius - _GAP_M for each in (length, width))
        if min(reach_x, reach_y) <= 0:
            return None
        for _ in range(_TRIES):
            x, y = self.draws.uniform(-1, 1, 2) * (reach_x, reach_y)
            if all(math.hypot(x - each.x, y - each.y) > radius + each.radius + _GAP_M for each in self.obstacles):
                self.obstacles.append(Obstacle(float(x), float(y), radius, low, high))
                return float(x), float(y)
        return None


def draw_room(spec: DatasetSpec, number: int) -> DrawnRoom:
    """A scene of a data set: the same whenever and wherever it is drawn.

    Parameters
    ----------
    number
        The scene's number, from 0.
    """
    draws = generator(spec.seed, "dataset", "scene", str(number))
    painter = Painter(draws, spec.surfaces, spec.colour)
    room = spec.room
    size = tuple(float(number_between(each, draws.random())) for each in (room.length_m, room.width_m, room.height_m))
    builder = _Builder(draws, painter, (size[0], size[1], size[2]))
    background = _shell(builder, room)
    _furnish(builder, spec.furniture)
    table: dict[str, Any] = {
        "name": f"{spec.name} {number}",
        "closed": background is None,
        "objects": builder.objects,
    }
    if background is not None:
        table["background_grey"] = background
    return DrawnRoom(table, painter.files, builder.size_m, tuple(builder.obstacles))


# --- Walls, floor and ceiling --------------------------------------------------------------------------------------


def _shell(builder: _Builder, room: Room) -> float | None:
    """Build the room itself, and return the grey level of the sky; None if no sky is visible."""
    windows, open_air = builder.count(room.windows), bool(builder.draws.random() < room.open_air)
    sky = builder.between(room.sky_grey)
    length, width, height = builder.size_m
    painted = [builder.painter.texture(small=False) for _ in range(6)]
    if not windows and not open_air:
        sides = dict(zip(("x_min", "x_max", "y_min", "y_max", "bottom", "top"), painted, strict=True))
        builder.objects.append(
            {"kind": "box", "name": "room", "inward": True, "size_m": [length, width, height], **sides}
        )
        return None
    level = {"kind": "plane", "size_m": [length + 2 * _LAP_M, width + 2 * _LAP_M]}
    builder.objects.append(level | {"name": "floor", "texture": painted[4]})
    if not open_air:
        builder.objects.append(level | {"name": "ceiling", "position_m": [0.0, 0.0, height], "texture": painted[5]})
    with_window = set(builder.draws.permutation(4)[:windows].tolist())
    for wall in range(4):
        builder.objects.extend(_wall(builder, wall, painted[wall], has_window=wall in with_window))
    return sky


_WALLS = (("x_min", 90.0), ("x_max", 90.0), ("y_min", 0.0), ("y_max", 0.0))


def _wall(builder: _Builder, wall: int, texture: dict[str, Any], *, has_window: bool) -> Iterator[dict[str, Any]]:
    """The strips of a wall: one, or four around a window."""
    length, width, height = builder.size_m
    along = (width, length)[wall // 2] / 2 + _LAP_M
    low, high = -_LAP_M, height + _LAP_M
    if not has_window:
        yield _strip(builder, wall, texture, (-along, along), (low, high), 0.0)
        return
    half = along * builder.draws.uniform(0.15, 0.4)
    middle = builder.draws.uniform(-0.5, 0.5) * along
    sill, lintel = builder.draws.uniform(0.3, 0.5) * height, builder.draws.uniform(0.7, 0.9) * height
    left, right = middle - half, middle + half
    yield _strip(builder, wall, texture, (-along, left), (low, high), 0.0)
    yield _strip(builder, wall, texture, (right, along), (low, high), 0.0)
    # Behind the others, and a little under them.
    yield _strip(builder, wall, texture, (left - _LAP_M, right + _LAP_M), (low, sill), _STEP_M)
    yield _strip(builder, wall, texture, (left - _LAP_M, right + _LAP_M), (lintel, high), _STEP_M)


def _strip(
    builder: _Builder,
    wall: int,
    texture: dict[str, Any],
    along: tuple[float, float],
    up: tuple[float, float],
    out: float,
) -> dict[str, Any]:
    """A rectangle on a wall, between positions along it and heights, so far outside it, metres."""
    name, yaw_deg = _WALLS[wall]
    across = (builder.size_m[0] / 2, builder.size_m[1] / 2)[wall // 2] + out
    across = -across if wall % 2 == 0 else across
    middle = sum(along) / 2
    x, y = (across, middle) if wall < 2 else (middle, across)
    return {
        "kind": "plane",
        "name": name,
        "size_m": [along[1] - along[0], up[1] - up[0]],
        "position_m": [x, y, sum(up) / 2],
        "yaw_deg": yaw_deg,
        "roll_deg": 90.0,
        "texture": texture,
    }


# --- What stands in the room ----------------------------------------------------------------------------------------


def _furnish(builder: _Builder, furniture: Furniture) -> None:
    for _ in range(builder.count(furniture.poles)):
        _pole(builder, furniture)
    for _ in range(builder.count(furniture.tables)):
        _table(builder)
    for _ in range(builder.count(furniture.boxes)):
        _box(builder, furniture)
    for _ in range(builder.count(furniture.curved)):
        _body(builder, furniture)
    for _ in range(builder.count(furniture.boards)):
        _board(builder)


def _pole(builder: _Builder, furniture: Furniture) -> None:
    low, high = np.log(furniture.pole_m)
    side = float(np.exp(builder.between((low, high))))
    height = builder.size_m[2]
    texture = builder.painter.texture()
    position = builder.place(side / math.sqrt(2), 0.0, height)
    if position:
        box = {"kind": "box", "name": "pole", "size_m": [side, side, height], "position_m": [*position, 0.0]}
        builder.objects.append(box | {"yaw_deg": float(builder.draws.uniform(0, 90)), "texture": texture})


def _box(builder: _Builder, furniture: Furniture) -> None:
    a, b = builder.between(furniture.box_m), builder.between(furniture.box_m)
    height = min(builder.between(furniture.box_m) * float(builder.draws.uniform(0.5, 2.0)), builder.size_m[2] - _GAP_M)
    texture, top = builder.painter.texture(), builder.painter.texture()
    position = builder.place(math.hypot(a, b) / 2, 0.0, height)
    if position:
        box = {"kind": "box", "name": "box", "size_m": [a, b, height], "position_m": [*position, 0.0]}
        turned = {"yaw_deg": float(builder.draws.uniform(0, 180)), "texture": texture, "top": top}
        builder.objects.append(box | turned)


def _table(builder: _Builder) -> None:
    """A slab on four legs, which end a millimetre below it: faces that coincide would be a matter of luck."""
    a, b, height = builder.between((0.8, 1.8)), builder.between((0.5, 1.0)), builder.between((0.65, 0.8))
    slab, leg = builder.between((0.02, 0.05)), builder.between((0.03, 0.08))
    texture, legs = builder.painter.texture(), builder.painter.texture()
    yaw_deg = float(builder.draws.uniform(0, 180))
    position = builder.place(math.hypot(a, b) / 2, 0.0, height)
    if not position:
        return
    x, y = position
    plate = {"kind": "box", "name": "table", "size_m": [a, b, slab], "position_m": [x, y, height - slab]}
    builder.objects.append(plate | {"yaw_deg": yaw_deg, "texture": texture})
    cosine, sine = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    for right in (-1, 1):
        for ahead in (-1, 1):
            u, v = right * (a / 2 - leg), ahead * (b / 2 - leg)
            at = [x + cosine * u - sine * v, y + sine * u + cosine * v, 0.0]
            size = [leg, leg, height - slab - 0.001]
            builder.objects.append(
                {"kind": "box", "name": "leg", "size_m": size, "position_m": at, "yaw_deg": yaw_deg, "texture": legs}
            )


def _body(builder: _Builder, furniture: Furniture) -> None:
    height = builder.between(furniture.curved_m)
    file, radius = builder.painter.body(min(height, builder.size_m[2] - _GAP_M))
    texture = builder.painter.texture()
    position = builder.place(radius, 0.0, height)
    if not position:
        del builder.painter.files[file]
        return
    body = {"kind": "mesh", "name": "body", "file": file, "position_m": [*position, 0.0], "texture": texture}
    builder.objects.append(body | {"yaw_deg": float(builder.draws.uniform(0, 360))})


def _board(builder: _Builder) -> None:
    """A board at a hand's breadth from a wall: whiteboards, and pictures."""
    wall = int(builder.draws.integers(4))
    length, width, height = builder.size_m
    reach = (width, length)[wall // 2] / 2
    half = builder.between((0.2, 0.4)) * min(reach, 2.5)
    middle = float(builder.draws.uniform(-1, 1)) * (reach - half - _GAP_M)
    low = builder.between((0.3, 0.5)) * height
    high = low + builder.between((0.15, 0.4)) * height
    out = -float(builder.draws.uniform(0.01, 0.1))  # each at a depth of its own: boards may hang over each other
    texture = builder.painter.texture(plain=bool(builder.draws.random() < 0.5))
    strip = _strip(builder, wall, texture, (middle - half, middle + half), (low, high), out)
    builder.objects.append(strip | {"name": "board"})


# --- Files ----------------------------------------------------------------------------------------------------------


def _laid_down(files: dict[str, bytes]) -> dict[str, str]:
    """Paths in the cache of files with these contents."""
    folder = (cache_folder() or Path(gettempdir()) / "omnirange") / "files"
    if files:
        make_folder(folder)
    paths = {}
    for name, content in files.items():
        path = folder / f"{hashlib.sha256(content).hexdigest()}{Path(name).suffix}"
        if not (path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content):
            replace_file(path, content, durable=False)
        paths[name] = str(path.resolve())
    return paths


def _with_files(value: Any, paths: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: paths[each] if key == "file" else _with_files(each, paths) for key, each in value.items()}
    return [_with_files(each, paths) for each in value] if isinstance(value, list) else value
