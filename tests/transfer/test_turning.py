"""Speed and yaw rate of walks whose path is known: a circle."""

import numpy as np
import pytest

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rollout import Episode
from turning import COMMANDS, commands_of, followed

STEPS, SPEED, RATE = 800, 0.3, 0.6


def circle(steps: int = STEPS, fault: int = 0) -> Episode:
    """To the left, more than half of a turn, so that the heading passes π."""
    time = PUPPER_V2.control_dt * np.arange(steps)
    trace, yaw = np.zeros((steps, 19)), RATE * time
    trace[:, 0], trace[:, 1] = SPEED / RATE * np.sin(yaw), SPEED / RATE * (1.0 - np.cos(yaw))
    trace[:, 3], trace[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    nothing = np.zeros(1)
    return Episode(0.0, steps, 0.0, np.zeros(2), fault, 1, nothing, nothing, trace, nothing)


def test_a_circle_has_its_speed_and_its_yaw_rate():
    found = followed(PUPPER_V2, [circle(), circle()], STEPS)
    assert found["upright"] == 1.0
    assert found["speed"] == pytest.approx(SPEED, rel=1e-3) and found["yaw_rate"] == pytest.approx(RATE, rel=1e-6)


def test_only_walks_without_a_fall_are_measured():
    found = followed(PUPPER_V2, [circle(), circle(300), circle(fault=1), circle()], STEPS)
    assert found["upright"] == 0.5 and found["yaw_rate"] == pytest.approx(RATE, rel=1e-6)
    assert followed(PUPPER_V2, [circle(50)], STEPS) == {"upright": 0.0}


def test_commands_are_shares_of_what_the_robot_is_built_for():
    told = commands_of(PUPPER_V2)
    assert len(told) == len(COMMANDS) and told[0] == pytest.approx((0.3, 0.6)) and told[4] == pytest.approx((-0.2, 0.0))
