"""Closed forms of every term of out-of-family motors."""

from dataclasses import fields

import numpy as np
import pytest

from motorprior.actuator import out_of_family as rows
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.bench.dynamometer import Response, Trial, run

DT = 1e-4


def motor(**constants: float) -> OutOfFamilyMotors:
    """One motor with a rotor, a stiff gear and these constants; all other terms are off."""
    values = {
        "torque_limit": 1e3,
        "armature": 0.004,
        "gear_stiffness": 4000.0,
        "gear_damping": 1.0,
    } | constants
    names = [field.name for field in fields(OutOfFamilyMotors)]
    assert set(values) <= set(names)
    return OutOfFamilyMotors(**{name: np.array([values.get(name, 0.0)]) for name in names})


def respond(
    motors: OutOfFamilyMotors,
    target: np.ndarray,
    external: np.ndarray | float = 0.0,
    load: float = 0.01,
) -> Response:
    """Response of one motor to (steps,) targets [rad] and torques [N·m], in steps of DT."""
    torque = np.broadcast_to(external, target.shape)
    return run(motors.actuator(), Trial(target[:, None], torque[:, None], np.array([load]), DT))


def step(height: float, seconds: float) -> np.ndarray:
    target = np.full(round(seconds / DT), height)
    target[0] = 0.0
    return target


def test_a_motor_without_optional_terms_is_a_second_order_system():
    kp = 9.0
    kd = 0.3
    viscous = 0.05
    inertia = 0.014  # of rotor and load: 0.004 + 0.01 kg·m²

    motors = motor(kp=kp, kd=kd, viscous_damping=viscous)
    answer = respond(motors, step(0.1, 0.6)).joint_pos[:, 0]

    decay = (kd + viscous) / (2 * inertia)
    time = DT * np.arange(len(answer))
    omega = np.sqrt(kp / inertia - decay**2)
    swing = np.cos(omega * time) + decay / omega * np.sin(omega * time)
    expected = 0.1 * (1 - np.exp(-decay * time) * swing)

    np.testing.assert_allclose(answer, expected, atol=0.0008)


def test_friction_before_sliding_is_the_spring_of_the_lugre_model():
    """dz/dx = 1 - sigma·z/g loaded slowly and one way: x = -g/sigma·ln(1 - torque/g)."""
    g = 0.05
    sigma = 20.0
    torque = 0.04
    stiffness = 4000.0
    motors = motor(
        coulomb=g, bristle_stiffness=sigma, viscous_damping=0.5, gear_stiffness=stiffness
    )
    external = torque * np.clip(np.linspace(0.0, 1.5, 20_000), 0.0, 1.0)
    moved = respond(motors, np.zeros(20_000), external, load=0.001).joint_pos[-1, 0]

    bristle = -g / sigma * np.log(1 - torque / g)
    gear = torque / stiffness
    assert moved == pytest.approx(bristle + gear, rel=0.01)


def friction_at(motors: OutOfFamilyMotors, speed: float) -> float:
    """Friction [N·m] of a heavy rotor that has moved at this speed [rad/s] for long."""
    arrays = motors.actuator().arrays(DT)
    still = np.zeros(1)
    gear = np.zeros(1)
    reset_actuator(arrays, still, still)

    for _ in range(1000):
        arrays.memory[rows.ROTOR_POS, 0] = 0.0
        arrays.memory[rows.ROTOR_VEL, 0] = speed
        step_actuator(arrays, DT, still, still, np.array([speed]), gear)

    return float((speed - arrays.memory[rows.ROTOR_VEL, 0]) * motors.armature[0] / DT - gear[0])


@pytest.mark.parametrize("speed", [0.05, 0.2, 3.0])
def test_friction_falls_with_speed_by_the_stribeck_curve(speed):
    """Stribeck: coulomb + static_torque·exp(-(w / stribeck_velocity)²)."""
    motors = motor(
        armature=100.0,
        coulomb=0.05,
        static_torque=0.04,
        stribeck_velocity=0.2,
        bristle_stiffness=400.0,
    )
    expected = 0.05 + 0.04 * np.exp(-((speed / 0.2) ** 2))

    for direction in (1.0, -1.0):
        assert friction_at(motors, direction * speed) == pytest.approx(
            direction * expected, rel=1e-3
        )


@pytest.mark.parametrize(
    ("speed", "min_torque", "max_torque"),
    [(15.0, -3.0, 1.0), (-15.0, -1.0, 3.0), (45.0, -5.0, 0.0)],
)
def test_the_voltage_leaves_more_torque_to_brake_than_to_drive(speed, min_torque, max_torque):
    """stall·(±1 - w / no_load_speed): back-EMF is against the drive and with the brake."""
    for target, expected in ((1e3, max_torque), (-1e3, min_torque)):
        motors = motor(kp=1e3, armature=1e9, stall_torque=2.0, no_load_speed=30.0)
        arrays = motors.actuator().arrays(DT)
        still = np.zeros(1)
        reset_actuator(arrays, np.array([target]), still)
        arrays.memory[rows.ROTOR_VEL, 0] = speed
        step_actuator(arrays, DT, np.array([target]), still, np.array([speed]), np.zeros(1))
        assert arrays.memory[rows.TORQUE, 0] == pytest.approx(expected)


def twisted(motors: OutOfFamilyMotors, twist: np.ndarray) -> np.ndarray:
    """(steps,) torque of the gear [N·m] behind a rotor that does not move."""
    arrays = motors.actuator().arrays(DT)
    torque = np.zeros((len(twist), 1))
    still = np.zeros(1)
    reset_actuator(arrays, still, still)

    for angle, out in zip(twist, torque, strict=True):
        step_actuator(arrays, DT, still, np.array([-angle]), still, out)

    return torque[:, 0]


def test_a_cycle_of_the_gear_costs_the_sliders_parallelogram():
    """4·torque·(amplitude - torque / stiffness) per cycle, Iwan (1966)."""
    motors = motor(armature=1e9, gear_stiffness=80.0, slider_stiffness=40.0, slider_torque=0.1)
    twist = 0.02 * np.sin(np.linspace(0.0, 4 * np.pi, 8001)) + 0.1
    torque = twisted(motors, twist)[4000:]
    area = np.sum(0.5 * (torque[1:] + torque[:-1]) * np.diff(twist[4000:]))

    assert area == pytest.approx(4 * 0.1 * (0.02 - 0.1 / 40.0), rel=0.01)
