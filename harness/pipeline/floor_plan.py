"""The floor plan of a scene: its surfaces cut by horizontal planes in a band of heights."""

import numpy as np

from harness.geometry.angles import Array
from harness.mapping.settings import Scan
from harness.pipeline.scan import layers
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import geometry_near


def floor_plan(scene: Scene, near_m: tuple[float, float, float], scan: Scan) -> Array:
    """`[n, 2, 2]`: both ends of the lines in which the scene's surfaces cut the band's layers, from above, metres.

    Parameters
    ----------
    near_m
        A point near by: see `geometry_near`.

    Raises
    ------
    InputError
        When the band lies outside of a closed scene.
    """
    import trimesh  # loading it takes long, and few runs need it

    geometry = geometry_near(scene, near_m)
    corners = geometry.corners
    mesh = trimesh.Trimesh(
        vertices=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3), process=False
    )
    bounds = geometry.bounds[:, 2] + geometry.centre[2] if geometry.closed else None
    cuts = [
        trimesh.intersections.mesh_plane(  # type: ignore[no-untyped-call]
            mesh, (0.0, 0.0, 1.0), (0.0, 0.0, height - geometry.centre[2])
        )
        for height in layers(scan, bounds, scene.name)
    ]
    lines = np.concatenate([np.asarray(each, dtype=np.float64).reshape(-1, 2, 3) for each in cuts])[..., :2]
    # Many layers cut out the same lines: a micrometre tells them apart.
    _, first = np.unique(np.round(lines.reshape(-1, 4), 6), axis=0, return_index=True)
    return np.asarray(lines[np.sort(first)] + geometry.centre[:2])
