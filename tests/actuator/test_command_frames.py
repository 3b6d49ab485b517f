"""MIT mode, velocity and torque control: one law, of which position commands are a special case."""

from dataclasses import replace

import numpy as np
import pytest
from grey_boxes import make_grey_box
from networks import network
from numpy_arithmetic import NUMPY

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.command_frame import IN_FORCE, Frames, framed_arrays, send_frame
from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.geared_motor_step import CommandFrame, MotorState, StepConstants, step
from motorprior.actuator.grey_box import TARGET, GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import NetworkActuator
from motorprior.actuator.motors import Motors
from motorprior.actuator.optional_terms import TERMS
from motorprior.bench.dynamometer import Response, Trial, run
from motorprior.exceptions import ConfigError

H = 0.002  # [s]
MOTORS = 11  # eight lanes and three alone
STEPS = 300
TERMS_OF_MOTORS = pytest.mark.parametrize("terms", [(), tuple(TERMS)], ids=len)


def grey_boxes(terms: tuple[str, ...] = ()) -> GreyBoxActuator:
    rng = np.random.default_rng(3)
    return GreyBoxActuator(make_grey_box(terms=terms), rng.standard_normal((MOTORS, 3)))


def physical_motors() -> Actuator:
    return require_geared(load_fleet("pupper_v2").sample(MOTORS, 2)).actuator()


def friction_pd() -> IdealPd:
    pd = IdealPd.uniform(MOTORS, 10.0, 0.5, 5.0, armature=0.002, delay=0.005, coulomb=0.05)
    return replace(pd, kp=np.linspace(5.0, 20.0, MOTORS))


def trial(frames: Frames | None) -> Trial:
    """Sines of several frequencies on a light load."""
    phases = H * np.arange(STEPS)[:, None] * np.linspace(3.0, 20.0, MOTORS)
    inertia = np.full(MOTORS, 0.01)
    return Trial(0.5 * np.sin(phases), np.zeros((STEPS, MOTORS)), inertia, H, frames=frames)


def moved(actuator: Actuator, frames: Frames | None) -> Response:
    return run(actuator, trial(frames))


@pytest.mark.parametrize(
    "actuator",
    [grey_boxes(), grey_boxes(tuple(TERMS)), friction_pd(), physical_motors()],
    ids=["grey_box", "grey_box_with_terms", "friction_pd", "physical"],
)
def test_a_frame_of_zeros_gives_the_bits_of_a_position_command(actuator: Actuator):
    position = moved(actuator, None)
    framed = moved(actuator, Frames())

    for name in ("joint_pos", "joint_vel", "joint_torque", "encoder_pos"):
        np.testing.assert_array_equal(getattr(framed, name), getattr(position, name))


@TERMS_OF_MOTORS
def test_the_compiled_step_is_the_formula_with_the_frame_in_force(terms: tuple[str, ...]):
    rng = np.random.default_rng(7)
    motors = grey_boxes(terms)
    arrays = framed_arrays(motors, H)
    table = arrays.parameters.copy()
    q = rng.uniform(-0.3, 0.3, MOTORS)
    dq = rng.standard_normal(MOTORS)
    torque = np.zeros(MOTORS)
    frame = Frames(*rng.uniform(0.2, 1.5, (4, MOTORS)))
    send_frame(arrays.frames, frame, MOTORS)
    reset_actuator(arrays, q + 0.1, q)
    state = MotorState(*arrays.memory[: len(MotorState._fields)].copy())

    step_actuator(arrays, H, q + 0.1, q, dq, torque)

    constants = StepConstants(*table, *[None] * (len(StepConstants._fields) - len(table)))
    in_force = CommandFrame(*frame)
    _, formula, damping = step(
        constants, state, arrays.memory[TARGET], q, dq, H, NUMPY, terms, in_force
    )
    np.testing.assert_allclose(torque, formula, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(arrays.damping, damping, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("command", [Frames(2.0, 0.5), Frames(0.0, 0.0, 0.3, 0.6)], ids=str)
def test_the_delay_holds_for_the_whole_frame(command: Frames):
    motors = grey_boxes()
    arrays = framed_arrays(motors, H)
    still = np.zeros(MOTORS)
    reset_actuator(arrays, still, still)
    before = np.array(Frames())[:, None]
    change = np.array(command)[:, None] - before
    arrived = np.zeros((4, MOTORS))

    for _ in range(40):
        send_frame(arrays.frames, command, MOTORS)
        step_actuator(arrays, H, still, still, still, np.zeros(MOTORS))
        arrived += arrays.frames[IN_FORCE].reshape(4, MOTORS) - before

    # a mean over the step from half a step earlier to half a step later
    delay = motors.constants()["delay"] / H + 0.5
    np.testing.assert_allclose(arrived, change * (40.0 - delay), atol=1e-9)


def test_torque_control_accelerates_rotor_and_load_by_the_commanded_torque():
    armature = 0.003
    inertia = 0.01
    box = make_grey_box(
        spread=0.0,
        armature=armature,
        coulomb=1e-9,
        stribeck_torque=1e-9,
        viscous_damping=1e-9,
        load_friction=1e-9,
    )
    motors = Motors(box.motors(np.zeros((1, 3))), H, np.zeros(1))
    q = np.zeros(1)
    dq = np.zeros(1)

    for _ in range(500):
        torque, damping = motors.step(
            np.full(1, 3.0), q, dq, torque_feedforward=0.02, kp_factor=0.0, kd_factor=0.0
        )
        dq = (dq + H * torque / inertia) / (1.0 + H * damping / inertia)
        q = q + H * dq

    delay = float(box.constants(np.zeros((1, 3)))["delay"][0])
    speed = 0.02 / (armature + inertia) * (500 * H - delay)
    assert dq[0] == pytest.approx(speed, rel=0.03)


def test_a_velocity_target_removes_the_lag_of_a_ramp():
    actuator = friction_pd()
    steps = 1500
    ramp = np.tile(0.5 * H * np.arange(steps)[:, None], (1, MOTORS))
    load = (np.zeros((steps, MOTORS)), np.full(MOTORS, 0.01), H)
    lag = ramp[-1] - run(actuator, Trial(ramp, *load)).joint_pos[-1]
    lag_with_target = ramp[-1] - run(actuator, Trial(ramp, *load, frames=Frames(0.5))).joint_pos[-1]

    # kd·velocity/kp of a PD whose kd acts on the absolute velocity
    saved = actuator.kd * 0.5 / actuator.kp
    np.testing.assert_allclose(lag - lag_with_target, saved, rtol=1e-3)


def test_motors_of_position_commands_alone_refuse_a_feed_forward_torque():
    motors = Motors(NetworkActuator(network(), np.zeros((1, 3))), H, np.zeros(1))

    with pytest.raises(ConfigError, match="position commands only"):
        motors.step(np.zeros(1), np.zeros(1), np.zeros(1), torque_feedforward=0.1)


def test_a_reset_forgets_the_frames_of_the_run_before():
    zeros = np.zeros(MOTORS)
    motors = Motors(grey_boxes(), H, zeros)
    first = motors.step(zeros + 0.1, zeros, zeros)[0]
    motors.reset(zeros)
    motors.step(zeros, zeros, zeros, torque_feedforward=1.0)
    motors.reset(zeros)

    np.testing.assert_array_equal(motors.step(zeros + 0.1, zeros, zeros)[0], first)
