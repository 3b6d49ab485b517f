"""The camera shows the robot, stick figures are its kinematics, and a rolling foot does not slide."""

# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from motorprior.robots.build_model import build_model
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rendering import foot_motion, set_view_and_light


def test_a_robot_of_collision_shapes_alone_is_visible():
    model = build_model(PUPPER_V2)
    for group, shown in ((0, 0), (2, 0), (3, 1)):
        model.geom_group[1:] = group
        option = mujoco.MjvOption()
        set_view_and_light(model, option)
        assert option.geomgroup[3] == shown


RADIUS = PUPPER_V2.legs[0].foot_radius


def standing(frames: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Qpos and qvel of a robot at rest in the nominal pose."""
    qpos = np.zeros((frames, 7 + PUPPER_V2.num_joints))
    qvel = np.zeros((frames, 6 + PUPPER_V2.num_joints))
    qpos[:, 2] = PUPPER_V2.standing_height
    qpos[:, 3] = 1.0
    qpos[:, 7:] = PUPPER_V2.nominal_pose
    return qpos, qvel


def test_feet_of_a_robot_at_rest_lifted_turned_and_sliding():
    qpos, qvel = standing(4)
    qpos[1, 2] += 0.05
    qpos[2, :2] = (3.0, -1.0)
    qpos[2, 3:7] = (np.cos(1.25), 0.0, 0.0, np.sin(1.25))
    qvel[2, :2] = (0.3, -0.4)
    qvel[3, 2] = -1.0
    clearance, sliding = foot_motion(PUPPER_V2, qpos, qvel)
    np.testing.assert_allclose(clearance, np.tile([[0.0], [0.05], [0.0], [0.0]], 4), atol=1e-9)
    np.testing.assert_allclose(sliding, np.tile([[0.0], [0.0], [0.5], [0.0]], 4), atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_a_foot_that_rolls_does_not_slide_and_one_that_spins_on_the_spot_does(yaw: float):
    """The body turns forward about +y at ω; where its centre of a foot moves by ω·radius, the lowest point rests."""
    omega = 1.5
    for leg, one in enumerate(PUPPER_V2.legs):
        qpos, qvel = standing()
        qpos[0, 3:7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        x, _ = one.rest
        # of the foot's centre relative to the base: ω y × (x, y, -h) = ω (-h, 0, -x); rolling wants
        # (ω r, 0, 0)
        below = PUPPER_V2.standing_height - RADIUS
        speed = omega * (RADIUS + below)
        qvel[0, :3] = speed * np.cos(yaw), speed * np.sin(yaw), omega * x
        qvel[0, 4] = omega
        assert foot_motion(PUPPER_V2, qpos, qvel)[1][0, leg] == pytest.approx(0.0, abs=1e-9)
        qvel[0, :2] *= below / (RADIUS + below)  # its centre stays where it is
        assert foot_motion(PUPPER_V2, qpos, qvel)[1][0, leg] == pytest.approx(
            omega * RADIUS, abs=1e-9
        )
