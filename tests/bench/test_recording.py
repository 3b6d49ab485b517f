"""Recordings are reproducible, valid logs of motors that start from rest."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.bench.recording import BENCH_SCHEDULES, record
from motorprior.logs.motor_log import channels, checked

FLEET = load_fleet("pupper_v2")
MOTORS = FLEET.sample(3, np.random.default_rng(0))
ROLLOUT = replace(BENCH_SCHEDULES["rollout"], segment_steps=400)


def recorded(seed=0, steps=2100, preset=ROLLOUT):
    return record(MOTORS, preset, steps, seed, FLEET)


def test_same_seed_same_bytes():
    one, same, other = (
        {name: each.tobytes() for name, each in channels(recorded(s)).items()} for s in (5, 5, 6)
    )
    assert one == same != other


@pytest.mark.parametrize("preset", BENCH_SCHEDULES)
def test_a_recording_is_a_valid_log_at_the_presets_period(preset):
    log = checked(recorded(preset=BENCH_SCHEDULES[preset], steps=2600))
    assert (log.num_rows, log.num_joints) == (2600, 3)
    np.testing.assert_allclose(np.diff(log.time), BENCH_SCHEDULES[preset].period)
    assert log.motor == FLEET.motor and "pupper_v2" in log.source


@pytest.mark.parametrize("steps", [2, 401, 2100])
def test_every_segment_starts_from_rest_at_its_target(steps):
    log = checked(recorded(steps=steps))  # refuses a segment of one row
    assert log.num_rows == steps
    for part in log.segments():
        assert part.joint_vel is not None
        np.testing.assert_array_equal(part.joint_vel[0], 0.0)
        np.testing.assert_array_equal(part.joint_pos[0], part.position_target[0])


def test_a_push_that_flings_a_joint_is_made_smaller_until_it_holds():
    preset = replace(BENCH_SCHEDULES["rollout"], excitations=("creep",))
    weak = replace(
        require_geared(MOTORS), torque_limit=require_geared(MOTORS).torque_limit * [1.0, 0.3, 1.0]
    )
    both = [record(motors, preset, 3000, 0, FLEET) for motors in (MOTORS, weak)]
    usual, held_back = (log.external_torque for log in both)
    assert usual is not None and held_back is not None
    np.testing.assert_array_equal(usual[:, [0, 2]], held_back[:, [0, 2]])
    pushed = usual[:, 1] != 0.0
    shares = set(held_back[pushed, 1] / usual[pushed, 1])
    assert shares <= {1.0, 0.5, 0.25, 0.125} and min(shares) < 1.0
    assert np.abs(both[1].joint_pos - both[1].position_target).max() < 1.6
