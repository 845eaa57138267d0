"""A scene: objects with their poses and textures, read from TOML.

Lengths are in metres; the world is right-handed with z up. Specifications are frozen and hashable, and round-trip
through TOML.
"""

import difflib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from harness import shipped
from harness.errors import InputError
from harness.files import path_of, printable
from harness.geometry.pose import Pose
from harness.simulation.texture import ChessboardTexture, Grey, ImageTexture, Texture
from harness.spec import Finite, Positive, Spec, parse
from harness.toml import read_toml

Point = tuple[Finite, Finite, Finite]
Corners = Annotated[int, Field(ge=2, le=64)]
BOX_SIDES = ("x_min", "x_max", "y_min", "y_max", "bottom", "top")


class _Placed(Spec):
    """An object's frame in the world: rotated by yaw about z, pitch about y, then roll about x, then translated."""

    name: str = ""
    """A name for messages and exports."""
    position_m: Point = (0.0, 0.0, 0.0)
    """Origin of the object's frame in the world, metres."""
    yaw_deg: Finite = 0.0
    """Rotation about z, degrees."""
    pitch_deg: Finite = 0.0
    """Rotation about y, degrees."""
    roll_deg: Finite = 0.0
    """Rotation about x, degrees."""

    @property
    def pose(self) -> Pose:
        """The object's frame as a pose."""
        return Pose(
            position_m=self.position_m,
            yaw_deg=self.yaw_deg,
            pitch_deg=self.pitch_deg,
            roll_deg=self.roll_deg,
        )


class Box(_Placed):
    """A cuboid; `position_m` is the centre of its bottom.

    A side's texture is the first one given of: its own (`x_min` ... `top`), `sides` for the four upright sides, and
    `texture`.
    """

    kind: Literal["box"]
    """A cuboid."""
    size_m: tuple[Positive, Positive, Positive]
    """Extent along x, y and z, metres."""
    inward: bool = False
    """Whether the box is a room, visible from inside; otherwise it is solid, and no view may be inside."""
    texture: Texture | None = None
    """Texture of all sides that have none of their own."""
    sides: Texture | None = None
    """Texture of the four upright sides."""
    x_min: Texture | None = None
    """Texture of the side at the smallest x."""
    x_max: Texture | None = None
    """Texture of the side at the largest x."""
    y_min: Texture | None = None
    """Texture of the side at the smallest y."""
    y_max: Texture | None = None
    """Texture of the side at the largest y."""
    bottom: Texture | None = None
    """Texture of the bottom."""
    top: Texture | None = None
    """Texture of the top."""

    def texture_of(self, side: str) -> Texture | None:
        """The texture of one of `BOX_SIDES`."""
        upright = None if side in {"bottom", "top"} else self.sides
        own: Texture | None = getattr(self, side)
        return own or upright or self.texture

    @model_validator(mode="after")
    def _covered(self) -> "Box":
        for side in BOX_SIDES:
            if self.texture_of(side) is None:
                raise ValueError(f"the box's {side} has no texture; give {side}, or texture for all sides")
        return self


class Plane(_Placed):
    """A rectangle in its own x-y plane about `position_m`, seen from both sides."""

    kind: Literal["plane"]
    """A rectangle."""
    size_m: tuple[Positive, Positive]
    """Extent along x and y of the plane's own frame, metres."""
    texture: Texture
    """Texture of both sides."""


