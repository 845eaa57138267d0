"""Random textures and curved bodies of a scene, in grey or in colour, with the files that they need."""

import hashlib
import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import fft

from harness.datasets.specification import Surfaces, number_between
from harness.geometry.angles import Array
from harness.images import LUMA
from harness.simulation.texture import BundledTexture

_TEXEL_M = 4.0 / 512
"""Size of a texel of noise, metres: the shortest wave that it can hold is twice as long."""
_LARGE_PX, _SMALL_PX = 512, 256
"""Texels along a tile on the room itself, and on what stands in it."""
_PATTERN_PX = 64
_SHARPNESS = 4.0
"""Steepness of a pattern's edges: they are blurred over a few texels, so that they do not alias."""
_AROUND, _ALONG = 24, 16
"""Quadrilaterals of a body of revolution, around its axis and along it."""


@dataclass
class Painter:
    """Draws the surfaces of one scene."""

    draws: np.random.Generator
    surfaces: Surfaces
    colour: bool
    files: dict[str, bytes] = field(default_factory=dict)
    """Contents, by name, of the files that the scene refers to."""

    def texture(self, *, small: bool = True, plain: bool = False) -> dict[str, Any]:
        """A texture's table, as of a scene's file.

        Parameters
        ----------
        small
            Whether it is for something smaller than the room, and need not reach so far before it repeats itself.
        plain
            Whether it has to be without any texture.
        """
        weights = np.array([getattr(self.surfaces, name) for name in ("noise", "photograph", "repetitive")])
        weights = np.append(weights, self.surfaces.textureless)
        kind = 3 if plain else int(self.draws.choice(4, p=weights / weights.sum()))
        if kind == 0:
            return self._noise(_SMALL_PX if small else _LARGE_PX)
        if kind == 1:
            return self._photograph(small=small)
        return self._repetitive() if kind == 2 else self._textureless()

    def _noise(self, size_px: int) -> dict[str, Any]:
        tile_m = size_px * _TEXEL_M
        shortest = max(self._between(self.surfaces.shortest_m), 2 * _TEXEL_M)
        longest = min(shortest * float(self.draws.uniform(8, 40)), tile_m)
        unit = _band_noise(self.draws, size_px, tile_m / longest, tile_m / shortest)
        return self._image(self.draws.uniform(90, 160) + self._between(self.surfaces.contrast) * unit, tile_m)

    def _photograph(self, *, small: bool) -> dict[str, Any]:
        name = ("brick", "grass", "gravel")[int(self.draws.integers(3))]
        tile_m = float(self.draws.uniform(1.5, 6.0))
        table = {"kind": "bundled", "name": name, "tile_m": tile_m}
        if not self.colour:
            return table
        grey = BundledTexture.model_validate(table).texels()
        if small:  # half as fine
            grey = grey.reshape(grey.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3))
        return self._tinted(grey, tile_m)

    def _repetitive(self) -> dict[str, Any]:
        across, down = (np.indices((_PATTERN_PX, _PATTERN_PX)) + 0.5) * (2 * np.pi / _PATTERN_PX)
        wave = (np.sin(across), np.sin(down), np.sin(across) * np.sin(down))[int(self.draws.integers(3))]
        middle, half = self.draws.uniform(100, 150), self.draws.uniform(20, 90)
        grey = middle + half * np.tanh(_SHARPNESS * wave)
        return self._image(np.asarray(grey), self._between(self.surfaces.period_m))

    def _textureless(self) -> dict[str, Any]:
        value = float(self.draws.uniform(30, 230))
        return self._image(np.full((2, 2), value), 1.0) if self.colour else {"kind": "grey", "value": value}

    def _image(self, grey: NDArray[np.floating], tile_m: float) -> dict[str, Any]:
        return self._tinted(grey, tile_m) if self.colour else self._kept(grey, tile_m)

    def _tinted(self, grey: NDArray[np.floating], tile_m: float) -> dict[str, Any]:
        """An image in a random colour whose luma is the grey, except for clipped pixels."""
        tint = self.draws.uniform(0.4, 1.0, 3)
        return self._kept(grey[..., None] * (tint / float(tint @ np.array(LUMA))), tile_m)

    def _kept(self, levels: NDArray[np.floating], tile_m: float) -> dict[str, Any]:
        stream = io.BytesIO()
        eight_bits = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        Image.fromarray(eight_bits).save(stream, format="PNG", compress_level=1)
        return {"kind": "image", "file": self.keep(stream.getvalue(), ".png"), "tile_m": tile_m}

    def keep(self, content: bytes, ending: str) -> str:
        """The name of a file with this content, which is kept."""
        name = f"{hashlib.sha256(content).hexdigest()[:16]}{ending}"
        self.files[name] = content
        return name

    def body(self, height_m: float) -> tuple[str, float]:
        """A curved body that stands on the floor: the name of its mesh file, and its largest radius, metres."""
        h = np.linspace(0.0, 1.0, _ALONG + 1)
        if self.draws.random() < 0.3:  # a ball, or an egg
            height_m *= 0.6
            radius = height_m * float(self.draws.uniform(0.35, 0.5)) * np.sin(np.pi * np.clip(h, 0.02, 0.98))
            h = 0.5 - 0.5 * np.cos(np.pi * h)
        else:
            a, b = self.draws.uniform(0.1, 0.4, 2)
            phase_a, phase_b = self.draws.uniform(0, 2 * np.pi, 2)
            waves = 1 + a * np.sin(2 * np.pi * h + phase_a) + 0.5 * b * np.sin(4 * np.pi * h + phase_b)
            radius = height_m * float(self.draws.uniform(0.12, 0.3)) * waves
        return self.keep(revolution(radius, h * height_m), ".ply"), float(radius.max())

    def _between(self, low_high: tuple[float, float]) -> float:
        return float(number_between(low_high, self.draws.random()))


