"""Export of a scene as a standard GLB file, so that another renderer can reproduce the image."""

from pathlib import Path
from typing import Any

import numpy as np

from harness.files import write
from harness.images import COLOURS
from harness.simulation.mesh_gltf import Z_UP_FROM_Y_UP
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Geometry, band_of, geometry_near, geometry_of
from harness.simulation.texture import Texels


def write_glb(scene: Scene, path: str | Path, *, colour: bool = False) -> None:
    """Write a scene as binary glTF: y up, one mesh for each textured surface, unlit grey materials.

    Textures are embedded as 8-bit PNG, which rounds those that are not whole numbers (noise); they repeat, which is
    glTF's default. Positions and texture coordinates are float32. Loading the file as a `mesh` object turns z up
    again.

    Parameters
    ----------
    colour
        Write textures in colour. Vertex colours that vary stay grey, as no one texture has them.

    Raises
    ------
    InputError
        When a mesh or texture file of the scene is wrong, or the file cannot be written.
    """
    import trimesh
    from PIL import Image

    geometry = geometry_near(scene, geometry_of(scene).bounds.mean(axis=0))
    # Positions are float32 and count from the centre; the move back is text, and exact.
    to_world = np.eye(4)
    to_world[:3, 3] = geometry.centre @ Z_UP_FROM_Y_UP
    face = geometry.face_of_triangle[:-1]
    homogeneous = np.concatenate([geometry.corners, np.ones((*geometry.corners.shape[:2], 1))], axis=-1)
    uv = np.einsum("tij,tkj->tki", geometry.uv_maps[face], homogeneous)
    visual: Any = trimesh.visual
    world: Any = trimesh.Scene()
    textures = _in_colour(scene, geometry) if colour else geometry.textures
    for index, texels in enumerate(textures):
        triangles = geometry.texture_of_face[face] == index
        scene_object = scene.objects[geometry.object_of_face[face[triangles][0]]]
        name = f"{index}: {scene_object.name or scene_object.kind}"
        levels = np.clip(np.rint(texels), 0, 255).astype(np.uint8)
        material = visual.material.PBRMaterial(
            name=name,
            baseColorTexture=Image.fromarray(levels).convert("RGB"),
            metallicFactor=0.0,
            roughnessFactor=1.0,
            doubleSided=True,
        )
        mesh = trimesh.Trimesh(
            vertices=geometry.corners[triangles].reshape(-1, 3) @ Z_UP_FROM_Y_UP,
            faces=np.arange(3 * np.count_nonzero(triangles)).reshape(-1, 3),
            visual=visual.TextureVisuals(uv=uv[triangles].reshape(-1, 2), material=material),
            process=False,
        )
        world.add_geometry(mesh, geom_name=name, node_name=name, transform=to_world)
    data = world.export(file_type="glb", include_normals=False, tree_postprocessor=_unlit)
    write(Path(path), data)


def _in_colour(scene: Scene, geometry: Geometry) -> list[Texels]:
    """The textures of `geometry_of`, `[height, width, 3]`; grey where a colour lies elsewhere on its faces."""
    x, y, z = geometry.centre.tolist()
    bands = [band_of(scene, (x, y, z), weights) for weights in COLOURS]
    result = []
    for index, grey in enumerate(geometry.textures):
        faces = geometry.texture_of_face == index
        alike = all(np.array_equal(maps[faces], geometry.uv_maps[faces]) for maps, _ in bands)
        result.append(np.stack([textures[index] for _, textures in bands], axis=-1) if alike else grey)
    return result


def _unlit(tree: dict[str, Any]) -> None:
    """Declare the materials unlit: a renderer that supports KHR_materials_unlit shows the bare texture."""
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", []), "KHR_materials_unlit"})
    for material in tree.get("materials", []):
        material.setdefault("extensions", {})["KHR_materials_unlit"] = {}
