"""Contract of all robots: the model has the joints, and an ideal PD holds the nominal pose."""

from pathlib import Path

import numpy as np
import pytest
from dog import LEGS_TOML, quadruped, written
from weighed_arm import write_arm

from motorprior.actuator.ideal_pd import described_pd
from motorprior.robots.build_model import build_model
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World


@pytest.fixture(params=["shipped", "dog", "arm"])
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Robot:
    if request.param == "shipped":
        return load_robot(DEFAULT_ROBOT)
    if request.param == "dog":
        return load_robot(written(tmp_path, LEGS_TOML, "dog", quadruped()))
    return load_robot(write_arm(tmp_path))


def test_the_joints_of_a_robot_are_the_joints_of_its_model_in_order(robot: Robot):
    model = build_model(robot)

    assert len(set(robot.joint_names)) == robot.num_joints

    addresses = [int(model.joint(name).qposadr[0]) for name in robot.joint_names]
    free = 7 if robot.base == "free" else 0

    assert addresses == [free + joint for joint in range(robot.num_joints)]
    assert model.nq == free + robot.num_joints
    assert np.all(robot.lower < robot.upper)
    assert np.all((robot.lower <= robot.nominal_pose) & (robot.nominal_pose <= robot.upper))

    limits = np.stack([robot.lower, robot.upper], axis=1)

    assert robot.limits_of(robot.joint_names) == pytest.approx(limits)


def test_an_ideal_pd_holds_the_nominal_pose(robot: Robot):
    pose = np.asarray(robot.nominal_pose)
    world = World(robot, robot.physics_dt, suspended=robot.base == "free")
    played = replay(world, described_pd(robot), np.tile(pose, (200, 1)))
    sag = np.array([joint.torque_limit / joint.kp for joint in robot.joints])

    assert np.all(np.abs(played.joint_pos[-1] - pose) < sag)
    assert np.abs(np.diff(played.joint_pos[-50:], axis=0)).max() < 1e-3, "at rest"
