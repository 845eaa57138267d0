"""What a camera model is made of. Each is one file beside this one; `docs/adding-a-camera-model.md` says how."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from harness.camera.intrinsics import Camera, FieldEdge
from harness.camera.lens import Lens
from harness.camera.mount import Looks
from harness.spec import Spec


class CameraModel(Spec, ABC):
    """Base of the settings of camera models: central ones, in which all rays meet in one viewpoint."""

    title: ClassVar[str]
    """In captions: `hyperboloid mirror`."""
    unused: ClassVar[tuple[str, ...]] = ()
    """The keys of `camera` that the model has no use for."""
    has_lens: ClassVar[bool] = False
    """Whether the terms of `lens` bend what the model projects."""
    looks: ClassVar[Looks] = "up"
    """Where the optical axis points in the model's own frame."""
    mirrored: ClassVar[bool] = False
    """Whether the model's images are mirror images."""

    @abstractmethod
    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:
        """Refuse a field of view whose edge lies outside the model's domain.

        Raises
        ------
        ValueError
            Says which key is wrong and what would be right.
        """

    @abstractmethod
    def parameters(self, camera: Camera, lens: Lens) -> Any:
        """What the compiled functions are given: a named tuple of numbers, of a class of the model's own."""

    def goes_round(self, camera: Camera) -> bool:  # noqa: ARG002
        """Whether the image is periodic across its left and right borders, as a panorama of 360 degrees is."""
        return False

    def refuse_unused(self, camera: Camera, lens: Lens) -> None:
        """Refuse what has been set and would change nothing.

        A key that holds its default counts as not set: a sensor that is written out has all of them.

        Raises
        ------
        ValueError
            Names the key.
        """
        for key in self.unused:
            value = getattr(camera, key)
            if value != Camera.model_fields[key].default:
                raise ValueError(f"camera.{key} = {value:g} has no meaning for the {self.title}; leave it out")
        given = [key for key in Lens.model_fields if getattr(lens, key)]
        if given and not self.has_lens:
            raise ValueError(
                f"lens.{given[0]} = {getattr(lens, given[0]):g}: the {self.title} has no lens terms beside its own; "
                "leave it out"
            )
