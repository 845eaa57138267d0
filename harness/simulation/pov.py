"""A view as a scene of POV-Ray: the camera, the hyperboloid mirror as a quadric of reflection 1, the world as meshes.

What this program renders from equations, another one then works out by tracing rays from the camera to the mirror and
on: an independent check of projection, misalignment, textures and ranges. All coordinates are in the world's axes,
from the centre that the renderer counts from. POV-Ray is told its camera's axes one by one, so that its left-handed
default does not come into it.

A ray is `direction + x right + y up`, x and y from -1/2 to 1/2 across the image, y upwards. With K the camera matrix,
A = K⁻¹ and pixel centres at integers, `right = width A e_u`, `up = -height A e_v` and
`direction = A ((width - 1)/2, (height - 1)/2, 1)`. An off-centre principal point or skew is thus exact, where cropping
a larger image would round it to half a pixel.
"""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.camera.models import Mirror
from harness.camera.models.hyperboloid import point_on_mirror
from harness.camera.mount import edge_of
from harness.camera.reflection import reflecting_camera
from harness.camera.sensor import Sensor, model_from_sensor
from harness.errors import InputError
from harness.files import write
from harness.geometry.angles import Array
from harness.geometry.pose import Pose
from harness.simulation.scene import Scene
from harness.simulation.scene_geometry import Geometry, geometry_near
from harness.simulation.texture import Texels

SAMPLES_PER_SIDE = 8
"""Samples along each side of a pixel that scene.ini asks for."""

PERIODS = 1024
"""Periods of the fine scale of positions along the coarse one."""

README = f"""
scene.pov             the view for POV-Ray 3.7 with its physical mirror; it reads texture_*.png (16 bit, linear)
scene.ini             its options: `povray scene.ini` writes pov.png, 16 bit, linear

POV-Ray weighs the {SAMPLES_PER_SIDE**2} samples of a pixel that scene.ini asks for in its own way.
To compare images, render n times as wide and high without anti-aliasing,
`povray scene.ini -A +W<n times width> +H<n times height>`. The means of blocks of n x n are then the pixels, and the
samples where omnirange's are with n^2 of them (it takes more where they alias). A sample that is magenta is a ray that
slipped between two triangles of a closed scene: leave it out. Pixels at the mirror's rim and at the camera's own body
are partly black; omni.npy has such a pixel whole or not at all.

POV-Ray remarks that the camera's vectors are not perpendicular where the principal point is not the image's centre, or
there is skew: they have to be so. The sensor's mask is not in the scene. For positions instead of grey levels call
`povray scene.ini -A Declare=Shown=1`, then `Declare=Shown=2`; scene.pov says how to read them.
"""


def check_pov(sensor: Sensor) -> None:
    """Check that POV-Ray can reproduce the images of a sensor.

    Raises
    ------
    InputError
        Unless it has a hyperboloid mirror, and no lens distortion.
    """
    if not isinstance(sensor.model, Mirror):
        raise InputError(
            f"POV-Ray has no {sensor.model.title}; a view for it needs a hyperboloid mirror",
            key="model.kind",
        )
    bent = [name for name in type(sensor.lens).model_fields if getattr(sensor.lens, name)]
    if bent:
        raise InputError(
            f"POV-Ray's camera has no lens terms; a view for it needs 0 in place of {getattr(sensor.lens, bent[0]):g}",
            key=f"lens.{bent[0]}",
        )


def write_pov(scene: Scene, sensor: Sensor, pose: Pose, folder: Path) -> None:
    """Write `scene.pov`, `scene.ini` and the textures into a folder that is there.

    Textures are 16-bit PNG: POV-Ray rounds between the texels of an 8-bit one.

    Raises
    ------
    InputError
        As `check_pov`, or when a file of the scene is wrong, or cannot be written.
    """
    check_pov(sensor)
    geometry = geometry_near(scene, pose.position_m)
    images = {id(texels): _png16(texels) for texels in {id(each): each for each in geometry.textures}.values()}
    names = {image: f"texture_{index:02d}.png" for index, image in enumerate(dict.fromkeys(images.values()))}
    for image, name in names.items():
        write(folder / name, image)
    parts = [_head(geometry), _camera(geometry, sensor, pose), _mirror(geometry, sensor, pose), _surface(geometry)]
    parts += [_mesh(geometry, index, names[images[id(texels)]]) for index, texels in enumerate(geometry.textures)]
    write(folder / "scene.pov", "\n".join(parts))
    write(folder / "scene.ini", _INI.format(width=sensor.camera.width_px, height=sensor.camera.height_px))


