"""The plane sweep as a program: a folder in, a folder out, nothing of omnirange in between."""

import sys
import tomllib
from pathlib import Path

import numpy as np
from scipy import ndimage

source, target, window = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
limits = tomllib.loads((source / "limits.toml").read_text())
pose = tomllib.loads((source / "view_2" / "pose.toml").read_text())
first, second = (np.load(source / f"view_{view}" / "panorama.npy") for view in (1, 2))
t, grid = np.array(pose["position_m"]), pose["panorama"]
height, width = first.shape
z_pitch, phi_pitch = (grid["z_max"] - grid["z_min"]) / height, 2 * np.pi / width

phi = -np.pi + (np.arange(width) + 0.5) * phi_pitch
z = grid["z_max"] - (np.arange(height)[:, None] + 0.5) * z_pitch
x = np.stack(np.broadcast_arrays(np.cos(phi), np.sin(phi), z), axis=-1)
x /= np.linalg.norm(x, axis=-1, keepdims=True)

least, alpha_2 = np.full(first.shape, np.inf), np.full(first.shape, np.nan)
for inverse in np.linspace(1 / limits["d_max_m"], 1 / limits["d_min_m"], 64):
    seen = x - inverse * t
    across = np.hypot(seen[..., 0], seen[..., 1])
    row = (grid["z_max"] - seen[..., 2] / across) / z_pitch - 0.5
    column = (np.arctan2(seen[..., 1], seen[..., 0]) + np.pi) / phi_pitch - 0.5
    warped = ndimage.map_coordinates(second, [row, column], order=1, mode="grid-wrap")
    difference = np.abs(warped - first)
    difference[(row < 0) | (row > height - 1) | np.isnan(difference)] = 255
    cost = ndimage.uniform_filter(difference, window, mode=("nearest", "wrap"))
    better = cost < least
    least[better] = cost[better]
    angle = np.arctan2(np.linalg.norm(np.cross(seen, t), axis=-1), seen @ t)
    alpha_2[better] = angle[better]
np.save(target / "alpha_2.npy", np.where(np.isnan(first), np.nan, alpha_2))
