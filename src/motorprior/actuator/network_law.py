"""The learned network, compiled: a history of errors and velocities, and the torque it gives, renewed every period.

The network runs on sixteen motors side by side (`lanes`). A plain loop over neurons takes 1.1 to 1.7 µs for a robot's
a dozen motors with the default prior, a tenth of a physics step or more; the lanes take 0.2 µs.
"""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.lanes import LANES, first_layer, linear_output, softsign_layer
from motorprior.compiled import njit


@njit(cache=True, nogil=True)
def reset_network(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the present error and zero velocity."""
    ring2 = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = np.float32((position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0])
        for slot in range(ring2):
            arrays.history[motor // LANES, slot, motor % LANES] = error


@njit(cache=True, nogil=True)
def _remember(
    history: np.ndarray,
    parameters: np.ndarray,
    slot: int,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
) -> None:
    """Write error and velocity twice, a ring apart, so that any age is read without wrapping around."""
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
def _evaluate(
    weights: np.ndarray, inputs: np.ndarray, biases: np.ndarray, history: np.ndarray, scratch: np.ndarray, slot: int
) -> None:
    """Run the network of one block of lanes; its output is the last row of the scratch."""
    neurons = (biases.shape[0] - 1) // 2
    first, second, last = scratch[:neurons], scratch[neurons : 2 * neurons], scratch[2 * neurons :]
    first_layer(weights, history, slot, inputs, biases[:neurons], first)
    offset = inputs.shape[0] * neurons
    softsign_layer(weights, offset, first, biases[neurons : 2 * neurons], second)
    linear_output(weights, offset + neurons * neurons, second, biases[2 * neurons :], last)


@njit(cache=True, nogil=True, inline="always")
def renew_torque(
    arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray
) -> None:
    """Renew the network's torque [N·m] in the first row of the memory if its period is over."""
    held = arrays.memory[0]
    if arrays.clock[0] % arrays.clock[1] == 0:
        slot = (arrays.clock[0] // arrays.clock[1]) % (arrays.history.shape[1] // 4)
        _remember(arrays.history, arrays.parameters, slot, position_target, joint_pos, joint_vel)
        scale, limit = arrays.parameters[2, 0], arrays.parameters[3, 0]
        for block in range(arrays.history.shape[0]):
            scratch = arrays.scratch[block]
            _evaluate(arrays.weights, arrays.inputs, arrays.biases[block], arrays.history[block], scratch, slot)
            first, output = block * LANES, scratch[scratch.shape[0] - 1]
            for motor in range(first, min(first + LANES, held.shape[0])):
                raw = scale * float(output[motor - first])
                held[motor] = min(limit, max(-limit, raw))
