"""The physical motor with nothing but a rotor is an ideal PD."""

import numpy as np
import pytest

from motorprior.actuator.physical import SUBSTEP, PhysicalActuator, PhysicalMotors
from motorprior.bench.dynamometer import Trial, run


@pytest.mark.parametrize(("kp", "kd", "load"), [(6.0, 0.3, 0.01), (3.0, 0.1, 0.003)])
def test_a_rigid_motor_without_friction_is_a_second_order_system(kp: float, kd: float, load: float):
    """Inertia·q̈ + kd·q̇ + kp·q = kp·target, from rest at 0, underdamped."""
    armature = 0.003
    values = dict.fromkeys(PhysicalMotors.__dataclass_fields__, 0.0) | {
        "kp": kp,
        "kd": kd,
        "torque_limit": 100.0,
        "stall_torque": 1e6,
        "no_load_speed": 1e6,
        "armature": armature,
        "velocity_filter": 1e-6,
        "stribeck_velocity": 0.3,
        "gear_stiffness": 3000.0,
        "gear_damping": 1.0,
    }
    motor = PhysicalMotors(**{name: np.array([value]) for name, value in values.items()})
    targets = np.full((2000, 1), 0.3)
    targets[0] = 0.0
    trial = Trial(targets, 0.0 * targets, np.array([load]), SUBSTEP)

    response = run(PhysicalActuator(motor), trial)

    time = np.arange(len(targets) - 1) * SUBSTEP
    inertia = load + armature
    decay = kd / (2 * inertia)
    wave = np.sqrt(kp / inertia - decay**2)
    swing = np.cos(wave * time) + decay / wave * np.sin(wave * time)
    expected = 0.3 * (1 - np.exp(-decay * time) * swing)

    # twist of the gear: 0.3 rad·kp/3000 = 6e-4 rad; Euler and the filter are late by about a
    # substep, at most 0.3 rad·sqrt(kp/inertia)·0.25 ms = 2e-3 rad
    np.testing.assert_allclose(response.joint_pos[1:, 0], expected, atol=2.5e-3)
    assert np.max(expected) > 0.33  # it swings: a wrong inertia or damping would show
