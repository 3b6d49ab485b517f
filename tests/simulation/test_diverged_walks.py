"""Walks that diverged are no falls, and a policy remembers its robot's weight."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

from dataclasses import replace
from types import SimpleNamespace

import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.load import load_robot
from motorprior.simulation.scene import require_walks
from motorprior.simulation.training import ROBOT_WEIGHT, WalkSettings, train_policy, weight_warning

ROBOT = load_robot("pupper_v2")


def test_a_training_whose_episodes_diverge_keeps_no_policy():
    motors = IdealPd.uniform(12, kp=1e300, kd=0.5, torque_limit=1e308, armature=0.003)
    search = ArsConfig(num_directions=1, num_top_directions=1)
    with pytest.raises(SimulationFault, match="2 of 2 episodes"):
        train_policy(
            ROBOT, motors, WalkSettings(search=search, iterations=1, episode_steps=20), workers=1
        )


def test_diverged_walks_are_named_and_counted():
    episodes = [SimpleNamespace(fault=fault) for fault in (0, 1, 1)]
    with pytest.raises(SimulationFault, match="2 of 3 walks of paper"):
        require_walks(episodes, "paper")  # pyright: ignore[reportArgumentType]
    require_walks(episodes[:1], "paper")  # pyright: ignore[reportArgumentType]


def test_a_heavier_robot_than_the_trained_one_is_a_warning():
    policy = Policy.of(
        ROBOT, PolicyShape(ROBOT.num_joints).untrained(), ROBOT.nominal_pose, ROBOT.nominal_pose
    )
    assert not weight_warning(policy, ROBOT)
    trained = replace(policy, provenance={ROBOT_WEIGHT: ROBOT.weight - 4.0 * 9.81})
    assert all(
        f"{weight / 9.81:.2f} kg" in weight_warning(trained, ROBOT)
        for weight in (trained.provenance[ROBOT_WEIGHT], ROBOT.weight)
    )
    assert not weight_warning(
        replace(policy, provenance={ROBOT_WEIGHT: 1.01 * ROBOT.weight}), ROBOT
    )
