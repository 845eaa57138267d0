"""A scene as arrays: triangles for Embree, and the planar faces to which they belong.

A *face* is a connected coplanar group of triangles with one affine texture map: a side of a box, a rectangle, or a
single triangle of a mesh. From a given viewpoint a face's texture coordinates are a homography of the direction, so
that the renderer can shade a ray without tracing it (see `homographies`).
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from harness.errors import InputError, Notice
from harness.geometry.angles import Array
from harness.images import LUMA, Weights
from harness.simulation._rendering_kernels import face_maps
from harness.simulation.coincident import Rivals, encloses, rivals_of, visible_pairs
from harness.simulation.content_cache import cached_by_content
from harness.simulation.mesh_file import read_mesh
from harness.simulation.scene import BOX_SIDES, Box, Chessboard, Mesh, Plane, Scene, SceneObject
from harness.simulation.texture import Texels, texels_of

Ints = NDArray[np.int32]

_LIMIT_TEXELS = 2**27
"""Most texels of all textures of a scene together: half a gigabyte, and as much again for the renderer."""

_NEAR_M = 64.0
"""Distance from the world's origin, metres, within which coordinates are relative to the origin."""
_LATTICE_M = 16.0
"""Farther away they are relative to the nearest point of a lattice with this pitch, metres."""


@dataclass(frozen=True)
class Solid:
    """The watertight surface of an object inside which no view may be."""

    name: str
    corners: Array
    """`[triangles, 3, 3]`, metres."""


@dataclass(frozen=True)
class Geometry:
    """A scene to be traced and shaded; arrays are read-only, in metres, along the world's axes relative to `centre`."""

    name: str
    centre: Array
    """`[3]`: the point of the world to which all coordinates here are relative; see `geometry_near`."""
    closed: bool
    background_grey: float
    corners: Array
    """Triangles `[triangles, 3, 3]`."""
    face_of_triangle: Ints
    """`[triangles + 1]`; the last is -1, so that the face of a miss, triangle -1, is -1."""
    normals: Array
    """Unit normal `[faces, 3]` of each face's plane, on either side."""
    offsets: Array
    """`[faces]`: the plane is `normal · p = offset`."""
    uv_maps: Array
    """`[faces, 2, 4]`: texture coordinates `(u, v) = uv_map @ (x, y, z, 1)`, in repetitions."""
    texture_of_face: Ints
    """`[faces]`."""
    object_of_face: Ints
    """`[faces]`: index into the scene's objects."""
    textures: tuple[Texels, ...]
    textureless: np.ndarray
    """`[textures]`, bool: the texture is a uniform grey."""
    edges: Array
    """`[edges, 2, 3]`: end points of the boundary edges of faces."""
    bounds: Array
    """`[2, 3]`: lowest and highest corner of the bounding box."""
    solids: tuple[Solid, ...]
    object_names: tuple[str, ...]
    """Names of the scene's objects, for messages."""
    rivals: Rivals
    """Coplanar faces that overlap."""
    embree: Any
    """The triangles as an Embree scene, float32; hits are triangle indices."""


@dataclass(frozen=True)
class _Patch:
    """Faces that share a texture."""

    corners: Array
    uv: Array
    face: NDArray[np.int64]
    texels: Texels


def geometry_near(scene: Scene, point_m: ArrayLike) -> Geometry:
    """The geometry of a scene, relative to a centre within 14 m of a point of the world.

    Embree's coordinates are float32, whose resolution is 0.25 m at 4,000 km. Within 64 m of the world's origin the
    centre is the origin, as nothing would be gained. Farther away it is a point of a lattice that neighbouring views
    share. Objects are translated by their position minus the centre, two numbers of about the same size, so that the
    difference is exact: what remains is the float64 resolution of the input, 4.7e-10 m at 4,000 km.

    Raises
    ------
    InputError
        As in `geometry_of`.
    """
    point = np.asarray(point_m, dtype=np.float64)
    near = not (np.abs(point) > _NEAR_M).any()
    x, y, z = (0.0, 0.0, 0.0) if near else (_LATTICE_M * np.round(point / _LATTICE_M)).tolist()
    return geometry_of(scene, (x, y, z))


