"""The step around the gait: commands ramp, heading and drift add up, targets lead and never jump, slips are counted."""

import math

import numpy as np
import pytest
from policies import ACTIONS, OBSERVATIONS

from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import (
    LEVEL_RATE,
    MAX_DRIFT,
    MAX_HEADING_ERROR,
    MAX_TARGET_SPEED,
    RAMP,
    RobotState,
    TaskWeights,
    command_step,
    evaluate_step,
    fallen,
    follow_command,
    heading_rate,
    levelling,
    new_gait,
    observe,
    sliding,
)
from motorprior.locomotion.gait import MAX_COMMAND, walker_arrays
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WALKER = walker_arrays(PUPPER_V2)
DT = PUPPER_V2.control_dt
NOTHING = np.zeros(ACTIONS)


def followed(gait, forward=0.0, yaw_rate=0.0, steps=1, rate=0.0):
    """The last observation of a level robot that turns at ``rate`` [rad/s]."""
    gait.observation[:] = 0.0
    for _ in range(steps):
        gait.observation[4] = rate
        follow_command(WALKER, gait, forward, yaw_rate)
    return gait.observation.copy()


def test_a_command_comes_into_force_within_half_a_second_and_at_a_bounded_rate():
    gait = new_gait(WALKER)
    speeds = np.array([followed(gait, 0.5, -0.6)[19:21] for _ in range(80)])
    assert np.all(np.diff(speeds[:, 0]) <= WALKER.max_speed * DT / RAMP + 1e-12)
    np.testing.assert_allclose(
        speeds[round(RAMP / DT) - 1 :], np.tile([0.5, -0.6], (31, 1)), atol=1e-12
    )
    assert speeds[round(RAMP / DT) // 2 - 1] == pytest.approx([0.25, -0.3])
    assert followed(gait, 0.0, 0.0, round(RAMP / DT))[19:21] == pytest.approx([0.0, 0.0], abs=1e-12)
    ends = (
        [MAX_COMMAND * WALKER.max_speed, WALKER.max_yaw_rate],
        [WALKER.min_speed, -WALKER.max_yaw_rate],
    )
    assert [followed(gait, way * 9.0, way * 9.0, 300)[19:21].tolist() for way in (1, -1)] == [
        *map(pytest.approx, ends)
    ]


def test_the_heading_error_is_the_turn_that_was_not_commanded():
    gait = new_gait(WALKER)
    assert followed(gait, forward=0.3, steps=100, rate=0.2)[18] == pytest.approx(0.2)
    assert followed(gait, forward=0.3, steps=1000, rate=0.2)[18] == MAX_HEADING_ERROR
    turning = new_gait(WALKER)
    commanded = 0.0
    for _ in range(150):  # a robot that turns as commanded, with the ramp
        turning.observation[4] = min(WALKER.max_yaw_rate * (commanded + DT) / RAMP, 0.4)
        follow_command(WALKER, turning, 0.0, 0.4)
        commanded += DT
    assert turning.observation[18] == pytest.approx(0.0, abs=1e-12)


def test_the_drift_is_the_way_aside_that_follows_from_the_heading_error():
    gait = new_gait(WALKER)
    followed(gait, 0.3, steps=100)
    followed(gait, 0.3, steps=10, rate=1.0)  # 0.1 rad
    before = gait.scalars[2]
    after = followed(gait, 0.3, steps=50)[17]
    assert after - before == pytest.approx(50 * DT * 0.3 * math.sin(0.1))
    assert followed(gait, 0.5, steps=3000, rate=0.1)[17] == pytest.approx(
        MAX_DRIFT * WALKER.max_speed
    )
    standing = new_gait(WALKER)
    assert followed(standing, 0.0, steps=100, rate=0.3)[17] == 0.0


@pytest.mark.parametrize("forward", [0.3, -0.2])
def test_a_turn_against_drift_and_heading_error_brings_a_robot_back_on_its_way(forward: float):
    """The sign of both gains is one for both ways: a linear policy has no other."""
    gait = new_gait(WALKER)
    aside = []
    heading = 0.0
    seen = gait.observation
    for step in range(3000):
        # led astray by 0.1 rad at first
        seen[4] = 1.0 if step in range(100, 110) else -2.0 * seen[18] - 4.0 * seen[17]
        heading += DT * seen[4]
        follow_command(WALKER, gait, forward, 0.0)
        aside.append(abs(gait.scalars[2]))
    assert max(aside) > 0.005 and aside[-1] < 0.1 * max(aside) and abs(heading) < 0.01


def test_a_soft_robot_reaches_out_with_the_legs_on_its_low_side_and_a_stiff_one_needs_not():
    """Pitch is positive with the nose down, roll with the left side up."""
    assert WALKER.levelling_gain == 0.0
    soft = WALKER._replace(levelling_gain=0.5)
    seen = np.zeros(OBSERVATIONS)
    seen[:4] = 0.2, 0.1, 1.0, -0.5
    assert levelling(soft, seen) == pytest.approx(
        (0.5 * (0.1 - 0.5 * LEVEL_RATE), -0.5 * (0.2 + LEVEL_RATE))
    )
    assert levelling(WALKER, seen) == (0.0, 0.0)
    seen[2:4] = 0.0
    gait = new_gait(soft)
    flat = new_gait(soft)
    gait.observation[:] = seen
    command_step(soft, gait, NOTHING)
    command_step(soft, flat, NOTHING)
    drops = [[leg.hip_height(each.target) for leg in PUPPER_V2.legs] for each in (gait, flat)]
    longer = {leg.name: one - other for leg, one, other in zip(PUPPER_V2.legs, *drops, strict=True)}
    assert longer["FR"] > longer["FL"] > longer["RL"] and longer["FR"] > longer["RR"] > longer["RL"]
    assert longer["FR"] > 0.0 > longer["RL"]


def test_targets_never_change_faster_than_the_bound_nor_leave_the_joint_limits():
    walker = walker_arrays(PUPPER_V2)
    rng = np.random.default_rng(0)
    gait = new_gait(walker)
    before = gait.target.copy()
    fastest = 0.0
    for _ in range(300):
        follow_command(walker, gait, rng.uniform(-0.5, 1.0), rng.uniform(-1.0, 1.0))
        command_step(walker, gait, rng.uniform(-3.0, 3.0, ACTIONS))
        fastest = max(fastest, np.abs(gait.target - before).max() / DT)
        assert np.all(gait.target >= walker.lower) and np.all(gait.target <= walker.upper)
        before = gait.target.copy()
    assert 0.3 * MAX_TARGET_SPEED < fastest <= MAX_TARGET_SPEED + 1e-9


def feet_at(x, y=0.0, height=0.0):
    """(legs, 3) centres of feet whose lowest points are at this height."""
    return np.stack([np.full(4, x), np.full(4, y), WALKER.foot_radius + height], axis=1)


def test_feet_that_stay_down_and_move_slide_and_feet_in_the_air_do_not():
    gait = new_gait(WALKER)
    joints = PUPPER_V2.nominal_pose

    def slid(places):
        state = RobotState(np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3), joints, places, 0.0)
        return sliding(WALKER, gait.feet, state, 0.0, 0.0)

    assert slid(feet_at(0.0)) == 0.0, "their earlier places are unknown"
    assert slid(feet_at(0.003, 0.004)) == pytest.approx(4 * 0.005 / DT)
    assert slid(feet_at(0.003, 0.004)) == pytest.approx(0.0, abs=1e-12)
    assert slid(feet_at(0.1, height=0.01)) == 0.0 and slid(feet_at(0.2)) == 0.0
    assert slid(np.full((4, 3), np.nan)) == 0.0 and slid(feet_at(0.5)) == 0.0


