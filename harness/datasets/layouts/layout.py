"""Layouts of data sets: the conversion of a pair to files, and of files to a pair.

A pair that is read has maps of truth over directions in a frame of the map's own, and for each view the place and the
rotation of its sensor in that frame: view 1 of most layouts is at the origin.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray
from PIL import Image

from harness.camera.sensor import Sensor
from harness.datasets.pair import STATES, VISIBLE, Pair
from harness.datasets.specification import DatasetSpec
from harness.display import OneLine
from harness.geometry.angles import Array
from harness.geometry.pose import Motion, Pose
from harness.io.view_folder import npy
from harness.simulation.noise import generator
from harness.spec import dump_toml

Files = dict[str, bytes]
"""Contents by path, relative to the set's folder, with slashes."""
Mask = NDArray[np.bool_]

_POINTS = 200
"""Points of a pair whose places in the world are kept, at most."""


@dataclass(frozen=True, eq=False, repr=False)
class Brief(OneLine):
    """The description of a pair in its scene's files: its geometry, and some points that both views see."""

    number: int
    sensors: tuple[Sensor, Sensor]
    poses: tuple[Pose, Pose]
    motion: Motion
    points_m: Array
    """`[n, 3]`, in the world."""
    pixels: tuple[Array, Array]
    """`[n, 2]` for each view: (u, v), whole numbers at the centres of pixels."""
    grey: NDArray[np.uint8]
    """`[n]`, in view 1."""


def brief_of(spec: DatasetSpec, pair: Pair) -> Brief:
    """The brief of a pair; its points are drawn by the set's seed."""
    draws = generator(spec.seed, "dataset", "points", str(pair.scene_number), str(pair.number))
    row, column = np.nonzero(pair.state == VISIBLE)
    chosen = np.sort(draws.permutation(row.size)[:_POINTS])
    row, column = row[chosen], column[chosen]
    from harness.camera.sensor import pixel_directions

    in_view = pixel_directions(pair.sensors[0])[0][row, column] * pair.range_m[0][row, column, None]
    image = pair.images[0][row, column]
    return Brief(
        number=pair.number,
        sensors=pair.sensors,
        poses=pair.poses,
        motion=pair.motion,
        points_m=in_view @ pair.poses[0].R_world_from_view.T + pair.poses[0].position_m,
        pixels=(np.stack([column, row], axis=-1).astype(np.float64), pair.match[row, column]),
        grey=image if image.ndim == 1 else image.mean(axis=1).astype(np.uint8),
    )


@dataclass(frozen=True, eq=False, repr=False)
class PlacedView(OneLine):
    """A view of a stored pair."""

    image: Path
    sensor: Sensor
    R_view_from_map: Array
    """`[3, 3]`: turns directions of the map's frame into the sensor's."""
    position_m: Array
    """`[3]`: the viewpoint in the map's frame."""


@dataclass(frozen=True, eq=False, repr=False)
class TruthMap(OneLine):
    """A map of truth, and what its numbers mean."""

    file: Path
    quantity: str
    """`range` (metres from the map's origin), `disparity` (degrees, along the meridians of two upright panoramas) or
    `inverse range` (1/metres)."""
    directions: Callable[[], Array]
    """Gives `[..., 3]`: unit directions of the map's pixels in the map's frame; NaN for a pixel without one."""
    read: Callable[[], Array]
    """Gives `[...]`: the numbers in the quantity's unit; NaN where the file marks a missing one."""
    raw: Callable[[], NDArray[Any]]
    """Gives the numbers as they stand in the file."""
    is_image: bool = True
    """Whether its pixels are those of view 1's image."""


@dataclass(frozen=True, eq=False, repr=False)
class StoredPair(OneLine):
    """A pair of a data set on the disk."""

    name: str
    """Unique within the set, with slashes."""
    split: str
    """`train`, `val`, `test`; empty where the set does not say."""
    scene: str
    views: tuple[PlacedView, PlacedView]
    maps: tuple[TruthMap, ...]
    """The first one is what estimates are compared with."""
    state: Callable[[], NDArray[np.uint8]] | None = None
    """Gives the states of view 1's pixels, see `pair.STATES`; None in a set without states."""
    match: Callable[[], Array] | None = None
    """Gives the places of view 1's pixels in view 2's image."""
    observed: tuple[Array, Array, Array] | None = None
    """Points `[n, 3]` in the map's frame and their pixels `[n, 2]` in both views, as stated by the set."""

    @property
    def motion(self) -> Motion:
        """The motion from view 1 to view 2."""
        first, second = self.views
        return Motion(
            R_v2_from_v1=second.R_view_from_map @ first.R_view_from_map.T,
            t_v1=first.R_view_from_map @ (second.position_m - first.position_m),
        )


@dataclass(frozen=True)
class Layout:
    """A layout of a data set's files: how it is recognised, read and written."""

    name: str
    title: str
    """The layout's name for people."""
    readme: str
    """The part of README.txt about the files."""
    pair_files: Callable[[DatasetSpec, str, Pair], Files]
    """The files of a pair of a part of the split."""
    scene_files: Callable[[DatasetSpec, str, int, Sequence[Brief]], Files]
    """The files of a scene, by its part, number and pairs."""
    set_files: Callable[[DatasetSpec, Sequence[str]], Files]
    """The files of the whole set, by the parts of its scenes in order."""
    recognises: Callable[[Path], bool]
    """Whether a folder is laid out so."""
    read: Callable[[Path], list[StoredPair]]
    """The pairs in a folder, by name; InputError when a file that lists the contents is wrong."""


# --- Files ------------------------------------------------------------------------------------------------------------


def states_in_lines(indent: int) -> str:
    """The meanings of the numbers in a map of states, a line each, those after the first indented."""
    return f"\n{' ' * indent}".join(f"{number} {text}" for number, text in STATES.items())


def png(image: NDArray[np.integer]) -> bytes:
    """A PNG file of 8 or 16 bits; quick rather than small."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG", compress_level=1)
    return stream.getvalue()


def single(array: Array) -> bytes:
    """An NPY file in single precision."""
    return npy(array.astype(np.float32))


def toml(table: dict[str, Any]) -> bytes:
    """A TOML file."""
    return tomli_w.dumps(table).encode()


def geometry_table(motion: Motion) -> dict[str, Any]:
    """The motion of a pair, for a TOML file."""
    return {
        "baseline_m": motion.baseline_m,
        "t_v1_m": motion.t_v1.tolist(),
        "R_v2_from_v1": motion.R_v2_from_v1.tolist(),
    }


def pose_table(pose: Pose) -> dict[str, Any]:
    """The pose of a view in the world, for a TOML file."""
    return {**pose.model_dump(), "R_world_from_view": pose.R_world_from_view.tolist()}


def spec_file(spec: DatasetSpec) -> Files:
    """`dataset.toml`: every key of the specification, defaults included."""
    return {"dataset.toml": dump_toml(spec).encode()}
