"""Recordings are reproducible, valid logs of motors that start from rest."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.bench.recording import BENCH_SCHEDULES, record
from motorprior.logs.motor_log import MotorLog, channels, checked

FLEET = load_fleet("pupper_v2")
MOTORS = FLEET.sample(3, np.random.default_rng(0))
ROLLOUT = replace(BENCH_SCHEDULES["rollout"], segment_steps=400)


def recorded(seed=0, steps=2100, schedule=ROLLOUT):
    return record(MOTORS, schedule, steps, seed, FLEET)


def bytes_of(log: MotorLog) -> dict[str, bytes]:
    return {name: values.tobytes() for name, values in channels(log).items()}


def test_the_seed_decides_the_bytes():
    assert bytes_of(recorded(seed=5)) == bytes_of(recorded(seed=5))
    assert bytes_of(recorded(seed=5)) != bytes_of(recorded(seed=6))


@pytest.mark.parametrize("schedule_name", BENCH_SCHEDULES)
def test_a_recording_is_a_valid_log_at_the_period_of_its_schedule(schedule_name):
    schedule = BENCH_SCHEDULES[schedule_name]

    log = checked(recorded(schedule=schedule, steps=2600))

    assert (log.num_rows, log.num_joints) == (2600, 3)
    np.testing.assert_allclose(np.diff(log.time), schedule.period)
    assert log.motor == FLEET.motor
    assert "pupper_v2" in log.source


@pytest.mark.parametrize("steps", [2, 401, 2100])
def test_every_segment_starts_from_rest_at_its_target(steps):
    log = checked(recorded(steps=steps))  # refuses a segment of one row

    assert log.num_rows == steps
    for segment in log.segments():
        assert segment.joint_vel is not None
        np.testing.assert_array_equal(segment.joint_vel[0], 0.0)
        np.testing.assert_array_equal(segment.joint_pos[0], segment.position_target[0])


def test_a_push_that_flings_a_joint_is_made_smaller_until_it_holds():
    schedule = replace(BENCH_SCHEDULES["rollout"], excitations=("creep",))
    usual = require_geared(MOTORS)
    weak = replace(usual, torque_limit=usual.torque_limit * [1.0, 0.3, 1.0])

    log = record(usual, schedule, 3000, 0, FLEET)
    weak_log = record(weak, schedule, 3000, 0, FLEET)

    push = log.external_torque
    weak_push = weak_log.external_torque
    assert push is not None
    assert weak_push is not None
    np.testing.assert_array_equal(push[:, [0, 2]], weak_push[:, [0, 2]])

    pushed = push[:, 1] != 0.0
    shares = set(weak_push[pushed, 1] / push[pushed, 1])
    assert shares <= {1.0, 0.5, 0.25, 0.125}
    assert min(shares) < 1.0
    assert np.abs(weak_log.joint_pos - weak_log.position_target).max() < 1.6