GAIT = PUPPER_V2.require_gait()


def test_a_schedule_holds_each_command_and_fills_the_range_evenly_in_any_order():
    rows = np.concatenate([Commands().schedule(PUPPER_V2, seed, 500) for seed in range(400)])
    assert -GAIT.yaw_rate <= rows[:, 1].min() < -0.58 and 0.58 < rows[:, 1].max() <= GAIT.yaw_rate
    speeds = Commands(hold=0.3, still=0.0).schedule(PUPPER_V2, 4, 100)[:, 0]
    assert np.flatnonzero(np.diff(speeds)).tolist() == [29, 59, 89]
    first = []
    for seed in range(30):
        speeds = Commands(hold=0.5, still=0.0).schedule(PUPPER_V2, seed, 500)[:, 0]
        parts = (
            (np.unique(speeds) - GAIT.forward[0])
            / (MAX_COMMAND * GAIT.forward[1] - GAIT.forward[0])
            * 10
        )
        np.testing.assert_array_equal(np.floor(parts), np.arange(10))
        first.append(speeds[0])
    assert np.ptp(first) > 0.5


def observed(quaternion, rates, joints) -> np.ndarray:
    out = np.full(23, np.nan)
    zero = np.zeros(3)
    state = RobotState(
        zero, np.array(quaternion), zero, np.array(rates), joints, np.zeros((4, 3)), 0.0
    )
    observe(walker_arrays(PUPPER_V2), state, out)
    assert np.isnan(out[17:]).all(), "what the gait follows is not the sensors'"
    return out


