"""Textures of surfaces, in grey levels 0 .. 255.

A texture is a tile that repeats; its texture coordinates (u, v) count repetitions, v upwards, and (0, 0) is the
lower left corner of the lower left texel. Between the texels' centres, at (i + 0.5)/n, the grey is bilinear.
Colours become luma, as in `harness.images`: matching is grey. Images in colour are rendered band by band.
"""

import math
from importlib import resources
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from harness.images import LIMIT_BYTES, LUMA, Weights, decode
from harness.simulation.content_cache import cached_by_content, read_recorded
from harness.spec import Positive, Spec

Texels = NDArray[np.float32]
Grey = Annotated[float, Field(ge=0, le=255)]


class ImageTexture(Spec):
    """An image file as a tile."""

    kind: Literal["image"]
    """A texture from an image file."""
    file: str
    """Path of the image, relative to the scene's file."""
    tile_m: Positive
    """Width of one tile on the surface, metres; its height follows from the image's shape."""
    white: Positive | None = None
    """Level in the file that is mapped to 255; by default the largest of 8 or 16 bits, and 1 in floating point."""

    def texels(self, weights: Weights = LUMA) -> Texels:
        """Grey, or another band, `[height, width]`, row 0 at the top."""
        return _read_image(self.file, self.white, weights)


class BundledTexture(Spec):
    """One of the photographs that come with scikit-image (public domain, 512 x 512)."""

    kind: Literal["bundled"]
    """A texture that comes with scikit-image."""
    name: Literal["brick", "grass", "gravel"]
    """The photograph's name."""
    tile_m: Positive
    """Width of one tile on the surface, metres."""

    def texels(self) -> Texels:
        """Grey `[height, width]`, row 0 at the top."""
        file = resources.files("skimage.data") / f"{self.name}.png"
        return decode(file.read_bytes(), f"{self.name}.png").grey()