_INI = f"""\
Input_File_Name=scene.pov
Output_File_Name=pov
Output_File_Type=N
Bits_Per_Color=16
File_Gamma=1.0
Width={{width}}
Height={{height}}
Antialias=On
Sampling_Method=1
Antialias_Threshold=0.0
Antialias_Depth={SAMPLES_PER_SIDE}
Jitter=Off
Display=Off
"""


def _png16(texels: Texels) -> bytes:
    """Grey levels 0 .. 255 as 0 .. 65535."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.clip(np.rint(texels.astype(np.float64) * 257), 0, 65535).astype(np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def _head(geometry: Geometry) -> str:
    background = "" if geometry.closed else f"#if (Shown = 0) rgb {geometry.background_grey / 255!r} #else "
    return f"""\
// {_comment(geometry.name)}. Metres, z up, right-handed, from {_vector(geometry.centre)} in the world.
#version 3.7;
#ifndef (Shown) #declare Shown = 0; #end // 0: grey levels; 1: positions, coarse; 2: positions, fine
global_settings {{ assumed_gamma 1 max_trace_level 4 adc_bailout 0 }}
#default {{ finish {{ ambient 0 diffuse 0 emission 1 }} }}
background {{ {background}rgb <1, 0, 1>{" #end" if background else ""} }} // where no surface is hit
"""


def _comment(text: str) -> str:
    """A text that stays on its line."""
    return " ".join(text.split())


def _camera(geometry: Geometry, sensor: Sensor, pose: Pose) -> str:
    camera = sensor.camera
    K = np.array(
        [
            [camera.focal_px, camera.skew_px, camera.cx_px],
            [0.0, camera.focal_px * camera.aspect, camera.cy_px],
            [0.0, 0.0, 1.0],
        ]
    )
    A = _world_from_mirror(sensor, pose) @ sensor.misalignment.R_mirror_from_camera @ np.linalg.inv(K)
    width, height = camera.width_px, camera.height_px
    return f"""\
camera {{ // focal length, aspect, skew and principal point are in these vectors; the ray is direction + x right + y up
  perspective
  location {_vector(_camera_centre(geometry, sensor, pose))}
  direction {_vector(A @ [(width - 1) / 2, (height - 1) / 2, 1.0])}
  right {_vector(width * A[:, 0])}
  up {_vector(-height * A[:, 1])}
}}
"""


def _mirror(geometry: Geometry, sensor: Sensor, pose: Pose) -> str:
    """The mirror, the camera's body that hides the middle of it, and black where the camera looks past it."""
    mirror, camera = sensor.model, reflecting_camera(sensor)
    assert isinstance(mirror, Mirror)
    a, b, e = mirror.a_m, mirror.b_m, mirror.e_m
    elevation = np.radians(edge_of(sensor.field, sensor.looks).angle_deg - 90)
    rim_r, _, rim_z = point_on_mirror(mirror, [np.cos(elevation), 0.0, np.sin(elevation)]).tolist()
    centre, rotation = _camera_centre(geometry, sensor, pose), _world_from_mirror(sensor, pose)
    axis = rotation @ sensor.misalignment.R_mirror_from_camera[:, 2]
    placed = [*rotation.T.ravel().tolist(), *_origin(geometry, pose).tolist()]
    reach = 2 * np.hypot(rim_r, rim_z + 2 * e) + np.linalg.norm(sensor.misalignment.offset_m)
    body = f"disc {{ {_vector(centre)}, {_vector(axis)}, {camera.body!r} pigment {{ rgb 0 }} no_image }}"
    wide = 1.01 * rim_r
    return f"""\
quadric {{ // (z + e)^2/a^2 - (x^2 + y^2)/b^2 = 1, upper sheet up to the rim; its origin is the inner focus
  <{-1 / b**2!r}, {-1 / b**2!r}, {1 / a**2!r}>, <0, 0, 0>, <0, 0, {2 * e / a**2!r}>, {b**2 / a**2!r}
  clipped_by {{ box {{ <{-wide!r}, {-wide!r}, {-e!r}>, <{wide!r}, {wide!r}, {rim_z!r}> }} }}
  pigment {{ rgb 0 }}
  finish {{ ambient 0 diffuse 0 emission 0 specular 0 phong 0 reflection {{ 1 }} }}
  matrix <{", ".join(map(repr, placed))}>
}}
{body if camera.body > 0 else "//"} // the camera's body, which hides what is behind it
sphere {{ {_vector(centre)}, {float(reach)!r} hollow pigment {{ rgb 0 }} no_reflection }} // black beside the mirror
"""


