"""Augmented Random Search: the update by hand, convergence, reproducibility, statistics and resume."""

import numpy as np
import pytest
from policies import stats_of

from motorprior.exceptions import SimulationFault
from motorprior.locomotion.ars import Ars, ArsConfig, RunningStats

TARGET = np.array([1.0, -2.0, 0.5, 0.0, 3.0])


def quadratic(parameters):
    return -float(np.sum((parameters - TARGET) ** 2))


def iterate(search, score=quadratic):
    """One iteration with two made-up observations per candidate."""
    tried = [search.candidate(*each) for each in search.ask()]
    returns = np.array([score(parameters) for parameters in tried]).reshape(-1, 2)
    search.tell(
        returns, [stats_of(np.stack([parameters[:2], parameters[2:4]])) for parameters in tried]
    )


def test_update_by_hand():
    search = Ars(
        ArsConfig(num_directions=3, num_top_directions=2, step_size=0.1, delta_std=0.5), 2, 1
    )
    d = [search.direction(k) for k in range(3)]
    # max(r+, r-) is 4, 1, 3: directions 0 and 2 are on top. Their returns 4, 2, 1, 3 have mean 2.5
    # and σ² = (2.25 + 0.25 + 2.25 + 0.25) / 4 = 1.25. Δ = 0.1 / (2 · √1.25) · ((4 - 2) δ0 + (1 - 3)
    # δ2).
    search.tell(np.array([[4.0, 2.0], [1.0, 0.0], [1.0, 3.0]]), [])
    np.testing.assert_allclose(
        search.parameters, 0.1 / (2.0 * np.sqrt(1.25)) * (2.0 * d[0] - 2.0 * d[2])
    )
    assert search.iteration == 1


def test_climbs_a_quadratic_to_its_top_also_when_resumed():
    config = ArsConfig(step_size=0.05, delta_std=0.05, seed=1)
    through = Ars(config, 5, 2)
    resumed = Ars(config, 5, 2)
    for iteration in range(300):
        iterate(through)
        if iteration == 289:
            resumed.restore(through.state())
        elif iteration > 289:
            iterate(resumed)
    np.testing.assert_allclose(through.parameters, TARGET, atol=0.1)
    for one, other in zip(resumed.state().values(), through.state().values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_merged_statistics_equal_numpy_over_everything():
    rng = np.random.default_rng(0)
    parts = [rng.normal(50.0, 3.0, (n, 4)) for n in (7, 0, 1, 120)]
    merged = RunningStats.empty(4)
    for part in parts:
        merged = merged.merge(stats_of(part))
    everything = np.concatenate(parts)
    assert merged.count == 128
    np.testing.assert_allclose(merged.mean, everything.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(merged.m2 / merged.count, everything.var(axis=0), rtol=1e-11)
    np.testing.assert_allclose(merged.std(), everything.std(axis=0), rtol=1e-11)


def test_a_return_that_is_not_finite_is_an_error():
    with pytest.raises(SimulationFault):
        Ars(ArsConfig(num_directions=2, num_top_directions=1), 5, 2).tell(
            np.array([[0.0, 1.0], [2.0, np.nan]]), []
        )
