"""Parameters stand for a policy and back; the search keeps the best policy of its evaluations."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from policies import OBSERVATIONS, as_file_content, stats_of

from motorprior.locomotion.ars import ArsConfig, RunningStats
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rollout import Episode


def shape_of(units: int = 0, symmetric: bool = True, gait: str = "trot") -> PolicyShape:
    return PolicyShape.of(PUPPER_V2, gait, units, symmetric)


@pytest.fixture
def seen() -> RunningStats:
    rng = np.random.default_rng(0)
    return stats_of(rng.normal(0.4, rng.uniform(0.2, 2.0, OBSERVATIONS), (200, OBSERVATIONS)))


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("units", [0, 4])
def test_a_search_that_starts_from_a_policy_begins_with_that_very_policy(units, symmetric, seen):
    shape = shape_of(units, symmetric)
    arrays = shape.policy(0.2 * np.random.default_rng(1).standard_normal(shape.size), seen)
    again = PolicySearch(ArsConfig(), shape, as_file_content(arrays)).policy(0, 0)
    for one, other in zip(arrays, again, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_a_symmetric_search_sees_what_it_would_have_seen_in_a_mirror(seen):
    shape = shape_of()
    both, swap = shape.symmetric_stats(seen), shape_of().mirror.observation  # pyright: ignore[reportOptionalMemberAccess]
    observations = np.random.default_rng(3).normal(0.4, 1.0, (30, OBSERVATIONS))
    together = stats_of(np.concatenate([observations, swap.mirrored(observations)]))
    merged = shape.symmetric_stats(stats_of(observations))
    np.testing.assert_allclose(merged.mean, together.mean, atol=1e-13)
    np.testing.assert_allclose(merged.std(), together.std(), rtol=1e-12)
    np.testing.assert_allclose(swap.mirrored(both.mean), both.mean, atol=1e-15)
    assert both.count == 2 * seen.count and shape_of(symmetric=False).symmetric_stats(seen) is seen


class Constant:
    """An executor whose episodes all have the same return; it records policies and tasks."""

    def __init__(self, total: float):
        self.total, self.walked, self.tasks = total, [], []

    def map(self, function: Any, shared: Any, tasks: Sequence[Any]) -> list[Any]:
        self.walked.append(shared.policy(*tasks[0][:2]))
        self.tasks.append(list(tasks))
        nothing = np.zeros(OBSERVATIONS)
        return [Episode(self.total, 1, 0.0, np.zeros(2), 0, nothing, nothing, nothing, nothing) for _ in tasks]

    def close(self) -> None:
        pass


def test_the_averaged_policy_replaces_the_best_only_if_it_is_better():
    search, evaluator = PolicySearch(ArsConfig(), shape_of()), Constant(1.0)
    search.ars.parameters, search.ars.average = np.full((2, search.shape.size), [[0.5], [0.1]])
    search.evaluate(evaluator)
    averaged = search.shape.policy(search.ars.average, search.ars.observations)
    np.testing.assert_allclose(evaluator.walked[0].weights, averaged.weights)
    assert search.best_return == 1.0 and search.best_iteration == 0
    search.ars.average, best = np.full(search.shape.size, 0.2), search.best
    search.evaluate(evaluator)
    assert search.best is best, "as good is not better"
    evaluator.total = 1.1
    search.evaluate(evaluator)
    assert search.best is not best and search.best_return == 1.1


def test_both_signs_of_a_direction_meet_the_same_motors_and_no_two_directions_do():
    walker = Constant(1.0)
    search = PolicySearch(ArsConfig(num_directions=5, num_top_directions=5), shape_of())
    for _ in range(3):
        search.advance(walker)
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for iteration, tasks in enumerate(walker.tasks):
        for direction, sign, seed in tasks:
            pairs.setdefault((iteration, direction), []).append((sign, seed))
    assert len(pairs) == 15
    assert all({sign for sign, _ in met} == {-1, 1} and len({seed for _, seed in met}) == 1 for met in pairs.values())
    assert len({met[0][1] for met in pairs.values()}) == 15


@pytest.mark.parametrize(("patience", "ends"), [(1, 10), (3, 30), (None, 45)])
def test_a_training_ends_after_enough_evaluations_without_a_better_policy(patience, ends):
    search, candidates, evaluator = PolicySearch(ArsConfig(), shape_of()), Constant(5.0), Constant(1.0)
    search.train(candidates, 45, evaluator, patience)
    assert search.best_iteration == 0 and search.ars.iteration == ends
    assert len(evaluator.walked) == 1 + -(-ends // 10) and len(candidates.walked) == ends
