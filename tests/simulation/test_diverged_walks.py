"""Walks that diverged are no falls, and a policy remembers its robot's weight."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

from dataclasses import replace
from types import SimpleNamespace

import pytest

from motorprior.exceptions import SimulationFault
from motorprior.locomotion.policy import Policy, zero_policy
from motorprior.robots.load import load_robot
from motorprior.simulation.scene import require_walks
from motorprior.simulation.training import WEIGHT, Training, WalkSettings, other_weight

ROBOT = load_robot("pupper_v2")


def test_a_training_whose_episodes_diverge_keeps_no_policy():
    training = Training(ROBOT, "pd", WalkSettings())
    episodes = 2 * training.settings.search.num_directions
    training.curve = [{"faults": {"too large": episodes}}, {"faults": {"too large": episodes // 10}}]
    with pytest.raises(
        SimulationFault, match=f"{episodes + episodes // 10} of {2 * episodes} episodes.*no policy is kept"
    ):
        training._require_physics()
    training.curve.append({"faults": {}})
    training._require_physics()


def test_diverged_walks_are_named_and_counted():
    episodes = [SimpleNamespace(fault=fault) for fault in (0, 1, 1)]
    with pytest.raises(SimulationFault, match=r"2 of 3 walks of paper had a simulation fault .*smaller gains"):
        require_walks(episodes, "paper")  # pyright: ignore[reportArgumentType]
    require_walks(episodes[:1], "paper")  # pyright: ignore[reportArgumentType]


def test_a_heavier_robot_than_the_trained_one_is_a_warning():
    policy = Policy.of(ROBOT, zero_policy(ROBOT.num_joints), ROBOT.nominal_pose, ROBOT.nominal_pose)
    assert not other_weight(policy, ROBOT)
    trained = replace(policy, provenance={WEIGHT: ROBOT.weight - 4.0 * 9.81})
    assert f"{ROBOT.weight / 9.81 - 4.0:.2f} kg, this pupper_v2 has {ROBOT.weight / 9.81:.2f} kg" in other_weight(
        trained, ROBOT
    )
    assert not other_weight(replace(policy, provenance={WEIGHT: 1.01 * ROBOT.weight}), ROBOT)
