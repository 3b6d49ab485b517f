"""A PD with Coulomb friction: the ideal PD less a force against the motion."""

import numpy as np
import pytest

from motorprior.actuator.friction_pd import SLOWEST, FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.torque_law import reset_actuator, step_actuator
from motorprior.bench.dynamometer import Trial, run

DT, COULOMB = 0.002, 0.12
PD = IdealPd.uniform(4, kp=8.0, kd=0.5, torque_limit=1.3, armature=0.004, delay=0.003)


def torques(actuator: IdealPd | FrictionPd, velocity: np.ndarray) -> np.ndarray:
    """(steps, 4) at rest position 0 with target 0.1, at the given velocities."""
    arrays, out = actuator.arrays(DT), np.zeros(velocity.shape)
    target, pos = np.full(4, 0.1), np.zeros(4)
    reset_actuator(arrays, target, pos)
    for step, row in enumerate(velocity):
        step_actuator(arrays, DT, target, pos, row.copy(), out[step])
    return out


def friction(coulomb: float, velocity: np.ndarray) -> np.ndarray:
    return torques(PD, velocity) - torques(FrictionPd(PD, np.full(4, coulomb)), velocity)


def test_it_is_against_the_motion_whole_when_fast_and_linear_when_slow():
    speeds = np.linspace(-3.0, 3.0, 61)[:, None] * np.array([1.0, 0.1, 0.01, 0.0])
    found = friction(COULOMB, speeds)
    np.testing.assert_allclose(found, COULOMB * np.clip(speeds / SLOWEST, -1.0, 1.0), atol=1e-12)


def test_a_light_rotor_gets_a_flatter_slope_and_none_without_armature():
    light = IdealPd.uniform(4, kp=8.0, kd=0.5, torque_limit=1.3, armature=1e-3)
    slow = np.full((3, 4), 0.05)
    found = torques(light, slow) - torques(FrictionPd(light, np.full(4, COULOMB)), slow)
    np.testing.assert_allclose(found, 1e-3 / DT * 0.05, atol=1e-12)
    bare = IdealPd.uniform(4, kp=8.0, kd=0.5, torque_limit=1.3)
    np.testing.assert_array_equal(torques(bare, slow), torques(FrictionPd(bare, np.full(4, COULOMB)), slow))


@pytest.mark.parametrize("coulomb", [0.15, 0.3])
def test_a_joint_that_coasts_is_stopped_and_not_turned_round(coulomb: float):
    """No gains, pushed for 0.1 s, then alone."""
    limp = IdealPd.uniform(1, kp=0.0, kd=0.0, torque_limit=1.0, armature=0.004)
    push = np.zeros((500, 1))
    push[:50] = 1.0
    coasting = run(FrictionPd(limp, np.array([coulomb])), Trial(np.zeros((500, 1)), push, np.array([0.002]), DT))
    speed = coasting.joint_vel[60:, 0]
    assert speed[0] > 1.0 and abs(speed[-1]) < 0.02 and speed.min() > -0.02
    free = run(limp, Trial(np.zeros((500, 1)), push, np.array([0.002]), DT)).joint_vel[60:, 0]
    assert free[-1] == pytest.approx(free[0])
