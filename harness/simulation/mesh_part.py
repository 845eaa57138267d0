"""Shared by the readers of meshes: parts, their colours, and the files that they refer to."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.files import printable
from harness.geometry.angles import Array
from harness.images import LIMIT_BYTES as IMAGE_LIMIT_BYTES
from harness.images import LUMA, Picture, Weights, decode, luma, tinted
from harness.simulation.content_cache import read_recorded
from harness.simulation.texture import Texels

LIMIT_BYTES = 2**28
"""The largest mesh, material or buffer file that is read, bytes."""

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class MeshPart:
    """The triangles of a file that share a texture."""

    corners: Array
    """`[triangles, 3, 3]`, in the file's unit, z up."""
    uv: Array | None
    """`[triangles, 3, 2]`, in repetitions of the texture, v up; None in a file without texture coordinates."""
    texels: Texels | None
    """Grey `[height, width]`; None when the file has no colours for these triangles."""


@dataclass
class Look:
    """Builds parts from a file's colours; equal textures share one array.

    A factor and uniform vertex colours multiply the texture, or replace a missing one. Vertex colours that vary become
    a texture if there is no other.
    """

    file: Path
    linear: bool = False
    """Whether factors multiply linear intensities (glTF) rather than grey levels."""
    weights: Weights = LUMA
    """Weights of red, green and blue in the parts' grey textures."""
    _greys: dict[tuple[int, Colour], Texels] = field(default_factory=dict)
    _pictures: list[Picture] = field(default_factory=list)

    def part(
        self,
        corners: Array,
        uv: Array | None,
        picture: Picture | None,
        factor: Colour | None,
        colours: Array | None,
        *,
        key: str | None = None,
    ) -> MeshPart:
        """A part with its grey texture.

        Parameters
        ----------
        factor
            The material's factor, 0 .. 1; None in a file without one.
        colours
            Colours of the corners, `[triangles, 3, 3]`, 0 .. 1.
        key
            The key of the colours in the file, for messages.
        """
        if colours is not None:
            if not (np.isfinite(colours).all() and colours.min() >= 0 and colours.max() <= 1):
                raise InputError(
                    "has vertex colours that are not within 0 .. 1; repair the mesh", file=self.file, key=key
                )
            if (colours == colours[0, 0]).all():
                r, g, b = (np.array(factor or WHITE) * colours[0, 0]).tolist()
                factor = (r, g, b)
            elif picture is not None or self.linear:
                what = "on a texture" if picture is not None else "as amounts of light"
                raise InputError(
                    f"has vertex colours that vary {what}, which is not rendered; bake them into a texture",
                    file=self.file,
                    key=key,
                )
            else:
                return _ramp(corners, 255 * luma(colours * np.array(factor or WHITE), self.weights))
        if picture is not None:
            return MeshPart(corners, uv, self._grey(picture, factor or WHITE))
        if factor is None:
            return MeshPart(corners, uv, None)
        level = luma(tinted(np.full((1, 1, 3), 255.0), factor, linear=self.linear), self.weights).astype(np.float32)
        return MeshPart(corners, np.zeros((*corners.shape[:2], 2)), level)

    def _grey(self, picture: Picture, factor: Colour) -> Texels:
        key = id(picture), factor
        if key not in self._greys:
            self._greys[key] = picture.grey(factor, linear=self.linear, weights=self.weights)
            self._greys[key].flags.writeable = False
            self._pictures.append(picture)  # kept, so that its identity stays its own
        return self._greys[key]


def _ramp(corners: Array, greys: Array) -> MeshPart:
    """A texture for the greys of corners `[triangles, 3]`: between the centres of two texels grey is linear in u."""
    low, high = float(greys.min()), float(greys.max())
    along = np.zeros_like(greys) if high == low else (greys - low) / (high - low)
    uv = np.stack([0.25 + 0.5 * along, np.full_like(along, 0.5)], axis=-1)
    return MeshPart(corners, uv, np.array([[low, high]], dtype=np.float32))


def named_file(name: str, owner: Path) -> Path:
    """The path of a file that `owner` refers to, relative to it. Backslashes, from other systems, count as slashes."""
    return owner.parent / name.replace("\\", "/")


def is_beside(name: str, owner: Path) -> bool:
    """Whether a file that `owner` refers to exists."""
    try:
        return named_file(name, owner).is_file()
    except (OSError, ValueError):  # too long a name, or none
        return False


def read_named(name: str, owner: Path, limit_bytes: int, what: str, *, key: str | None = None) -> tuple[bytes, Path]:
    """Contents and path of a file that `owner` refers to; errors name the owner."""
    path = named_file(name, owner)
    try:
        return read_recorded(path, limit_bytes, what), path
    except InputError as error:
        raise InputError(
            f"names {what} '{printable(name)}': {error.problem}; looked for {printable(path)}", file=owner, key=key
        ) from error


def read_picture(name: str, owner: Path, *, key: str | None = None) -> Picture:
    """The image that a file refers to."""
    data, path = read_named(name, owner, IMAGE_LIMIT_BYTES, "texture", key=key)
    try:
        return decode(data, path)
    except InputError as error:
        raise InputError(
            f"names texture '{printable(name)}': {error.problem}; looked for {printable(path)}", file=owner, key=key
        ) from error


def text_of(data: bytes) -> str:
    """A text file's contents, from UTF-8 or else Latin-1, with line feeds as line ends."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def refuse_unless_convex(corners: Array, polygon: NDArray[np.int64], file: Path) -> None:
    """Check that a fan about its first corner fills every polygon.

    Parameters
    ----------
    corners
        Triangles of the fans, `[triangles, 3, 3]`.
    polygon
        `[triangles]`: the polygon of each, ascending.
    """
    if not len(polygon) or polygon[-1] + 1 == len(polygon):  # triangles only
        return
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(polygon, weights=cross[:, axis]) for axis in range(3)], axis=-1)[polygon]
    # A thousandth of the squared area, as collinear corners with rounding errors are not a fold.
    folded = np.sum(cross * total, axis=-1) < -1e-3 * np.sum(total**2, axis=-1)
    if folded.any():
        raise InputError(
            f"polygon {polygon[np.argmax(folded)] + 1} is not convex; triangulate the mesh when exporting it", file=file
        )
