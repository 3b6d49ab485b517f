"""Parameters stand for a policy and back, with and without normalisation of what it observes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from policies import ACTIONS, OBSERVATIONS, as_file_content, random_policy

from motorprior.exceptions import ConfigError
from motorprior.locomotion.policy import act
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig, Candidate
from motorprior.search.moments import Moments
from motorprior.search.policy_search import Champion, Round, advance, contest, new_search, train
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.rollout import Episode

SIZE = ACTIONS * (OBSERVATIONS + 1)


def shape_of(units: int = 0, symmetric: bool = True, gait: str = "trot") -> PolicyShape:
    return PolicyShape.of(PUPPER_V2, gait, units, symmetric)


@pytest.fixture
def seen() -> Moments:
    rng = np.random.default_rng(0)
    return Moments.of(rng.normal(0.4, rng.uniform(0.2, 2.0, OBSERVATIONS), (200, OBSERVATIONS)))


def acted(policy, observation: np.ndarray) -> np.ndarray:
    out = np.zeros(ACTIONS)
    act(policy, observation, out)
    return out


@pytest.mark.parametrize(("units", "size"), [(0, SIZE), (3, SIZE + 3 * (OBSERVATIONS + 1 + ACTIONS))])
def test_number_of_parameters(units: int, size: int):
    assert shape_of(units).size == shape_of(units, symmetric=False).size == size


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("units", [0, 4])
def test_a_search_that_starts_from_a_policy_begins_with_that_very_policy(units, symmetric, seen):
    shape = shape_of(units, symmetric)
    arrays = shape.policy(0.2 * np.random.default_rng(1).standard_normal(shape.size), seen)
    search = new_search(ArsConfig(), shape, as_file_content(arrays))
    again = Round.of(search, shape).policy(Candidate(0, 0))
    for one, other in zip(arrays, again, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_a_start_of_another_number_of_hidden_units_is_refused():
    with pytest.raises(ConfigError, match="the policy to start from has 3 hidden units, wanted 4"):
        new_search(ArsConfig(), shape_of(2), as_file_content(random_policy(0.1, 0, units=3)))


@pytest.mark.parametrize(("units", "changed"), [(0, "weights"), (2, "hidden"), (2, "readout")])
def test_a_start_that_may_limp_is_refused_by_a_search_that_may_not(units, changed, seen):
    shape = shape_of(units)
    arrays = shape.policy(np.random.default_rng(1).standard_normal(shape.size), seen)
    getattr(arrays, changed)[0, 3] += 0.1
    with pytest.raises(ConfigError, match=f"the {changed} of the policy to start from are not symmetric -> train with"):
        new_search(ArsConfig(), shape, as_file_content(arrays))
    free = shape_of(2 * units, symmetric=False)
    assert new_search(ArsConfig(), free, as_file_content(arrays)).parameters.size == free.size


def test_a_symmetric_search_sees_what_it_would_have_seen_in_a_mirror(seen):
    shape = shape_of()
    both, swap = shape.seen(seen), shape_of().mirror.observation  # pyright: ignore[reportOptionalMemberAccess]
    observations = np.random.default_rng(3).normal(0.4, 1.0, (30, OBSERVATIONS))
    together = Moments.of(np.concatenate([observations, swap.of(observations)]))
    merged = shape.seen(Moments.of(observations))
    np.testing.assert_allclose(merged.mean, together.mean, atol=1e-13)
    np.testing.assert_allclose(merged.std(), together.std(), rtol=1e-12)
    np.testing.assert_allclose(swap.of(both.mean), both.mean, atol=1e-15)
    assert both.count == 2 * seen.count and shape_of(symmetric=False).seen(seen) is seen


def test_version_1_observes_as_it_is_and_version_2_by_mean_and_spread(seen):
    shape, parameters = shape_of(symmetric=False), np.random.default_rng(2).normal(0.0, 0.02, SIZE)
    weights = parameters.reshape(ACTIONS, OBSERVATIONS + 1)
    for normalise in (False, True):
        search = new_search(ArsConfig(normalise=normalise), shape)
        search.parameters, search.observations = parameters, seen
        policy = Round.of(search, shape).policy(Candidate(0, 0))
        observation = np.random.default_rng(4).normal(0.4, 1.0, OBSERVATIONS)
        inputs = (observation - seen.mean) / seen.std() if normalise else observation
        expected = np.clip(weights @ np.append(np.clip(inputs, -10.0, 10.0), 1.0), -1.0, 1.0)
        np.testing.assert_allclose(acted(policy, observation), expected, atol=1e-12)


def test_a_search_of_version_1_starts_from_a_policy_of_version_2_as_it_is(seen):
    shape = shape_of(2)
    arrays = shape.policy(0.1 * np.random.default_rng(1).standard_normal(shape.size), seen)
    search = new_search(ArsConfig(normalise=False), shape, as_file_content(arrays))
    again = Round.of(search, shape).policy(Candidate(0, 0))
    for observation in np.random.default_rng(5).normal(0.4, 1.0, (20, OBSERVATIONS)):
        np.testing.assert_allclose(acted(again, observation), acted(arrays, observation), atol=1e-12)


@pytest.mark.parametrize("units", [0, 5])
def test_a_new_search_leaves_the_gait_as_it_is_and_its_hidden_units_differ(units):
    shape = shape_of(units)
    policy = Round.of(new_search(ArsConfig(seed=1), shape), shape).policy(Candidate(0, 0))
    for observation in np.random.default_rng(6).standard_normal((5, OBSERVATIONS)):
        assert not acted(policy, observation).any()
    assert len(policy.hidden) == 2 * units == len({row.tobytes() for row in policy.hidden})
    other = new_search(ArsConfig(seed=2), shape)
    assert np.array_equal(other.parameters, new_search(ArsConfig(seed=1), shape).parameters) == (units == 0)


class Judge:
    """An executor whose episodes all earn the same; it remembers what walked."""

    def __init__(self, total: float):
        self.total, self.walked, self.tasks = total, [], []

    def map(self, function: Any, shared: Any, tasks: Sequence[Any]) -> list[Any]:
        self.walked.append(shared.policy(tasks[0].candidate))
        self.tasks.append(list(tasks))
        nothing = np.zeros(OBSERVATIONS)
        return [Episode(self.total, 1, 0.0, np.zeros(2), 0, 1, nothing, nothing, nothing, nothing) for _ in tasks]

    def close(self) -> None:
        pass


def test_the_averaged_policy_challenges_the_champion_and_must_be_better():
    shape = shape_of()
    search, judge = new_search(ArsConfig(), shape), Judge(1.0)
    search.parameters, search.average = np.full(shape.size, 0.5), np.full(shape.size, 0.1)
    champion = contest(search, shape, judge, Champion.none_yet(shape))
    np.testing.assert_allclose(judge.walked[0].weights, shape.policy(search.average, search.observations).weights)
    assert champion.score == 1.0 and champion.policy is not None
    search.average = np.full(shape.size, 0.2)
    assert contest(search, shape, judge, champion) is champion, "as good is not better"
    judge.total = 1.1
    assert contest(search, shape, judge, champion).score == 1.1


def test_both_signs_of_a_direction_meet_the_same_motors_and_no_two_directions_do():
    shape, walker = shape_of(), Judge(1.0)
    search = new_search(ArsConfig(num_directions=5, num_top_directions=5), shape)
    for _ in range(3):
        advance(search, shape, walker)
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for iteration, tasks in enumerate(walker.tasks):
        for task in tasks:
            met = pairs.setdefault((iteration, task.candidate.direction), [])
            met.append((task.candidate.sign, task.seed))
    assert len(pairs) == 15
    assert all({sign for sign, _ in met} == {-1, 1} and len({seed for _, seed in met}) == 1 for met in pairs.values())
    assert len({met[0][1] for met in pairs.values()}) == 15


@pytest.mark.parametrize(("patience", "ends"), [(1, 10), (3, 30), (None, 45)])
def test_a_training_ends_when_the_champion_has_won_often_enough(patience, ends):
    """Nothing is better than the first champion: the candidates walk elsewhere than the contests."""
    shape = shape_of()
    search, candidates, judge = new_search(ArsConfig(), shape), Judge(5.0), Judge(1.0)
    champion = contest(search, shape, judge, Champion.none_yet(shape))
    kept = train(search, shape, candidates, 45, champion, judge=judge, patience=patience)
    assert kept is champion and search.iteration == ends
    assert len(judge.walked) == 1 + -(-ends // 10) and len(candidates.walked) == ends


def test_a_better_policy_starts_the_patience_anew():
    shape = shape_of()
    search, judge = new_search(ArsConfig(), shape), Judge(1.0)
    champion = contest(search, shape, judge, Champion.none_yet(shape))
    train(search, shape, Judge(0.0), 10, champion, judge=judge, patience=2)
    judge.total = 2.0
    better = train(search, shape, Judge(0.0), 20, champion, judge=judge, patience=2)
    assert better.iteration == 20 and train(search, shape, Judge(0.0), 90, better, judge=judge, patience=2) is better
    assert search.iteration == 40


def test_a_champion_survives_its_file(seen):
    shape = shape_of(2)
    policy = shape.policy(np.random.default_rng(7).standard_normal(shape.size), seen)
    champion = replace(Champion.none_yet(shape), policy=policy, score=1.5, iteration=20)
    again = Champion.restore(champion.state())
    assert (again.score, again.iteration) == (1.5, 20)
    for one, other in zip(champion.policy, again.policy, strict=True):
        np.testing.assert_array_equal(one, other)
    assert Champion.none_yet(shape).score < -1e300
