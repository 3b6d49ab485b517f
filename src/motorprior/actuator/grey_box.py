"""The compiled grey box: a geared motor with the constants that z decodes to, and a network for what they leave."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.borrowed import borrowed
from motorprior.actuator.geared_motor import (
    DAMPING,
    STIFFNESS,
    read_rotor_encoders,
    reset_geared_motor,
    step_geared_motor,
)
from motorprior.actuator.kind import ActuatorKind
from motorprior.actuator.network_law import renew_torque, reset_network
from motorprior.compiled import njit

# Rows of the parameters before the motor's: the network's scales and limit. One row of memory is the network's.
SCALES = 4


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest, histories filled with the present."""
    if arrays.weights.shape[0] > 0:
        reset_network(arrays, position_target, joint_pos)
    reset_geared_motor(arrays.memory[1:], position_target, joint_pos)


@njit(cache=True, nogil=True)
def _step(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque [N·m] and ``arrays.damping``: the gear's, plus that of a network, renewed every period."""
    arrays, torque = borrowed(arrays), borrowed(torque)
    position_target, joint_pos, joint_vel = borrowed(position_target), borrowed(joint_pos), borrowed(joint_vel)
    has_network = arrays.weights.shape[0] > 0
    if has_network:
        renew_torque(arrays, position_target, joint_pos, joint_vel)
    step_geared_motor(
        arrays.parameters[SCALES:],
        arrays.memory[1:],
        arrays.clock[0],
        physics_dt,
        position_target,
        joint_pos,
        joint_vel,
        torque,
        arrays.damping,
    )
    if has_network:
        for motor in range(torque.shape[0]):
            torque[motor] += arrays.memory[0, motor]


def _limit_stiffness(arrays: ActuatorArrays, largest: float) -> None:
    """Simulate gears stiffer than ``largest`` [N·m/rad] as if they were only so stiff."""
    row = arrays.parameters[SCALES + STIFFNESS]
    np.minimum(row, largest, out=row)


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Brake the joint by torque; since the engine does not damp, the rotors get nothing back in the next step."""
    for motor in range(torque.shape[0]):
        torque[motor] -= arrays.damping[motor] * joint_vel[motor]
    arrays.damping[:] = 0.0
    arrays.memory[1 + DAMPING, :] = 0.0


@njit(cache=True, nogil=True)
def _measure(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """(n,) encoder angle [rad], on the rotor: the backlash is invisible to it."""
    read_rotor_encoders(arrays.parameters[SCALES:], arrays.memory[1:], out)


GREY_BOX = ActuatorKind(
    "grey_box", "grey box", reset=_reset, step=_step, measure=_measure, make_explicit=_make_explicit,
    limit_stiffness=_limit_stiffness,
)  # fmt: skip
