"""The control step: ramps, heading and drift, levelling, bounded targets, sliding feet, rewards."""

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

    ramp_steps = round(RAMP / DT)
    reached = speeds[ramp_steps - 1 :]
    np.testing.assert_allclose(reached, np.tile([0.5, -0.6], (31, 1)), atol=1e-12)
    assert speeds[ramp_steps // 2 - 1] == pytest.approx([0.25, -0.3])
    stopped = followed(gait, 0.0, 0.0, ramp_steps)[19:21]
    assert stopped == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_command_beyond_the_limits_of_the_robot_is_limited():
    gait = new_gait(WALKER)

    fastest = followed(gait, 9.0, 9.0, 300)[19:21]
    assert fastest == pytest.approx([MAX_COMMAND * WALKER.max_speed, WALKER.max_yaw_rate])

    slowest = followed(gait, -9.0, -9.0, 300)[19:21]
    assert slowest == pytest.approx([WALKER.min_speed, -WALKER.max_yaw_rate])


def test_the_heading_error_is_the_turn_that_was_not_commanded():
    gait = new_gait(WALKER)
    assert followed(gait, forward=0.3, steps=100, rate=0.2)[18] == pytest.approx(0.2)
    assert followed(gait, forward=0.3, steps=1000, rate=0.2)[18] == MAX_HEADING_ERROR


def test_a_robot_that_turns_as_commanded_has_no_heading_error():
    gait = new_gait(WALKER)
    time = 0.0
    for _ in range(150):
        gait.observation[4] = min(WALKER.max_yaw_rate * (time + DT) / RAMP, 0.4)
        follow_command(WALKER, gait, 0.0, 0.4)
        time += DT

    assert gait.observation[18] == pytest.approx(0.0, abs=1e-12)


def test_the_drift_is_the_way_aside_that_follows_from_the_heading_error():
    gait = new_gait(WALKER)
    followed(gait, 0.3, steps=100)
    followed(gait, 0.3, steps=10, rate=1.0)  # 0.1 rad
    first_drift = gait.scalars[2]

    drift = followed(gait, 0.3, steps=50)[17]

    assert drift - first_drift == pytest.approx(50 * DT * 0.3 * math.sin(0.1))


def test_the_drift_is_bounded_and_a_standing_robot_has_none():
    walking = new_gait(WALKER)
    drift = followed(walking, 0.5, steps=3000, rate=0.1)[17]
    assert drift == pytest.approx(MAX_DRIFT * WALKER.max_speed)

    standing = new_gait(WALKER)
    assert followed(standing, 0.0, steps=100, rate=0.3)[17] == 0.0


@pytest.mark.parametrize("forward", [0.3, -0.2])
def test_a_turn_against_drift_and_heading_error_brings_a_robot_back_on_its_way(forward: float):
    """The gains have the same sign forward and backward, as a linear policy requires."""
    gait = new_gait(WALKER)
    drifts = []
    heading = 0.0
    observation = gait.observation
    for step in range(3000):
        # a disturbance of 0.1 rad first: 10 steps of 10 ms at 1 rad/s
        if step in range(100, 110):
            observation[4] = 1.0
        else:
            observation[4] = -2.0 * observation[18] - 4.0 * observation[17]
        heading += DT * observation[4]
        follow_command(WALKER, gait, forward, 0.0)
        drifts.append(abs(gait.scalars[2]))

    assert max(drifts) > 0.005
    assert drifts[-1] < 0.1 * max(drifts)
    assert abs(heading) < 0.01


SOFT = WALKER._replace(levelling_gain=0.5)


def test_the_levelling_of_a_soft_robot_follows_its_tilt_and_a_stiff_robot_has_none():
    observation = np.zeros(OBSERVATIONS)
    observation[:4] = 0.2, 0.1, 1.0, -0.5  # roll, pitch [rad] and their rates [rad/s]

    rise_of_pitch = 0.5 * (0.1 - 0.5 * LEVEL_RATE)
    rise_of_roll = -0.5 * (0.2 + LEVEL_RATE)
    assert levelling(SOFT, observation) == pytest.approx((rise_of_pitch, rise_of_roll))

    assert WALKER.levelling_gain == 0.0
    assert levelling(WALKER, observation) == (0.0, 0.0)


def test_a_soft_robot_extends_the_legs_on_its_low_side():
    """Pitch is positive with the nose down, roll with the left side up."""
    tilted = new_gait(SOFT)
    tilted.observation[:2] = 0.2, 0.1  # roll and pitch [rad]
    level = new_gait(SOFT)
    command_step(SOFT, tilted, NOTHING)
    command_step(SOFT, level, NOTHING)

    longer = {}
    for leg in PUPPER_V2.legs:
        longer[leg.name] = leg.hip_height(tilted.target) - leg.hip_height(level.target)

    assert longer["FR"] > longer["FL"] > longer["RL"]
    assert longer["FR"] > longer["RR"] > longer["RL"]
    assert longer["FR"] > 0.0 > longer["RL"]


def test_targets_never_change_faster_than_the_bound_nor_leave_the_joint_limits():
    walker = walker_arrays(PUPPER_V2)
    rng = np.random.default_rng(0)
    gait = new_gait(walker)
    last_target = gait.target.copy()
    fastest = 0.0

    for _ in range(300):
        follow_command(walker, gait, rng.uniform(-0.5, 1.0), rng.uniform(-1.0, 1.0))
        command_step(walker, gait, rng.uniform(-3.0, 3.0, ACTIONS))

        fastest = max(fastest, np.abs(gait.target - last_target).max() / DT)
        assert np.all(gait.target >= walker.lower)
        assert np.all(gait.target <= walker.upper)
        last_target = gait.target.copy()

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
    # four feet, 5 mm each
    assert slid(feet_at(0.003, 0.004)) == pytest.approx(4 * 0.005 / DT)
    assert slid(feet_at(0.003, 0.004)) == pytest.approx(0.0, abs=1e-12)

    assert slid(feet_at(0.1, height=0.01)) == 0.0, "in the air"
    assert slid(feet_at(0.2)) == 0.0, "landed elsewhere"
    assert slid(np.full((4, 3), np.nan)) == 0.0, "unknown places"
    assert slid(feet_at(0.5)) == 0.0, "known again"


GAIT = PUPPER_V2.require_gait()


def test_a_schedule_turns_both_ways_up_to_the_yaw_rate_of_the_robot():
    rows = np.concatenate([Commands().schedule(PUPPER_V2, seed, 500) for seed in range(400)])
    yaw_rates = rows[:, 1]
    assert -GAIT.yaw_rate <= yaw_rates.min() < -0.58
    assert 0.58 < yaw_rates.max() <= GAIT.yaw_rate


def test_a_schedule_holds_every_command_for_the_same_time():
    speeds = Commands(hold=0.3, still=0.0).schedule(PUPPER_V2, 4, 100)[:, 0]
    assert np.flatnonzero(np.diff(speeds)).tolist() == [29, 59, 89]


def test_a_schedule_fills_the_range_of_speeds_evenly_in_random_order():
    slowest = GAIT.forward[0]
    fastest = MAX_COMMAND * GAIT.forward[1]
    first_speeds = []
    for seed in range(30):
        # ten commands in 5 s, one in every tenth of the range
        speeds = Commands(hold=0.5, still=0.0).schedule(PUPPER_V2, seed, 500)[:, 0]
        tenths = (np.unique(speeds) - slowest) / (fastest - slowest) * 10
        np.testing.assert_array_equal(np.floor(tenths), np.arange(10))
        first_speeds.append(speeds[0])

    assert np.ptp(first_speeds) > 0.5


def test_an_observation_has_tilt_rates_and_joints_relative_to_the_nominal_pose():
    roll = 0.2
    pitch = -0.1
    # Quaternion of R_y(pitch) R_x(roll), yaw 0.
    cr = math.cos(roll / 2)
    sr = math.sin(roll / 2)
    cp = math.cos(pitch / 2)
    sp = math.sin(pitch / 2)
    state = RobotState(
        base_pos=np.zeros(3),
        base_quat=np.array([cp * cr, cp * sr, sp * cr, -sp * sr]),
        base_lin_vel=np.zeros(3),
        base_ang_vel=np.array([1.0, 2.0, 3.0]),
        measured_joint_pos=PUPPER_V2.nominal_pose + np.arange(12) * 0.01,
        foot_pos=np.zeros((4, 3)),
        torque_squared_sum=0.0,
    )
    observation = np.full(23, np.nan)

    observe(WALKER, state, observation)

    assert observation[:5] == pytest.approx([roll, pitch, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(observation[5:17], np.arange(12) * 0.01, atol=1e-15)
    assert np.isnan(observation[17:]).all(), "the state of the gait is written elsewhere"


def test_the_heading_rate_is_the_rotation_about_the_vertical():
    observation = np.zeros(23)
    observation[:5] = 0.0, 0.0, 5.0, 7.0, 0.3
    assert heading_rate(observation) == pytest.approx(0.3)

    # a body that turns at 0.5 rad/s about the vertical while rolled by 0.2 and pitched by -0.1 rad
    roll = 0.2
    pitch = -0.1
    rate = 0.5
    up = np.array(
        [-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)]
    )
    observation[:5] = roll, pitch, *(rate * up)
    assert heading_rate(observation) == pytest.approx(rate)


def test_the_reward_is_the_weighted_sum_by_hand():
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
    state = RobotState(
        base_pos=np.array([0.0, 0.0, 0.17]),
        base_quat=rolled,
        base_lin_vel=np.array([0.1, 0.1, 0.0]),
        base_ang_vel=np.array([0.0, 0.0, 0.4]),
        measured_joint_pos=PUPPER_V2.nominal_pose,
        foot_pos=feet,
        torque_squared_sum=5.0 * WALKER.reference_torque**2,
    )

    reward, has_fallen = evaluate_step(WALKER, gait, state, weights.array())

    # 0.5 - 0.2 - 0.8·0.1 - 0.6·0.05 - 0.1·0.3 - 0.2·0.07 - 0.003·5 - 0.4·0.1 = 0.091
    assert reward == pytest.approx(DT * 0.091)
    assert not has_fallen


def test_a_robot_has_fallen_beyond_its_limits_and_when_its_state_is_unknown():
    # roll [rad], pitch [rad], height [m]; heights from 0.05 to 0.6 m are allowed
    upright = [(0.0, 0.0, 0.17), (0.39, -0.39, 0.06)]
    tilted = [(0.41, 0.0, 0.17), (0.0, -0.41, 0.17)]
    out_of_range = [(0.0, 0.0, 0.04), (0.0, 0.0, 0.61)]
    unknown = [(math.nan, 0.0, 0.17), (0.0, 0.0, math.nan)]

    for state in upright:
        assert not fallen(*state, 0.05, 0.6), state
    for state in tilted + out_of_range + unknown:
        assert fallen(*state, 0.05, 0.6), state
