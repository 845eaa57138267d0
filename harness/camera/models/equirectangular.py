"""The equirectangular panorama, longitude and latitude, as spherical cameras and stitching programs write it.

Its axis runs from pole to pole, not into the scene: in the sensor's frame (x forward, y left, z up) the panorama stands
upright and is seen from inside, so that u grows to the right, clockwise seen from above, and v down:

    u = cx - f atan2(y, x),      v = cy - f aspect atan2(z, hypot(x, y)),

f being pixels per radian: an image of 360 degrees has f = width/(2 pi). +x is at cx. u is taken modulo one turn to lie
on the image, whose middle is (width - 1)/2; an image of 360 degrees is periodic in azimuth.

Domain: all but the two poles, whose longitude is undefined.
"""

import math
from typing import ClassVar, Literal, NamedTuple

from harness.camera._projection_kernels import CompiledModel, add_compiled_model
from harness.camera.intrinsics import Camera, FieldEdge
from harness.camera.lens import Lens
from harness.camera.models.model import CameraModel
from harness.camera.mount import Looks
from harness.compiled import kernel

_SLACK_PX = 0.01
"""Tolerance, pixels, for an image to miss a whole turn or to reach beyond a pole: a focal length's rounded digits."""


class Equirectangular(CameraModel):
    """A panorama in longitude and latitude."""

    title: ClassVar[str] = "equirectangular camera"
    looks: ClassVar[Looks] = "forward"
    elevations_deg: ClassVar[tuple[float, float]] = (-90.0, 90.0)
    unused: ClassVar[tuple[str, ...]] = ("skew_px",)

    kind: Literal["equirectangular"] = "equirectangular"
    """A panorama in longitude and latitude."""

    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:  # noqa: ARG002
        """Check that no unused key is set, and that the image spans at most one turn and ends at the poles."""
        self.refuse_unused(camera, lens)
        if camera.width_px > 2 * math.pi * camera.focal_px + _SLACK_PX:
            raise ValueError(
                f"camera.focal_px = {camera.focal_px:g}: {camera.width_px} pixels span "
                f"{math.degrees(camera.width_px / camera.focal_px):.2f} deg, more than one turn; focal_px is pixels "
                f"per radian, {camera.width_px / (2 * math.pi):.9g} for 360 deg"
            )
        quarter = camera.focal_px * camera.aspect * math.pi / 2
        for pole, rows in (("upper", camera.cy_px + 0.5), ("lower", camera.height_px - 0.5 - camera.cy_px)):
            if rows > quarter + _SLACK_PX:
                raise ValueError(
                    f"camera.cy_px = {camera.cy_px:g}: the image extends {rows - quarter:.2f} rows beyond the {pole} "
                    f"pole, which is {quarter:.2f} from cy_px; with this focal_px and aspect an image from pole to "
                    f"pole has {2 * quarter:.2f} rows"
                )

    def goes_round(self, camera: Camera) -> bool:
        """Whether the image spans 360 degrees."""
        return abs(camera.width_px - 2 * math.pi * camera.focal_px) <= _SLACK_PX

    def parameters(self, camera: Camera, lens: Lens) -> "EquirectangularCamera":  # noqa: ARG002
        """The model's parameters as the compiled functions take them."""
        turn = 2 * math.pi * camera.focal_px
        first = 0.5 * (camera.width_px - 1 - turn)
        whole = self.goes_round(camera)
        return EquirectangularCamera(
            fu=camera.focal_px,
            fv=camera.focal_px * camera.aspect,
            cu=camera.cx_px,
            cv=camera.cy_px,
            turn=turn,
            first=first,
            least=-0.5 if whole else first,
            most=camera.width_px - 0.5 if whole else first + turn,
            highest=math.pi / 2 + 2 * _SLACK_PX / (camera.focal_px * camera.aspect),
        )


class EquirectangularCamera(NamedTuple):
    """Camera as numbers, in pixels and pixels per radian."""

    fu: float
    fv: float
    cu: float
    cv: float
    turn: float
    """Pixels to 360 degrees."""
    first: float
    """The u at which the full turn begins of which the image is a part."""
    least: float
    most: float
    """The bounds of u, so that a direction on the seam is not rounded off the image."""
    highest: float
    """Latitude beyond which a pixel sees nothing, radians."""


@kernel
def _project(x, y, z, camera):
    rho = math.sqrt(x * x + y * y)
    u = camera.cu - camera.fu * math.atan2(y, x)
    u -= camera.turn * math.floor((u - camera.first) / camera.turn)
    return min(max(u, camera.least), camera.most), camera.cv - camera.fv * math.atan2(z, rho), rho > 0.0


@kernel
def _move(x, y, z, dx, dy, dz, camera):
    u, v, _ = _project(x, y, z, camera)
    rho2 = x * x + y * y
    rho = math.sqrt(rho2)
    rho_d = (x * dx + y * dy) / rho
    return (
        u,
        v,
        -camera.fu * (x * dy - y * dx) / rho2,
        -camera.fv * (rho * dz - z * rho_d) / (rho2 + z * z),
    )


@kernel
def _rays(u, v, camera, x_out, y_out, z_out):
    for i in range(u.size):
        longitude = (camera.cu - u[i]) / camera.fu
        latitude = (camera.cv - v[i]) / camera.fv
        across = math.cos(latitude) if abs(latitude) <= camera.highest else math.nan
        x_out[i] = across * math.cos(longitude)
        y_out[i] = across * math.sin(longitude)
        z_out[i] = math.sin(latitude)


add_compiled_model(EquirectangularCamera, CompiledModel(_project, _move, _rays))
