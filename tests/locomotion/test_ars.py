"""Augmented Random Search: update by hand, convergence, resumption and running statistics."""

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
    candidates = [search.candidate(*task) for task in search.ask()]
    returns = np.array([score(parameters) for parameters in candidates]).reshape(-1, 2)
    observations = [np.stack([parameters[:2], parameters[2:4]]) for parameters in candidates]
    search.tell(returns, [stats_of(values) for values in observations])


def test_an_update_is_the_step_by_hand():
    config = ArsConfig(num_directions=3, num_top_directions=2, step_size=0.1, delta_std=0.5)
    search = Ars(config, 2, 1)
    d = [search.direction(k) for k in range(3)]

    search.tell(np.array([[4.0, 2.0], [1.0, 0.0], [1.0, 3.0]]), [])

    # max(r+, r-) is 4, 1, 3: directions 0 and 2 are on top. Their returns 4, 2, 1, 3 have mean 2.5
    # and σ² = (2.25 + 0.25 + 2.25 + 0.25) / 4 = 1.25.
    # Δ = 0.1 / (2 · √1.25) · ((4 - 2) δ0 + (1 - 3) δ2)
    step = 0.1 / (2.0 * np.sqrt(1.25)) * (2.0 * d[0] - 2.0 * d[2])
    np.testing.assert_allclose(search.parameters, step)
    assert search.iteration == 1


def test_a_search_climbs_a_quadratic_to_its_top_also_when_resumed():
    config = ArsConfig(step_size=0.05, delta_std=0.05, seed=1)
    through = Ars(config, 5, 2)
    resumed = Ars(config, 5, 2)

    for _ in range(290):
        iterate(through)
    resumed.restore(through.state())
    for _ in range(10):
        iterate(through)
        iterate(resumed)

    np.testing.assert_allclose(through.parameters, TARGET, atol=0.1)
    for name, array in through.state().items():
        np.testing.assert_array_equal(resumed.state()[name], array)


def test_the_first_average_is_the_first_parameters_and_a_constant_search_is_its_average():
    config = ArsConfig(num_directions=2, num_top_directions=2, step_size=0.1, delta_std=0.5)
    search = Ars(config, 5, 2)

    iterate(search)
    np.testing.assert_allclose(search.average, search.parameters, rtol=1e-12)

    first = search.parameters
    for _ in range(200):  # equal returns: the parameters stay
        search.tell(np.ones((2, 2)), [])
    np.testing.assert_allclose(search.average, first, rtol=1e-12)


def test_the_average_follows_a_moving_search_closely_at_first():
    search = Ars(ArsConfig(step_size=0.05, delta_std=0.05, seed=1), 5, 2)

    for _ in range(10):
        iterate(search)

    behind = np.linalg.norm(search.parameters - search.average)
    assert behind < 0.35 * np.linalg.norm(search.parameters)


def test_merged_statistics_equal_numpy_over_everything():
    rng = np.random.default_rng(0)
    samples = [rng.normal(50.0, 3.0, (n, 4)) for n in (7, 0, 1, 120)]

    merged = RunningStats.empty(4)
    for sample in samples:
        merged = merged.merge(stats_of(sample))

    everything = np.concatenate(samples)
    assert merged.count == 128
    np.testing.assert_allclose(merged.mean, everything.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(merged.m2 / merged.count, everything.var(axis=0), rtol=1e-11)
    np.testing.assert_allclose(merged.std(), everything.std(axis=0), rtol=1e-11)


def test_a_return_that_is_not_finite_is_an_error():
    search = Ars(ArsConfig(num_directions=2, num_top_directions=1), 5, 2)
    with pytest.raises(SimulationFault):
        search.tell(np.array([[0.0, 1.0], [2.0, np.nan]]), [])
