"""The compiled grey box: a geared motor with the constants that z decodes to, and a network for what they leave."""

from __future__ import annotations

import numpy as np
from numba import njit

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.geared_motor import (
    DAMPING,
    STIFFNESS,
    read_rotor_encoders,
    reset_geared_motor,
    step_geared_motor,
)
from motorprior.actuator.latent import renew_torque, reset_latent

SCALES = 4
"""Rows of the parameters before the motor's: the network's scales and limit. One row of memory is the network's."""


@njit(cache=True, nogil=True)
def reset_grey_box(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest, histories filled with the present."""
    reset_latent(arrays, position_target, joint_pos)
    reset_geared_motor(arrays.memory[1:], position_target, joint_pos)


@njit(cache=True, nogil=True, inline="always")
def step_grey_box(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque [N·m] and ``arrays.damping``: the gear's, plus the network's torque, renewed every period."""
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
    for motor in range(torque.shape[0]):
        torque[motor] += arrays.memory[0, motor]


def limit_stiffness(arrays: ActuatorArrays, largest: float) -> None:
    """Simulate gears stiffer than ``largest`` [N·m/rad] as if they were only so stiff."""
    row = arrays.parameters[SCALES + STIFFNESS]
    np.minimum(row, largest, out=row)


@njit(cache=True, nogil=True)
def forget_damping(arrays: ActuatorArrays) -> None:
    """The engine did not damp: nothing is given back to the rotors in the next step."""
    arrays.damping[:] = 0.0
    arrays.memory[1 + DAMPING, :] = 0.0


@njit(cache=True, nogil=True, inline="always")
def read_grey_box_encoders(arrays: ActuatorArrays, out: np.ndarray) -> None:
    """(n,) encoder angle [rad], on the rotor: the play is invisible to it."""
    read_rotor_encoders(arrays.parameters[SCALES:], arrays.memory[1:], out)
