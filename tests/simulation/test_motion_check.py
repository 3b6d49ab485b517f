"""Collisions of a planned motion in the robot's model."""

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.excitation.servo_motion import servo_parts
from motorprior.robots.servos import MotionPart
from motorprior.robots.so101.robot import SO101
from motorprior.simulation.motion_check import require_free_motion

PERIOD = 0.01


@pytest.mark.parametrize("seed", range(3))
def test_the_usual_motion_of_an_arm_is_free(seed: int):
    parts = servo_parts(
        SO101.joint_names, SO101.lower, SO101.upper, SO101.nominal_pose, period=PERIOD, seed=seed
    )

    assert require_free_motion(SO101, parts, PERIOD) > 10


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
