"""Which constants of motors their logs feel: half and double of such a constant both replay the logs worse.

A log does not feel a constant if half of it, or double, replays the log as well. Nor does it feel how large torques are
if half of everything that is a torque, the rotor's inertia included, replays it as well, or double: the load, which
stays as it is, then hardly counts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.fleet_fit import held_constants
from motorprior.identification.physics.initial_motor import TORQUES
from motorprior.identification.physics.motor_fit import MotorFit
from motorprior.identification.physics.speed_limits import SPEED_LIMITS
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.logs.motor_log import PHYSICAL_GAINS

# Of torque and speed. Where logs do not show them, a fit sets most of them far beyond (`fleet_fit.ROOM`).
LIMITS = ("torque_limit", *SPEED_LIMITS)
WORSE = 1.02  # Loss with half or double of a constant, over the loss with it, from which on the log feels it


def felt_constants(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, names: Iterable[str]) -> frozenset[str]:
    """Those of the constants ``names`` that the logs feel in half of the motors or more.

    Args:
        network: with a geared motor.
        runs: the logs of M motors.
        z: (M, Z) their latents.
        names: of constants that are positive.
    """
    least = MotorFit(network, runs).losses(z)
    return frozenset(name for name in names if np.median(_worse(network, runs, z, name, least), axis=1).min() > WORSE)


@dataclass(frozen=True)
class NotFelt:
    """A limit that some motors' logs do not feel. Attributes: which of M motors; the largest limit of theirs [SI]."""

    motors: np.ndarray
    most: float


def limits_not_felt(network: LatentNetwork, runs: WindowRuns, z: np.ndarray) -> dict[str, NotFelt]:
    """LIMITS that were fitted and that the logs of some motors do not feel; each motor is judged by its own log.

    Args:
        network: with a geared motor.
        runs: the logs of M motors.
        z: (M, Z) their latents.
    """
    assert network.motor is not None
    rows, found = parameters_of(network.motor.terms), {}
    held, least = held_constants(network.motor.terms, runs), MotorFit(network, runs).losses(z)
    for name in LIMITS:
        if name in rows and not held[rows.index(name)]:
            hidden = _worse(network, runs, z, name, least).min(axis=0) <= WORSE
            if hidden.any():
                found[name] = NotFelt(hidden, float(network.constants(z)[name][hidden].max()))
    return found


def sizes_not_felt(network: LatentNetwork, runs: WindowRuns, z: np.ndarray) -> np.ndarray:
    """(M,) whether a motor's log does not feel how large its torques are; never where gains are stated in N·m/rad.

    Args:
        network: with a geared motor.
        runs: the logs of M motors.
        z: (M, Z) their latents.
    """
    if runs.gain_unit == PHYSICAL_GAINS:
        return np.zeros(len(z), bool)
    least = MotorFit(network, runs).losses(z)
    losses = [MotorFit(_of_size(network, factor), runs).losses(z) for factor in (0.5, 2.0)]
    return np.min(losses, axis=0) <= WORSE * least


def _of_size(network: LatentNetwork, factor: float) -> LatentNetwork:
    """Motors all of whose torques are so many times as large."""
    motor = network.motor
    assert motor is not None
    rows = np.isin(parameters_of(motor.terms), TORQUES)
    return replace(
        network, motor=replace(motor, center=motor.center + np.log(factor) * rows),
        torque_scale=factor * network.torque_scale, torque_limit=factor * network.torque_limit,
    )  # fmt: skip


def _worse(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, name: str, least: np.ndarray) -> np.ndarray:
    """(2, M) losses of the motors with half and with double of a constant, over those with it, ``least`` (M,)."""
    motor = network.motor
    assert motor is not None
    row = np.array(parameters_of(motor.terms)) == name
    changed = [replace(motor, center=motor.center + np.log(factor) * row) for factor in (0.5, 2.0)]
    return np.stack([MotorFit(replace(network, motor=each), runs).losses(z) for each in changed]) / least
