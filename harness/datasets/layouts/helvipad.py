"""Helvipad's layout: upright panoramas of a bottom and a top camera, depth and disparity as PNG files of 16 bits.

With psi the angle of a direction from the zenith at the bottom camera, B the baseline and r the range from the bottom
camera, the disparity d, the angle from the zenith at the top camera less psi, is by the sine rule

    tan d = B sin psi / (r - B cos psi),     r = B (sin psi / tan d + cos psi).

Published disparities had the other sign before the cosine for a while.
"""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from harness.camera.sensor import Sensor
from harness.datasets.layouts.layout import (
    Brief,
    Files,
    Layout,
    PlacedView,
    StoredPair,
    TruthMap,
    png,
    spec_file,
    states_in_lines,
    toml,
)
from harness.datasets.layouts.own import seen_directions
from harness.datasets.layouts.reading import known, numbers_of, read_array
from harness.datasets.pair import Pair
from harness.datasets.rigs import draw_motion
from harness.datasets.specification import DatasetSpec
from harness.errors import InputError
from harness.geometry.angles import Array
from harness.spec import parse
from harness.toml import read_toml

DEPTH_STEPS, DISPARITY_STEPS = 256.0, 2048.0
"""Levels to a metre, and to a degree."""
_LARGEST = 65535
_BASELINE_M = 0.191
"""Helvipad's own, where no calibration says otherwise."""
_SKIPPED_ROWS = 192 / 960
"""Rows above Helvipad's images, which are cut, as a share of those from pole to pole."""

README = f"""\
train, val, test/
    images_bottom/SCENE_IN/PAIR.png     view 1, 8 bits: an upright panorama, row 0 at the zenith
    images_top/SCENE_IN/PAIR.png        view 2, straight above view 1, turned alike
    depth_maps/SCENE_IN/PAIR.png        range from the bottom camera, 16 bits: level/256 metres; 0 where there is none
    disparity_maps/SCENE_IN/PAIR.png    level/2048 degrees: angle from the zenith at the top camera less that at the
                                        bottom one; 0 where there is none, or more than 32 degrees
    states/SCENE_IN/PAIR.png            {states_in_lines(40)}
calibration.toml                        the baseline

Despite the folder's name a depth is the Euclidean distance. r = B (sin psi / tan d + cos psi), psi = pi (row + 0.5) /
height being the angle from the zenith. Column j is centred at (width/2 - j - 0.5) 2 pi/width, counter-clockwise.
"""


def disparity_deg(range_m: Array, polar: Array, baseline_m: float) -> Array:
    """The disparity of points at a range from the bottom camera, at an angle from its zenith (radians)."""
    with np.errstate(invalid="ignore"):
        return np.degrees(np.arctan2(baseline_m * np.sin(polar), range_m - baseline_m * np.cos(polar)))


