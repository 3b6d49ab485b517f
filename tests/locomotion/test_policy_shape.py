"""Parameters of policies, their mirror symmetry, and the best policy of a search."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from policies import ACTIONS, OBSERVATIONS, stats_of

from motorprior.locomotion.ars import ArsConfig, RunningStats
from motorprior.locomotion.control_step import (
    RobotState,
    command_step,
    follow_command,
    new_gait,
    observe,
)
from motorprior.locomotion.executor import ThreadExecutor
from motorprior.locomotion.gait import walker_arrays
from motorprior.locomotion.policy import act
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape, mirror_of
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import Episode


def shape_of(units: int = 0, symmetric: bool = True) -> PolicyShape:
    return PolicyShape.of(PUPPER_V2, units, symmetric)


@pytest.fixture
def seen() -> RunningStats:
    rng = np.random.default_rng(0)
    return stats_of(rng.normal(0.4, rng.uniform(0.2, 2.0, OBSERVATIONS), (200, OBSERVATIONS)))


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("units", [0, 4])
def test_a_search_that_starts_from_a_policy_begins_with_that_very_policy(units, symmetric, seen):
    shape = shape_of(units, symmetric)
    arrays = shape.policy(0.2 * np.random.default_rng(1).standard_normal(shape.size), seen)

    first = PolicySearch(ArsConfig(), shape, arrays).policy(0, 0)

    for array, array_of_search in zip(arrays, first, strict=True):
        np.testing.assert_allclose(array, array_of_search, rtol=1e-9, atol=1e-12)


def test_statistics_of_a_symmetric_search_include_the_mirrored_observations(seen):
    swap = mirror_of(PUPPER_V2).inputs[:-1, :-1]
    observations = np.random.default_rng(3).normal(0.4, 1.0, (30, OBSERVATIONS))
    together = stats_of(np.concatenate([observations, observations @ swap]))

    merged = shape_of().symmetric_stats(stats_of(observations))

    np.testing.assert_allclose(merged.mean, together.mean, atol=1e-13)
    np.testing.assert_allclose(merged.std(), together.std(), rtol=1e-12)
    assert merged.count == 60
    assert shape_of(symmetric=False).symmetric_stats(seen) is seen


class Constant(ThreadExecutor):
    """An executor whose episodes all have the same return; it records policies and tasks."""

    def __init__(self, total: float):  # pyright: ignore[reportMissingSuperCall]
        self.total = total
        self.walked = []
        self.tasks = []

    def map(self, function: Any, shared: Any, tasks: Sequence[Any]) -> list[Any]:
        self.walked.append(shared.policy(*tasks[0][:2]))
        self.tasks.append(list(tasks))
        nothing = np.zeros(OBSERVATIONS)
        episode = Episode(self.total, 1, 0.0, np.zeros(2), 0, nothing, nothing, nothing, nothing)
        return [episode for _ in tasks]

    def close(self) -> None:
        pass


def test_the_averaged_policy_replaces_the_best_only_if_it_is_better():
    search = PolicySearch(ArsConfig(), shape_of())
    evaluator = Constant(1.0)
    search.ars.parameters = np.full(search.shape.size, 0.5)
    search.ars.average = np.full(search.shape.size, 0.1)
    search.evaluate(evaluator)
    averaged = search.shape.policy(search.ars.average, search.ars.observations)
    np.testing.assert_allclose(evaluator.walked[0].weights, averaged.weights)
    assert search.best_return == 1.0
    assert search.best_iteration == 0

    search.ars.average = np.full(search.shape.size, 0.2)
    best = search.best
    search.evaluate(evaluator)
    assert search.best is best, "as good is not better"

    evaluator.total = 1.1
    search.evaluate(evaluator)
    assert search.best is not best
    assert search.best_return == 1.1


def test_both_signs_of_a_direction_meet_the_same_motors_and_no_two_directions_do():
    walker = Constant(1.0)
    search = PolicySearch(ArsConfig(num_directions=5, num_top_directions=5), shape_of())

    for _ in range(3):
        search.advance(walker)

    signs: dict[tuple[int, int], set[int]] = {}
    seeds: dict[tuple[int, int], set[int]] = {}
    for iteration, tasks in enumerate(walker.tasks):
        for direction, sign, seed in tasks:
            signs.setdefault((iteration, direction), set()).add(sign)
            seeds.setdefault((iteration, direction), set()).add(seed)
    assert len(signs) == 15  # 3 iterations of 5 directions
    assert all(signs_of_direction == {-1, 1} for signs_of_direction in signs.values())
    assert all(len(seeds_of_direction) == 1 for seeds_of_direction in seeds.values())
    assert len(set.union(*seeds.values())) == 15


@pytest.mark.parametrize(("patience", "ends"), [(1, 40), (3, 80), (None, 90)])
def test_a_training_ends_when_its_return_has_not_increased_often_enough(patience, ends):
    search = PolicySearch(ArsConfig(), shape_of())
    candidates = Constant(5.0)
    evaluator = Constant(1.0)

    search.train(candidates, 90, evaluator, patience)

    assert search.best_iteration == 0
    assert search.ars.iteration == ends
    assert len(candidates.walked) == ends
    # at the start, after every 20 iterations, and at the end
    assert len(evaluator.walked) == 1 + math.ceil(ends / 20)


class Rising(Constant):
    """An executor whose returns rise for 30 iterations."""

    def map(self, function: Any, shared: Any, tasks: Sequence[Any]) -> list[Any]:
        self.total = min(len(self.walked), 30.0)
        return super().map(function, shared, tasks)


@pytest.mark.parametrize(("patience", "ends"), [(1, 80), (2, 100)])
def test_a_training_goes_on_while_its_return_rises(patience, ends):
    search = PolicySearch(ArsConfig(), shape_of())
    search.train(Rising(0.0), 120, Constant(1.0), patience)
    assert search.ars.iteration == ends


RIGHT_TO_LEFT = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
ABDUCTIONS = np.tile([-1.0, 1.0, 1.0], 4)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize(
    ("forward", "yaw_rate"), [(0.3, 0.4), (-0.2, 0.4), (0.0, 0.6), (-0.03, 0.6)]
)
def test_a_mirrored_robot_observes_the_mirrored_observation(forward: float, yaw_rate: float, rng):
    """Both gaits begin in the same pose; the phase of the mirrored one is half a cycle later."""
    inputs, actions = mirror_of(PUPPER_V2)
    walker = walker_arrays(PUPPER_V2)._replace(levelling_gain=0.2)
    gait = new_gait(walker)
    mirrored_gait = new_gait(walker)
    mirrored_gait.scalars[0] = 0.5

    def observed(gait_of_robot, quat, rates, joints, yaw_rate):
        nothing = np.zeros(3)
        pose = joints + PUPPER_V2.nominal_pose
        state = RobotState(nothing, quat, nothing, rates, pose, np.zeros((4, 3)), 0.0)
        observe(walker, state, gait_of_robot.observation)
        follow_command(walker, gait_of_robot, forward, yaw_rate)
        return gait_of_robot.observation

    for _ in range(60):
        quat = np.array([1.0, 0.0, 0.0, 0.0]) + rng.uniform(0.1, 0.2, 4)
        quat /= np.linalg.norm(quat)
        rates = rng.standard_normal(3)
        joints = rng.standard_normal(12)
        observation = observed(gait, quat, rates, joints, yaw_rate)

        mirrored_observation = observed(
            mirrored_gait,
            quat * [1.0, -1.0, 1.0, -1.0],
            rates * [-1.0, 1.0, -1.0],
            ABDUCTIONS * joints[RIGHT_TO_LEFT],
            -yaw_rate,
        )
        reflection = inputs[:-1, :-1] @ observation
        np.testing.assert_allclose(reflection, mirrored_observation, atol=1e-12)

        action = rng.uniform(-1.0, 1.0, ACTIONS)
        command_step(walker, gait, action)
        command_step(walker, mirrored_gait, actions @ action)
        mirrored_target = ABDUCTIONS * gait.target[RIGHT_TO_LEFT]
        np.testing.assert_allclose(mirrored_target, mirrored_gait.target, atol=1e-12)


@pytest.mark.parametrize("units", [0, 5])
def test_a_symmetric_policy_answers_the_mirrored_observation_with_the_mirrored_action(units, rng):
    shape = PolicyShape.of(PUPPER_V2, 2 * units, symmetric=True)
    seen = stats_of(rng.normal(0.3, 1.0, (40, OBSERVATIONS)))
    policy = shape.policy(0.15 * rng.standard_normal(shape.size), seen)
    assert len(policy.hidden) == 2 * units
    inputs, actions = mirror_of(PUPPER_V2)
    action = np.zeros(ACTIONS)
    mirrored_action = np.zeros(ACTIONS)

    for observation in rng.normal(0.0, 1.0, (50, OBSERVATIONS)):
        act(policy, observation, action)
        act(policy, inputs[:-1, :-1] @ observation, mirrored_action)
        np.testing.assert_allclose(mirrored_action, actions @ action, atol=1e-12)
        assert not np.all(np.abs(action) == 1.0), "a policy at its limits shows nothing"
