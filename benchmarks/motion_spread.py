"""What keeps the direct motion from the Cramér-Rao bound: noise of gradients, and grey levels that no motion explains.

For pairs of `motion.py` at a noise of 10 grey levels the errors of many draws are counted in units of the bound of the
tiles that exact images give, planes, gains and offsets unknown: the root of the mean square of the five of each draw,
from the truth (`error`) and from the mean of the draws (`scatter`). The bound takes view 2's gradients for known, and
the model `I_1 = a I_2 + b` for exact. So beside `fit_direct` stands the same least squares without either's failing:

- *exact gradients*: view 2 is exact, and its noise is put into view 1, where the pixels of view 2 are seen: residuals
  are as noisy as before, and gradients not at all;
- *offset*: how far the mean of those lies from the truth: what aliasing and tiles that show two surfaces do, the same
  in every draw.

    pip install 'omnirange[motion]'
    python benchmarks/motion_spread.py [pairs] [draws] [seed]
"""

import sys
from dataclasses import dataclass

import numpy as np
from motion import pairs
from scipy import ndimage
from scipy.spatial.transform import Rotation

import harness
from harness.camera.sensor import Sensor, pixel_directions, project
from harness.motion.direct import DirectFit, _adjusted, _equations, _reduced, _ridge, _State, fit_direct
from harness.motion.residuals import Turn
from harness.motion.sparse import tangents
from harness.motion.tiles import SIDE_PX, views

NOISE = 10.0
Images = tuple[np.ndarray, np.ndarray]


@dataclass
class Exact:
    """A pair without noise, and the tiles that match in it."""

    images: Images
    sensor: Sensor
    truth: Turn
    tiles: np.ndarray
    state: _State
    root: np.ndarray
    """`[5, 5]`: errors times it are deviates of standard deviation 1, at the bound."""
    held: np.ndarray
    """`[6, 5]`, the motion's five directions."""

    def deviates(self, turn: Turn) -> np.ndarray:
        """Errors in units of the bound."""
        omega = Rotation.from_matrix(self.truth.R.T @ turn.R).as_rotvec()
        return self.root @ self.held.T @ np.concatenate([omega, turn.t - self.truth.t])

    def adjusted(self, images: Images) -> Turn:
        """The least-squares motion on the exact tiles, from the exact planes, without smoothing."""
        state = _State(self.truth, self.state.planes.copy(), self.state.gain.copy(), self.state.offset.copy())
        fitted = _adjusted(views(single(images), (self.sensor, self.sensor)), self.tiles, state, "free")
        assert fitted is not None
        return fitted.turn

    def in_view_1(self, noise: np.ndarray) -> np.ndarray:
        """What view 2 with this noise has more than without, at the pixels of view 1's tiles."""
        x, _ = pixel_directions(self.sensor)
        seen = np.zeros(noise.shape)
        for (row, column), m, gain in zip(self.tiles, self.state.planes, self.state.gain, strict=True):
            tile = slice(row, row + SIDE_PX), slice(column, column + SIDE_PX)
            p = x[tile] - (x[tile] @ m)[..., None] * self.truth.t
            pixels = np.nan_to_num(project(self.sensor, p @ self.truth.R.T)[0])
            seen[tile] = gain * ndimage.map_coordinates(noise, [pixels[..., 1], pixels[..., 0]], order=3, mode="mirror")
        return seen


def exact_of(images: Images, sensor: Sensor, truth: Turn, direct: DirectFit) -> Exact:
    given, held, tiles = views(single(images), (sensor, sensor)), np.vstack(tangents(truth, "free")), direct.tiles
    state = _State(truth, direct.planes.copy(), np.ones(len(tiles)), np.zeros(len(tiles)))
    equations = _equations(given, tiles, state)
    information = _reduced(equations.H, held, _ridge(given, tiles, equations.H)).H.sum(axis=0) / (2 * NOISE**2)
    return Exact(images, sensor, truth, tiles, state, np.linalg.cholesky(information).T, held)


def single(images: Images) -> tuple[np.ndarray, np.ndarray]:
    first, second = (each.astype(np.float32) for each in images)
    return first, second


def main() -> None:
    given = [int(each) for each in sys.argv[1:]]
    count, draws, seed = [*given, *(6, 10, 71)[len(given) :]]
    everything: dict[str, list[tuple[float, float]]] = {}
    print("pair              direct fit      exact gradients")
    print("               error  scatter     error  scatter    offset", flush=True)
    for i, (name, first, second) in enumerate(pairs(count, seed)):
        motion = harness.relative_motion(first.pose, second.pose)
        truth = Turn(motion.R_v2_from_v1, motion.t_v1 / motion.baseline_m)
        images, sensor = (first.image, second.image), first.sensor
        estimate = harness.estimate_motion(*images, sensor)
        assert estimate.sparse is not None
        assert estimate.direct is not None
        exact = exact_of(images, sensor, truth, estimate.direct)
        rows: dict[str, list[np.ndarray]] = {"direct": [], "gradients": []}
        for draw in range(draws):
            noise = NOISE * np.random.default_rng([seed, i, draw]).normal(size=(2, *first.image.shape))
            noisy = single((images[0] + noise[0], images[1] + noise[1]))
            direct = fit_direct(noisy, (sensor, sensor), estimate.sparse, estimate.pairs)
            if direct is not None:
                rows["direct"].append(exact.deviates(direct.turn))
            moved = images[0] + noise[0] - exact.in_view_1(noise[1])
            rows["gradients"].append(exact.deviates(exact.adjusted((moved, images[1]))))
        figures = {stage: (rms(each), rms(scatter(each))) for stage, each in rows.items()}
        offset = rms(np.mean(rows["gradients"], axis=0))
        for stage, pair in figures.items():
            everything.setdefault(stage, []).append(pair)
        (a, b), (c, d) = figures["direct"], figures["gradients"]
        print(f"{name:15} {a:5.2f}    {b:5.2f}     {c:5.2f}    {d:5.2f}     {offset:5.2f}", flush=True)
    (a, b), (c, d) = (np.sqrt(np.mean(np.square(everything[stage]), axis=0)) for stage in ("direct", "gradients"))
    print(f"{'all':15} {a:5.2f}    {b:5.2f}     {c:5.2f}    {d:5.2f}")


def rms(values: list[np.ndarray] | np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def scatter(rows: list[np.ndarray]) -> np.ndarray:
    return (np.asarray(rows) - np.mean(rows, axis=0)) * np.sqrt(len(rows) / (len(rows) - 1))


if __name__ == "__main__":
    main()
