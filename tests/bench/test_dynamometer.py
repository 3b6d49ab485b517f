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
    trial = Trial(np.zeros((steps, 2)), np.tile(torque, (steps, 1)), LOAD, dt)
    response = run(limp(armature=0.004), trial)
    acceleration = torque / (LOAD + 0.004)
    time = np.arange(steps)[:, None] * dt
    np.testing.assert_allclose(response.joint_vel, acceleration * time, rtol=1e-12, atol=1e-12)
    # semi-implicit Euler with steps h <= 2 ms: q = a·h²·m·(m+1)/2 after m steps = a·t·(t + h)/2
    h = min(dt, 0.002)
    np.testing.assert_allclose(
        response.joint_pos, acceleration * time * (time + h) / 2, rtol=1e-9, atol=1e-15
    )
    np.testing.assert_array_equal(response.joint_torque, 0.0)


@pytest.mark.parametrize("preset", ["paper", "rollout"])
def test_a_recorded_log_obeys_newton(preset):
    fleet = load_fleet("pupper_v2")
    motors = fleet.sample(3, np.random.default_rng(0))
    log = record(motors, BENCH_SCHEDULES[preset], 3100, seed=1, fleet=fleet)
    for part in log.segments():
        assert part.joint_vel is not None and part.joint_torque is not None
        assert part.load_inertia is not None and part.external_torque is not None
        gained = (
            part.load_inertia[:-1]
            * np.diff(part.joint_vel, axis=0)
            / BENCH_SCHEDULES[preset].period
        )
        # joint_torque is the mean over the sample, so the identity is exact but for rounding
        np.testing.assert_allclose(
            gained, (part.joint_torque + part.external_torque)[:-1], atol=1e-9
        )
        moved = np.diff(part.joint_pos, axis=0) / BENCH_SCHEDULES[preset].period
        # the mean speed of a sample lies near its two ends': within the acceleration's share
        slack = np.abs(np.diff(part.joint_vel, axis=0)).max()
        np.testing.assert_allclose(moved, part.joint_vel[1:], atol=2 * slack)
