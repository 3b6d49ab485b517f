"""Observation, reward and termination by hand, and their signs."""

import math

import numpy as np
import pytest

from motorprior.backend import BackendState
from motorprior.locomotion.body import body_of
from motorprior.locomotion.task import TaskWeights, fallen, heading_rate, observe, reward
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import NOMINAL_POSE

DT = 0.01
WRONG = ("speed", "lateral", "heading", "yaw_rate", "tilt", "torque", "slip")


def pay(weights: TaskWeights | None = None, alive: bool = True, **wrong: float) -> float:
    """Reward of a step in which these are wrong; nothing else is."""
    speed, lateral, heading, yaw_rate, tilt, torque, slip = (wrong.pop(name, 0.0) for name in WRONG)
    assert not wrong
    given = (weights or TaskWeights()).array()
    return reward(speed, lateral, heading, yaw_rate, tilt, torque, slip, alive, DT, given)


def observed(quaternion, rates, joints) -> np.ndarray:
    out, zero = np.full(23, np.nan), np.zeros(3)
    state = BackendState(zero, np.array(quaternion), zero, np.array(rates), joints, np.zeros((4, 3)), 0.0)
    observe(body_of(PUPPER_V2), state, out)
    assert np.isnan(out[17:]).all(), "what the gait follows is not the sensors'"
    return out


def test_a_level_robot_in_the_nominal_pose_observes_zeros():
    np.testing.assert_allclose(observed([1.0, 0, 0, 0], [0.0, 0, 0], NOMINAL_POSE)[:17], 0.0, atol=1e-15)


def test_observation_layout_and_signs():
    roll, pitch = 0.2, -0.1
    # Quaternion of R_y(pitch) R_x(roll), yaw 0.
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    quaternion = np.array([cp * cr, cp * sr, sp * cr, -sp * sr])
    joints = NOMINAL_POSE + np.arange(12) * 0.01
    out = observed(quaternion, [1.0, 2.0, 3.0], joints)
    assert out[:5] == pytest.approx([roll, pitch, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(out[5:17], np.arange(12) * 0.01, atol=1e-15)


def test_the_rate_of_the_heading_is_the_gyroscopes_about_the_vertical():
    seen = np.zeros(23)
    seen[:5] = 0.0, 0.0, 5.0, 7.0, 0.3
    assert heading_rate(seen) == pytest.approx(0.3)
    # a body that turns at 0.5 rad/s about the vertical while rolled by 0.2 and pitched by -0.1 rad
    roll, pitch, rate = 0.2, -0.1, 0.5
    up = np.array([-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])
    seen[:5] = roll, pitch, *(rate * up)
    assert heading_rate(seen) == pytest.approx(rate)


def test_reward_by_hand():
    weights = TaskWeights(
        alive=0.5, speed=1.0, lateral=0.8, heading=0.6, yaw_rate=0.1, tilt=0.2, torque=0.003, slip=0.4
    )
    wrong = {"speed": -0.2, "lateral": 0.1, "heading": -0.05, "yaw_rate": 0.3, "tilt": 0.07, "torque": 5.0, "slip": 0.1}
    # 0.5 - 0.2 - 0.08 - 0.03 - 0.03 - 0.014 - 0.015 - 0.04 = 0.091
    assert pay(weights, True, **wrong) == pytest.approx(DT * 0.091)
    assert pay(weights, False, **wrong) == pytest.approx(DT * -0.409)


@pytest.mark.parametrize("name", WRONG)
def test_whatever_is_wrong_costs_on_either_side_and_the_more_the_worse(name):
    little: dict[str, float] = {name: 0.1}
    assert pay() > pay(None, True, **little) > pay(None, True, **{name: 0.2})
    if name not in ("tilt", "torque", "slip"):
        assert pay(None, True, **{name: -0.1}) == pay(None, True, **little)


def test_standing_still_under_any_command_beats_falling_at_once():
    """Or a search would learn to fall before it learns to walk."""
    assert pay(speed=0.45, torque=4.0) > 0.0 >= pay(alive=False)


@pytest.mark.parametrize(
    ("roll", "pitch", "height", "down"),
    [
        (0.0, 0.0, 0.17, False),
        (0.39, -0.39, 0.06, False),
        (0.41, 0.0, 0.17, True),
        (0.0, -0.41, 0.17, True),
        (0.0, 0.0, 0.04, True),
        (0.0, 0.0, 0.61, True),
        (math.nan, 0.0, 0.17, True),
        (0.0, 0.0, math.nan, True),
    ],
)
def test_fallen(roll, pitch, height, down):
    assert fallen(roll, pitch, height, 0.05, 0.6) is down
