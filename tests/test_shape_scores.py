"""The seam, boundaries and normals of a map of ranges, against SciPy's filters, plain loops and analytic planes."""

import numpy as np
import pytest
from scipy import ndimage

from harness.evaluation.shape_scores import EDGES_M, NORMALS_DEG, Shape, edges_and_normals, shape_of, shape_scores
from harness.geometry.panorama import Grid, directions

GRID = Grid(width_px=90, height_px=30)
LOOKING = directions(GRID)
NOTHING = np.zeros(GRID.shape, dtype=bool)
EVERYTHING = ~NOTHING


def room() -> tuple[np.ndarray, np.ndarray]:
    """Ranges from within a room of 6 x 5 m, 1 m above its floor, and the normals of what is seen."""
    at_3_m = ((1, 0, 0), (-1, 0, 0), (0, -1, 0))
    planes = [*((n, 3.0) for n in at_3_m), ((0, 1, 0), 2.0), ((0, 0, -1), 1.0), ((0, 0, 1), 2.0)]
    with np.errstate(divide="ignore"):
        along = np.stack([distance / np.maximum(LOOKING @ np.array(n, float), 0) for n, distance in planes])
    return along.min(axis=0), -np.array([n for n, _ in planes], dtype=float)[along.argmin(axis=0)]


@pytest.fixture(scope="module")
def shape() -> Shape:
    range_m, _ = room()
    range_m[8:19, 22:30] = 1.2  # something in front
    return shape_of(range_m, EVERYTHING, LOOKING, NOTHING)


def test_edges_are_scipys_sobel() -> None:
    draws = np.random.default_rng(3)
    range_m = draws.uniform(1, 5, GRID.shape)
    edge, _ = edges_and_normals(range_m, LOOKING, around=True)
    modes = ("nearest", "wrap")
    expected = np.hypot(*(ndimage.sobel(range_m, axis=axis, mode=modes) for axis in (0, 1)))
    np.testing.assert_allclose(edge[1:-1], expected[1:-1], rtol=1e-12)
    assert np.isnan(edge[[0, -1]]).all()
    range_m[20, 0] = np.nan
    holes = np.isnan(edges_and_normals(range_m, LOOKING, around=True)[0])
    expected_holes = ndimage.maximum_filter(np.isnan(range_m), 3, mode=modes)
    np.testing.assert_array_equal(holes[1:-1], expected_holes[1:-1])  # on both sides of the seam


def test_normals_of_planes_are_the_planes_own() -> None:
    range_m, normal = room()
    _, found = edges_and_normals(range_m, LOOKING, around=True)
    inner = np.zeros(GRID.shape, dtype=bool)
    alike = [(np.roll(normal, shift, axis) == normal).all(axis=-1) for axis in (0, 1) for shift in (1, -1)]
    inner[1:-1] = np.logical_and.reduce(alike)[1:-1]
    assert inner.mean() > 0.8
    # Differences of points of a plane lie in it: roundings of coordinates of metres, over steps of centimetres.
    np.testing.assert_allclose(found[inner], normal[inner], atol=1e-11)


def test_the_truth_itself_is_perfect(shape: Shape) -> None:
    zero = np.zeros(GRID.shape)
    scores = shape_scores(shape, zero, zero, EVERYTHING)
    assert (scores.seam_m, scores.seam_px, scores.precision, scores.recall) == (0, 0, (1, 1, 1), (1, 1, 1))
    assert scores.normal_rmse_deg < 1e-5  # the arccos of a rounding below 1
    assert scores.normal_within == (1, 1, 1)
    nothing = shape_scores(shape, zero * np.nan, zero * np.nan, NOTHING)
    assert nothing.recall == (0, 0, 0)
    assert np.isnan([nothing.seam_m, nothing.normal_mean_deg, *nothing.precision, *nothing.normal_within]).all()


