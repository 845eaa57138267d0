"""Map files for ROS's map_server: a PNG and a YAML beside it."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from harness.errors import InputError
from harness.files import make_folder, read_regular, write
from harness.images import png_note
from harness.mapping.occupancy import FREE_BELOW, OCCUPIED_ABOVE, Cell, GridFrame

LEVELS = {Cell.OCCUPIED: 0, Cell.FREE: 254, Cell.UNKNOWN: 205}
"""Grey levels of map_saver: (255 - level)/255 is the probability that a cell is occupied."""
_LIMIT_BYTES = 1 << 26


def write_map(state: NDArray[np.uint8], frame: GridFrame, folder: Path, name: str = "map") -> None:
    """Write `name.png` and `name.yaml`.

    Parameters
    ----------
    state
        `[rows, columns]` of the frame: `Cell`.

    Raises
    ------
    InputError
        When the folder cannot be written to.
    """
    levels = np.zeros(len(Cell), dtype=np.uint8)
    for cell, level in LEVELS.items():
        levels[cell] = level
    stream = io.BytesIO()
    picture = Image.fromarray(levels[state][::-1])  # an image's first row is the highest y
    picture.save(stream, format="PNG", pnginfo=png_note())
    table = {
        "image": f"{name}.png",
        "mode": "trinary",
        "resolution": frame.cell_m,
        "origin": [*frame.origin_m, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_ABOVE,
        "free_thresh": FREE_BELOW,
    }
    make_folder(folder)
    write(folder / f"{name}.png", stream.getvalue())
    write(folder / f"{name}.yaml", yaml.safe_dump(table, sort_keys=False, default_flow_style=None))


def read_map(file: Path) -> tuple[NDArray[np.uint8], GridFrame]:
    """The states and the frame of a map's YAML, read as map_server reads them (mode `trinary`).

    Raises
    ------
    InputError
        When a file is missing or is no such map.
    """
    try:
        table: Any = yaml.safe_load(read_regular(file, _LIMIT_BYTES))
        picture = file.parent / table["image"]
        with Image.open(io.BytesIO(read_regular(picture, _LIMIT_BYTES, "image"))) as image:
            grey = np.asarray(image.convert("L"), dtype=np.float64)[::-1]
        occupied, free = float(table["occupied_thresh"]), float(table["free_thresh"])
        x, y, yaw = (float(each) for each in table["origin"])
        cell_m, negate = float(table["resolution"]), bool(table["negate"])
    except (yaml.YAMLError, OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"is no map of map_server's: {error}", file=file) from error
    if yaw:
        raise InputError("rotated maps are not supported; give one with a yaw of 0", file=file, key="origin")
    probability = grey / 255 if negate else (255 - grey) / 255
    state = np.full(grey.shape, np.uint8(Cell.UNKNOWN))
    state[probability > occupied] = Cell.OCCUPIED
    state[probability < free] = Cell.FREE
    return state, GridFrame((x, y), cell_m, grey.shape)