def test_observation_layout_and_signs():
    roll = 0.2
    pitch = -0.1
    # Quaternion of R_y(pitch) R_x(roll), yaw 0.
    cr = math.cos(roll / 2)
    sr = math.sin(roll / 2)
    cp = math.cos(pitch / 2)
    sp = math.sin(pitch / 2)
    quaternion = np.array([cp * cr, cp * sr, sp * cr, -sp * sr])
    joints = PUPPER_V2.nominal_pose + np.arange(12) * 0.01
    out = observed(quaternion, [1.0, 2.0, 3.0], joints)
    assert out[:5] == pytest.approx([roll, pitch, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(out[5:17], np.arange(12) * 0.01, atol=1e-15)


def test_the_rate_of_the_heading_is_the_gyroscopes_about_the_vertical():
    seen = np.zeros(23)
    seen[:5] = 0.0, 0.0, 5.0, 7.0, 0.3
    assert heading_rate(seen) == pytest.approx(0.3)
    # a body that turns at 0.5 rad/s about the vertical while rolled by 0.2 and pitched by -0.1 rad
    roll = 0.2
    pitch = -0.1
    rate = 0.5
    up = np.array(
        [-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)]
    )
    seen[:5] = roll, pitch, *(rate * up)
    assert heading_rate(seen) == pytest.approx(rate)


def test_reward_by_hand():
    weights = TaskWeights(
        alive=0.5,
        speed=1.0,
        lateral=0.8,
        heading=0.6,
        yaw_rate=0.1,
        tilt=0.2,
        torque=0.003,
        slip=0.4,
    )
    gait = new_gait(WALKER)
    feet = feet_at(0.0)
    rolled = np.array([math.cos(0.035), math.sin(0.035), 0.0, 0.0])
    gait.velocity_command[:] = 0.3, 0.1
    gait.scalars[3:6] = 0.05, 0.1, 0.1  # heading and filtered speeds, which stay
    gait.feet[:, :3] = feet
    gait.feet[:, 3] = PUPPER_V2.nominal_pose[1] + PUPPER_V2.nominal_pose[2]
    feet[0, 0] = 0.1 * DT  # one foot slides by 0.1 m/s
    # 0.5 - 0.2 - 0.8·0.1 - 0.6·0.05 - 0.1·0.3 - 0.2·0.07 - 0.003·5 - 0.4·0.1 = 0.091
    state = RobotState(
        np.array([0.0, 0.0, 0.17]),
        rolled,
        np.array([0.1, 0.1, 0.0]),
        np.array([0.0, 0.0, 0.4]),
        PUPPER_V2.nominal_pose,
        feet,
        5.0 * WALKER.reference_torque**2,
    )
    assert evaluate_step(WALKER, gait, state, weights.array()) == (pytest.approx(DT * 0.091), False)


def test_a_robot_has_fallen_beyond_its_limits_and_when_its_state_is_unknown():
    assert not any(fallen(*state, 0.05, 0.6) for state in ((0.0, 0.0, 0.17), (0.39, -0.39, 0.06)))
    tilted = ((0.41, 0.0, 0.17), (0.0, -0.41, 0.17))
    out_of_range = ((0.0, 0.0, 0.04), (0.0, 0.0, 0.61))
    unknown = ((math.nan, 0.0, 0.17), (0.0, 0.0, math.nan))
    assert all(fallen(*state, 0.05, 0.6) for state in (*tilted, *out_of_range, *unknown))