def _band_noise(draws: np.random.Generator, size_px: int, fewest: float, most: float) -> NDArray[np.floating]:
    """Noise `[px, px]` of unit variance that tiles, its spectrum flat between two numbers of cycles to the tile."""
    cycles = np.hypot(fft.fftfreq(size_px, 1 / size_px)[:, None], fft.rfftfreq(size_px, 1 / size_px))
    spectrum = draws.standard_normal((*cycles.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    noise = fft.irfft2(spectrum * ((cycles >= fewest) & (cycles <= most)))
    return np.asarray(noise / noise.std())


def revolution(radius_m: Array, height_m: Array) -> bytes:
    """The surface of revolution about z of a profile `[n]`, closed at both ends, as a PLY file."""
    rings = len(radius_m)
    phi = np.arange(_AROUND) * (2 * np.pi / _AROUND)
    around = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    side = np.empty((rings, _AROUND, 3))
    side[..., :2] = radius_m[:, None, None] * around
    side[..., 2] = height_m[:, None]
    vertices = np.concatenate([side.reshape(-1, 3), [[0.0, 0.0, height_m[0]], [0.0, 0.0, height_m[-1]]]])
    i, j = (each.ravel() for each in np.indices((rings - 1, _AROUND)))
    a, b = i * _AROUND + j, i * _AROUND + (j + 1) % _AROUND
    low, high = rings * _AROUND, rings * _AROUND + 1
    j = np.arange(_AROUND)
    after = (j + 1) % _AROUND
    last = (rings - 1) * _AROUND
    triangles = np.concatenate(
        [
            np.stack([a, b, b + _AROUND], axis=-1),
            np.stack([a, b + _AROUND, a + _AROUND], axis=-1),
            np.stack([np.full_like(j, low), after, j], axis=-1),
            np.stack([np.full_like(j, high), last + j, last + after], axis=-1),
        ]
    )
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, triangles
    return header.encode() + vertices.astype("<f8").tobytes() + faces.tobytes()
