"""The camera models, one file each, and the table of them."""

from harness.camera.models.hyperboloid import Mirror
from harness.camera.models.model import CameraModel

MODELS: dict[str, type[CameraModel]] = {"hyperboloid": Mirror}
"""The settings of every camera model, by `kind`. A `sensor.model` without a `kind` is a hyperboloid."""

__all__ = ["MODELS", "CameraModel", "Mirror"]
