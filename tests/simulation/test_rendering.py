"""The camera shows the robot, and its feet have the clearance and sliding of its kinematics."""

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


def test_feet_have_the_height_and_the_horizontal_speed_of_a_robot_that_glides():
    qpos, qvel = standing(4)
    # Frame 0: at rest. Frame 1: lifted by 5 cm.
    qpos[1, 2] += 0.05
    # Frame 2: at another place and heading, it glides at 0.5 m/s.
    qpos[2, :2] = (3.0, -1.0)
    qpos[2, 3:7] = (np.cos(1.25), 0.0, 0.0, np.sin(1.25))
    qvel[2, :2] = (0.3, -0.4)
    # Frame 3: it moves down.
    qvel[3, 2] = -1.0

    clearance, sliding = foot_motion(PUPPER_V2, qpos, qvel)

    np.testing.assert_allclose(clearance, np.tile([[0.0], [0.05], [0.0], [0.0]], 4), atol=1e-9)
    np.testing.assert_allclose(sliding, np.tile([[0.0], [0.0], [0.5], [0.0]], 4), atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_a_foot_that_rolls_does_not_slide_and_one_that_spins_on_the_spot_does(yaw: float):
    """The body turns forward about +y at ω.

    The lowest point of a foot rests where the centre of the foot moves by ω·radius.
    """
    omega = 1.5  # [rad/s]
    for index, leg in enumerate(PUPPER_V2.legs):
        qpos, qvel = standing()
        qpos[0, 3:7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)

        # The centre of the foot has the velocity ω y × (x, y, -h) = ω (-h, 0, -x) relative to the
        # base, and (ω r, 0, 0) in the world if it rolls.
        x, _ = leg.rest
        below = PUPPER_V2.standing_height - RADIUS
        speed = omega * (RADIUS + below)
        qvel[0, :3] = speed * np.cos(yaw), speed * np.sin(yaw), omega * x
        qvel[0, 4] = omega
        _, sliding = foot_motion(PUPPER_V2, qpos, qvel)
        assert sliding[0, index] == pytest.approx(0.0, abs=1e-9)

        # Now the centre of the foot stays where it is.
        qvel[0, :2] *= below / (RADIUS + below)
        _, sliding = foot_motion(PUPPER_V2, qpos, qvel)
        assert sliding[0, index] == pytest.approx(omega * RADIUS, abs=1e-9)
