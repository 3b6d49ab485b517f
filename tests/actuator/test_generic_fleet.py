"""The generic fleet of a robot: near the identified fleets, and of the size of any robot."""

from dataclasses import replace

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.fleet import fleet_files, load_robot_fleet
from motorprior.robots.robot import Robot

PUPPER = mp.load_robot("pupper_v2")


def of_size(factor: float) -> Robot:
    """The shipped robot with gains and torque limits times a factor, under another name."""
    joints = []
    for joint in PUPPER.joints:
        limit = factor * joint.torque_limit
        joints.append(
            replace(joint, kp=factor * joint.kp, kd=factor * joint.kd, torque_limit=limit)
        )
    return replace(PUPPER, name="other", joints=tuple(joints), fleets=())


def test_the_generic_fleet_of_the_shipped_robot_contains_its_calibrated_motor():
    generic = mp.generic_fleet(PUPPER)
    calibrated = mp.load_fleet("pupper_v2")
    samples = generic.sample(2000, seed=0)
    truth = calibrated.center(1)

    for name in ("kp", "armature", "coulomb", "delay"):
        low, high = np.quantile(getattr(samples, name), (0.01, 0.99))
        assert low < getattr(truth, name)[0] < high, name


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_constants_scale_with_the_robot(factor: float):
    small = mp.generic_fleet(PUPPER).center(1)
    scaled = mp.generic_fleet(of_size(factor)).center(1)

    for name in ("kp", "armature", "coulomb", "gear_stiffness", "torque_limit"):
        np.testing.assert_allclose(getattr(scaled, name), factor * getattr(small, name))
    np.testing.assert_allclose(getattr(scaled, "delay"), getattr(small, "delay"))  # noqa: B009


def test_a_robot_without_a_shipped_fleet_has_the_generic_one():
    robot = of_size(2.0)

    assert load_robot_fleet(robot) == mp.generic_fleet(robot)
    assert load_robot_fleet(PUPPER).name == "pupper_v2"
    assert fleet_files(robot, None) == []
    assert mp.make_env(robot, motors="fleet").reset(seed=0)[0].size > 0
