"""Observation, reward and termination by hand, and their signs."""

import math

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.locomotion.task import TaskWeights, fallen, observe, reward
from motorprior.robots.pupper_v2.spec import NOMINAL_POSE

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
DT = 0.01


def pay(forward=0.0, lateral=0.0, yaw_rate=0.0, yaw=0.0, torque=0.0, alive=True, weights=None):
    return reward(forward, lateral, yaw_rate, yaw, torque, alive, DT, (weights or TaskWeights()).array())


def test_level_robot_in_nominal_pose_observes_zeros_and_its_phase():
    out = np.full(18, np.nan)
    observe(LEVEL, np.zeros(3), NOMINAL_POSE.copy(), 0.0, NOMINAL_POSE, out)
    np.testing.assert_allclose(out, [0.0] * 16 + [1.0, 0.5], atol=1e-15)
    observe(LEVEL, np.zeros(3), NOMINAL_POSE.copy(), 0.25, NOMINAL_POSE, out)
    assert out[16:] == pytest.approx([0.5, 1.0])


def test_observation_layout_and_signs():
    roll, pitch = 0.2, -0.1
    # Quaternion of R_y(pitch) R_x(roll), yaw 0.
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    quaternion = np.array([cp * cr, cp * sr, sp * cr, -sp * sr])
    joints = NOMINAL_POSE + np.arange(12) * 0.01
    out = np.full(18, np.nan)
    observe(quaternion, np.array([1.0, 2.0, 3.0]), joints, 0.5, NOMINAL_POSE, out)
    assert out[:4] == pytest.approx([roll, pitch, 1.0, 2.0])
    np.testing.assert_allclose(out[4:16], np.arange(12) * 0.01, atol=1e-15)


def test_weights_travel_in_the_order_of_their_names():
    np.testing.assert_array_equal(TaskWeights(1, 2, 3, 4, 5, 6).array(), [1, 2, 3, 4, 5, 6])
    assert TaskWeights().array()[:3] == pytest.approx([0.5, 0.004, 3e-5])


def test_reward_by_hand():
    weights = TaskWeights(max_speed=0.5, alive=0.004, torque=1e-4, lateral=0.2, yaw_rate=0.1, heading=0.3)
    # 0.003 + 0.004 - 1e-4·10 - 0.01·(0.2·0.5 + 0.1·2 + 0.3·0.4) = 0.006 - 0.0042
    assert pay(0.003, -0.5, 2.0, -0.4, 10.0, True, weights) == pytest.approx(0.0018)


def test_displacement_counts_up_to_half_a_metre_per_second_both_ways():
    assert pay(0.02) == pay(0.005) and pay(-0.02) == pay(-0.005)
    assert pay(0.005) - pay(-0.005) == pytest.approx(0.01)


def test_walking_straight_and_calm_pays_most():
    best = pay(0.004)
    assert best > pay(0.0)
    worse = [pay(0.004, lateral=0.1), pay(0.004, yaw_rate=-0.5), pay(0.004, yaw=0.1), pay(0.004, torque=3.0)]
    assert best > max(worse)
    assert best - pay(0.004, alive=False) == pytest.approx(0.004)


def test_standing_still_beats_falling_early_at_ordinary_torques():
    assert pay(0.0, torque=12 * 1.0**2) > 0.0


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


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1, "0.1", None, True])
def test_a_coefficient_that_is_no_finite_number_of_at_least_zero_is_refused(value):
    with pytest.raises(ConfigError, match=f"task.yaw_rate {value!r} is not a finite number of at least 0"):
        TaskWeights(yaw_rate=value)
