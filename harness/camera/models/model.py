"""What a camera model is made of. Each is one file beside this one; `docs/adding-a-camera-model.md` says how."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.spec import Spec


class CameraModel(Spec, ABC):
    """Base of the settings of camera models: central ones, in which all rays meet in one viewpoint."""

    title: ClassVar[str]
    """In captions: `hyperboloid mirror`."""

    @abstractmethod
    def check(self, camera: Camera, lens: Lens, field: FieldOfView) -> None:
        """Refuse a field that lies outside the model's domain.

        Raises
        ------
        ValueError
            Says which key is wrong and what would be right.
        """

    @abstractmethod
    def parameters(self, camera: Camera, lens: Lens) -> Any:
        """What the compiled functions are given: a named tuple of numbers, of a class of the model's own."""
