"""The law of sensitivity from geometry alone.

Exact angles (and apart from them |t|) are perturbed by known noise, and the spread and bias of the triangulated range
are compared with the exact law, with the paper's d²/|t|, with d/|t| (eq. 10) and with the bias of second order. This
says nothing about images; it verifies the formulas and shows where their linearisation breaks down.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from harness.geometry.angles import Array
from harness.geometry.triangulation import paper_law, sensitivity_to_alpha_2, sensitivity_to_baseline, triangulate

BASELINE_M = 0.5
RANGES_M = (1.5, 3.0, 6.0)
ALPHA_1_DEG = (30.0, 45.0, 60.0, 90.0, 120.0, 150.0)
SMALL_SIGMA_DEG = 0.02
"""Small enough that the range's relative spread is below 2 % everywhere on the grid: the linearisation holds."""
SIGMAS_DEG = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
DRAWS = 100_000
"""Each used with both signs. The standard error of a spread is 1/sqrt(2 draws), 0.2 %: well below the required 1 %."""


@dataclass(frozen=True)
class GeometryCheck:
    """Measured over predicted, one entry for each range, direction and noise `[ranges, directions, sigmas]`."""

    spread_over_exact: Array
    spread_over_paper: Array
    bias_over_second_order: Array
    baseline_spread_over_eq10: Array
    """`[ranges, directions]`; a spread of 1 % of |t|."""
    relative_spread: Array
    """The spread that the exact law predicts, as a share of the range."""

    def summary(self) -> dict[str, float]:
        """The medians where the noise is smallest, so that the linearisation holds."""
        return {
            "angle_spread_over_exact": float(np.median(self.spread_over_exact[..., 0])),
            "angle_spread_over_paper": float(np.median(self.spread_over_paper[..., 0])),
            # The bias grows with sigma², its own noise with sigma: it stands out of it at the second-largest noise.
            "bias_over_second_order": float(np.nanmedian(self.bias_over_second_order[..., 2])),
            "baseline_spread_over_eq10": float(np.median(self.baseline_spread_over_eq10)),
        }


def second_order_bias(alpha_1: ArrayLike, alpha_2: ArrayLike, baseline_m: float, sigma: float) -> Array:
    """`½ ∂²d_1/∂alpha_2² sigma²`, metres: the mean error of the range for an unbiased error of the angle.

    With delta = alpha_2 - alpha_1, `∂²d_1/∂alpha_2² = 2 |t| sin alpha_1 cos delta / sin³ delta`.
    """
    alpha_1, alpha_2 = np.asarray(alpha_1, dtype=np.float64), np.asarray(alpha_2, dtype=np.float64)
    delta = alpha_2 - alpha_1
    return np.asarray(baseline_m * np.sin(alpha_1) * np.cos(delta) / np.sin(delta) ** 3 * sigma**2)


@lru_cache(maxsize=1)
def check_geometry(seed: int = 0, draws: int = DRAWS) -> GeometryCheck:
    """Perturb and compare, over a grid of ranges, directions and noises."""
    generator = np.random.default_rng(seed)
    unit = generator.standard_normal(draws)
    unit = np.concatenate([unit, -unit])
    shape = (len(RANGES_M), len(ALPHA_1_DEG))
    exact, paper, bias, relative = (np.full((*shape, len(SIGMAS_DEG)), np.nan) for _ in range(4))
    eq_10 = np.full(shape, np.nan)
    for i, d_1 in enumerate(RANGES_M):
        for j, alpha_1 in enumerate(np.radians(ALPHA_1_DEG)):
            alpha_2 = np.arctan2(d_1 * np.sin(alpha_1), d_1 * np.cos(alpha_1) - BASELINE_M)
            law = -float(sensitivity_to_alpha_2(alpha_1, alpha_2, BASELINE_M))
            for k, sigma in enumerate(np.radians(SIGMAS_DEG)):
                d, _ = triangulate(alpha_1, alpha_2 + sigma * unit, BASELINE_M)
                relative[i, j, k] = law * sigma / d_1
                if np.isnan(d).any():
                    continue  # some rays no longer meet: there is neither a mean nor a spread
                exact[i, j, k] = d.std() / (law * sigma)
                paper[i, j, k] = d.std() / (float(paper_law(d_1, BASELINE_M)) * sigma)
                bias[i, j, k] = (d.mean() - d_1) / float(second_order_bias(alpha_1, alpha_2, BASELINE_M, sigma))
            sigma_t = 0.01 * BASELINE_M
            d = triangulate(alpha_1, alpha_2, 1.0)[0] * (BASELINE_M + sigma_t * unit)
            eq_10[i, j] = d.std() / (float(sensitivity_to_baseline(d_1, BASELINE_M)) * sigma_t)
    return GeometryCheck(exact, paper, bias, eq_10, relative)
