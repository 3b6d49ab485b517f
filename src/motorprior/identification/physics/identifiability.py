"""Identifiability of constants: halving and doubling one both increase the replay loss.

The scale of all torques is not identifiable if halving or doubling all torques and the rotor's inertia replays the log
as well: the effect of the load, which stays the same, is then negligible.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics.motor_problem import TORQUES, fixed_constants, motor_search
from motorprior.identification.physics.window_runs import SPEED_LIMITS, WindowRuns
from motorprior.logs.motor_log import PHYSICAL_GAINS

THRESHOLD = 1.02  # a constant is identifiable if half and double of it both raise the loss by more than this factor


def identifiable_constants(model: GreyBox, runs: WindowRuns, z: np.ndarray, names: Iterable[str]) -> frozenset[str]:
    """The positive constants among ``names`` that at least half of the M motors identify.

    ``runs`` are the logs of the motors and ``z`` (M, Z) their latents.
    """
    fitted = motor_search(model, runs).losses(z)
    ratio = {name: np.median(_loss_ratio(model, runs, z, name, fitted), axis=1).min() for name in names}
    return frozenset(name for name in ratio if ratio[name] > THRESHOLD)


def unidentifiable_limits(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> dict[str, np.ndarray]:
    """Fitted limits of torque and speed -> (M,) motors whose own logs do not identify them; arguments as above."""
    rows, fixed = parameters_of(model.motor.terms), fixed_constants(model.motor.terms, runs)
    limits = [name for name in ("torque_limit", *SPEED_LIMITS) if name in rows and not fixed[rows.index(name)]]
    fitted = motor_search(model, runs).losses(z)
    found = {name: _loss_ratio(model, runs, z, name, fitted).min(axis=0) <= THRESHOLD for name in limits}
    return {name: hidden for name, hidden in found.items() if hidden.any()}


def unknown_torque_scale(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> np.ndarray:
    """(M,) whether a motor's log does not identify the scale of its torques; False if gains are logged in N·m/rad."""
    if runs.gain_unit == PHYSICAL_GAINS:
        return np.zeros(len(z), bool)
    motor = model.motor
    rows, losses = np.isin(parameters_of(motor.terms), TORQUES), []
    for factor in (0.5, 2.0):
        scaled = replace(model, motor=replace(motor, center=motor.center + np.log(factor) * rows))
        losses.append(motor_search(scaled, runs).losses(z))
    return np.min(losses, axis=0) <= THRESHOLD * motor_search(model, runs).losses(z)


def _loss_ratio(model: GreyBox, runs: WindowRuns, z: np.ndarray, name: str, fitted: np.ndarray) -> np.ndarray:
    """(2, M) losses of the motors with half and with double of a constant, over the ``fitted`` losses (M,)."""
    motor = model.motor
    row = np.array(parameters_of(motor.terms)) == name
    changed = [replace(motor, center=motor.center + np.log(factor) * row) for factor in (0.5, 2.0)]
    losses = [motor_search(replace(model, motor=each), runs).losses(z) for each in changed]
    return np.stack(losses) / fitted
