"""A PD with Coulomb friction: the ideal PD less a force against the motion."""

from dataclasses import fields, replace

import numpy as np
import pytest

from motorprior.actuator.friction_pd import FULL_FRICTION_SPEED, FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.kernels import make_explicit, reset_actuator, step_actuator

DT, COULOMB = 0.002, 0.26
PD = IdealPd.uniform(4, kp=8.3, kd=0.73, torque_limit=1.45, armature=0.0015)
LIGHT = replace(PD, armature=np.full(4, 1e-4), kd=np.full(4, 0.1))
SPEEDS = np.linspace(-3.0, 3.0, 61)[:, None] * np.array([1.0, 0.1, 0.01, 0.0])


def effort(actuator: IdealPd | FrictionPd, velocity: np.ndarray, explicit: bool = False) -> np.ndarray:
    """(steps, 4) what acts on a joint that keeps its velocity, where its target is [N·m]."""
    arrays, out = actuator.arrays(DT), np.zeros(velocity.shape)
    there = np.zeros(4)
    reset_actuator(arrays, there, there)
    for step, row in enumerate(velocity):
        step_actuator(arrays, DT, there, there, row.copy(), out[step])
        if explicit:
            make_explicit(arrays, row.copy(), out[step])
            np.testing.assert_array_equal(arrays.damping, actuator.damping)
        out[step] -= arrays.damping * row
    return out


def friction(pd: IdealPd, velocity: np.ndarray, explicit: bool = False) -> np.ndarray:
    return effort(pd, velocity) - effort(FrictionPd(pd, np.full(4, COULOMB)), velocity, explicit)


@pytest.mark.parametrize("pd", [PD, LIGHT])
def test_it_is_against_the_motion_whole_when_fast_and_linear_when_slow(pd: IdealPd):
    np.testing.assert_allclose(
        friction(pd, SPEEDS), COULOMB * np.clip(SPEEDS / FULL_FRICTION_SPEED, -1.0, 1.0), atol=1e-12
    )


def motion(pd: IdealPd, coulomb: float, load: float, start: float, target: float, h: float, seconds: float):
    """(steps,) velocity of a joint with a load [kg·m²], as an engine takes torque and damping."""
    one = IdealPd(*(getattr(pd, field.name)[:1] for field in fields(IdealPd)))
    actuator = FrictionPd(one, np.array([coulomb]))
    arrays, inertia = actuator.arrays(h), load + one.armature
    pos, velocity, torque, found = np.zeros(1), np.array([start]), np.zeros(1), []
    reset_actuator(arrays, np.array([target]), pos)
    for _ in range(round(seconds / h)):
        step_actuator(arrays, h, np.array([target]), pos, velocity, torque)
        velocity = (inertia * velocity + h * torque) / (inertia + h * arrays.damping)
        pos = pos + h * velocity
        found.append(velocity[0])
    return np.array(found)


@pytest.mark.parametrize("kd", [0.0, 0.73])
@pytest.mark.parametrize("armature", [0.0, 0.0015])
@pytest.mark.parametrize("load", [3.4e-4, 0.01])
def test_a_joint_that_coasts_is_stopped_and_not_turned_round(kd: float, armature: float, load: float):
    limp = IdealPd.uniform(1, kp=0.0, kd=kd, torque_limit=10.0, armature=armature)
    for start in (0.11, 0.15, 0.19, 0.25, 0.3, 0.4, 1.0):
        speeds = motion(limp, COULOMB, load, start, 0.0, DT, 0.3)
        assert np.all(speeds >= 0.0) and np.all(np.diff(speeds) <= 1e-15) and speeds[-1] < 1e-3
