"""The parts of glTF 2.0's JSON that are read, and the parts that are rejected by name.

Property names are those of the specification; properties that are not listed are ignored, unless they are extensions.
"""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field

from harness.errors import InputError
from harness.files import printable
from harness.geometry.angles import Array
from harness.spec import Finite, Spec

_NO_DIFFERENCE = {
    "KHR_materials_unlit", "KHR_lights_punctual", "KHR_materials_ior", "KHR_materials_specular",
    "KHR_materials_clearcoat", "KHR_materials_sheen", "KHR_materials_anisotropy", "KHR_materials_iridescence",
    "KHR_materials_dispersion", "KHR_materials_emissive_strength", "KHR_materials_variants", "KHR_xmp_json_ld",
    "KHR_mesh_quantization", "KHR_animation_pointer", "EXT_lights_image_based",
}  # fmt: skip
"""Extensions that only affect shading, or offer alternatives to the default appearance."""
_APPLIED = {"KHR_texture_transform", "EXT_texture_webp"}

Index = Annotated[int, Field(ge=0, lt=2**31)]
Share = Annotated[float, Field(ge=0, le=1)]
Colour = tuple[Share, Share, Share]


class _Part(Spec):
    """Base of all parts: names that are not listed are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    extensions: dict[str, Any] = Field(default_factory=dict)


class Asset(_Part):
    """The `asset` property."""

    version: str


class Buffer(_Part):
    """A buffer."""

    uri: str | None = None
    byteLength: Index


class BufferView(_Part):
    """A part of a buffer."""

    buffer: Index
    byteOffset: Index = 0
    byteLength: Index
    byteStride: Annotated[int, Field(ge=4, le=252)] | None = None


class SparseIndices(_Part):
    """The indices of the elements that a sparse accessor replaces."""

    bufferView: Index
    byteOffset: Index = 0
    componentType: int


class SparseValues(_Part):
    """The values that replace them."""

    bufferView: Index
    byteOffset: Index = 0


class Sparse(_Part):
    """Elements of an accessor that differ from its buffer view."""

    count: Index
    indices: SparseIndices
    values: SparseValues


class Accessor(_Part):
    """A typed array."""

    bufferView: Index | None = None
    byteOffset: Index = 0
    componentType: int
    normalized: bool = False
    count: Index
    type: str
    sparse: Sparse | None = None


class Image(_Part):
    """An image, in a file or in a buffer view."""

    uri: str | None = None
    bufferView: Index | None = None


class Sampler(_Part):
    """Wrap modes and filters of a texture."""

    magFilter: int | None = None
    wrapS: int = 10497
    wrapT: int = 10497


class Texture(_Part):
    """An image with a sampler."""

    sampler: Index | None = None
    source: Index | None = None

    @property
    def webp(self) -> int | None:
        """The image of EXT_texture_webp."""
        source = _table(self.extensions.get("EXT_texture_webp")).get("source")
        return source if isinstance(source, int) and not isinstance(source, bool) else None


class TextureTransform(Spec):
    """KHR_texture_transform."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    offset: tuple[Finite, Finite] = (0.0, 0.0)
    rotation: Finite = 0.0
    scale: tuple[Finite, Finite] = (1.0, 1.0)
    texCoord: Index | None = None

    def applied(self, uv: Array) -> Array:
        """Texture coordinates `[n, 2]`, v down: scaled, then moved. A rotation is refused by the reader."""
        return np.asarray(uv * self.scale + self.offset)


class TextureInfo(_Part):
    """A texture as a material uses it."""

    class Extensions(Spec):
        """The extensions that are applied."""

        model_config = ConfigDict(frozen=True, extra="ignore")
        KHR_texture_transform: TextureTransform | None = None

    index: Index
    texCoord: Index = 0
    extensions: Extensions = Extensions()  # type: ignore[assignment]

    @property
    def transform(self) -> TextureTransform | None:
        """KHR_texture_transform, if it is used."""
        return self.extensions.KHR_texture_transform

    @property
    def set_used(self) -> int:
        """The number of the texture coordinates: n of TEXCOORD_n."""
        given = None if self.transform is None else self.transform.texCoord
        return self.texCoord if given is None else given


