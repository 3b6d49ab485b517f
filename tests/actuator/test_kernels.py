"""Arrays without reference counts are the same arrays, and nothing leaks."""

import sys
from typing import NamedTuple

import numpy as np
from numba import njit

from motorprior.actuator.kernels import without_refcounts


class Pair(NamedTuple):
    number: int
    inner: tuple[np.ndarray, np.ndarray]
    strided: np.ndarray


@njit
def double(pair, single):
    pair, single = without_refcounts(pair), without_refcounts(single)
    for k in range(3):
        row = pair.inner[0][k]
        row *= 2.0
    pair.inner[1][1:] = pair.number
    pair.strided[:] += single[0]


def test_what_is_written_lands_in_the_owners_arrays_and_nothing_leaks():
    table, flat, wide, single = np.ones((3, 2)), np.zeros(3, np.int64), np.zeros((2, 8)), np.array([5.0])
    pair = Pair(7, (table, flat), wide[:, ::4])
    arrays = (table, flat, wide, single, pair.strided)
    double(pair, single)  # compiles, and the compiler keeps references of its own
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(3):
        double(pair, single)
    assert [sys.getrefcount(array) for array in arrays] == before
    np.testing.assert_array_equal(table, 16.0)
    np.testing.assert_array_equal(flat, [0, 7, 7])
    np.testing.assert_array_equal(wide[:, ::4], 20.0)
    np.testing.assert_array_equal(wide[:, 1:4], 0.0)
