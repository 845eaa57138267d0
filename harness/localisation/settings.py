"""Settings of a trial's test of localisation by appearance."""

from typing import Annotated

from pydantic import Field, model_validator

from harness.spec import Finite, Positive, Spec

Corner = tuple[Finite, Finite]
Even = Annotated[int, Field(ge=2, le=512, multiple_of=2)]


class Localisation(Spec):
    """Localisation by appearance: how far from the truth a new image is placed, against the number of real images.

    Real images are taken in pairs, the rig's, at random places of an area; more images are made of each pair by warping
    it with its ranges. New images stand anywhere in the area, turned by any yaw.
    """

    images: Annotated[tuple[Even, ...], Field(max_length=16)] = ()
    """Numbers of real images to learn from, even; none for no such test."""
    area_m: tuple[Corner, Corner] = ((-1.0, -1.0), (1.0, 1.0))
    """Opposite corners of the area, (x, y) in the world, metres; the heights are view 1's."""
    queries: Annotated[int, Field(ge=1, le=1000)] = 40
    """New images to place."""
    synthesised: Annotated[int, Field(ge=0, le=64)] = 6
    """Images that are made of each pair."""
    radius_m: Positive = 0.5
    """They stand within this distance of the middle of the pair, metres, where its ranges say that there is room."""
    width_px: Annotated[int, Field(ge=32, le=2048)] = 180
    """Columns of the panorama that images are described on."""
    components: Annotated[int, Field(ge=1, le=256)] = 20
    """Principal components of the PCA of panoramas."""
    words: Annotated[int, Field(ge=2, le=256)] = 16
    """Visual words of the VLAD descriptor."""

    @model_validator(mode="after")
    def _is_an_area(self) -> "Localisation":
        (a, b), (c, d) = self.area_m
        if a == c or b == d:
            raise ValueError("area_m must be opposite corners of an area; these are on one line")
        if len(set(self.images)) < len(self.images):
            raise ValueError("images: each number may occur only once")
        return self

    @property
    def most(self) -> int:
        """The largest number of images."""
        return max(self.images, default=0)
