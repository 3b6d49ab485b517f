"""Which constants of motors their logs feel: half and double of such a constant both replay the logs worse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.fleet_fit import held_constants
from motorprior.identification.motor_fit import MotorFit
from motorprior.identification.speed_limits import SPEED_LIMITS
from motorprior.identification.window_runs import WindowRuns

LIMITS = ("torque_limit", *SPEED_LIMITS)
"""Limits that a fit sets far above what the logs reach where these do not show them (`fleet_fit.ROOM`)."""
WORSE = 1.02
"""Loss with half or double of a constant, over the loss with it, from which on the log feels it."""


def felt_constants(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, names: Iterable[str]) -> frozenset[str]:
    """Those of the constants ``names`` that the logs feel in half of the motors or more.

    Args:
        network: with a geared motor.
        runs: the logs of M motors.
        z: (M, Z) their latents.
        names: of constants that are positive.
    """
    assert network.motor is not None
    rows, least = parameters_of(network.motor.terms), MotorFit(network, runs).losses(z)

    def worse(name: str, factor: float) -> float:
        motor = network.motor
        assert motor is not None
        center = motor.center + np.log(factor) * (np.array(rows) == name)
        changed = replace(network, motor=replace(motor, center=center))
        return float(np.median(MotorFit(changed, runs).losses(z) / least))

    return frozenset(name for name in names if min(worse(name, 0.5), worse(name, 2.0)) > WORSE)


def limits_not_shown(network: LatentNetwork, runs: WindowRuns, z: np.ndarray) -> dict[str, float]:
    """LIMITS that were fitted and that the logs do not feel, with the median over motors [N·m], [rad/s].

    Args:
        network: with a geared motor.
        runs: the logs of M motors.
        z: (M, Z) their latents.
    """
    assert network.motor is not None
    rows = parameters_of(network.motor.terms)
    held = held_constants(network.motor.terms, runs)
    fitted = [name for name in LIMITS if name in rows and not held[rows.index(name)]]
    felt, values = felt_constants(network, runs, z, fitted), network.constants(z)
    return {name: float(np.median(values[name])) for name in fitted if name not in felt}
