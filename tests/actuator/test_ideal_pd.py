"""An ideal PD equals its formula; its closed loop is a second-order system with dry friction."""

from dataclasses import fields, replace

import numpy as np
import pytest
from imposed_motion import torques

from motorprior.actuator.actuator import ConstantFactors, with_factors
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.kernels import reset_actuator, step_actuator

DT = 0.002


def test_torque_is_the_clipped_law_plus_the_damping_that_the_engine_takes():
    rng = np.random.default_rng(0)
    actuator = IdealPd.without_friction(
        *(rng.uniform(0.1, 2.0, 5) for _ in range(4)), delay=np.zeros(5)
    )
    inputs = rng.normal(0.0, 1.0, (3, 200, 5))
    target, q, dq = inputs
    request = actuator.kp * (target - q) - actuator.kd * dq
    law = np.clip(request, -actuator.torque_limit, actuator.torque_limit)

    np.testing.assert_allclose(torques(actuator, inputs) - actuator.kd * dq, law, atol=1e-12)
    assert 0.2 < np.mean(np.abs(law) == actuator.torque_limit) < 0.9  # both branches are seen
    np.testing.assert_array_equal(actuator.damping, actuator.kd)


@pytest.mark.parametrize("lag", [0.0, 0.3, 7.5])
def test_a_delayed_target_is_the_target_of_so_long_ago(lag):
    rng = np.random.default_rng(1)
    target = np.cumsum(rng.normal(size=(40, 2)), axis=0)
    inputs = np.stack([target, 0.0 * target, 0.0 * target])
    actuator = IdealPd.uniform(2, kp=1.0, kd=0.0, torque_limit=1e9, delay=lag * DT)
    steps = np.arange(40.0)
    # before the start the first target has held for ever, which is what np.interp extrapolates
    expected = np.stack([np.interp(steps - lag, steps, column) for column in target.T], axis=1)

    np.testing.assert_allclose(torques(actuator, inputs), expected, atol=1e-9)


@pytest.mark.parametrize("coulomb", [0.0, 0.1])
def test_scaled_motors_are_those_with_scaled_constants(coulomb: float):
    values = ConstantFactors(kp=9.0, kd=0.8, torque_limit=1.3, coulomb=coulomb)  # pyright: ignore[reportArgumentType]
    scales = ConstantFactors(*np.random.default_rng(0).uniform(0.5, 1.5, (4, 3)))
    if not coulomb:
        scales = scales._replace(coulomb=np.ones(3))

    def motors(kp: np.ndarray, kd: np.ndarray, limit: np.ndarray, dry: np.ndarray) -> IdealPd:
        return IdealPd(kp, kd, limit, np.full(3, 0.003), np.full(3, 0.01), dry)

    nominal = motors(*np.outer(values, np.ones(3)))
    scaled = with_factors(nominal, scales).arrays(DT)

    expected = motors(*(np.array(scales) * np.array(values)[:, None])).arrays(DT)
    np.testing.assert_allclose(scaled.parameters, expected.parameters, rtol=1e-12)
    np.testing.assert_allclose(scaled.damping, expected.damping, rtol=1e-12)


COULOMB = 0.26
PD = IdealPd.uniform(4, kp=8.3, kd=0.73, torque_limit=1.45, armature=0.0015)
LIGHT = replace(PD, armature=np.full(4, 1e-4), kd=np.full(4, 0.1))
SPEEDS = np.linspace(-3.0, 3.0, 61)[:, None] * np.array([1.0, 0.1, 0.01, 0.0])


def effort(actuator: IdealPd, velocity: np.ndarray) -> np.ndarray:
    """(steps, 4) torque on joints that stay at their target with imposed velocities [N·m]."""
    arrays = actuator.arrays(DT)
    out = np.zeros(velocity.shape)
    there = np.zeros(4)
    reset_actuator(arrays, there, there)

    for step, row in enumerate(velocity):
        step_actuator(arrays, DT, there, there, row.copy(), out[step])
        out[step] -= arrays.damping * row

    return out


@pytest.mark.parametrize("pd", [PD, LIGHT])
def test_friction_opposes_the_motion_whole_when_fast_and_linear_when_slow(pd: IdealPd):
    friction = effort(pd, SPEEDS) - effort(replace(pd, coulomb=np.full(4, COULOMB)), SPEEDS)
    fast = np.abs(SPEEDS) > 0.5
    slow = (SPEEDS != 0.0) & (np.abs(SPEEDS) < 0.05)

    np.testing.assert_allclose(friction[fast], COULOMB * np.sign(SPEEDS[fast]))

    slope = friction[slow] / SPEEDS[slow]

    np.testing.assert_allclose(slope, slope[0])
    assert slope[0] > COULOMB / 0.5
    assert np.all(friction[SPEEDS == 0.0] == 0.0)


def motion(
    pd: IdealPd, coulomb: float, load: float, start: float, target: float, h: float, seconds: float
):
    """(steps,) velocity of a joint with a load [kg·m²], as an engine takes torque and damping."""
    one = IdealPd(*(getattr(pd, field.name)[:1] for field in fields(IdealPd)))
    actuator = replace(one, coulomb=np.array([coulomb]))
    arrays = actuator.arrays(h)
    inertia = load + one.armature
    pos = np.zeros(1)
    velocity = np.array([start])
    torque = np.zeros(1)
    velocities = []
    reset_actuator(arrays, np.array([target]), pos)

    for _ in range(round(seconds / h)):
        step_actuator(arrays, h, np.array([target]), pos, velocity, torque)
        velocity = (inertia * velocity + h * torque) / (inertia + h * arrays.damping)
        pos = pos + h * velocity
        velocities.append(velocity[0])

    return np.array(velocities)


@pytest.mark.parametrize("kd", [0.0, 0.73])
@pytest.mark.parametrize("armature", [0.0, 0.0015])
@pytest.mark.parametrize("load", [3.4e-4, 0.01])
def test_friction_stops_a_coasting_joint_and_does_not_reverse_it(
    kd: float, armature: float, load: float
):
    limp = IdealPd.uniform(1, kp=0.0, kd=kd, torque_limit=10.0, armature=armature)
    for start in (0.11, 0.15, 0.19, 0.25, 0.3, 0.4, 1.0):
        speeds = motion(limp, COULOMB, load, start, 0.0, DT, 0.3)

        assert np.all(speeds >= 0.0)
        assert np.all(np.diff(speeds) <= 1e-15)
        assert speeds[-1] < 1e-3
