"""The specification of a rig: sensor and baseline, noise and texture, and the uncertainty of all parameters."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from harness.camera.sensor import Sensor
from harness.evaluation.propagation import Rig
from harness.evaluation.rig_uncertainty import Uncertainty
from harness.geometry.pose import Motion
from harness.runs.named_files import read_in
from harness.simulation.chip import Chip
from harness.simulation.texture import BundledTexture, Texture
from harness.spec import Finite, Positive, Spec, parse
from harness.toml import read_toml


class RigDesign(Spec):
    """A rig of one sensor in two places."""

    name: str = ""
    """The rig's name."""
    sensor: Sensor = Sensor()
    """The sensor of both views: a table, or the path of a TOML file."""
    baseline_m: Positive = 0.5
    """Distance between the viewpoints, metres."""
    azimuth_deg: Finite = 0.0
    """Direction of the baseline in view 1's frame: azimuth from x towards y, degrees."""
    elevation_deg: Finite = 0.0
    """Direction of the baseline in view 1's frame: elevation, degrees."""
    turn_deg: Finite = 0.0
    """View 2's turn about z between the views, degrees: what `uncertainty.odometry.rotation_per_turn` is a share of."""
    noise_grey: Annotated[float, Field(ge=0, le=255)] = 2.0
    """White noise of the images, grey levels of 0 .. 255."""
    chip: Chip = Chip()
    """The image sensor, whose noise comes on top; taken at a grey level of 110."""
    texture: Texture = BundledTexture(kind="bundled", name="gravel", tile_m=6.0)
    """The texture of surfaces."""
    window_px: Annotated[int, Field(ge=3, le=101)] = 17
    """Side of the matcher's window, pixels of mirror image 1."""
    fixed_error_px: Annotated[float, Field(ge=0, le=10)] = 0.002
    """The matcher's error without noise, standard deviation, pixels of the image: of aliasing, and of surfaces that
    are not as the matcher takes them to be. `slanted` has 0.003 to 0.016 in the shipped scenes."""
    uncertainty: Uncertainty = Uncertainty()
    """The uncertainty of the rig's parameters."""

    @model_validator(mode="after")
    def _has_a_mirror_to_align(self) -> "RigDesign":
        if self.sensor.profile is not None:
            raise ValueError("sensor.profile: a design needs a camera with a viewpoint; see omnirange sensor --central")
        if not self.sensor.is_central:
            raise ValueError("sensor.misalignment: give its uncertainty, as uncertainty.alignment_mm and _deg")
        if (self.uncertainty.alignment_mm or self.uncertainty.alignment_deg) and not self.has_mirror:
            raise ValueError("uncertainty.alignment_mm and _deg are for sensors with a hyperboloid mirror")
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px must be odd; found {self.window_px}")
        return self

    @property
    def has_mirror(self) -> bool:
        """Whether camera and mirror can be misaligned."""
        from harness.camera.models.hyperboloid import Mirror

        return isinstance(self.sensor.model, Mirror)

    @property
    def title(self) -> str:
        """The rig's name, or else its image size and baseline."""
        camera = self.sensor.camera
        return self.name or f"{camera.width_px} x {camera.height_px} px, {self.baseline_m:g} m"

    @property
    def believed(self) -> Rig:
        """The rig itself, view 2 turned about z."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        t_hat = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        R_v1_from_v2 = Rotation.from_euler("z", self.turn_deg, degrees=True).as_matrix() if self.turn_deg else np.eye(3)
        return Rig((self.sensor, self.sensor), Motion(R_v1_from_v2.T, self.baseline_m * np.array(t_hat)))


def load_rig(file: Path) -> RigDesign:
    """Read a rig from a TOML file; paths in it are relative to the file.

    Raises
    ------
    InputError
        When the file cannot be read or is wrong; names the file, the key and what would be right.
    """
    return parse(RigDesign, rig_table(read_toml(file), file), file=file)


def rig_table(table: dict[str, Any], file: Path) -> dict[str, Any]:
    """A rig's table with the sensor's file read in."""
    return read_in(table, file.parent, file, "")
