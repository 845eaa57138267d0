"""How a camera is displaced and turned against its hyperboloid mirror.

The frame is the mirror's own (`harness.camera.models.hyperboloid`): x along u, y along v, z along the mirror's axis
from the camera to the mirror; the camera centre belongs at the outer focus F1 = (0, 0, -2e), looking along z.
"""

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from harness.geometry.angles import Array
from harness.spec import Spec

Millimetres = Annotated[float, Field(ge=-1000, le=1000)]
Degrees = Annotated[float, Field(ge=-90, le=90)]


class Misalignment(Spec):
    """Where the camera is and how it is turned against its hyperboloid mirror; zero for a perfect sensor.

    Unless all six are zero, the rays of the sensor have no viewpoint in common.
    """

    x_mm: Millimetres = 0.0
    """Camera centre beside the mirror's outer focus, along u, millimetres."""
    y_mm: Millimetres = 0.0
    """Camera centre beside the mirror's outer focus, along v, millimetres."""
    z_mm: Millimetres = 0.0
    """Camera centre beside the mirror's outer focus, along the mirror's axis, millimetres; towards the mirror is
    positive."""
    rotation_x_deg: Degrees = 0.0
    """Rotation of the camera about x, degrees; positive turns its optical axis against y. Applied first."""
    rotation_y_deg: Degrees = 0.0
    """Rotation of the camera about y, degrees; positive turns its optical axis towards x."""
    rotation_z_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Rotation of the camera about the mirror's axis, degrees; applied last. The mirror looks the same from all
    sides, so that it turns the image, and no more."""

    @property
    def is_zero(self) -> bool:
        """Whether camera and mirror are aligned."""
        return not any(getattr(self, name) for name in Misalignment.model_fields)

    @property
    def offset_m(self) -> Array:
        """`[3]`: the camera centre less the outer focus, in the mirror's frame, metres."""
        return np.array([self.x_mm, self.y_mm, self.z_mm]) / 1000

    @property
    def R_mirror_from_camera(self) -> Array:
        """`[3, 3]`, `R_z R_y R_x`: takes directions of the camera's frame, z along its axis, to the mirror's."""
        angles = [self.rotation_z_deg, self.rotation_y_deg, self.rotation_x_deg]
        return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())

    @property
    def rotation_axes(self) -> Array:
        """`[3, 3]`: the axes about which the camera turns when the rotation about x, y or z is changed a little.

        In the mirror's frame, a row each: `R_z R_y e_x`, `R_z e_y`, `e_z`.
        """
        R_z = Rotation.from_euler("z", self.rotation_z_deg, degrees=True)
        R_y = Rotation.from_euler("y", self.rotation_y_deg, degrees=True)
        return np.stack([(R_z * R_y).apply([1.0, 0, 0]), R_z.apply([0, 1.0, 0]), np.array([0, 0, 1.0])])
