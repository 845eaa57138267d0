"""The compiled projection of a camera in another mount than its model's default: rotate, then project."""

from typing import Any, NamedTuple

from harness.camera._projection_kernels import CompiledModel, add_compiled_model, move, project, rays
from harness.compiled import kernel


class MountedCamera(NamedTuple):
    """A camera model's parameters, and the matrix that turns directions of the sensor's frame into the model's."""

    xx: float
    """First row of the matrix: the model's x axis in the sensor's frame."""
    xy: float
    xz: float
    yx: float
    yy: float
    yz: float
    zx: float
    zy: float
    zz: float
    model: Any
    """The named tuple of the model's parameters."""


@kernel(inline=True)
def _turned(x, y, z, camera):
    return (
        camera.xx * x + camera.xy * y + camera.xz * z,
        camera.yx * x + camera.yy * y + camera.yz * z,
        camera.zx * x + camera.zy * y + camera.zz * z,
    )


@kernel
def _project(x, y, z, camera):
    x, y, z = _turned(x, y, z, camera)
    return project(x, y, z, camera.model)


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    x, y, z = _turned(x, y, z, camera)
    dx, dy, dz = _turned(dx, dy, dz, camera)
    return move(x, y, z, dx, dy, dz, camera.model)


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    rays(u, v, camera.model, x_out, y_out, z_out)
    for i in range(u.size):
        x, y, z = x_out[i], y_out[i], z_out[i]
        x_out[i] = camera.xx * x + camera.yx * y + camera.zx * z
        y_out[i] = camera.xy * x + camera.yy * y + camera.zy * z
        z_out[i] = camera.xz * x + camera.yz * y + camera.zz * z


add_compiled_model(MountedCamera, CompiledModel(_project, _move, _rays))
