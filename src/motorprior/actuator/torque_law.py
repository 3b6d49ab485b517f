"""One compiled entry for all torque laws, so that the rollout kernel can inline every actuator."""

from __future__ import annotations

import numpy as np
from numba import njit

from motorprior.actuator.actuator import GREY_BOX, IDEAL_PD, LATENT, PHYSICAL, ActuatorArrays
from motorprior.actuator.grey_box import (
    forget_damping,
    limit_stiffness,
    read_grey_box_encoders,
    reset_grey_box,
    step_grey_box,
)
from motorprior.actuator.ideal_pd import reset_ideal_pd, step_ideal_pd
from motorprior.actuator.latent import reset_latent, step_latent
from motorprior.actuator.physical import read_encoders, reset_physical, step_physical


@njit(cache=True, nogil=True)
def reset_actuator(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Put the memory at rest: target and joint have been where they are for ever."""
    arrays.clock[0] = 0
    if arrays.kind == IDEAL_PD:
        reset_ideal_pd(arrays, position_target)
    elif arrays.kind == LATENT:
        reset_latent(arrays, position_target, joint_pos)
    elif arrays.kind == GREY_BOX:
        reset_grey_box(arrays, position_target, joint_pos)
    else:
        reset_physical(arrays, position_target, joint_pos)


@njit(cache=True, nogil=True, inline="always")
def step_actuator(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write the (n,) torque [N·m] and ``arrays.damping`` for the physics step [s] that begins now."""
    if arrays.kind == IDEAL_PD:
        step_ideal_pd(arrays, position_target, joint_pos, joint_vel, torque)
    elif arrays.kind == LATENT:
        step_latent(arrays, position_target, joint_pos, joint_vel, torque)
    elif arrays.kind == GREY_BOX:
        step_grey_box(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    else:
        step_physical(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    arrays.clock[0] += 1


def limit_explicit(arrays: ActuatorArrays, largest: float) -> None:
    """For an engine that needs `make_explicit`: no gear of a grey box stiffer than ``largest`` [N·m/rad]."""
    if arrays.kind == GREY_BOX:
        limit_stiffness(arrays, largest)


@njit(cache=True, nogil=True)
def make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """For an engine that cannot renew its damping: put that of the coming step into the torque.

    Only a grey box renews it; what an engine damps all the time stays with the engine. With the gear's stiffness k and
    a bare link of inertia I, a step h is stable only while 2·k·h²/I + gear_damping·h/I < 4: see `limit_explicit`.
    """
    if arrays.kind == GREY_BOX:
        torque -= arrays.damping * joint_vel
        forget_damping(arrays)


@njit(cache=True, nogil=True, inline="always")
def measure_joint_pos(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """(n,) joint angle [rad] as the motor's own encoder reports it."""
    if arrays.kind == PHYSICAL:
        read_encoders(arrays, out)
    elif arrays.kind == GREY_BOX:
        read_grey_box_encoders(arrays, out)
    else:
        out[:] = joint_pos