def _surface(geometry: Geometry) -> str:
    low, high = geometry.bounds
    # A little more than the scene, so that no position is 0 or 1.
    span = 1.02 * float((high - low).max())
    low = low - 0.01 * span
    coarse, fine = (
        " ".join(
            f"[1 function {{ ({axis} - ({start!r}))*{scale!r} }} color_map {{ [0 rgb 0] [1 rgb 3*{axis}] }}]"
            for axis, start in zip("xyz", low.tolist(), strict=True)
        )
        for scale in (1 / span, PERIODS / span)
    )
    return f"""\
// Red, green and blue are x, y and z of the point that is seen. With C the coarse value and F the fine one, 0 .. 1, a
// coordinate is low + span*(round({PERIODS}*C - F) + F)/{PERIODS}, low = {_vector(low)}, span = {span!r}.
#macro Surface(File)
  #switch (Shown)
    #case (0) texture {{ uv_mapping pigment {{ image_map {{ png File gamma 1 interpolate 2 }} }} }} #break
    #case (1) texture {{ pigment {{ average pigment_map {{ {coarse} }} }} }} #break
    #else texture {{ pigment {{ average pigment_map {{ {fine} }} }} }}
  #end
#end
"""


def _mesh(geometry: Geometry, texture: int, file: str) -> str:
    """One texture's triangles; the camera sees them in the mirror alone."""
    face = geometry.face_of_triangle[:-1]
    triangles = geometry.texture_of_face[face] == texture
    corners = geometry.corners[triangles]
    homogeneous = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], axis=-1)
    uv = np.einsum("tij,tkj->tki", geometry.uv_maps[face[triangles]], homogeneous)
    points, point_index = _listed(corners)
    uv_vectors, uv_index = _listed(uv)
    name = geometry.object_names[geometry.object_of_face[face[triangles][0]]]
    return f"""\
mesh2 {{ // {_comment(name)}
  vertex_vectors {{ {points} }}
  uv_vectors {{ {uv_vectors} }}
  face_indices {{ {point_index} }}
  uv_indices {{ {uv_index} }}
  Surface("{file}")
  no_image
}}
"""


def _listed(values: Array) -> tuple[str, str]:
    """The distinct vectors among `[triangles, 3, n]`, and the index of each, both as POV-Ray lists them."""
    distinct, index = np.unique(values.reshape(-1, values.shape[-1]), axis=0, return_inverse=True)
    vectors = ", ".join(map(_vector, distinct))
    indices = ", ".join(f"<{i}, {j}, {k}>" for i, j, k in index.reshape(-1, 3).tolist())
    return f"{len(distinct)}, {vectors}", f"{len(values)}, {indices}"


def _vector(values: NDArray[np.float64]) -> str:
    return f"<{', '.join(map(repr, values.tolist()))}>"


def _origin(geometry: Geometry, pose: Pose) -> Array:
    """The mirror's inner focus, from the geometry's centre."""
    return np.asarray(pose.position_m, dtype=np.float64) - geometry.centre


def _world_from_mirror(sensor: Sensor, pose: Pose) -> Array:
    return np.asarray(pose.R_world_from_view @ model_from_sensor(sensor).T)


def _camera_centre(geometry: Geometry, sensor: Sensor, pose: Pose) -> Array:
    camera = reflecting_camera(sensor)
    placed = _world_from_mirror(sensor, pose) @ [camera.c_x, camera.c_y, camera.c_z]
    return np.asarray(_origin(geometry, pose) + placed)
