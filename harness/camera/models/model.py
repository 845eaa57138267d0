"""The base class of camera models. Each has a file beside this one; see `docs/adding-a-camera-model.md`."""

import json
import math
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, ClassVar

from harness.camera.intrinsics import Camera, FieldEdge, FieldOfView
from harness.camera.lens import Lens
from harness.camera.mount import Looks, edge_of
from harness.errors import InputError
from harness.spec import LEFT_OUT, Spec, remember
from harness.third_party import identity_of


class CameraModel(Spec, ABC):
    """Base of the settings of central camera models, in which all rays meet in one viewpoint."""

    title: ClassVar[str]
    """The model's name in captions: `hyperboloid mirror`."""
    unused: ClassVar[tuple[str, ...]] = ()
    """The keys of `camera` that the model does not use."""
    has_lens: ClassVar[bool] = False
    """Whether the distortion terms of `lens` apply to the model."""
    looks: ClassVar[Looks] = "up"
    """Direction of the optical axis in the model's own frame."""
    mirrored: ClassVar[bool] = False
    """Whether the model's images are mirror images."""
    elevations_deg: ClassVar[tuple[float, float]] = (-75.0, 20.0)
    """Default lowest and highest elevation of the field of view."""

    @abstractmethod
    def check(self, camera: Camera, lens: Lens, edge: FieldEdge) -> None:
        """Check that the edge of a field of view lies within the model's domain.

        Raises
        ------
        ValueError
            Names the key and what would be right.
        """

    @abstractmethod
    def parameters(self, camera: Camera, lens: Lens) -> Any:
        """The argument of the compiled functions: a named tuple of numbers, of a class that belongs to the model."""

    def identity(self) -> str:
        """SHA-256 of the source of a third-party model, which its settings do not identify; empty for a model of this
        program.

        Raises
        ------
        InputError
            When its source cannot be read, or has changed since this process has loaded it.
        """
        is_own = type(self).__module__.partition(".")[0] == __name__.partition(".")[0]
        return "" if is_own else identity_of(type(self))

    @classmethod
    def __pydantic_init_subclass__(cls, **keywords: Any) -> None:
        """Record the source files of a third-party model's module as they are when the class is defined."""
        super().__pydantic_init_subclass__(**keywords)
        if cls.__module__.partition(".")[0] != __name__.partition(".")[0]:
            with suppress(InputError):  # `identity` reports it
                identity_of(cls)

    def largest_angle_rad(self, camera: Camera, lens: Lens) -> float:  # noqa: ARG002
        """The largest angle off the optical axis of a field of view without a limit of its own, radians."""
        return math.pi

    def filled_in(self, field: FieldOfView, camera: Camera, lens: Lens, looks: Looks) -> FieldOfView:
        """A field of view whose missing limits are filled in.

        They are the model's own elevations and, if neither an elevation nor an angle limits the field away from the
        optical axis, the angle at which the model's domain ends.

        Raises
        ------
        ValueError
            When the lowest elevation is not below the highest, or that angle depends on a focal length to be fitted.
        """
        keys = [key for key in FieldOfView.model_fields if key not in field.model_fields_set]
        if not keys:
            return field
        limits = field.model_dump() | {
            key: value
            for key, value in zip(("elevation_min_deg", "elevation_max_deg"), self.elevations_deg, strict=True)
            if key in keys
        }
        if not limits["elevation_min_deg"] < limits["elevation_max_deg"]:
            raise ValueError(
                f"field: elevation_min_deg must be below elevation_max_deg; found {limits['elevation_min_deg']:g} and "
                f"{limits['elevation_max_deg']:g}"
            )
        filled = FieldOfView(**limits)
        edge = edge_of(filled, looks)
        if "angle_max_deg" in keys and (edge.key in keys or edge.key == "angle_max_deg"):
            if camera.is_open and type(self).largest_angle_rad is not CameraModel.largest_angle_rad:
                raise ValueError('camera.focal_px = "fit" fits the field of view: give field.angle_max_deg')
            largest = math.degrees(self.largest_angle_rad(camera, lens))
            if largest < edge.angle_deg:
                filled = FieldOfView(**limits | {"angle_max_deg": math.floor(largest * 100) / 100})
        return remember(filled, dict.fromkeys(keys, LEFT_OUT))

    def goes_round(self, camera: Camera) -> bool:  # noqa: ARG002
        """Whether the image is periodic across its left and right borders, as a panorama of 360 degrees is."""
        return False

    def refuse_unused(self, camera: Camera, lens: Lens) -> None:
        """Check that no key is set that the model does not use.

        A key at its default counts as not set, as a sensor that is written to a file has all of them.

        Raises
        ------
        ValueError
            Names the key.
        """
        for key in self.unused:
            value = getattr(camera, key)
            if value != Camera.model_fields[key].default:
                shown = json.dumps(value) if isinstance(value, str) else f"{value:g}"
                raise ValueError(f"camera.{key} = {shown} has no meaning for the {self.title}; leave it out")
        given = [key for key in Lens.model_fields if getattr(lens, key)]
        if given and not self.has_lens:
            raise ValueError(
                f"lens.{given[0]} = {getattr(lens, given[0]):g}: the {self.title} has no lens terms besides its own; "
                "leave it out"
            )
