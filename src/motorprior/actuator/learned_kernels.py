"""Kernels of learned motors: the network, which updates its torque every period, and the grey box.

The inputs of the network are a history of errors and velocities. It evaluates 16 motors in parallel (`lanes`): 0.2 µs
for the motors of a quadruped, where a plain loop over neurons takes 1.1 to 1.7 µs, 10 % of a physics step or more. A
grey box is a geared motor with constants decoded from z, plus a network for the residual torque.
"""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.geared_motor import (
    DAMPING,
    STIFFNESS,
    read_rotor_encoders,
    reset_geared_motor,
    step_geared_motor,
)
from motorprior.actuator.kernels import ActuatorKind, without_refcounts
from motorprior.actuator.lanes import LANES, first_layer, linear_output, softsign_layer
from motorprior.compiled import njit

SCALES = 4  # rows of the parameters before those of the geared motor


@njit(cache=True, nogil=True)
def reset_network(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the current error and zero velocity."""
    ring2 = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = np.float32((position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0])
        for slot in range(ring2):
            arrays.history[motor // LANES, slot, motor % LANES] = error


@njit(cache=True, nogil=True)
def _write_history(history, parameters, slot, position_target, joint_pos, joint_vel):
    """Write error and velocity twice, one ring length apart, so that reads of any age need no wrap-around."""
    ring, motors = history.shape[1] // 4, position_target.shape[0]
    error_gain, velocity_gain = parameters[0, 0], parameters[1, 0]
    for block in range(history.shape[0]):
        first = block * LANES
        for lane in range(min(LANES, motors - first)):
            motor = first + lane
            error = np.float32((position_target[motor] - joint_pos[motor]) * error_gain)
            velocity = np.float32(joint_vel[motor] * velocity_gain)
            history[block, slot, lane] = error
            history[block, slot + ring, lane] = error
            history[block, slot + 2 * ring, lane] = velocity
            history[block, slot + 3 * ring, lane] = velocity


@njit(cache=True, nogil=True)
def _evaluate(weights, inputs, biases, history, scratch, slot):
    neurons = (biases.shape[0] - 1) // 2
    first, second, last = scratch[:neurons], scratch[neurons : 2 * neurons], scratch[2 * neurons :]
    first_layer(weights, history, slot, inputs, biases[:neurons], first)
    offset = inputs.shape[0] * neurons
    softsign_layer(weights, offset, first, biases[neurons : 2 * neurons], second)
    linear_output(weights, offset + neurons * neurons, second, biases[2 * neurons :], last)


@njit(cache=True, nogil=True, inline="always")
def _update_torque(arrays, position_target, joint_pos, joint_vel):
    """Every period, write the torque [N·m] of the network into the first row of the memory."""
    network_torque = arrays.memory[0]
    if arrays.clock[0] % arrays.clock[1] == 0:
        slot = (arrays.clock[0] // arrays.clock[1]) % (arrays.history.shape[1] // 4)
        _write_history(arrays.history, arrays.parameters, slot, position_target, joint_pos, joint_vel)
        scale, limit = arrays.parameters[2, 0], arrays.parameters[3, 0]
        for block in range(arrays.history.shape[0]):
            scratch = arrays.scratch[block]
            _evaluate(arrays.weights, arrays.inputs, arrays.biases[block], arrays.history[block], scratch, slot)
            first, output = block * LANES, scratch[scratch.shape[0] - 1]
            for motor in range(first, min(first + LANES, network_torque.shape[0])):
                raw = scale * float(output[motor - first])
                network_torque[motor] = min(limit, max(-limit, raw))


@njit(cache=True, nogil=True)
def _step_network(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    arrays = without_refcounts(arrays)
    _update_torque(arrays, position_target, joint_pos, joint_vel)
    torque[:] = arrays.memory[0]


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    if arrays.weights.shape[0] > 0:
        reset_network(arrays, position_target, joint_pos)
    reset_geared_motor(arrays.memory[1:], position_target, joint_pos)


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    # separately: a tuple would count each array once more
    arrays, torque = without_refcounts(arrays), without_refcounts(torque)
    position_target = without_refcounts(position_target)
    joint_pos, joint_vel = without_refcounts(joint_pos), without_refcounts(joint_vel)
    has_network = arrays.weights.shape[0] > 0
    if has_network:
        _update_torque(arrays, position_target, joint_pos, joint_vel)
    p, memory, now, damping = arrays.parameters[SCALES:], arrays.memory[1:], arrays.clock[0], arrays.damping
    step_geared_motor(p, memory, now, physics_dt, position_target, joint_pos, joint_vel, torque, damping)
    if has_network:
        for motor in range(torque.shape[0]):
            torque[motor] += arrays.memory[0, motor]


def _limit_stiffness(arrays: ActuatorArrays, max_stiffness: float) -> None:
    row = arrays.parameters[SCALES + STIFFNESS]
    np.minimum(row, max_stiffness, out=row)


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    # the engine does not damp, so the rotors get no momentum from its damping in the next step
    for motor in range(torque.shape[0]):
        torque[motor] -= arrays.damping[motor] * joint_vel[motor]
    arrays.damping[:] = 0.0
    arrays.memory[1 + DAMPING, :] = 0.0


@njit(cache=True, nogil=True)
def _measure(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    read_rotor_encoders(arrays.parameters[SCALES:], arrays.memory[1:], out)


GREY_BOX = ActuatorKind(
    "grey_box", "grey box", reset=_reset, step=_step, measure=_measure, make_explicit=_make_explicit,
    limit_stiffness=_limit_stiffness,
)  # fmt: skip
LATENT = ActuatorKind("latent", "latent network", reset=reset_network, step=_step_network)
