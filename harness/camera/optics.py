"""A camera model with its image and lens, without mount and field, as a calibration file describes it.

Directions are in the lens's own frame: X along u, Y along v, Z along the optical axis into the scene. A mirror's frame
looks the other way, (X, Y, Z) = (x, y, -z); see `harness.camera.conversions`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from harness.camera._projection_kernels import compiled_model, differentiate_all, project_all
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import CameraModel
from harness.camera.mount import camera_from_sensor
from harness.camera.sensor import Sensor, require_central
from harness.display import OneLine
from harness.geometry.angles import Array


@dataclass(frozen=True, repr=False)
class Optics(OneLine):
    """A camera model with its image and lens: the map from directions to pixels."""

    model: CameraModel
    camera: Camera
    lens: Lens

    @property
    def _lens_from_own(self) -> Array:
        """`[3, 3]`: turns directions of the model's own frame, a sensor's in its default mount, into the lens's."""
        return camera_from_sensor(self.model.looks, mirrored=self.model.mirrored)

    def project(self, directions: ArrayLike) -> Array:
        """Pixels `[n, 2]` of directions `[n, 3]` of any length; NaN outside the model's domain."""
        own = self._own(directions)
        out = np.empty((len(own), 2))
        project_all(own, self.model.parameters(self.camera, self.lens), out)
        return out

    def jacobian(self, directions: ArrayLike) -> Array:
        """Derivatives `[n, 2, 3]` of the pixels by the directions; NaN outside the model's domain."""
        own = self._own(directions)
        out = np.empty((len(own), 2, 3))
        differentiate_all(own, self.model.parameters(self.camera, self.lens), out)
        return out @ self._lens_from_own.T

    def unproject(self, pixels: ArrayLike) -> Array:
        """Unit directions `[n, 3]` of pixels `[n, 2]`; NaN outside the model's domain."""
        pixels = np.asarray(pixels, dtype=np.float64)
        u, v = (np.ascontiguousarray(pixels[:, i]) for i in (0, 1))
        rays = np.empty((3, len(pixels)))
        parameters = self.model.parameters(self.camera, self.lens)
        compiled_model(type(parameters)).rays(u, v, parameters, rays[0], rays[1], rays[2])
        with np.errstate(invalid="ignore"):
            rays = self._lens_from_own @ (rays / np.sqrt(np.sum(rays * rays, axis=0)))
        return np.ascontiguousarray(rays.T)

    def _own(self, directions: ArrayLike) -> Array:
        return np.ascontiguousarray(np.asarray(directions, dtype=np.float64) @ self._lens_from_own)

    def largest_angle_on_image(self) -> float:
        """The largest angle off the optical axis of any point of the image, its corners included, radians."""
        edge = edge_pixels(self.camera)
        z = self.unproject(edge)[:, 2]
        # Where a pixel has no direction, the image circle ends inside the frame.
        return math.pi if np.isnan(z).any() else float(np.arccos(np.clip(z.min(), -1, 1)))


def optics_of(sensor: Sensor) -> Optics:
    """A sensor's optics; a sensor whose camera and mirror are misaligned has none, and is refused as such."""
    require_central(sensor)
    return Optics(sensor.model, sensor.camera, sensor.lens)


def edge_pixels(camera: Camera, spacing_px: float = 4.0) -> Array:
    """Points `[n, 2]` along the border of the image, half a pixel outside the outermost pixel centres."""
    u = np.linspace(-0.5, camera.width_px - 0.5, max(3, round(camera.width_px / spacing_px)))
    v = np.linspace(-0.5, camera.height_px - 0.5, max(3, round(camera.height_px / spacing_px)))
    sides = [(u, np.full_like(u, v[0])), (np.full_like(v, u[-1]), v), (u[::-1], np.full_like(u, v[-1]))]
    sides.append((np.full_like(v, u[0]), v[::-1]))
    return np.concatenate([np.stack(side, axis=-1) for side in sides])
