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
        model.geom_group[1:], option = group, mujoco.MjvOption()
        set_view_and_light(model, option)
        assert option.geomgroup[3] == shown


RADIUS = PUPPER_V2.legs[0].foot_radius


def standing(frames: int = 1, lifted: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Qpos and qvel of a robot at rest in the nominal pose, so much above the floor [m]."""
    qpos, qvel = np.zeros((frames, 7 + PUPPER_V2.num_joints)), np.zeros((frames, 6 + PUPPER_V2.num_joints))
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height + lifted, 1.0, PUPPER_V2.nominal_pose
    return qpos, qvel


def test_a_standing_robot_touches_the_floor_with_four_feet_that_do_not_slide():
    found = foot_motion(PUPPER_V2, *standing(2))
    assert found.clearance.shape == found.sliding.shape == (2, 4)
    np.testing.assert_allclose(found.clearance, 0.0, atol=1e-9)
    np.testing.assert_array_equal(found.sliding, 0.0)
    np.testing.assert_allclose(foot_motion(PUPPER_V2, *standing(lifted=0.05)).clearance, 0.05, atol=1e-9)


def test_a_foot_is_so_far_ahead_of_the_base_as_it_rests_wherever_the_robot_looks():
    qpos, qvel = standing()
    qpos[0, :2], qpos[0, 3:7] = (3.0, -1.0), (np.cos(1.25), 0.0, 0.0, np.sin(1.25))
    found = foot_motion(PUPPER_V2, qpos, qvel).ahead[0]
    np.testing.assert_allclose(found, [leg.rest[0] for leg in PUPPER_V2.legs], atol=1e-9)


def test_a_sliding_robot_slides_as_fast_as_it_goes_in_any_direction_and_not_by_falling():
    qpos, qvel = standing(3)
    qvel[0, :2], qvel[1, :2], qvel[2, 2] = (0.3, -0.4), (-0.2, 0.0), -1.0
    np.testing.assert_allclose(
        foot_motion(PUPPER_V2, qpos, qvel).sliding, [[0.5] * 4, [0.2] * 4, [0.0] * 4], atol=1e-12
    )


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_a_foot_that_rolls_does_not_slide_and_one_that_spins_on_the_spot_does(yaw: float):
    """The body turns forward about +y at ω; where its centre of a foot moves by ω·radius, the lowest point rests."""
    omega = 1.5
    for leg, one in enumerate(PUPPER_V2.legs):
        qpos, qvel = standing()
        qpos[0, 3:7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        x, _ = one.rest
        # of the foot's centre relative to the base: ω y × (x, y, -h) = ω (-h, 0, -x); rolling wants (ω r, 0, 0)
        below = PUPPER_V2.standing_height - RADIUS
        speed = omega * (RADIUS + below)
        qvel[0, :3] = speed * np.cos(yaw), speed * np.sin(yaw), omega * x
        qvel[0, 4] = omega
        assert foot_motion(PUPPER_V2, qpos, qvel).sliding[0, leg] == pytest.approx(0.0, abs=1e-9)
        qvel[0, :2] *= below / (RADIUS + below)  # its centre stays where it is
        assert foot_motion(PUPPER_V2, qpos, qvel).sliding[0, leg] == pytest.approx(omega * RADIUS, abs=1e-9)
