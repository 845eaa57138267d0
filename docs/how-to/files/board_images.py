"""Ten images of a chessboard around a hyperboloid mirror, as a camera would take them; the sensor is known here."""

import math
from pathlib import Path

import numpy as np
from PIL import Image

import harness

SENSOR = {
    "camera": {"width_px": 1024, "height_px": 768, "focal_px": 985, "cx_px": 514.0, "cy_px": 381.0},
    "field": {"elevation_max_deg": 19},
}
ROOM = {"kind": "box", "size_m": [6, 6, 3], "inward": True, "texture": {"kind": "grey", "value": 110}}

folder = Path("boards")
folder.mkdir(exist_ok=True)
for i in range(10):
    around = math.radians(36 * i)
    board = {
        "kind": "chessboard",
        "columns": 9,
        "rows": 6,
        "square_m": 0.04,
        "position_m": [0.35 * math.cos(around), 0.35 * math.sin(around), 0.9],
        "yaw_deg": 36 * i + 12 * (i % 2),
        "pitch_deg": 75 + 13 * (i % 3),
        "roll_deg": 12 * (i % 4) - 18,
    }
    view = harness.render({"name": "target", "objects": [ROOM, board]}, sensor=SENSOR, position_m=(0, 0, 1))
    noisy = view.image + np.random.default_rng(i).normal(0, 3, view.image.shape)
    Image.fromarray(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)).save(folder / f"{i}.png")
