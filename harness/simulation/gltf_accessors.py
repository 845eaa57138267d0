"""Arrays in a glTF file: buffers, views of them, and accessors with types, strides and sparse elements."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.errors import InputError
from harness.geometry.angles import Array
from harness.simulation.gltf_schema import Accessor, Gltf, Sparse

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_LIMIT_ELEMENTS = 2**26
"""Most elements of an accessor: one without a buffer view is all zeros, of any declared count."""


class Accessors:
    """Reader of accessors.

    Parameters
    ----------
    load
        Returns the contents of a buffer that has a URI, by its index.
    binary
        The binary chunk of a GLB, which is the first buffer when that has no URI.
    """

    def __init__(self, file: Path, gltf: Gltf, load: Callable[[int], bytes], binary: bytes | None) -> None:
        self._file, self._gltf, self._load, self._binary = file, gltf, load, binary
        self._buffers: dict[int, bytes] = {}

    def read(self, index: int, kinds: tuple[str, ...], *, normalised: bool = False, whole: bool = False) -> Array:
        """Elements `[count, components]` as float64; integers marked as normalised are scaled to 0 .. 1 or -1 .. 1.

        Parameters
        ----------
        kinds
            The allowed types.
        normalised
            Whether integers must be marked as normalised.
        whole
            Whether only integers are allowed.

        Raises
        ------
        InputError
            When the accessor, its view or its buffer is missing or of another type.
        """
        key = f"accessors[{index}]"
        if not 0 <= index < len(self._gltf.accessors):
            raise InputError(f"there is no {key}; repair the mesh", file=self._file)
        accessor = self._gltf.accessors[index]
        component = _COMPONENTS.get(accessor.componentType)
        if component is None or accessor.type not in kinds:
            raise InputError(f"must be of type {' or '.join(kinds)}", file=self._file, key=key)
        is_float = component == "<f4"
        if (whole and is_float) or (normalised and not is_float and not accessor.normalized):
            right = "whole numbers" if whole else "floating point, or whole numbers that are normalized"
            raise InputError(f"must contain {right}", file=self._file, key=key)
        values = self._elements(accessor, component, _SIZES[accessor.type], key)
        if accessor.sparse is not None:
            values = self._replaced(values, accessor.sparse, component, key)
        result = values.astype(np.float64)
        if accessor.normalized and not is_float:
            result = np.maximum(result / np.iinfo(component).max, -1.0)
        return result

    def view(self, index: int, key: str) -> bytes:
        """The bytes of a buffer view."""
        if not 0 <= index < len(self._gltf.bufferViews):
            raise InputError(f"there is no bufferViews[{index}]; repair the mesh", file=self._file, key=key)
        view = self._gltf.bufferViews[index]
        data = self._buffer(view.buffer, f"bufferViews[{index}]")[view.byteOffset : view.byteOffset + view.byteLength]
        if len(data) < view.byteLength:
            raise InputError("is longer than its buffer", file=self._file, key=f"bufferViews[{index}]")
        return data

    def _buffer(self, index: int, key: str) -> bytes:
        buffers = self._gltf.buffers
        if not 0 <= index < len(buffers):
            raise InputError(f"there is no buffers[{index}]; repair the mesh", file=self._file, key=key)
        if index not in self._buffers:
            inside = index == 0 and buffers[0].uri is None and self._binary is not None
            data = self._binary if inside else self._load(index)
            assert data is not None
            self._buffers[index] = data[: buffers[index].byteLength]
        return self._buffers[index]

    def _elements(self, accessor: Accessor, component: str, size: int, key: str) -> NDArray[Any]:
        if accessor.bufferView is None:
            if accessor.count > _LIMIT_ELEMENTS:
                raise InputError(f"has more than {_LIMIT_ELEMENTS} elements", file=self._file, key=key)
            return np.zeros((accessor.count, size), dtype=component)
        data = self.view(accessor.bufferView, key)
        stride = self._gltf.bufferViews[accessor.bufferView].byteStride
        return self._array(data, accessor.byteOffset, accessor.count, component, size, stride, key)

    def _array(
        self, data: bytes, offset: int, count: int, component: str, size: int, stride: int | None, key: str
    ) -> NDArray[Any]:
        one = np.dtype(component).itemsize * size
        step = stride or one
        if count and offset + (count - 1) * step + one > len(data):
            raise InputError("is longer than its buffer view", file=self._file, key=key)
        if not count:
            return np.zeros((0, size), dtype=component)
        return np.ndarray((count, size), component, data, offset, (step, np.dtype(component).itemsize))

    def _replaced(self, values: NDArray[Any], sparse: Sparse, component: str, key: str) -> NDArray[Any]:
        indices_type = _COMPONENTS.get(sparse.indices.componentType, "<f4")
        if indices_type not in {"<u1", "<u2", "<u4"}:
            raise InputError("must be unsigned whole numbers", file=self._file, key=f"{key}.sparse.indices")
        indices, replacements = sparse.indices, sparse.values
        inside = f"{key}.sparse"
        rows = self._array(
            self.view(indices.bufferView, inside), indices.byteOffset, sparse.count, indices_type, 1, None, inside
        )[:, 0].astype(np.int64)
        if rows.size and rows.max() >= len(values):
            raise InputError("replaces elements that do not exist", file=self._file, key=inside)
        replaced = values.copy()
        replaced[rows] = self._array(
            self.view(replacements.bufferView, inside),
            replacements.byteOffset,
            sparse.count,
            component,
            values.shape[1],
            None,
            inside,
        )
        return replaced
