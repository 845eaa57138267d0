"""What surroundings say of a match: against plain loops, and on an edge whose planes are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from harness.matching.slanted import _doubt_kernels as _kernels
from harness.matching.slanted.doubt import Surroundings, factor, factor_by_start, unlike
from harness.matching.slanted.sigma import doubted


def field(shape=(40, 50), seed=1):
    """Random planes, of which every pixel takes its own, one beside it, or none."""
    draws = np.random.default_rng(seed)
    x = draws.normal(size=(*shape, 3))
    plane = draws.normal(size=(*shape, 3))
    chosen = np.arange(np.prod(shape)).reshape(shape)
    moved = draws.random(shape) < 0.3
    chosen = np.where(moved, np.roll(chosen, 3, axis=1), chosen)
    chosen[draws.random(shape) < 0.2] = -1
    gain, offset = draws.uniform(0.8, 1.2, shape), draws.uniform(-5, 5, shape)
    first, value = draws.uniform(0, 255, (2, *shape)).astype(np.float32)
    known = draws.random(shape) < 0.9
    w = np.where(chosen >= 0, np.sum(plane.reshape(-1, 3)[chosen] * x, axis=-1), np.nan)
    return x, first, known, value, plane, chosen, gain, offset, w


def surroundings(reach, parts):
    square, disagreement = np.empty((2, *parts[-1].shape))
    _kernels.surroundings_rows(0, len(square), reach, *parts, square, disagreement)
    return square, disagreement


def test_the_third_best_of_eight_planes_around_counts():
    parts = field()
    x, _, _, _, plane, chosen, _, _, w = parts
    _, disagreement = surroundings(4, parts)
    for i, j in ((0, 0), (3, 20), (20, 25), (39, 49), (11, 4), (30, 47), (25, 12)):
        if chosen[i, j] < 0:
            assert disagreement[i, j] == np.inf
            continue
        others = sorted(
            abs(plane.reshape(-1, 3)[chosen[row, column]] @ x[i, j] - w[i, j])
            for row in (i - 4, i, i + 4)
            for column in (j - 4, j, j + 4)
            if (row, column) != (i, j) and 0 <= row < 40 and 0 <= column < 50 and chosen[row, column] >= 0
        )
        # A sum of three products: a few roundings.
        assert disagreement[i, j] == pytest.approx(others[2] if len(others) > 2 else np.inf, rel=1e-12)


def test_residuals_are_those_of_the_chosen_plane():
    parts = field()
    _, first, known, value, _, chosen, gain, offset, _ = parts
    square, _ = surroundings(4, parts)
    there = known & (chosen >= 0)
    expected = np.where(there, (first - gain.ravel()[chosen] * value - offset.ravel()[chosen]) ** 2, 0)
    # Grey levels are single, their products double.
    assert square == pytest.approx(expected, rel=1e-12)


def test_on_the_far_side_of_a_border_planes_need_not_agree():
    """Two planes side by side, one of them far in front: pixels of both have five neighbours of their own there."""
    parts = list(field())
    shape = parts[-1].shape
    parts[0] = np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)).copy()
    parts[4] = np.where(np.arange(shape[1])[None, :, None] < 25, [0.0, 0.0, 0.3], [0.0, 0.0, 0.9]) * np.ones(
        (*shape, 1)
    )
    parts[5] = np.arange(np.prod(shape)).reshape(shape)
    parts[8] = parts[4][..., 2].copy()
    _, disagreement = surroundings(4, parts)
    assert not disagreement[4:-4, 4:-4].any()


def one_pixel(unexplained=0.1, near=1.0, whole=1.0):
    """Two pixels alike."""
    residual = np.ones(2, np.float32)
    return Surroundings(
        np.zeros(2), residual, np.full(2, unexplained, np.float32), np.full(2, near, float), np.full(2, whole, float)
    )


INDEX = np.array([0, 1])


def test_a_match_like_its_window_is_not_doubted():
    assert factor(one_pixel(), INDEX, INDEX) == pytest.approx([1.0, 1.0])


def test_what_makes_doubt():
    usual, own = factor(one_pixel(), INDEX, INDEX)[0], INDEX
    assert factor(one_pixel(unexplained=0.7), INDEX, own)[0] > 2 * usual
    assert factor(one_pixel(near=0.1), INDEX, own)[0] > 3 * usual
    assert factor(one_pixel(), INDEX, INDEX[::-1])[0] == pytest.approx(2 * usual)
    assert factor(one_pixel(near=0.0), INDEX, own)[0] == np.inf  # a blank place


def test_a_match_is_doubted_as_far_as_it_has_left_the_start():
    from_start = np.array([0.0, 0.1, 0.5, 1.0, 5.0, 50.0, 500.0, np.nan])
    doubt = factor_by_start(from_start, np.ones(8, bool))
    assert doubt[:-1] == pytest.approx(np.clip(from_start[:-1], 0.25, 10.0) / 0.6)
    assert doubt[3] < doubt[-1] < doubt[4]  # without a start, as a few pixels away from one
    # Where the views have nothing in common, what has stayed at the start is doubted no less for it.
    assert factor_by_start(from_start, np.zeros(8, bool)) == pytest.approx(np.maximum(doubt, 1.0))


def test_doubt_makes_standard_deviations_larger_and_its_lack_none_smaller():
    assert doubted(np.full(4, 0.1), np.array([0.3, 1.0, 32.0, np.inf])) == pytest.approx([0.1, 0.1, 0.2, np.inf])


def test_nothing_known_is_no_certainty():
    assert not factor(one_pixel(near=np.nan), INDEX, INDEX)[0] <= 1e9


def test_unlike_is_what_leaves_twice_the_middle_residual():
    around = one_pixel()
    residual = np.array([1.0, 2.0, 3.0, 4.5, 100.0, np.nan], np.float32)
    object.__setattr__(around, "residual", residual)
    # The last two have no plane, and do not count towards the middle, which is 2.5.
    field = SimpleNamespace(chosen=np.array([0, 1, 2, 3, -1, -1]))
    assert unlike(field, around).tolist() == [False, False, False, False, True, False]
    around.residual[3] = 6.0
    assert unlike(field, around).tolist() == [False, False, False, True, True, False]
