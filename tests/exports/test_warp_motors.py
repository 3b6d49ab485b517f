"""The Warp kernel and the actuators of mjlab and Newton move as the compiled motors."""

# pyright: reportMissingImports=false
# pyright: reportOptionalMemberAccess=false
from dataclasses import replace

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra newton or mjlab")

import exports as bench  # noqa: E402
from motorprior.actuator.geared_motor_step import parameters_of  # noqa: E402
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator  # noqa: E402
from motorprior.actuator.motor_prior import MotorPrior  # noqa: E402
from motorprior.actuator.motors import Motors  # noqa: E402
from motorprior.actuator.optional_terms import INITIAL, SIGNED, TERMS  # noqa: E402
from motorprior.exceptions import ConfigError  # noqa: E402
from motorprior.exports.warp_motors import WarpMotors  # noqa: E402

CENTRAL = INITIAL | {
    "kp": 9.0,
    "kd_over_kp": 0.09,
    "velocity_filter": 0.005,
    "delay": 0.006,
    "torque_limit": 1.5,
    "armature": 0.003,
    "coulomb": 0.1,
    "stribeck_torque": 0.02,
    "viscous_damping": 0.005,
    "load_friction": 0.2,
    "gear_stiffness": 80.0,
    "backlash": 0.01,
    "gear_damping": 0.02,
}
"""Constants of the central motor in SI units."""


def prior_of(terms: tuple[str, ...] = ()) -> MotorPrior:
    """A prior around the central motor, with these optional dynamics terms."""
    names = parameters_of(terms)
    center = np.zeros(len(names))
    for index, name in enumerate(names):
        if name not in SIGNED:
            center[index] = np.log(CENTRAL[name])
    model = GreyBox(center, 0.15 * np.eye(len(names)), bench.DT, terms)
    zeros = np.zeros((2, len(names)))
    return MotorPrior(model, zeros, zeros, "rollout", "rig", "a motor", {})


def motors_of_prior(count: int, terms: tuple[str, ...] = ()) -> GreyBoxActuator:
    motors = prior_of(terms).sample(count, seed=1)
    assert isinstance(motors, GreyBoxActuator)
    return motors


TOLERANCE = {(): 2e-3, tuple(TERMS): 3e-2} | {(term,): 2e-2 for term in TERMS}
"""Largest difference of the angles [rad] by the optional terms of the motors."""


@pytest.mark.parametrize("terms", TOLERANCE)
def test_the_kernel_follows_the_compiled_motors(terms: tuple[str, ...]):
    motors = motors_of_prior(bench.COUNT, terms)
    # An encoder behind the backlash makes these motors oscillate, and any difference grows
    # exponentially.
    steps = 200 if "output_encoder" in terms else bench.STEPS

    ours = bench.free_run(bench.compiled(motors), bench.COUNT, steps)
    in_warp = bench.free_run(bench.kernel(motors), bench.COUNT, steps)

    assert np.abs(ours).max() > 0.3, "they move"
    difference = np.abs(ours - in_warp).max(axis=0)  # [rad]
    assert np.median(difference) < 1e-4
    # float32: dry friction of some motors breaks away a step earlier or later.
    assert difference.max() < TOLERANCE[terms]


def state_of_two(steps: int, motor_indices: tuple[int, int], restarts: bool = False) -> np.ndarray:
    """(values, 2) states after these steps; the second motor may restart as motor 3 at step 20."""
    motors = WarpMotors(motors_of_prior(4), 2, bench.DT, "cpu")
    motors.sample_index.assign(motor_indices)
    target = bench.warp_array([0.3, 0.5])
    joint_pos = bench.warp_array([0.0, 0.5])
    joint_vel = bench.warp_array([0.0, 0.5])

    for step in range(steps):
        if restarts and step == 20:
            motors.waiting.assign([False, True])
            motors.sample_index.assign([2, 3])
        motors.step(target, joint_pos, joint_vel)

    return np.concatenate([motors.table.numpy(), motors.memory.numpy(), [motors.torque.numpy()]])


def test_only_waiting_motors_restart_as_the_chosen_ones():
    states = state_of_two(25, (0, 1), restarts=True)
    np.testing.assert_array_equal(states[:, 0], state_of_two(25, (0, 1))[:, 0])
    np.testing.assert_array_equal(states[:, 1], state_of_two(5, (0, 3))[:, 1])


def with_constant(motors, name, value):
    center = motors.model.center.copy()
    center[parameters_of(()).index(name)] = np.log(value)
    return replace(motors, model=replace(motors.model, center=center))


def test_a_step_that_cannot_resolve_the_gear_is_refused():
    stiff = with_constant(motors_of_prior(1), "gear_stiffness", 5000.0)
    stiff = with_constant(stiff, "kp", 100.0)

    with pytest.raises(ConfigError, match="gear") as refused:
        WarpMotors(stiff, 1, bench.DT, "cpu")

    assert "step" in str(refused.value.remedy)


