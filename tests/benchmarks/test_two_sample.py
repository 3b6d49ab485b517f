"""Two-sample statistics: calibrated on one fleet, powerful between two, blind to units."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.physical import PhysicalActuator
from virtual_fleets.behaviour import behaviours
from virtual_fleets.two_sample import area_under_curve, two_sample_auc

COUNT = 64


def auc_spread(n: int, m: int) -> float:
    """Standard deviation of the AUC of a fixed score, n against m motors of one distribution.

    Mann & Whitney (1947).
    """
    return float(np.sqrt((n + m + 1) / (12 * n * m)))


@pytest.fixture(scope="module")
def fleet():
    """(256, F) features of motors of one fleet."""
    motors = require_geared(load_fleet("mixed").sample(4 * COUNT, np.random.default_rng(21)))
    return behaviours(PhysicalActuator(motors))


def halves(fleet, seed):
    index = np.random.default_rng(seed).permutation(len(fleet))
    return fleet[index[:COUNT]], fleet[index[COUNT : 2 * COUNT]]


def test_area_under_the_curve_counts_pairs_and_halves_ties():
    assert area_under_curve(np.array([2.0, 3.0]), np.array([1.0, 2.0])) == 3.5 / 4
    assert area_under_curve(np.zeros(5), np.zeros(3)) == 0.5
    rng = np.random.default_rng(0)
    one = rng.integers(0, 5, 30).astype(float)
    other = rng.integers(1, 6, 20).astype(float)
    pairs = np.mean((one[:, None] > other) + 0.5 * (one[:, None] == other))
    assert area_under_curve(one, other) == pytest.approx(pairs)


def test_one_fleet_against_itself_is_at_chance(fleet):
    areas = [two_sample_auc(*halves(fleet, seed), seed) for seed in range(12)]
    spread = auc_spread(COUNT, COUNT)
    assert abs(np.mean(areas) - 0.5) < 0.6 * spread
    assert np.max(np.abs(np.array(areas) - 0.5)) < 4 * spread


def test_a_fifth_more_kp_is_detected():
    source = load_fleet("pupper_v2")
    ours, theirs = (
        require_geared(source.sample(2 * COUNT, np.random.default_rng(seed))) for seed in (1, 2)
    )
    stiff = replace(theirs, kp=1.2 * theirs.kp)
    a, b = (behaviours(PhysicalActuator(motors)) for motors in (ours, stiff))
    assert two_sample_auc(a, b, 0) > 0.5 + 4 * auc_spread(2 * COUNT, 2 * COUNT)


def test_a_difference_of_spread_alone_is_detected():
    a, b = (
        size * np.random.default_rng(seed).standard_normal((2 * COUNT, 4))
        for seed, size in ((3, 1.0), (4, 2.0))
    )
    alone = np.array([area_under_curve(*columns) for columns in zip(a.T, b.T, strict=True)])
    assert np.abs(alone - 0.5).max() < 3 * auc_spread(len(a), len(b))
    assert two_sample_auc(a, b, 0) > 0.5 + 4 * auc_spread(len(a), len(b))
