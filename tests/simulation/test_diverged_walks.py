"""Walks that diverged are no falls, and a policy remembers its robot's weight."""

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
    settings = WalkSettings(search=search, iterations=1, episode_steps=20)

    with pytest.raises(SimulationFault, match="2 of 2"):
        train_policy(ROBOT, motors, settings, workers=1)


def test_diverged_walks_are_named_and_counted():
    episodes = [SimpleNamespace(fault=fault) for fault in (0, 1, 1)]

    with pytest.raises(SimulationFault, match=r"2 of 3.*paper"):
        require_walks(episodes, "paper")  # pyright: ignore[reportArgumentType]

    require_walks(episodes[:1], "paper")  # pyright: ignore[reportArgumentType]


def test_a_robot_of_another_weight_than_the_trained_one_is_a_warning_with_both_weights():
    arrays = PolicyShape(ROBOT.num_joints).untrained()
    policy = Policy.of(ROBOT, arrays, ROBOT.nominal_pose, ROBOT.nominal_pose)
    lighter = ROBOT.weight - 4.0 * 9.81  # 4 kg
    trained_lighter = replace(policy, provenance={ROBOT_WEIGHT: lighter})
    trained_alike = replace(policy, provenance={ROBOT_WEIGHT: 1.01 * ROBOT.weight})

    warning = weight_warning(trained_lighter, ROBOT)
    assert f"{lighter / 9.81:.2f} kg" in warning
    assert f"{ROBOT.weight / 9.81:.2f} kg" in warning

    assert not weight_warning(trained_alike, ROBOT)
    assert not weight_warning(policy, ROBOT), "its training did not record the weight"