def test_a_gear_that_is_softened_for_the_step_moves_as_ours():
    stiff = with_constant(motors_of_prior(2), "gear_stiffness", 5000.0)

    ours = bench.free_run(bench.compiled(stiff), 2, 500)
    in_warp = bench.free_run(bench.kernel(stiff), 2, 500)

    assert np.abs(ours).max() > 0.3
    assert np.abs(ours - in_warp).max() < 2e-3


@pytest.mark.parametrize("terms", [(), tuple(TERMS)], ids=len)
def test_the_kernel_obeys_the_whole_command_of_every_step(terms: tuple[str, ...]):
    motors = motors_of_prior(bench.COUNT, terms)
    steps = 200 if terms else 400

    angles = bench.free_run(bench.compiled(motors), bench.COUNT, steps, bench.mit_frames)
    in_warp = bench.free_run(bench.kernel(motors), bench.COUNT, steps, bench.mit_frames)
    position_alone = bench.free_run(bench.compiled(motors), bench.COUNT, steps)

    assert np.abs(angles - position_alone).max() > 0.1, "these commands move the joints"
    difference = np.abs(angles - in_warp).max(axis=0)
    assert np.median(difference) < 1e-4
    assert difference.max() < TOLERANCE[terms]


def test_a_frame_of_position_control_gives_the_bits_of_a_position_command():
    motors = motors_of_prior(3)
    alone = WarpMotors(motors, 3, bench.DT, "cpu")
    framed = WarpMotors(motors, 3, bench.DT, "cpu")
    zeros = bench.warp_array(np.zeros(3))
    ones = bench.warp_array(np.ones(3))
    targets = {"velocity_target": zeros, "torque_feedforward": zeros}
    gains = {"kp_factor": ones, "kd_factor": ones}

    for step in range(50):
        command = [bench.warp_array(bench.targets(step, 3)), zeros, zeros]
        alone.step(*command)
        framed.step(*command, **targets, **gains)
        np.testing.assert_array_equal(framed.torque.numpy(), alone.torque.numpy())


def test_motors_of_torque_commands_obey_the_feed_forward_torque_alone():
    motors = replace(motors_of_prior(2), command_mode="torque")
    kernel = WarpMotors(motors, 2, bench.DT, "cpu")
    ours = Motors(motors, bench.DT, np.zeros(2))
    rest = np.zeros(2)
    torque = rest
    feedforward = np.array([0.3, -0.3])

    for _ in range(20):
        kernel.step(
            *map(bench.warp_array, (rest + 1.0, rest, rest)),
            torque_feedforward=bench.warp_array(feedforward),
        )
        torque, _ = ours.step(rest + 1.0, rest, rest, torque_feedforward=feedforward)

    assert np.abs(torque).min() > 0.01
    np.testing.assert_allclose(kernel.torque.numpy(), torque, rtol=1e-4)


@pytest.mark.parametrize("frames", [bench.position_frames, bench.mit_frames])
def test_newton_moves_the_joints_as_our_motors_do(frames):
    pytest.importorskip("newton", reason="needs the extra newton")
    motors = motors_of_prior(3)

    ours = bench.free_run(bench.explicit(motors), 3, 500, frames)
    in_newton = bench.free_run(bench.newton(motors), 3, 500, frames)

    assert np.abs(ours).max() > 0.3
    assert bench.largest_difference(ours, in_newton) < 1e-4


def test_newton_restarts_masked_motors():
    pytest.importorskip("newton", reason="needs the extra newton")
    from motorprior.exports.newton import MotorPriorDrive

    state = MotorPriorDrive(motors_of_prior(2), bench.DT).state(2, "cpu")
    state.waiting.fill_(False)
    state.reset(bench.warp_array([False, True], wp.bool))
    assert state.waiting.numpy().tolist() == [False, True]
    state.reset()
    assert state.waiting.numpy().all()


def test_mjlab_has_other_motors_in_every_world_and_damps_each():
    pytest.importorskip("mjlab", reason="needs the extra mjlab")
    import torch

    from motorprior.exports.mjlab import per_world_damping

    assert per_world_damping().func.model_fields == ("dof_damping",)
    assert bench.mjlab_parity(prior_of(), 8, 400) < 1e-3
    assert bench.mjlab_parity(prior_of(), 8, 400, bench.mit_frames) < 1e-3
    torch.manual_seed(0)
    angles, motors_of_worlds, _ = bench.mjlab_run(prior_of(), 8, 300)
    assert np.ptp(angles[-1]) > 1e-3
    assert len(set(motors_of_worlds.tolist())) > 1


def test_mjlab_chooses_other_motors_in_worlds_that_are_reset():
    pytest.importorskip("mjlab", reason="needs the extra mjlab")
    import torch

    torch.manual_seed(0)
    _, _, robot = bench.mjlab_run(prior_of(), 8, 300)
    actuator = robot.actuators[0]
    first_choice = actuator._sample_index.clone()

    robot.reset(torch.tensor([1, 5]))

    assert actuator._waiting.flatten().tolist() == [world in (1, 5) for world in range(8)]
    kept = [world for world in range(8) if world not in (1, 5)]
    assert torch.equal(actuator._sample_index[kept], first_choice[kept])
