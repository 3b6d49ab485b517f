"""The physical motor keeps the laws of mechanics and, with nothing but a rotor, is an ideal PD."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.physical import SUBSTEP, PhysicalActuator, PhysicalMotors
from motorprior.bench.dynamometer import Trial, run

STIFF = {"gear_stiffness": 3000.0, "gear_damping": 1.0}
FEW = settings(max_examples=15, deadline=None, derandomize=True)


def motor(**changes):
    """One motor without any imperfection but a soft gear; changes by name."""
    values = dict.fromkeys(PhysicalMotors.__dataclass_fields__, 0.0)
    values |= {"kp": 6.0, "kd": 0.3, "torque_limit": 100.0, "stall_torque": 1e6, "no_load_speed": 1e6}
    values |= {"armature": 0.003, "velocity_filter": 1e-6, "stribeck_velocity": 0.3, "gear_stiffness": 80.0}
    values |= changes
    return PhysicalActuator(PhysicalMotors(**{name: np.array([value]) for name, value in values.items()}))


def step_response(time, size, inertia, kp, kd):
    """Angle of inertia·q̈ + kd·q̇ + kp·q = kp·size, from rest at 0, underdamped."""
    decay = kd / (2 * inertia)
    wave = np.sqrt(kp / inertia - decay**2)
    return size * (1 - np.exp(-decay * time) * (np.cos(wave * time) + decay / wave * np.sin(wave * time)))


@pytest.mark.parametrize(("kp", "kd", "load"), [(6.0, 0.3, 0.01), (3.0, 0.1, 0.003)])
def test_a_rigid_motor_without_friction_is_a_second_order_system(kp, kd, load):
    steps = 2000
    targets = np.full((steps, 1), 0.3)
    targets[0] = 0.0
    trial = Trial(targets, np.zeros((steps, 1)), np.array([load]), SUBSTEP)
    response = run(motor(kp=kp, kd=kd, **STIFF), trial)
    time = np.arange(steps - 1) * SUBSTEP
    expected = step_response(time, 0.3, load + 0.003, kp, kd)
    # twist of the gear: 0.3 rad·kp/3000 = 6e-4 rad; Euler and the filter are late by about a substep, at
    # most 0.3 rad·sqrt(kp/inertia)·0.25 ms = 2e-3 rad
    np.testing.assert_allclose(response.joint_pos[1:, 0], expected, atol=2.5e-3)
    assert np.max(expected) > 0.33  # it swings: a wrong inertia or damping would show


def energy(response, actuator, load):
    """Kinetic and gear energy [J] of a response whose rotor is replayed on the same joint motion."""
    arrays = actuator.arrays(SUBSTEP)
    q, dq = response.joint_pos, response.joint_vel
    reset_actuator(arrays, q[0].copy(), q[0].copy())
    rotor = np.zeros((len(q), 2))
    for k in range(len(q)):
        rotor[k] = arrays.memory[:2, 0]
        step_actuator(arrays, SUBSTEP, q[0], q[k].copy(), dq[k].copy(), np.zeros(1))
    m = actuator.motors
    twist = np.abs(rotor[:, 0] - q[:, 0]) - 0.5 * m.backlash[0]
    gear = 0.5 * m.gear_stiffness[0] * np.maximum(0.0, twist) ** 2
    return 0.5 * load * dq[:, 0] ** 2 + 0.5 * m.armature[0] * rotor[:, 1] ** 2 + gear


@FEW
@given(
    friction=st.fixed_dictionaries(
        {
            "coulomb": st.floats(0.0, 0.2),
            "stribeck_torque": st.floats(0.0, 0.05),
            "viscous_damping": st.floats(0.0, 0.01),
            "load_friction": st.floats(0.0, 0.4),
            "backlash": st.floats(0.0, 0.03),
            "gear_stiffness": st.floats(40.0, 120.0),
            "gear_damping": st.floats(0.0, 0.03),
            "armature": st.floats(0.001, 0.005),
        }
    ),
    load=st.floats(0.001, 0.03),
)
def test_an_unpowered_motor_spun_by_hand_only_loses_energy(friction, load):
    actuator, steps, pushed = motor(kp=0.0, kd=0.0, **friction), 1200, 20
    external = np.zeros((steps, 1))
    external[:pushed] = 5.0 * load / (pushed * SUBSTEP)  # an impulse to 5 rad/s
    response = run(actuator, Trial(np.zeros((steps, 1)), external, np.array([load]), SUBSTEP))
    left = energy(response, actuator, load)[pushed:]
    # symplectic Euler swings about the true energy by wave·h/2, wave = sqrt(stiffness/reduced inertia)
    armature = friction["armature"]
    wave = np.sqrt(friction["gear_stiffness"] * (1 / load + 1 / armature))
    assert np.max(left) <= left[0] * (1 + wave * SUBSTEP)
    quarters = [np.max(part) for part in np.split(left, [295, 590, 885])]
    assert np.all(np.diff(quarters) <= wave * SUBSTEP * np.array(quarters[:-1]))
    if friction["coulomb"] > 0.01:
        assert left[-1] < left[0]
