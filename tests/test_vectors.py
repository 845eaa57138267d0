"""Vectors of eight numbers in compiled loops: each number is NumPy's to the last bit, and no other is touched."""

import numpy as np

from harness.compiled import kernel
from harness.matching._vector_kernels import (
    LANES,
    absolute,
    bits_set,
    doubles,
    from_1,
    from_2,
    from_4,
    load,
    load_four,
    numbers,
    singles,
    store,
    times,
    zeros,
)

RNG = np.random.default_rng(7)
INTEGERS = RNG.integers(-(2**31), 2**31, (4, 30), dtype=np.int64).astype(np.int32)
SINGLES = (RNG.standard_normal((4, 30)) * 10.0 ** RNG.integers(-6, 6, (4, 30))).astype(np.float32)
SINGLES[0, :3] = 0.0, -0.0, np.inf


@kernel
def _of_floats(a, b, row, column, out):
    x, y = load(a, (row, column)), load(b, (row, column))
    store(out, (0, column), x + y)
    store(out, (1, column), x - y)
    store(out, (2, column), x * y)
    store(out, (3, column), absolute(x))
    total = zeros(np.float32)
    for i in range(row + 1):
        total += load(a, (i, column))
    store(out, (4, column), total)


@kernel
def _of_integers(a, b, row, column, bits, out):
    x, y = load(a, (row, column)), load(b, (row, column))
    store(bits, (0, column), bits_set(x ^ y))
    store(bits, (1, column), x + y)
    store(out, (column,), singles(x - y))


@kernel
def _in_doubles(a, b, row, column, out):
    store(out, (column,), doubles(load(a, (row, column))) * doubles(load(b, (row, column))))


@kernel
def _four(a, row, column, factor, out):
    four = times(factor, doubles(load_four(a, (row, column))))
    first, second, third, last = numbers(four)
    out[0], out[1], out[2], out[3] = last, third, second, first
    store(out, (4,), four)


@kernel
def _across(a, row, column, out):
    first, second = load(a, (row, column)), load(a, (row, column + LANES))
    store(out, (0, 0), from_1(first, second))
    store(out, (1, 0), from_2(first, second))
    store(out, (2, 0), from_4(first, second))


def _around(column: int) -> tuple[slice, list[int]]:
    """The numbers of a vector, and all beside it."""
    return slice(column, column + LANES), [i for i in range(SINGLES.shape[1]) if not column <= i < column + LANES]


def test_floating_point_numbers_are_those_of_numpy_wherever_the_vector_begins():
    other = SINGLES[::-1].copy()
    for column in (0, 1, 7, SINGLES.shape[1] - LANES):
        out = np.full((5, SINGLES.shape[1]), np.float32(-3))
        _of_floats(SINGLES, other, 2, column, out)
        vector, beside = _around(column)
        a, b = SINGLES[2, vector], other[2, vector]
        in_order = (SINGLES[0, vector] + SINGLES[1, vector]) + a
        for row, expected in zip(out, (a + b, a - b, a * b, np.abs(a), in_order), strict=True):
            np.testing.assert_array_equal(row[vector].view(np.int32), expected.view(np.int32))
        assert (out[:, beside] == -3).all()


def test_whole_numbers_are_those_of_numpy_and_overflow_as_they_do():
    other = np.roll(INTEGERS, 5, axis=1)
    bits, out = np.full((2, INTEGERS.shape[1]), -3, np.int32), np.full(INTEGERS.shape[1], np.float32(-3))
    _of_integers(INTEGERS, other, 1, 9, bits, out)
    vector, beside = _around(9)
    a, b = INTEGERS[1, vector], other[1, vector]
    assert bits[0, vector].tolist() == [int(np.uint32(x)).bit_count() for x in a ^ b]
    np.testing.assert_array_equal(bits[1, vector], a + b)
    np.testing.assert_array_equal(out[vector], (a - b).astype(np.float32))
    assert (bits[:, beside] == -3).all()
    assert (out[beside] == -3).all()


def test_products_in_double_precision_are_exact():
    out = np.full(SINGLES.shape[1], -3.0)
    _in_doubles(SINGLES, SINGLES[::-1].copy(), 3, 22, out)
    vector, beside = _around(22)
    np.testing.assert_array_equal(out[vector], SINGLES[3, vector].astype(float) * SINGLES[0, vector].astype(float))
    assert (out[beside] == -3).all()


def test_vectors_of_four_come_apart_in_order():
    out = np.full(10, -3.0)
    _four(SINGLES, 1, SINGLES.shape[1] - 4, 0.1, out)
    expected = 0.1 * SINGLES[1, -4:].astype(float)
    np.testing.assert_array_equal(out, [*expected[::-1], *expected, -3, -3])


def test_numbers_across_two_vectors():
    out = np.empty((3, LANES), np.float32)
    _across(SINGLES, 1, 3, out)
    for row, begin in zip(out, (1, 2, 4), strict=True):
        np.testing.assert_array_equal(row, SINGLES[1, 3 + begin : 3 + begin + LANES])
