"""Functions of signals agree with their closed forms."""

import numpy as np

from motorprior.signals import runs_of_true


def test_runs_of_true_are_half_open_ranges_of_indices():
    mask = np.array([True, False, True, True, False, False, True])

    assert runs_of_true(mask).tolist() == [[0, 1], [2, 4], [6, 7]]
    assert runs_of_true(mask & False).shape == (0, 2)