class Chessboard(_Placed):
    """A planar board of dark and bright squares for calibration, centred on `position_m` in its own x-y plane.

    It is visible from both sides. Columns of corners follow each other along x, rows along y.
    """

    kind: Literal["chessboard"]
    """A board of squares."""
    columns: Corners = 9
    """Inner corners along x, where four squares meet."""
    rows: Corners = 6
    """Inner corners along y."""
    square_m: Positive = 0.04
    """Side of a square, metres."""
    margin_squares: Annotated[int, Field(ge=0, le=16)] = 1
    """Width of the bright margin around the squares, in squares."""
    dark: Grey = 20.0
    """Grey level of every other square, 0 .. 255."""
    bright: Grey = 235.0
    """Grey level of the others and of the margin, 0 .. 255."""

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along x and y, including margins, metres."""
        squares = self.columns + 1 + 2 * self.margin_squares, self.rows + 1 + 2 * self.margin_squares
        return squares[0] * self.square_m, squares[1] * self.square_m

    @property
    def texture(self) -> ChessboardTexture:
        """Texture of both sides."""
        return ChessboardTexture(
            columns=self.columns,
            rows=self.rows,
            square_m=self.square_m,
            margin_squares=self.margin_squares,
            dark=self.dark,
            bright=self.bright,
        )


class Mesh(_Placed):
    """Triangles of a GLB, OBJ or PLY file with its own UV texture.

    glTF has y up and is rotated to z up; other formats are assumed to have z up.
    """

    kind: Literal["mesh"]
    """A mesh from a file."""
    file: str
    """Path of the GLB, OBJ or PLY file, relative to the scene's file."""
    scale: Positive = 1.0
    """Scale factor of the mesh, no unit."""
    inward: bool = False
    """Whether a watertight mesh is visible from inside; otherwise it is solid, and no view may be inside."""
    texture: Texture | None = None
    """Replaces the file's texture; mapped by projection along the axis closest to each triangle's normal, in the mesh's
    own frame and size, so that it needs no UV."""


SceneObject = Annotated[Box | Plane | Chessboard | Mesh, Field(discriminator="kind")]


class Scene(Spec):
    """A scene: a list of objects, and the background."""

    name: str
    """The scene's name."""
    description: str = ""
    """A description for the reader."""
    closed: bool = True
    """Whether every ray hits something: one that escapes is then an error. An open scene shows the background
    there."""
    background_grey: Grey = 0.0
    """Grey level, 0 .. 255, of rays that hit nothing in an open scene."""
    scale: Positive = 1.0
    """Scale factor of everything about the origin, textures included; no unit."""
    objects: Annotated[tuple[SceneObject, ...], Field(min_length=1)]
    """The objects: boxes, planes and meshes."""


def load_scene(source: str | Path | Mapping[str, Any]) -> Scene:
    """Read a scene: a shipped name, the path of a TOML file, or a table like that of a file.

    Paths of meshes and images are relative to the scene's file, or the working folder where there is none, and
    absolute in the result.

    Raises
    ------
    InputError
        Names the file, the key and what would be right.
    """
    if isinstance(source, Mapping):
        return parse(Scene, _with_absolute_files(dict(source), Path("scene"), ""), file="scene")
    path = shipped.find("scenes", str(source))
    table = _with_absolute_files(read_toml(path), path, "")
    return parse(Scene, table, file=path)


def assets(scene: Scene) -> tuple[Path, ...]:
    """The files of a scene's meshes and images, sorted."""
    return tuple(sorted({Path(spec.file) for spec in file_specs(scene)}))


def file_specs(spec: Any) -> Iterator[Mesh | ImageTexture]:
    """The parts of a specification that name a file."""
    if isinstance(spec, Mesh | ImageTexture):
        yield spec
    if isinstance(spec, Spec):
        for field in type(spec).model_fields:
            yield from file_specs(getattr(spec, field))
    elif isinstance(spec, tuple):
        for item in spec:
            yield from file_specs(item)


def _with_absolute_files(value: Any, scene_path: Path, key: str) -> Any:
    if isinstance(value, dict):
        return {k: _with_absolute_files(v, scene_path, f"{key}.{k}" if key else k) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_absolute_files(v, scene_path, f"{key}[{i}]") for i, v in enumerate(value)]
    if isinstance(value, str) and key.rpartition(".")[2] == "file":
        return str(_existing(value, scene_path, key))
    return value


def _existing(file: str, scene_path: Path, key: str) -> Path:
    path = path_of(file, scene_path.parent, file=scene_path, key=key).resolve()
    if path.exists() and not path.is_file():
        raise InputError(f"'{printable(file)}' is not a regular file", file=scene_path, key=key)
    if not path.is_file():
        siblings = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        close = difflib.get_close_matches(path.name, siblings, n=1, cutoff=0.5)
        hint = f"did you mean '{Path(file).with_name(close[0])}'?" if close else f"looked for {printable(path)}"
        raise InputError(f"no such file '{printable(file)}'; {hint}", file=scene_path, key=key)
    return path