def test_a_map_that_does_not_go_around_has_no_seam(shape: Shape) -> None:
    half = slice(0, GRID.width_px // 2)
    part = shape_of(shape.range_m[:, half], EVERYTHING[:, half], LOOKING[:, half], NOTHING[:, half])
    assert (shape.around, part.around) == (True, False)
    assert np.isnan(part.edge[:, [0, -1]]).all()
    np.testing.assert_array_equal(part.edge[:, 1:-1], shape.edge[:, 1 : GRID.width_px // 2 - 1])
    zero = np.zeros(part.range_m.shape)
    scores = shape_scores(part, zero, zero, EVERYTHING[:, half])
    assert np.isnan([scores.seam_m, scores.seam_px]).all()
    assert scores.recall == (1, 1, 1)
    assert not shape_of(zero * np.nan, zero > 0, LOOKING[:, half] * np.nan, zero > 0).around


def test_the_seam_by_hand(shape: Shape) -> None:
    """A jump of 0.2 m at the seam, in the rows that have an estimate on both sides of it; one row has another."""
    error = np.zeros(GRID.shape)
    error[:, -10:] = 0.2
    error[5:9, -1] = np.nan  # no estimate: not counted
    error[9, -1] = 1.0
    scores = shape_scores(shape, error, 3 * error, EVERYTHING)
    assert scores.seam_m == pytest.approx((25 * 0.2 + 1.0) / 26)
    assert scores.seam_px == pytest.approx(3 * (25 * 0.2 + 1.0) / 26)
    same_everywhere = shape_scores(shape, np.full(GRID.shape, 0.4), np.zeros(GRID.shape), EVERYTHING)
    assert same_everywhere.seam_m == pytest.approx(0, abs=1e-15)


@pytest.mark.slow
def test_boundaries_and_normals_as_plain_loops_would(shape: Shape) -> None:
    draws = np.random.default_rng(8)
    smoothed = ndimage.gaussian_filter(shape.range_m, 1.0, mode=("nearest", "wrap"))
    estimate = smoothed + draws.normal(0, 0.02, GRID.shape)
    valid = draws.random(GRID.shape) > 0.02
    domain = draws.random(GRID.shape) > 0.3
    discontinuity = draws.random(GRID.shape) > 0.9
    here = shape_of(shape.range_m, domain, LOOKING, discontinuity)
    scores = shape_scores(here, np.where(valid, estimate - shape.range_m, np.nan), np.zeros(GRID.shape), valid)
    rows, columns = GRID.shape
    given = np.where(valid, estimate, np.nan)

    def gradient(values: np.ndarray, i: int, j: int) -> float:
        window = values[np.ix_([i - 1, i, i + 1], [(j - 1) % columns, j, (j + 1) % columns])]
        kernel = np.outer([1, 2, 1], [-1, 0, 1])
        return float(np.hypot((window * kernel).sum(), (window * kernel.T).sum()))

    def normal(values: np.ndarray, i: int, j: int) -> np.ndarray:
        point = lambda a, b: values[a, b % columns] * LOOKING[a, b % columns]  # noqa: E731
        n = np.cross(point(i, j + 1) - point(i, j - 1), point(i + 1, j) - point(i - 1, j))
        return n / np.linalg.norm(n) * -np.sign(n @ LOOKING[i, j])

    true, found, both, angles = np.zeros(3), np.zeros(3), np.zeros(3), []
    for i in range(1, rows - 1):
        for j in range(columns):
            if not domain[i, j]:
                continue
            a = np.array([gradient(shape.range_m, i, j) > limit for limit in EDGES_M])
            b = np.array([gradient(given, i, j) > limit for limit in EDGES_M])
            true, found, both = true + a, found + b, both + (a & b)
            cosine = normal(shape.range_m, i, j) @ normal(given, i, j)
            if not discontinuity[i, j] and np.isfinite(cosine):
                angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    assert scores.precision == pytest.approx(both / found)
    assert scores.recall == pytest.approx(both / true)
    assert 0 < min(scores.recall) < max(scores.precision) <= 1
    # Counts are whole, and angles of the arccos near 1 lose half of their digits.
    assert scores.normal_mean_deg == pytest.approx(np.mean(angles), rel=1e-6)
    assert scores.normal_rmse_deg == pytest.approx(np.sqrt(np.mean(np.square(angles))), rel=1e-6)
    assert scores.normal_within == pytest.approx([np.mean(np.array(angles) < limit) for limit in NORMALS_DEG])
