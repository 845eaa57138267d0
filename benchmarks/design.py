"""Predicted beside measured errors of random rigs: `python benchmarks/design.py [RIGS] [DRAWS] [SEED]` (20, 16, 1)."""

import sys

import numpy as np

from harness.camera.sensor import Sensor
from harness.design.answers import resized
from harness.design.rig import RigDesign
from harness.design.verify import verify
from harness.evaluation.rig_uncertainty import Uncertainty
from harness.simulation.texture import BundledTexture, NoiseTexture

TEXTURES = (
    BundledTexture(kind="bundled", name="gravel", tile_m=6.0),
    BundledTexture(kind="bundled", name="grass", tile_m=6.0),
    BundledTexture(kind="bundled", name="gravel", tile_m=3.0),
    NoiseTexture(kind="noise", seed=1, tile_m=6.0, shortest_m=0.08, longest_m=1.0),
)


def random_rig(rng: np.random.Generator) -> tuple[RigDesign, float]:
    """A rig, and the distance of the walls that it is measured on."""
    some = iter(rng.random(8) < 0.4)

    def sigma(largest: float) -> float:
        return float(rng.uniform(0.2, 1) * largest) if next(some) else 0.0

    rig = RigDesign(
        sensor=resized(Sensor(), int(rng.choice([640, 800, 1024, 1280]))),
        baseline_m=float(rng.uniform(0.2, 0.8)),
        azimuth_deg=float(rng.uniform(-180, 180)),
        noise_grey=float(rng.uniform(1, 10)),
        texture=TEXTURES[rng.integers(len(TEXTURES))],
        uncertainty=Uncertainty(
            rotation_deg=sigma(0.05),
            t_direction_deg=sigma(0.3),
            t_length=sigma(0.01),
            focal=sigma(0.002),
            centre_px=sigma(0.5),
            shape=sigma(0.003),
            alignment_mm=sigma(0.3),
            alignment_deg=sigma(0.1),
        ),
    )
    return rig, float(rng.uniform(2, 6))


def main(rigs: int = 20, draws: int = 16, seed: int = 1) -> None:
    """Print a line for each rig, and what share is within 25 %."""
    rng, ratios = np.random.default_rng(seed), []
    print(f"{'rig':<24}{'walls':>7}{'predicted':>11}{'measured':>10}{'ratio':>7}{'density':>9}  uncertain")
    for _ in range(rigs):
        rig, range_m = random_rig(rng)
        result = verify(rig, range_m, draws=draws, seed=seed)
        ratios.append(result.ratio)
        known = {name: value for name, value in rig.uncertainty.model_dump(exclude={"odometry"}).items() if value}
        print(
            f"{rig.title:<24}{range_m:>5.1f} m{1000 * result.predicted_m:>8.1f} mm{1000 * result.measured_m:>7.1f} mm"
            f"{result.ratio:>7.2f}{result.density:>9.3f}  {', '.join(f'{k} {v:.2g}' for k, v in known.items())}",
            flush=True,
        )
    within = np.mean(np.abs(np.array(ratios) - 1) <= 0.25)
    print(f"within 25 %: {within:.0%} of {rigs}; median ratio {np.median(ratios):.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
