"""The field of view in the form that compiled loops take."""

from typing import NamedTuple

from harness.compiled import kernel


class FieldLimits(NamedTuple):
    """Limits of a sensor's field of view, for directions in its frame."""

    lowest: float
    """Sine of the lowest elevation; -2 where there is no limit."""
    highest: float
    """Sine of the highest elevation; 2 where there is no limit."""
    nearest: float
    """Cosine of the largest angle off the optical axis; -2 where there is no limit."""
    up_x: float
    """The direction from which elevations are measured: the z axis of the sensor before it is tilted."""
    up_y: float
    up_z: float
    axis_x: float
    """The optical axis."""
    axis_y: float
    axis_z: float


@kernel(inline=True)
def along_up(x, y, z, field):
    """The sine of a direction's elevation, times its length."""
    return field.up_x * x + field.up_y * y + field.up_z * z


@kernel(inline=True)
def along_axis(x, y, z, field):
    """The cosine of a direction's angle off the optical axis, times its length."""
    return field.axis_x * x + field.axis_y * y + field.axis_z * z
