"""Predicted errors of a rig beside measured ones: of images rendered with drawn parameters, matched with nominal ones.

The parameters are drawn from their uncertainties, since the true rig is not known.
"""

from dataclasses import dataclass

import numpy as np

from harness.camera.coverage import coverage
from harness.camera.sensor import in_use
from harness.design.budget import FAR_FROM_T, budget
from harness.design.rig import RigDesign
from harness.display import OneLine
from harness.evaluation.propagation import Rig
from harness.evaluation.rig_uncertainty import uncertain
from harness.evaluation.statistics import SHARE, central_68
from harness.geometry.epipolar import alpha_1
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion, Pose
from harness.io.view_folder import pose_in
from harness.matching.pair import Pair
from harness.matching.ranges import ranges_of
from harness.matching.slanted.settings import Slanted
from harness.simulation.chip import captured
from harness.simulation.noise import generator
from harness.simulation.render import render
from harness.simulation.scene import Box, Scene
from harness.simulation.truth import truth

_SAMPLES = 16
_EVERY = 7
"""Steps between the pixels whose errors are predicted."""


@dataclass(frozen=True, repr=False)
class Verified(OneLine):
    """Predicted and measured errors of one rig, over the same pixels."""

    rig: RigDesign
    range_m: float
    """Half the side of the room whose walls were measured."""
    predicted_m: float
    measured_m: float
    """The error that 68.3 % of the matched pixels of all draws stay within."""
    density: float
    """Share of the pixels with a range."""
    draws: int

    @property
    def ratio(self) -> float:
        """Measured over predicted."""
        return self.measured_m / self.predicted_m


def verify(rig: RigDesign, range_m: float, *, draws: int = 4, seed: int = 0, threads: int | None = None) -> Verified:
    """Measure a rig's errors in a simulated room with walls at a distance, its parameters drawn anew several times.

    Parameters
    ----------
    draws
        Draws of noise and of the uncertain parameters; each renders two images and matches them.
    threads
        All available CPUs when None.
    """
    grid = _grid(rig)
    scene = _room(rig, range_m)
    believed = rig.believed
    x, towards = directions(grid), alpha_1(grid, believed.motion.t_v1)
    errors, predicted, expected = [], [], 0
    for draw, true in enumerate(drawn(rig, draws, generator(seed, "design"))):
        first, second = _poses(true.motion, range_m)
        images = [
            captured(
                render(scene, sensor, pose, _SAMPLES, threads),
                rig.sensor,
                rig.chip,
                rig.noise_grey,
                *(generator(seed, purpose, str(draw), str(view)) for purpose in ("shot", "white")),
            )
            for view, (sensor, pose) in enumerate(zip(true.sensors, (first, second), strict=True))
        ]
        pair = Pair((images[0], images[1]), believed.sensors, believed.motion, grid)
        matches = Slanted(kind="slanted", window_px=rig.window_px).match(pair)
        range_estimate, _ = ranges_of(matches, towards, rig.baseline_m)
        seen = truth(scene, first, x, in_use(rig.sensor, x), pose_2=second, sensor_2=rig.sensor)
        walls = seen.visible & (np.abs(seen.normal[..., 2]) < 0.5)
        walls &= np.sin(towards) >= FAR_FROM_T
        errors.append((range_estimate - seen.range_m)[walls])
        expected += int(walls.sum())
        points = (seen.range_m[..., None] * x)[walls][::_EVERY]
        normals = seen.normal[walls][::_EVERY] @ first.R_world_from_view
        predicted.append(budget(rig, points, normals).total_m)
    off = np.abs(np.concatenate(errors))
    known = off[np.isfinite(off)]
    return Verified(
        rig,
        range_m,
        predicted_m=central_68(np.concatenate(predicted)),
        measured_m=float(np.quantile(known, SHARE)) if known.size else float("inf"),
        density=known.size / max(1, expected),
        draws=draws,
    )


def drawn(rig: RigDesign, draws: int, random: np.random.Generator) -> list[Rig]:
    """Rigs whose uncertain parameters deviate from the nominal ones by random draws, `draws` in number.

    Where there are more draws than numbers, the draws are made to have exactly the covariance that they are drawn from:
    a few then tell as much of the range's as many would.
    """
    parameters = uncertain(rig.sensor, rig.uncertainty, rig.believed.motion)
    units = random.standard_normal((draws, len(parameters)))
    if draws > len(parameters) > 0:
        units = np.linalg.qr(units)[0] * np.sqrt(draws) * random.choice([-1.0, 1.0], len(parameters))
    rigs = []
    for row in units:
        true = rig.believed
        for (parameter, sigma), unit in zip(parameters, row, strict=True):
            true = parameter.changed(true, sigma * unit)
        rigs.append(true)
    return rigs


def _grid(rig: RigDesign) -> Grid:
    """A panorama with as many columns as the image has pixels around the horizon, to the next 40."""
    resolution = coverage(rig.sensor).resolution
    per_degree = np.nanmedian(resolution.tangential)
    return Grid(width_px=int(np.clip(40 * round(360 * per_degree / 40), 360, 2880)))


def _room(rig: RigDesign, range_m: float) -> Scene:
    side = dict.fromkeys(("x_min", "x_max", "y_min", "y_max", "bottom", "top"), rig.texture)
    box = Box(kind="box", name="room", inward=True, size_m=(2 * range_m, 2 * range_m, 2 * range_m), **side)
    return Scene(name="room of a design", objects=(box,))


def _poses(motion: Motion, range_m: float) -> tuple[Pose, Pose]:
    """Views on both sides of the middle of the room, as the motion says."""
    middle = np.array([0.0, 0.0, range_m])
    first = Pose(position_m=tuple((middle - motion.t_v1 / 2).tolist()))
    second = pose_in(motion)
    return first, second.model_copy(update={"position_m": tuple((middle + motion.t_v1 / 2).tolist())})
