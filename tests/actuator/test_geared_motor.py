"""The geared motor of a grey box: momentum, passivity, stiction, and the limit of a stiff gear."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays as drawn

from motorprior.actuator.geared_motor_step import MotorState
from motorprior.actuator.grey_box import (
    FILTERED_VEL,
    JOINT_VEL,
    ROTOR_POS,
    ROTOR_VEL,
    GreyBox,
    GreyBoxActuator,
)
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.physics.motor_problem import encoded

MOTORS = 8
FREE = {"coulomb": 0.0, "stribeck_torque": 0.0, "viscous_damping": 0.0, "load_friction": 0.0}
LIMP = {"kp": 0.0}  # without a law: kd is a share of kp
STEPS_OF_PHYSICS = pytest.mark.parametrize("dt", [0.001, 0.002])


@dataclass
class State:
    """Initial angles and velocities of joints and rotors, (n,) each."""

    q: np.ndarray
    dq: np.ndarray
    rotor_pos: np.ndarray
    rotor_vel: np.ndarray


@dataclass
class Motion:
    """(steps + 1, n) arrays from the start on; momentum and energy are of rotor, gear and joint."""

    q: np.ndarray
    dq: np.ndarray
    rotor_pos: np.ndarray
    torque: np.ndarray
    twist_vel: np.ndarray
    momentum: np.ndarray
    energy: np.ndarray


def at_rest(n: int) -> State:
    return State(*np.zeros((4, n)))


def energy_of(values, load, q, dq, rotor_pos, rotor_vel):
    """Kinetic energy and elastic energy of the gear [J]."""
    twist = np.abs(rotor_pos - q)
    wound = np.maximum(twist - 0.5 * values["backlash"], 0.0)
    kinetic = 0.5 * (load * dq**2 + values["armature"] * rotor_vel**2)
    return kinetic + 0.5 * values["gear_stiffness"] * wound**2


def simulate(
    actuator: GreyBoxActuator, dt, load, target, external, start: State | None = None
) -> Motion:
    """A joint of inertia ``load`` (n,) as engines integrate it; target and external (steps, n)."""
    n = actuator.num_motors
    values = actuator.constants()
    arrays = actuator.arrays(dt)
    torque = np.zeros(n)
    start = start or at_rest(n)
    q = start.q.copy()
    dq = start.dq.copy()
    reset_actuator(arrays, target[0].copy(), q)
    motor = arrays.memory
    motor[ROTOR_POS] += start.rotor_pos
    motor[ROTOR_VEL] = start.rotor_vel
    motor[FILTERED_VEL] = start.rotor_vel
    motor[JOINT_VEL] = dq
    rotor_vel = start.rotor_vel
    rows = []

    def note():
        momentum = load * dq + values["armature"] * rotor_vel
        # positions are half a step ahead of the velocities
        q_now = q - 0.5 * dt * dq
        rotor_pos_now = motor[ROTOR_POS] - 0.5 * dt * rotor_vel
        energy = energy_of(values, load, q_now, dq, rotor_pos_now, rotor_vel)
        rotor_pos = motor[ROTOR_POS].copy()
        twist_vel = rotor_vel - dq
        rows.append([q.copy(), dq.copy(), rotor_pos, torque.copy(), twist_vel, momentum, energy])

    note()

    for row_of_targets, push in zip(target.copy(), external, strict=True):
        step_actuator(arrays, dt, row_of_targets, q, dq, torque)
        dq_before = dq
        dq = (dq + dt * (torque + push) / load) / (1.0 + dt * arrays.damping / load)
        q = q + dt * dq
        torque -= arrays.damping * dq

        # The engine's implicit damping took momentum from the joint. What differs from the
        # expected momentum goes to the rotor from the next step on.
        late = dq - dq_before - motor[MotorState._fields.index("expected_change")]
        rotor_vel = motor[ROTOR_VEL] + dt * arrays.damping * late / values["armature"]
        note()

    return Motion(*np.array(rows).transpose(1, 0, 2))


def still(seconds: float, dt: float, n: int = MOTORS) -> np.ndarray:
    return np.zeros((round(seconds / dt), n))


def latents(low: float = -2.0, high: float = 2.0):
    return drawn(float, (MOTORS, 3), elements=st.floats(low, high))


def values_of(low: float, high: float):
    """(MOTORS,) numbers of this range, and often 0, which is a special case of a start."""
    return drawn(float, MOTORS, elements=st.one_of(st.just(0.0), st.floats(low, high)))


LOADS = drawn(float, MOTORS, elements=st.floats(np.log(1e-4), np.log(3e-2))).map(np.exp)
STARTS = st.builds(
    State, values_of(-1, 1), values_of(-10, 10), values_of(-0.05, 0.05), values_of(-10, 10)
)


@STEPS_OF_PHYSICS
@settings(max_examples=5, deadline=None)
@given(z=latents(), load=LOADS, start=STARTS)
def test_rotor_and_joint_keep_their_momentum(grey_box, dt, z, load, start):
    motors = GreyBoxActuator(grey_box(**FREE, **LIMP), z)
    motion = simulate(motors, dt, load, still(0.3, dt), still(0.3, dt), start)
    # rounding of 300 impulses of at most load·10 rad/s; e^-50 of friction is less
    scale = 10.0 * (load + motors.model.armature(z))

    assert np.max(np.abs(motion.momentum - motion.momentum[0]) / scale) < 1e-12 * len(motion.q)


@STEPS_OF_PHYSICS
@pytest.mark.parametrize("friction", [FREE, {}], ids=["free", "with friction"])
@settings(max_examples=5, deadline=None)
@given(z=latents(), load=LOADS, start=STARTS)
def test_an_unpowered_motor_adds_no_energy_whatever_the_start(
    grey_box, dt, friction, z, load, start
):
    box: GreyBox = grey_box(**friction, **LIMP)
    motion = simulate(GreyBoxActuator(box, z), dt, load, still(0.4, dt), still(0.4, dt), start)
    # A blow may be seen a step too late: the energy of a spring wound by one step's twist. It is
    # never more than that, however long the joint bounces in its play; friction takes it again.
    late = (
        0.5 * box.constants(z)["gear_stiffness"] * (dt * np.abs(motion.twist_vel).max(axis=0)) ** 2
    )

    assert np.all(motion.energy <= motion.energy[0] + late + 1e-12)
    if not friction:
        assert np.all(motion.energy[-1] <= motion.energy[0] + 1e-12)


def test_a_held_motor_does_not_creep_below_its_friction_and_yields_above_it(grey_box):
    dt = 0.002
    n = MOTORS
    box: GreyBox = grey_box(spread=0.1, coulomb=0.1, stribeck_torque=0.05, load_friction=0.2)
    motors = GreyBoxActuator(box, np.random.default_rng(5).uniform(-1, 1, (n, 3)))
    values = box.constants(motors.z)
    breakaway = (values["coulomb"] + values["stribeck_torque"]) / (1.0 - values["load_friction"])
    target = np.tile(values["encoder_zero"], (1500, 1))  # the law pushes with nothing
    ramp = np.minimum(np.arange(1500) * dt / 1.0, 1.0)[:, None]
    load = np.full(n, 0.01)
    held = simulate(motors, dt, load, target, 0.8 * breakaway * ramp)

    # but for the blow that takes up the play
    assert np.max(np.abs(held.rotor_pos[-1] - held.rotor_pos[0])) < 1e-4

    late = held.rotor_pos[750:]

    np.testing.assert_array_equal(late, np.broadcast_to(late[0], late.shape))  # for ever
    # the gear carries what the law does not
    np.testing.assert_allclose(held.torque[-1], -0.8 * breakaway, rtol=0.02)

    moved = simulate(motors, dt, load, target, 1.5 * breakaway * ramp).rotor_pos[-1]
    expected = (1.5 * breakaway * (1 - values["load_friction"]) - values["coulomb"]) / values["kp"]

    assert np.all(moved > 0.5 * expected)
    assert np.all(moved < 1.5 * expected)


def rigid_response(
    inertia: float, kp: float, damping: float, delay: float, target: np.ndarray, dt: float
):
    """Angles [rad] of a rigid motor on a PD, simulated in steps of dt / 40.

    Commands are held from each step of ``dt`` and delayed.
    """
    q = 0.0
    dq = 0.0
    h = dt / 40
    angles = np.empty(len(target))

    for step in range(40 * len(target)):
        if step % 40 == 0:
            angles[step // 40] = q
        sent = max(0, int(np.floor((step * h - delay) / dt + 1e-9)))
        push = h * (kp * (target[sent] - q) - 0.5 * damping * dq) / inertia
        dq = (dq + push) / (1.0 + 0.5 * h * damping / inertia)
        q += h * dq

    return angles


@pytest.mark.parametrize("load", [0.004, 0.06])
def test_a_stiff_gear_moves_a_load_as_a_rigid_motor(load: float):
    dt = 0.002
    values = dict(kp=20.0, kd_over_kp=0.05, delay=0.01, armature=0.01, viscous_damping=0.1)
    none = dict.fromkeys(
        ("velocity_filter", "coulomb", "stribeck_torque", "load_friction", "backlash"), 1e-6
    )
    stiff = dict(torque_limit=500.0, gear_stiffness=1e4, gear_damping=1.0)
    center = encoded(values | none | stiff, ())
    motors = GreyBox(center, np.eye(len(center)), dt).motors(np.zeros((1, len(center))))
    target = np.repeat(np.random.default_rng(3).uniform(-0.3, 0.3, 16) * (np.arange(16) > 0), 125)
    trial = Trial(target[:, None], np.zeros((len(target), 1)), np.array([load]), dt)
    exact = rigid_response(load + 0.01, 20.0, 20.0 * 0.05 + 0.1, 0.01, target, dt)
    error = run(motors, trial).joint_pos[:, 0] - exact
    vel = np.gradient(exact, dt)

    assert abs(error @ vel / (vel @ vel)) < 0.1 * dt  # delay of the simulated joint
    assert np.sqrt(np.mean(error**2)) < 0.6e-3