class BaseColour(_Part):
    """The properties of `pbrMetallicRoughness` that are used."""

    baseColorFactor: tuple[Share, Share, Share, Share] | None = None
    baseColorTexture: TextureInfo | None = None


class Material(_Part):
    """A material."""

    pbrMetallicRoughness: BaseColour | None = None
    emissiveFactor: tuple[Share, Share, Share] = (0.0, 0.0, 0.0)
    emissiveTexture: dict[str, Any] | None = None
    alphaMode: str = "OPAQUE"

    def refuse_what_shows(self, file: Path, key: str) -> None:
        """Check that a material has no emission and no transparency, which are not rendered.

        Raises
        ------
        InputError
            Names the key.
        """
        advice = "is not rendered; bake it into the base colour, or give the object a texture"
        if any(self.emissiveFactor):
            raise InputError(f"emitted light {advice}", file=file, key=f"{key}.emissiveFactor")
        if self.alphaMode != "OPAQUE":
            raise InputError(f"transparency ({printable(self.alphaMode)}) {advice}", file=file, key=f"{key}.alphaMode")


class Primitive(_Part):
    """Triangles of one material."""

    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: Annotated[int, Field(ge=0, le=6)] = 4


class Mesh(_Part):
    """A mesh."""

    primitives: tuple[Primitive, ...]
    weights: tuple[Finite, ...] | None = None


Four = tuple[Finite, Finite, Finite, Finite]


class Node(_Part):
    """A node of the scene's tree."""

    children: tuple[Index, ...] = ()
    mesh: Index | None = None
    skin: Index | None = None
    weights: tuple[Finite, ...] | None = None
    matrix: Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)] | None = None
    translation: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rotation: Four = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Finite, Finite, Finite] = (1.0, 1.0, 1.0)

    @property
    def transform(self) -> Array:
        """`[4, 4]`, from the node's frame into its parent's."""
        if self.matrix is not None:
            return np.array(self.matrix).reshape(4, 4).T  # by columns
        x, y, z, w = np.array(self.rotation) / (math.hypot(*self.rotation) or 1.0)
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        transform = np.eye(4)
        transform[:3, :3] = rotation * self.scale
        transform[:3, 3] = self.translation
        return transform


class SceneNodes(_Part):
    """The nodes of one of the file's scenes."""

    nodes: tuple[Index, ...] = ()


class Gltf(_Part):
    """A glTF file."""

    asset: Asset
    extensionsRequired: tuple[str, ...] = ()
    scene: Index | None = None
    scenes: tuple[SceneNodes, ...] = ()
    nodes: tuple[Node, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    accessors: tuple[Accessor, ...] = ()
    bufferViews: tuple[BufferView, ...] = ()
    buffers: tuple[Buffer, ...] = ()
    materials: tuple[Material, ...] = ()
    textures: tuple[Texture, ...] = ()
    images: tuple[Image, ...] = ()
    samplers: tuple[Sampler, ...] = ()

    def refuse_extensions(self, file: Path) -> None:
        """Check that there are no extensions that change the image and are not applied.

        An extension of the file itself, or one with a fallback, is ignored unless the file requires it.

        Raises
        ------
        InputError
            Names the extension and where it is.
        """
        for name in self.extensionsRequired:
            _refuse_unknown(name, file, "extensionsRequired")
        for kind in ("nodes", "meshes", "materials"):
            for index, part in enumerate(getattr(self, kind)):
                for name in part.extensions:
                    _refuse_unknown(name, file, f"{kind}[{index}].extensions")


def _refuse_unknown(name: str, file: Path, key: str) -> None:
    if name not in _NO_DIFFERENCE | _APPLIED:
        raise InputError(f"extension '{printable(name)}' is not supported; export without it", file=file, key=key)


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
