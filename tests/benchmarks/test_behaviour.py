"""Behaviour features against closed forms: second-order response, friction, saturation; no NaN."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.physical import PhysicalActuator
from virtual_fleets import behaviour

KP = np.array([8.0, 12.0])
KD = np.array([0.8, 0.9])
ARMATURE = np.array([0.002, 0.004])


def pd(delay=0.0, kd=KD, limit=50.0):
    return IdealPd.without_friction(KP, kd, np.full(2, limit), ARMATURE, np.full(2, delay))


def central(**changes):
    """Two central motors of the fleet, changed."""
    motors = require_geared(load_fleet("pupper_v2").center(2))
    return replace(
        motors, **{name: np.broadcast_to(value, 2).astype(float) for name, value in changes.items()}
    )


@pytest.mark.parametrize(("frequency", "delay"), [(1, 0.0), (8, 0.012)])
def test_gain_and_lag_are_those_of_the_second_order_system(frequency, delay):
    s = 2j * np.pi * frequency
    inertia = behaviour.LOAD_INERTIA + ARMATURE
    expected = KP * np.exp(-s * delay) / (inertia * s**2 + KD * s + KP)
    gain, lag = behaviour.frequency_response(pd(delay), frequency)
    np.testing.assert_allclose(gain, np.abs(expected), rtol=0.03)
    phase = np.mod(-np.angle(expected), 2 * np.pi)
    # a target holds for 2 ms
    np.testing.assert_allclose(lag, phase / (2 * np.pi * frequency), atol=0.0015)


def test_stall_torque_is_the_limit_of_a_pd_and_the_limit_less_friction_of_a_motor():
    np.testing.assert_allclose(behaviour.stall_torque(pd(limit=1.3)), 1.3, rtol=1e-6)
    np.testing.assert_allclose(behaviour.stall_torque(pd()), KP * behaviour.STALL_ERROR, rtol=1e-3)
    motors = central(coulomb=[0.05, 0.2], load_friction=[0.0, 0.3], backlash=0.0)
    expected = (motors.torque_limit - motors.coulomb - motors.stribeck_torque) / (
        1 + motors.load_friction
    )
    np.testing.assert_allclose(
        behaviour.stall_torque(PhysicalActuator(motors)), expected, rtol=0.02
    )
