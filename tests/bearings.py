"""Pairs of bearing vectors of points drawn in space, for tests of motion."""

import numpy as np

from harness.camera.sensor import Sensor, project, unproject
from harness.geometry.angles import normalise
from harness.motion.features import Correspondences, spreads

SENSOR = Sensor()


def draw(turn, n=400, *, false=0.0, noise_px=0.2, seed=0, near=1.0, far=8.0, baseline=0.5, points=None):
    """Points in all directions that both views see, with noise on the pixels; a share of them matched at random."""
    draws = np.random.default_rng(seed)
    R, t = turn.R, baseline * turn.t
    result = []
    while sum(map(len, result)) < n:
        p = normalise(draws.normal(size=(4 * n, 3))) * draws.uniform(near, far, (4 * n, 1))
        p = p if points is None else points(draws, 4 * n)
        visible = project(SENSOR, p)[1] & project(SENSOR, (p - t) @ R.T)[1]
        result.append(p[visible])
    p = np.vstack(result)[:n]
    pixels = [project(SENSOR, each)[0] + draws.normal(0, noise_px, (n, 2)) for each in (p, (p - t) @ R.T)]
    wrong = int(false * n)
    pixels[1][:wrong] = pixels[1][draws.permutation(n)[:wrong]]
    return pairs_of(*pixels)


def pairs_of(pixels_1, pixels_2, sensor=SENSOR):
    x_1, x_2 = (unproject(sensor, each)[0] for each in (pixels_1, pixels_2))
    return Correspondences(x_1, x_2, spreads(sensor, x_1), spreads(sensor, x_2), pixels_1, pixels_2)