@cached_by_content(8)
def geometry_of(scene: Scene, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Geometry:
    """The triangles, faces and edges of a scene; cached until its files change, so that views share it.

    Parameters
    ----------
    centre
        The point of the world to which coordinates are relative, metres.

    Raises
    ------
    InputError
        When a mesh or texture file is wrong.
    """
    patches: list[_Patch] = []
    object_of_patch: list[int] = []
    solids: dict[int, Solid] = {}
    for index, scene_object in enumerate(scene.objects):
        own = _placed_patches(scene, scene_object, centre)
        patches += own
        object_of_patch += [index] * len(own)
        corners = np.concatenate([patch.corners for patch in own])
        if not isinstance(scene_object, Plane | Chessboard) and not scene_object.inward and _is_watertight(corners):
            solids[index] = Solid(name=_name(index, scene_object), corners=corners)
    return _assemble(scene, np.array(centre), patches, object_of_patch, solids)


@cached_by_content(6)
def band_of(scene: Scene, centre: tuple[float, float, float], weights: Weights) -> tuple[Array, tuple[Texels, ...]]:
    """Texture maps `[faces, 2, 4]` and textures of a scene in a band of their colours.

    The faces and their textures are those of `geometry_of` about that centre, in its order.
    """
    patches = [
        patch for scene_object in scene.objects for patch in _placed_patches(scene, scene_object, centre, weights)
    ]
    corners, uv, face, _ = _joined(patches)
    _, first = np.unique(face, return_index=True)
    return _planes(corners[first], uv[first])[2], tuple(patch.texels for patch in patches)


def _placed_patches(
    scene: Scene, thing: SceneObject, centre: tuple[float, float, float], weights: Weights = LUMA
) -> list[_Patch]:
    moved = np.subtract(thing.pose.position_m, np.divide(centre, scene.scale))
    return [_placed(patch, thing.pose.R_world_from_view, moved, scene.scale) for patch in _patches(thing, weights)]


def _joined(patches: list[_Patch]) -> tuple[Array, Array, NDArray[np.int64], NDArray[np.int64]]:
    """Corners, texture coordinates and faces of all triangles, and the patch of each face."""
    faces_before = np.cumsum([0] + [patch.face.max() + 1 for patch in patches])
    face = np.concatenate([patch.face + n for patch, n in zip(patches, faces_before, strict=False)])
    return (
        np.concatenate([patch.corners for patch in patches]),
        np.concatenate([patch.uv for patch in patches]),
        face,
        np.repeat(np.arange(len(patches)), np.diff(faces_before)),
    )


def _name(index: int, thing: SceneObject) -> str:
    return thing.name or f"object {index} ({thing.kind})"


def _assemble(
    scene: Scene, centre: Array, patches: list[_Patch], object_of_patch: list[int], solids: dict[int, Solid]
) -> Geometry:
    corners, uv, face, patch_of_face = _joined(patches)
    _, first = np.unique(face, return_index=True)
    for index in np.flatnonzero(~(np.linalg.norm(_cross_of_edges(corners[first]), axis=-1) > 0))[:1]:
        object_index = object_of_patch[patch_of_face[index]]
        raise InputError(
            f"'{_name(object_index, scene.objects[object_index])}' has a face without area; "
            "its size is below the precision of its position",
            file=scene.name,
        )
    normals, offsets, uv_maps = _planes(corners[first], uv[first])
    textures = tuple(patch.texels for patch in patches)
    if sum({id(texels): texels.size for texels in textures}.values()) > _LIMIT_TEXELS:
        raise InputError(
            f"its textures have more than {_LIMIT_TEXELS / 1e6:.0f} million texels together", file=scene.name
        )
    triangles = _indexed(corners)
    edges = _face_edges(triangles, face)
    vertices = np.empty((triangles.max() + 1, 3))
    vertices[triangles] = corners
    arrays: dict[str, np.ndarray] = {
        "centre": centre,
        "corners": corners,
        "face_of_triangle": np.append(face, -1).astype(np.int32),
        "normals": normals,
        "offsets": offsets,
        "uv_maps": uv_maps,
        "texture_of_face": patch_of_face.astype(np.int32),
        "object_of_face": np.asarray(object_of_patch, dtype=np.int32)[patch_of_face],
        "textureless": np.array([np.ptp(texels) == 0 for texels in textures]),
        "edges": vertices[edges],
        "bounds": np.stack([vertices.min(axis=0), vertices.max(axis=0)]),
    }
    for array in arrays.values():
        array.flags.writeable = False
    inside = [solids[index].corners if index in solids else None for index in arrays["object_of_face"].tolist()]
    rivals = rivals_of(corners, arrays["face_of_triangle"][:-1], normals, offsets, inside, scene.name)
    embree = EmbreeScene(robust=True)
    TriangleMesh(embree, vertices.astype(np.float32), triangles)
    return Geometry(
        name=scene.name,
        closed=scene.closed,
        background_grey=scene.background_grey,
        textures=textures,
        solids=tuple(solids.values()),
        object_names=tuple(_name(index, object_index) for index, object_index in enumerate(scene.objects)),
        rivals=rivals,
        embree=embree,
        **arrays,
    )


def homographies(geometry: Geometry, uv_maps: Array, viewpoint: ArrayLike, rotation: Array) -> Array:
    """For each face the homography H `[faces, 3, 3]` with `(u w, v w, w) = H @ direction`, from a viewpoint.

    With the plane n · p = h, a ray c + s d meets it at s = (h - n · c)/(n · d); the texture coordinate a · p + b
    there is ((a · c + b) n + (h - n · c) a) · d / (n · d).

    Parameters
    ----------
    uv_maps
        The geometry's maps, or others of that form, `[faces, 2, 4]`.
    viewpoint
        `[3]`, metres, from the geometry's centre.
    rotation
        World from view, `[3, 3]`: directions are in the view's frame, and need not be of unit length.
    """
    out = np.empty((len(geometry.normals), 3, 3))
    c = np.asarray(viewpoint, dtype=np.float64)
    face_maps(geometry.normals, geometry.offsets, uv_maps, c, np.ascontiguousarray(rotation), out)
    return out


def check_viewpoint(geometry: Geometry, viewpoint: ArrayLike) -> None:
    """Check that a viewpoint, metres, relative to the geometry's centre, is valid; see `check_position`.

    Warns (`Notice`) when faces of two objects coincide.
    """
    p = np.asarray(viewpoint, dtype=np.float64)
    check_position(geometry, p)
    for pair in _coincident_objects(geometry, p):
        warnings.warn(
            f"{geometry.name}: faces of {' and '.join(pair)} coincide; the later one is visible. Move one of them",
            Notice,
            stacklevel=1,  # the same code location, so that each notice is shown once
        )


def check_position(geometry: Geometry, viewpoint: ArrayLike) -> None:
    """Check that something can be seen from a position, metres, relative to the geometry's centre.

    Raises
    ------
    InputError
        When it is outside the bounds of a closed scene, or inside a solid object.
    """
    p = np.asarray(viewpoint, dtype=np.float64)
    # Rounded: cos(90°) is 6e-17 in floating point.
    where = f"({', '.join(f'{value:.10g}' for value in np.round(p + geometry.centre, 9) + 0.0)}) m"
    low, high = geometry.bounds
    if geometry.closed and not ((p > low) & (p < high)).all():
        in_world = zip("xyz", low + geometry.centre, high + geometry.centre, strict=True)
        box = ", ".join(f"{axis} {a:.10g} .. {b:.10g}" for axis, a, b in in_world)
        raise InputError(f"the view at {where} is outside the scene; place it within {box} m", file=geometry.name)
    for solid in geometry.solids:
        if encloses(solid.corners, p):
            raise InputError(
                f"the view at {where} is inside '{solid.name}'; place it outside, or set inward = true for a room",
                file=geometry.name,
            )


def _coincident_objects(geometry: Geometry, viewpoint: Array) -> list[list[str]]:
    """The names of objects with overlapping coplanar faces that are visible from a viewpoint, in pairs.

    A single name for an object that overlaps itself with faces of different textures.
    """
    pairs = visible_pairs(geometry.rivals, geometry.normals, geometry.offsets, viewpoint)
    objects = geometry.object_of_face[pairs]
    a, b = pairs.T
    same_object = objects[:, 0] == objects[:, 1]
    same_texture = np.array(
        [geometry.textures[i] is geometry.textures[j] for i, j in geometry.texture_of_face[pairs].tolist()], dtype=bool
    )
    alike = same_object & same_texture & (np.abs(geometry.uv_maps[a] - geometry.uv_maps[b]) < 1e-6).all(axis=(1, 2))
    return [
        [f"'{geometry.object_names[index]}'" for index in dict.fromkeys(each)]
        for each in np.unique(objects[~alike], axis=0).tolist()
    ]


def _patches(thing: SceneObject, weights: Weights) -> list[_Patch]:
    if isinstance(thing, Box):
        return list(_box_patches(thing, weights))
    if isinstance(thing, Plane | Chessboard):
        width, height = thing.size_m
        corner = np.array([-width / 2, -height / 2, 0.0])
        return [_rectangle(corner, np.array([width, 0, 0]), np.array([0, height, 0]), thing.texture, weights)]
    return list(_mesh_patches(thing, weights))


def _box_patches(box: Box, weights: Weights) -> Iterator[_Patch]:
    """Six rectangles. On upright sides u runs horizontally and v up; on bottom and top u runs along x and v along y."""
    a, b, c = box.size_m
    x, y, z = np.diag([a, b, c]).astype(np.float64)
    origin = np.array([-a / 2, -b / 2, 0.0])
    spans = {
        "x_min": (origin, y, z),
        "x_max": (origin + x, y, z),
        "y_min": (origin, x, z),
        "y_max": (origin + y, x, z),
        "bottom": (origin, x, y),
        "top": (origin + z, x, y),
    }
    for side in BOX_SIDES:
        yield _rectangle(*spans[side], box.texture_of(side), weights)


def _rectangle(corner: Array, along_u: Array, along_v: Array, texture: Any, weights: Weights) -> _Patch:
    texels = texels_of(texture, weights)
    height, width = texels.shape
    reach = np.array([np.linalg.norm(along_u), np.linalg.norm(along_v) * width / height]) / texture.tile_m
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
    points = corner + square[:, :1] * along_u + square[:, 1:] * along_v
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    return _Patch(corners=points[halves], uv=(square * reach)[halves], face=np.zeros(2, np.int64), texels=texels)


def _mesh_patches(mesh: Mesh, weights: Weights) -> Iterator[_Patch]:
    for part in read_mesh(Path(mesh.file), mesh.texture is None, weights):
        # Degenerate triangles are never hit and have no plane.
        area = np.linalg.norm(_cross_of_edges(part.corners), axis=-1)
        solid = area > 1e-14 * np.ptp(part.corners.reshape(-1, 3), axis=0).max() ** 2
        if not solid.any():
            raise InputError("has no triangle with an area; repair the mesh", file=mesh.file)
        corners = part.corners[solid] * mesh.scale
        face = np.arange(len(corners))
        if mesh.texture is not None:
            texels = texels_of(mesh.texture, weights)
            yield _Patch(corners, _projected_uv(corners, texels, mesh.texture.tile_m), face, texels)
        elif part.uv is None or part.texels is None:
            missing = "texture coordinates" if part.uv is None else "texture image"
            raise InputError(f"has no {missing}; give the object a texture in the scene", file=mesh.file)
        else:
            yield _Patch(corners, part.uv[solid], face, part.texels)


def _projected_uv(corners: Array, texels: Texels, tile_m: float) -> Array:
    """Texture coordinates by projection along the axis closest to each triangle's normal; v is up on upright ones."""
    axis = np.argmax(np.abs(_cross_of_edges(corners)), axis=-1)
    u_and_v = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    height, width = texels.shape
    flat = np.take_along_axis(corners, u_and_v[:, None, :], axis=2)
    return np.asarray(flat * [1.0, width / height] / tile_m)


def _placed(patch: _Patch, rotation: Array, position: Array, scale: float) -> _Patch:
    corners = (patch.corners @ rotation.T + position) * scale
    return _Patch(corners=corners, uv=patch.uv, face=patch.face, texels=patch.texels)


def _cross_of_edges(corners: Array) -> Array:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _planes(corners: Array, uv: Array) -> tuple[Array, Array, Array]:
    """Unit normals, offsets and affine texture maps of the planes of triangles."""
    p, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(e1, e2)
    area2 = np.linalg.norm(cross, axis=-1, keepdims=True)
    normals = cross / area2
    # The basis dual to (e1, e2) in the plane: gradient of u = du_1 e1' + du_2 e2'.
    dual_1, dual_2 = np.cross(e2, normals) / area2, np.cross(normals, e1) / area2
    du = uv[:, 1:] - uv[:, :1]
    gradient = du[:, 0, :, None] * dual_1[:, None, :] + du[:, 1, :, None] * dual_2[:, None, :]
    constant = uv[:, 0] - np.einsum("fij,fj->fi", gradient, p)
    return (
        normals,
        np.sum(normals * p, axis=-1),
        np.concatenate([gradient, constant[..., None]], axis=-1),
    )


def _indexed(corners: Array) -> Ints:
    """Vertex index `[triangles, 3]`: coincident corners are one vertex, so that there are no cracks for Embree."""
    _, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return index.reshape(-1, 3).astype(np.int32)


def _sides(triangles: Ints) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Sides of triangles as sorted vertex pairs: the distinct ones `[n, 2]`, each side's index, and their counts."""
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    key = pairs[:, 0] * (int(triangles.max()) + 1) + pairs[:, 1]
    _, first, index, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    return pairs[first], index, count


def _face_edges(triangles: Ints, face: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertex pairs `[edges, 2]` of the sides that are not shared by two triangles of one face."""
    pairs, index, count = _sides(triangles)
    face_of_side = np.repeat(face, 3)
    lowest = np.full(len(pairs), np.iinfo(np.int64).max)
    highest = np.full(len(pairs), -1)
    np.minimum.at(lowest, index, face_of_side)
    np.maximum.at(highest, index, face_of_side)
    return pairs[(lowest != highest) | (count != 2)]


def _is_watertight(corners: Array) -> bool:
    return bool((_sides(_indexed(corners))[2] == 2).all())
