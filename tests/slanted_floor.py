"""A floor whose texture is a formula, so that images, truth and gradients are exact, and slanted windows on it."""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.sensor import Sensor, pixel_directions
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.geometry.triangulation import exact_alpha_2
from harness.matching.slanted.refine import Slanted, refine_slanted

SENSOR = Sensor(
    camera=Camera(width_px=220, height_px=220, focal_px=560.0, cx_px=109.5, cy_px=109.5),
    field=FieldOfView(elevation_min_deg=-75, elevation_max_deg=-20),
)
GRID = Grid(width_px=240, height_px=60, z_max=-0.4, z_min=-2.0)
HEIGHT_M = 1.0
SETTINGS = Slanted(window_px=13, d_min_m=0.5)
WAVES = np.random.default_rng(3).normal(size=(60, 2)), np.random.default_rng(4).uniform(0, 2 * np.pi, 60)


def texture(x, y):
    """Sixty waves of 0.25 m and longer: eight mirror pixels or more."""
    directions, phases = WAVES
    lengths = 0.25 + 0.5 * np.linspace(0, 1, len(phases))
    k = 2 * np.pi * directions / np.linalg.norm(directions, axis=-1, keepdims=True) / lengths[:, None]
    total = np.zeros(np.shape(x))
    for (k_x, k_y), phase in zip(k, phases, strict=True):
        total += np.cos(k_x * x + k_y * y + phase)
    return 128 + 8 * total


def seen_along(directions_v1, viewpoint):
    """The floor's grey in some directions of v1's orientation, from a viewpoint given in v1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (-HEIGHT_M - viewpoint[2]) / directions_v1[..., 2]
    return texture(viewpoint[0] + reach * directions_v1[..., 0], viewpoint[1] + reach * directions_v1[..., 1])


def render(viewpoint, R=None, sensor=SENSOR):
    """A mirror image; R turns from v1 into the view."""
    x, visible = pixel_directions(sensor)
    grey = seen_along(x if R is None else x @ R, viewpoint)
    return np.where(visible, grey, 0).astype(np.float32)


def motion(t=(0.2, 0.05, 0.02), turn=(20.0, 3.0, -2.0)):
    return Motion(Rotation.from_euler("ZYX", turn, degrees=True).as_matrix(), np.array(t))


@lru_cache
def pair(t=(0.2, 0.05, 0.02), turn=(20.0, 3.0, -2.0)):
    there = motion(t, turn)
    return render(np.zeros(3)), render(there.t_v1, there.R_v2_from_v1)


def truth(there, grid=GRID):
    x = directions(grid)
    return exact_alpha_2(x * (-HEIGHT_M / x[..., 2:]), there.t_v1)


def start(there, error_px=0.5, outliers=0.05, seed=0):
    """The truth, wrong by up to half a pixel; some pixels by up to ten."""
    draws = np.random.default_rng(seed)
    error = draws.uniform(-error_px, error_px, GRID.shape)
    error = np.where(draws.random(GRID.shape) < outliers, draws.uniform(-10, 10, GRID.shape), error)
    return truth(there) + error * GRID.phi_pitch


def refine(images, there, begin=None, **settings):
    threads = settings.pop("threads", 2)
    begin = start(there) if begin is None else begin
    chosen = SETTINGS.model_copy(update=settings)
    return refine_slanted(images, (SENSOR, SENSOR), there, GRID, begin, settings=chosen, threads=threads)


def errors_px(matches, there):
    return (matches.alpha_2 - truth(there)) / GRID.phi_pitch


def steep(there):
    """Not towards the epipoles, where disparity says little about range and errors are not the matcher's."""
    x = directions(GRID)
    return np.linalg.norm(np.cross(x, there.t_v1 / np.linalg.norm(there.t_v1)), axis=-1) >= 0.5
