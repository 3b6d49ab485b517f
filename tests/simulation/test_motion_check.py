"""Collisions of a planned motion in the robot's model."""

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.excitation.servo_motion import motion_range, servo_parts
from motorprior.robots.servos import MotionPart
from motorprior.robots.so101.robot import SO101
from motorprior.simulation.loaded_poses import loaded_poses
from motorprior.simulation.motion_check import require_free_motion

NAMES = SO101.joint_names
PERIOD = 0.01


def usual_motion(free_space: float | None = None, seed: int = 0) -> list[MotionPart]:
    motion = motion_range(NAMES, SO101.lower, SO101.upper, SO101.nominal_pose, 0.5)
    poses = loaded_poses(
        SO101, motion.lowest, motion.highest, motion.center, motion.reach, free_space
    )
    return servo_parts(NAMES, motion, poses, period=PERIOD, seed=seed)


@pytest.mark.parametrize("seed", range(3))
def test_the_usual_motion_of_an_arm_is_free(seed: int):
    check = require_free_motion(SO101, usual_motion(seed=seed), PERIOD)

    assert len(check.pairs) > 10
    assert 0.4 < check.radius < 0.6


def test_no_link_leaves_the_free_space():
    # motions about the nominal pose reach 0.527 m, about the loaded ones 0.547 m
    check = require_free_motion(SO101, usual_motion(0.53), PERIOD, 0.53)

    assert check.radius <= 0.53
    with pytest.raises(ConfigError, match=r"away from the base") as refusal:
        require_free_motion(SO101, usual_motion(), PERIOD, 0.53)
    assert refusal.value.argument == "free_space"


def lowered(joint: str, angle: float) -> list[MotionPart]:
    """A motion of one joint from the nominal pose to an angle [rad] in a second."""
    targets = np.tile(SO101.nominal_pose, (100, 1))
    index = SO101.joint_names.index(joint)
    targets[:, index] = np.linspace(targets[0, index], angle, 100)
    return [MotionPart(f"{joint} down", targets)]


def test_an_arm_that_reaches_the_table_is_refused_with_part_body_and_time():
    with pytest.raises(ConfigError, match=r"shoulder_lift down: .*table.* after 0\.\d s"):
        require_free_motion(SO101, lowered("shoulder_lift", 1.5), PERIOD)


def test_an_arm_that_reaches_itself_is_refused():
    folded = np.tile(SO101.nominal_pose, (100, 1))
    folded[:, 1] = -1.2
    folded[:, 2] = np.linspace(0.0, 1.68, 100)

    with pytest.raises(ConfigError, match=r"shoulder .* lower_arm") as refusal:
        require_free_motion(SO101, [MotionPart("fold", folded)], PERIOD)
    assert refusal.value.argument == "amplitude"