class NoiseTexture(Spec):
    """Seeded noise with a spectrum that is flat between two wavelengths and zero elsewhere; it tiles seamlessly."""

    kind: Literal["noise"]
    """A texture of band-limited noise."""
    seed: Annotated[int, Field(ge=0)]
    """Seed of the noise."""
    tile_m: Positive
    """Width and height of one tile on the surface, metres."""
    shortest_m: Positive
    """Shortest wavelength, metres; at least two texels."""
    longest_m: Positive
    """Longest wavelength, metres; at most the tile."""
    mean: Grey = 128.0
    """Mean grey level, 0 .. 255."""
    contrast: Annotated[float, Field(gt=0, le=128)] = 40.0
    """Standard deviation in grey levels, before values outside 0 .. 255 are clipped."""
    size_px: Annotated[int, Field(ge=8, le=4096)] = 512
    """Texels along each side of the tile."""

    @model_validator(mode="after")
    def _band_fits(self) -> "NoiseTexture":
        nyquist = 2 * self.tile_m / self.size_px
        if not nyquist <= self.shortest_m < self.longest_m <= self.tile_m:
            raise ValueError(
                f"the wavelengths must satisfy {nyquist:g} (two texels) <= shortest_m < longest_m "
                f"<= {self.tile_m:g} (tile_m)"
            )
        if not self._has_a_wave():
            raise ValueError(
                f"no wavelength that repeats in tile_m = {self.tile_m:g} is between shortest_m = {self.shortest_m:g} "
                f"and longest_m = {self.longest_m:g}; widen the band"
            )
        return self

    def _has_a_wave(self) -> bool:
        """Whether the band contains a frequency: for each number of cycles along one side, the longest allowed wave."""
        i = np.arange(min(math.ceil(self.tile_m / self.shortest_m), self.size_px // 2) + 1.0)
        least = np.sqrt(np.maximum((self.tile_m / self.longest_m) ** 2 - i**2, 0))
        # The nearest whole numbers: rounding decides as it does in `texels`.
        j = np.ceil(least)[:, None] + [-1.0, 0.0, 1.0]
        per_metre = np.hypot(i[:, None], j) / self.tile_m
        within = (per_metre >= 1 / self.longest_m) & (per_metre <= 1 / self.shortest_m)
        return bool((within & (j >= 0) & (j <= self.size_px // 2)).any())

    def texels(self) -> Texels:
        """Grey `[size_px, size_px]`."""
        white = np.random.default_rng(self.seed).standard_normal((self.size_px, self.size_px))
        cycles = np.fft.fftfreq(self.size_px, 1 / self.size_px)
        per_metre = np.hypot(cycles[:, None], cycles[None, :]) / self.tile_m
        band = (per_metre >= 1 / self.longest_m) & (per_metre <= 1 / self.shortest_m)
        noise = np.fft.ifft2(np.fft.fft2(white) * band).real
        return np.clip(self.mean + self.contrast * noise / noise.std(), 0, 255).astype(np.float32)


class GreyTexture(Spec):
    """A uniform grey: a surface on which nothing can be matched."""

    kind: Literal["grey"]
    """One grey everywhere."""
    value: Grey
    """The grey level, 0 .. 255."""

    @property
    def tile_m(self) -> float:
        """Width of the tile, metres: any value, as the texture is uniform."""
        return 1.0

    def texels(self) -> Texels:
        """Grey `[1, 1]`."""
        return np.full((1, 1), self.value, dtype=np.float32)


class ChessboardTexture(Spec):
    """Dark and bright squares with a bright margin: one tile is the whole board."""

    columns: int
    """Inner corners along u."""
    rows: int
    """Inner corners along v."""
    square_m: Positive
    """Side of a square, metres."""
    margin_squares: int
    """Width of the margin, squares."""
    dark: Grey
    """Grey level of every other square."""
    bright: Grey
    """Grey level of the others, and of the margin."""

    @property
    def tile_m(self) -> float:
        """Width of the board."""
        return (self.columns + 1 + 2 * self.margin_squares) * self.square_m

    def texels(self) -> Texels:
        """Grey `[height, width]`. An edge lies between two texels, so that the grey there is the mean of both sides."""
        row, column = np.indices(((self.rows + 1) * _SQUARE_TEXELS, (self.columns + 1) * _SQUARE_TEXELS))
        squares = (row // _SQUARE_TEXELS + column // _SQUARE_TEXELS) % 2 == 0
        margin = self.margin_squares * _SQUARE_TEXELS
        return np.pad(np.where(squares, self.dark, self.bright), margin, constant_values=self.bright).astype(np.float32)


_SQUARE_TEXELS = 32
"""Texels along the side of a chessboard's square: its edges are blurred over one of them."""

Texture = Annotated[
    ImageTexture | BundledTexture | NoiseTexture | GreyTexture,
    Field(discriminator="kind"),
]


@cached_by_content(16)
def _read_image(file: str, white: float | None, weights: Weights) -> Texels:
    """A band of an image file; one array for all textures that use it."""
    return decode(read_recorded(file, LIMIT_BYTES, "image"), file, white=white).grey(weights=weights)


@cached_by_content(64)
def texels_of(
    texture: ImageTexture | BundledTexture | NoiseTexture | GreyTexture | ChessboardTexture, weights: Weights = LUMA
) -> Texels:
    """Grey levels `[height, width]` of a texture, row 0 at the top; read-only, cached until its file changes.

    Parameters
    ----------
    weights
        Of red, green and blue, for the levels of another band. All textures but images are grey.

    Raises
    ------
    InputError
        When an image file cannot be read.
    """
    texels = texture.texels(weights) if isinstance(texture, ImageTexture) else texture.texels()
    texels.flags.writeable = False
    return texels


def lookup(texels: Texels, uv: ArrayLike) -> NDArray[np.float64]:
    """Bilinear grey at texture coordinates `[..., 2]`, which wrap around.

    The reference implementation for the renderer's kernels.
    """
    height, width = texels.shape
    uv = np.asarray(uv, dtype=np.float64)
    column = uv[..., 0] * width - 0.5
    row = (1 - uv[..., 1]) * height - 0.5
    left, above = np.floor(column), np.floor(row)
    right_weight, below_weight = column - left, row - above
    i, j = left.astype(np.int64) % width, above.astype(np.int64) % height
    i_next, j_next = (i + 1) % width, (j + 1) % height
    upper = texels[j, i] * (1 - right_weight) + texels[j, i_next] * right_weight
    lower = texels[j_next, i] * (1 - right_weight) + texels[j_next, i_next] * right_weight
    return np.asarray(upper * (1 - below_weight) + lower * below_weight)