def range_of_disparity(disparity: Array, polar: Array, baseline_m: float) -> Array:
    """The inverse of `disparity_deg`: metres; NaN where the disparity is not above 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        range_m = baseline_m * (np.sin(polar) / np.tan(np.radians(disparity)) + np.cos(polar))
        return np.where((disparity > 0) & (range_m > 0), range_m, np.nan)


def polar_of(directions: Array) -> Array:
    """Angle of unit directions `[..., 3]` from the zenith, radians."""
    return np.arctan2(np.hypot(directions[..., 0], directions[..., 1]), directions[..., 2])


def _pair_files(spec: DatasetSpec, split: str, pair: Pair) -> Files:  # noqa: ARG001
    range_m = pair.range_m[0]
    disparity = disparity_deg(range_m, polar_of(seen_directions(pair.sensors[0])), pair.motion.baseline_m)
    maps: dict[str, NDArray[Any]] = {
        "images_bottom": pair.images[0],
        "images_top": pair.images[1],
        "depth_maps": _levels(range_m, DEPTH_STEPS),
        "disparity_maps": _levels(disparity, DISPARITY_STEPS),
        "states": pair.state,
    }
    path = f"scene{pair.scene_number:05d}_IN/{pair.number:04d}.png"
    return {f"{split}/{kind}/{path}": png(levels) for kind, levels in maps.items()}


def _levels(values: Array, steps: float) -> NDArray[np.uint16]:
    """Levels of 16 bits; 0 for values that are unknown or do not fit."""
    levels = np.rint(np.nan_to_num(values) * steps)
    return np.where((levels > 0) & (levels < _LARGEST), levels, 0).astype(np.uint16)


def _scene_files(spec: DatasetSpec, split: str, scene: int, pairs: Sequence[Brief]) -> Files:  # noqa: ARG001
    return {}


def _set_files(spec: DatasetSpec, splits: Sequence[str]) -> Files:  # noqa: ARG001
    table = {"baseline_m": draw_motion(spec, 0, 0).baseline_m, "width_px": spec.rig.width_px}
    return spec_file(spec) | {"calibration.toml": toml(table | {"height_px": spec.rig.height_px, "skipped_rows": 0})}


def _recognises(folder: Path) -> bool:
    return any(folder.glob("*/images_bottom"))


def _read(folder: Path) -> list[StoredPair]:
    pairs = []
    for image in sorted(folder.glob("*/images_bottom/*/*.png")):
        base, name = image.parents[2], image.relative_to(image.parents[1]).as_posix()
        pairs.append(_stored(folder, base, name))
    return pairs


def _stored(folder: Path, base: Path, place: str) -> StoredPair:
    image = base / "images_bottom" / place
    sensor, baseline_m = _camera(folder, image)
    directions = partial(seen_directions, sensor)
    maps = []
    for kind, quantity, steps in (
        ("depth_maps", "range", DEPTH_STEPS),
        ("disparity_maps", "disparity", DISPARITY_STEPS),
    ):
        file = base / kind / place
        if file.is_file():
            read = partial(_values, file, steps)
            maps.append(TruthMap(file, quantity, directions, read, partial(read_array, file)))
    state = base / "states" / place
    return StoredPair(
        name=f"{base.name}/{Path(place).with_suffix('').as_posix()}",
        split=base.name,
        scene=Path(place).parent.name,
        views=(
            PlacedView(image, sensor, np.eye(3), np.zeros(3)),
            PlacedView(base / "images_top" / place, sensor, np.eye(3), np.array([0.0, 0.0, baseline_m])),
        ),
        maps=tuple(maps),
        state=partial(read_array, state) if state.is_file() else None,
    )


def _values(file: Path, steps: float) -> Array:
    return known(read_array(file), invalid=0) / steps


def _camera(folder: Path, image: Path) -> tuple[Sensor, float]:
    """The panoramic camera of an image, and the baseline: as the set says, or as Helvipad itself has them."""
    file = folder / "calibration.toml"
    try:
        with Image.open(image) as opened:
            width, height = opened.size
    except Exception as error:  # Pillow's readers raise exceptions of any class
        raise InputError("cannot be read as an image; it may be cut off", file=image) from error
    skipped, baseline_m = (0.0 if 2 * height == width else _SKIPPED_ROWS * width / 2), _BASELINE_M
    if file.is_file():
        table = read_toml(file)
        baseline_m = float(numbers_of(table, "baseline_m", (), file))
        skipped = float(numbers_of(table, "skipped_rows", (), file))
    if not 0 < baseline_m < 100:
        raise InputError("must be above 0 and below 100 metres", file=file, key="baseline_m")
    centre = {"cx_px": (width - 1) / 2, "cy_px": width / 4 - 0.5 - skipped}
    camera = {"width_px": width, "height_px": height, "focal_px": width / (2 * math.pi), **centre}
    return parse(Sensor, {"model": {"kind": "equirectangular"}, "camera": camera}, file=image), baseline_m


HELVIPAD = Layout("helvipad", "Helvipad's", README, _pair_files, _scene_files, _set_files, _recognises, _read)
