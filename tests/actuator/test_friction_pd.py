"""A PD with Coulomb friction: the ideal PD less a force against the motion."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.friction_pd import SLOWEST, FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.torque_law import make_explicit, reset_actuator, step_actuator
from motorprior.bench.dynamometer import Trial, run

DT, COULOMB = 0.002, 0.12
PD = IdealPd.uniform(4, kp=8.0, kd=0.5, torque_limit=1.3, armature=0.004, delay=0.003)


def effort(actuator: IdealPd | FrictionPd, velocity: np.ndarray, explicit: bool = False) -> np.ndarray:
    """(steps, 4) what acts on a joint that keeps its velocity, at position 0 with target 0.1 [N·m]."""
    arrays, out = actuator.arrays(DT), np.zeros(velocity.shape)
    target, pos = np.full(4, 0.1), np.zeros(4)
    reset_actuator(arrays, target, pos)
    for step, row in enumerate(velocity):
        step_actuator(arrays, DT, target, pos, row.copy(), out[step])
        if explicit:
            make_explicit(arrays, row.copy(), out[step])
            np.testing.assert_array_equal(arrays.damping, actuator.damping)
        out[step] -= arrays.damping * row
    return out


def friction(pd: IdealPd, velocity: np.ndarray, explicit: bool = False) -> np.ndarray:
    return effort(pd, velocity) - effort(FrictionPd(pd, np.full(4, COULOMB)), velocity, explicit)


LIGHT = replace(PD, armature=np.full(4, 1e-4), kd=np.full(4, 0.1))
SPEEDS = np.linspace(-3.0, 3.0, 61)[:, None] * np.array([1.0, 0.1, 0.01, 0.0])


@pytest.mark.parametrize("pd", [PD, LIGHT])
def test_it_is_against_the_motion_whole_when_fast_and_linear_when_slow(pd: IdealPd):
    np.testing.assert_allclose(friction(pd, SPEEDS), COULOMB * np.clip(SPEEDS / SLOWEST, -1.0, 1.0), atol=1e-12)


def test_an_engine_without_implicit_friction_gets_a_flatter_slope_on_a_light_rotor():
    np.testing.assert_allclose(
        friction(PD, SPEEDS, explicit=True), COULOMB * np.clip(SPEEDS / SLOWEST, -1.0, 1.0), atol=1e-12
    )
    slope = 1e-4 / DT + 0.1
    np.testing.assert_allclose(
        friction(LIGHT, SPEEDS, explicit=True), np.clip(slope * SPEEDS, -COULOMB, COULOMB), atol=1e-12
    )


@pytest.mark.parametrize(("armature", "coulomb"), [(0.004, 0.15), (0.004, 0.3), (0.0, 0.26)])
def test_a_joint_that_coasts_is_stopped_and_not_turned_round(armature: float, coulomb: float):
    """No gains, pushed for 0.1 s, then alone."""
    limp = IdealPd.uniform(1, kp=0.0, kd=0.0, torque_limit=1.0, armature=armature)
    push = np.zeros((500, 1))
    push[:50] = 1.0
    coasting = run(FrictionPd(limp, np.array([coulomb])), Trial(np.zeros((500, 1)), push, np.array([0.002]), DT))
    speed = coasting.joint_vel[60:, 0]
    assert speed[0] > 1.0 and abs(speed[-1]) < 0.02 and speed.min() > -0.02
    free = run(limp, Trial(np.zeros((500, 1)), push, np.array([0.002]), DT)).joint_vel[60:, 0]
    assert free[-1] == pytest.approx(free[0])
