"""The compiled projection of all camera models, selected by the type of the parameters.

Compiled code calls `project`, `move` and `rays`; numba replaces them by the model's own functions when it compiles. So
loops are written once, and compiled for each model.
"""

import math
from typing import Any, NamedTuple

from numba.extending import overload

from harness.compiled import kernel


class CompiledModel(NamedTuple):
    """The compiled functions of a camera model; `camera` is the named tuple of its parameters."""

    project: Any
    """`project(x, y, z, camera) -> u, v, inside`: the pixel of a direction of any length, and whether it is within the
    model's domain; outside, the pixel is undefined."""
    move: Any
    """`move(x, y, z, dx, dy, dz, camera) -> u, v, du, dv`: the pixel, and its derivative along (dx, dy, dz)."""
    rays: Any
    """`rays(u, v, camera, x, y, z)`: writes the direction, of any length, of each pixel's ray, `[n]`; NaN where there
    is none."""


_MODELS: dict[Any, CompiledModel] = {}


def add_compiled_model(parameters: Any, functions: CompiledModel) -> None:
    """Register the functions for parameters of this class."""
    _MODELS[parameters] = functions


def compiled_model(parameters: Any) -> CompiledModel:
    """The functions for parameters of this class."""
    return _MODELS[parameters]


def project(x, y, z, camera):
    """See `CompiledModel.project`. For compiled code."""
    return compiled_model(type(camera)).project(x, y, z, camera)


def move(x, y, z, dx, dy, dz, camera):
    """See `CompiledModel.move`. For compiled code."""
    return compiled_model(type(camera)).move(x, y, z, dx, dy, dz, camera)


def rays(u, v, camera, x, y, z):
    """See `CompiledModel.rays`. For compiled code."""
    compiled_model(type(camera)).rays(u, v, camera, x, y, z)


@overload(project)
def _project_of(x, y, z, camera):  # noqa: ARG001 - numba goes by their names
    of_model = compiled_model(camera.instance_class).project

    def chosen(x, y, z, camera):
        return of_model(x, y, z, camera)

    return chosen


@overload(move)
def _move_of(x, y, z, dx, dy, dz, camera):  # noqa: ARG001 - numba goes by their names
    of_model = compiled_model(camera.instance_class).move

    def chosen(x, y, z, dx, dy, dz, camera):
        return of_model(x, y, z, dx, dy, dz, camera)

    return chosen


@overload(rays)
def _rays_of(u, v, camera, x, y, z):  # noqa: ARG001 - numba goes by their names
    of_model = compiled_model(camera.instance_class).rays

    def chosen(u, v, camera, x, y, z):
        of_model(u, v, camera, x, y, z)

    return chosen


@kernel
def project_all(directions, camera, out):
    """Write the pixels `[n, 2]` of directions `[n, 3]`; NaN outside the model's domain."""
    for i in range(directions.shape[0]):
        u, v, inside = project(directions[i, 0], directions[i, 1], directions[i, 2], camera)
        out[i, 0], out[i, 1] = (u, v) if inside else (math.nan, math.nan)


@kernel
def differentiate_all(directions, camera, out):
    """Write the derivatives `[n, 2, 3]` of pixels by directions `[n, 3]`; NaN outside the model's domain."""
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        _, _, inside = project(x, y, z, camera)
        for axis in range(3):
            dx = 1.0 if axis == 0 else 0.0
            dy = 1.0 if axis == 1 else 0.0
            _, _, du, dv = move(x, y, z, dx, dy, 1.0 - dx - dy, camera)
            out[i, 0, axis], out[i, 1, axis] = (du, dv) if inside else (math.nan, math.nan)
