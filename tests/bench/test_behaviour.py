"""Behaviour features against closed forms: second-order response, friction, saturation; and no NaN, ever."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.true_motors import PhysicalActuator
from motorprior.bench import behaviour
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import load_fleet

KP, KD, ARMATURE = np.array([8.0, 12.0]), np.array([0.8, 0.9]), np.array([0.002, 0.004])


def pd(delay=0.0, kd=KD, limit=50.0):
    return IdealPd(KP, kd, np.full(2, limit), ARMATURE, np.full(2, delay))


def central(**changes):
    """Two central motors of the fleet, changed."""
    motors = require_geared(load_fleet("pupper_v2").center(2))
    return replace(motors, **{name: np.broadcast_to(value, 2).astype(float) for name, value in changes.items()})


@pytest.mark.parametrize(("frequency", "delay"), [(1, 0.0), (8, 0.012)])
def test_gain_and_lag_are_those_of_the_second_order_system(frequency, delay):
    s = 2j * np.pi * frequency
    inertia = behaviour.LOAD_INERTIA + ARMATURE
    expected = KP * np.exp(-s * delay) / (inertia * s**2 + KD * s + KP)
    gain, lag = behaviour.frequency_response(pd(delay), frequency)
    np.testing.assert_allclose(gain, np.abs(expected), rtol=0.03)
    phase = np.mod(-np.angle(expected), 2 * np.pi)
    np.testing.assert_allclose(lag, phase / (2 * np.pi * frequency), atol=0.0015)  # a target holds for 2 ms


def test_rise_time_of_an_overdamped_system():
    kd = np.array([3.0, 4.0])
    inertia = behaviour.LOAD_INERTIA + ARMATURE
    poles = np.array([np.sort(np.roots([j, d, k]).real) for j, d, k in zip(inertia, kd, KP, strict=True)])
    fast, slow = -poles[:, 0], -poles[:, 1]
    time = np.arange(0.0, 1.2, 1e-4)[:, None]
    progress = 1 - (fast * np.exp(-slow * time) - slow * np.exp(-fast * time)) / (fast - slow)
    progress /= progress[-1000:].mean(axis=0)  # to the final value as it is defined: the mean of the last 0.1 s
    expected = [np.interp(0.9, p, time[:, 0]) - np.interp(0.1, p, time[:, 0]) for p in progress.T]
    np.testing.assert_allclose(behaviour.rise_time(pd(kd=kd)), expected, atol=0.002)
    np.testing.assert_allclose(behaviour.overshoot(pd(kd=kd)), 0.0, atol=5e-3)


def test_stall_torque_is_the_limit_of_a_pd_and_the_limit_less_friction_of_a_motor():
    np.testing.assert_allclose(behaviour.stall_torque(pd(limit=1.3)), 1.3, rtol=1e-6)
    np.testing.assert_allclose(behaviour.stall_torque(pd()), KP * behaviour.STALL_ERROR, rtol=1e-3)
    motors = central(coulomb=[0.05, 0.2], load_friction=[0.0, 0.3], backlash=0.0)
    expected = (motors.torque_limit - motors.coulomb - motors.stribeck_torque) / (1 + motors.load_friction)
    np.testing.assert_allclose(behaviour.stall_torque(PhysicalActuator(motors)), expected, rtol=0.02)


def test_breakaway_is_friction_plus_the_spring_of_the_controller():
    motors = central(coulomb=[0.1, 0.25], load_friction=[0.0, 0.2], backlash=0.0, encoder_zero=0.0, kd=0.0)
    motors = replace(motors, gear_stiffness=np.full(2, 600.0))
    expected = (motors.coulomb + motors.stribeck_torque + motors.kp * behaviour.BREAKAWAY_ANGLE) / (
        1 - motors.load_friction
    )
    np.testing.assert_allclose(behaviour.breakaway(PhysicalActuator(motors)), expected, rtol=0.05)
