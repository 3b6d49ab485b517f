"""The dynamometer's joint is a rigid body: momentum, energy and decay in closed form."""

import numpy as np
import pytest

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.recording import BENCH_SCHEDULES, record

LOAD = np.array([0.002, 0.03])


def limp(kd=0.0, armature=0.0):
    return IdealPd.uniform(2, kp=0.0, kd=kd, torque_limit=1e9, armature=armature)


@pytest.mark.parametrize("dt", [0.002, 0.01])
def test_a_constant_torque_gives_a_free_joint_its_impulse(dt):
    steps = 50
    torque = np.array([0.3, -0.2])
    armature = 0.004
    trial = Trial(np.zeros((steps, 2)), np.tile(torque, (steps, 1)), LOAD, dt)

    response = run(limp(armature=armature), trial)

    acceleration = torque / (LOAD + armature)
    time = np.arange(steps)[:, None] * dt

    np.testing.assert_allclose(response.joint_vel, acceleration * time, rtol=1e-12, atol=1e-12)

    # semi-implicit Euler with steps h <= 2 ms: q = a·h²·m·(m+1)/2 after m steps = a·t·(t + h)/2
    h = min(dt, 0.002)

    expected_pos = acceleration * time * (time + h) / 2
    np.testing.assert_allclose(response.joint_pos, expected_pos, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(response.joint_torque, 0.0)


@pytest.mark.parametrize("schedule_name", ["paper", "rollout"])
def test_a_recorded_log_obeys_newton(schedule_name):
    fleet = load_fleet("pupper_v2")
    motors = fleet.sample(3, np.random.default_rng(0))
    schedule = BENCH_SCHEDULES[schedule_name]

    log = record(motors, schedule, 3100, seed=1, fleet=fleet)

    for segment in log.segments():
        assert segment.joint_vel is not None
        assert segment.joint_torque is not None
        assert segment.load_inertia is not None
        assert segment.external_torque is not None

        # joint_torque is the mean over the sample, so the identity is exact but for rounding
        acceleration = np.diff(segment.joint_vel, axis=0) / schedule.period
        torque = segment.joint_torque + segment.external_torque
        np.testing.assert_allclose(segment.load_inertia[:-1] * acceleration, torque[:-1], atol=1e-9)

        # the mean speed of a sample lies near its two ends': within the acceleration's share
        mean_speed = np.diff(segment.joint_pos, axis=0) / schedule.period
        slack = np.abs(np.diff(segment.joint_vel, axis=0)).max()
        np.testing.assert_allclose(mean_speed, segment.joint_vel[1:], atol=2 * slack)
