"""Which constants of motors their logs feel: half and double of such a constant both replay the logs worse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.fleet_fit import held_constants
from motorprior.identification.motor_fit import MotorFit
from motorprior.identification.speed_limits import SPEED_LIMITS
from motorprior.identification.window_runs import WindowRuns

LIMITS = ("torque_limit", *SPEED_LIMITS)
"""Of torque and speed. Where logs do not show them, a fit sets most of them far beyond (`fleet_fit.ROOM`)."""
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
    least = MotorFit(network, runs).losses(z)

    def worse(name: str, factor: float) -> float:
        return float(np.median(_losses_with(network, runs, z, name, factor) / least))

    return frozenset(name for name in names if min(worse(name, 0.5), worse(name, 2.0)) > WORSE)


@dataclass(frozen=True)
class NotShown:
    """A limit that some motors' logs do not feel. Attributes: how many motors; the largest limit of theirs [SI]."""

    motors: int
    most: float


def limits_not_shown(network: LatentNetwork, runs: WindowRuns, z: np.ndarray) -> dict[str, NotShown]:
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
            either = [_losses_with(network, runs, z, name, factor) / least for factor in (0.5, 2.0)]
            hidden = np.minimum(*either) <= WORSE
            if hidden.any():
                found[name] = NotShown(int(hidden.sum()), float(network.constants(z)[name][hidden].max()))
    return found


def _losses_with(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, name: str, factor: float) -> np.ndarray:
    """(M,) losses of motors whose constant ``name`` is multiplied."""
    assert network.motor is not None
    center = network.motor.center + np.log(factor) * (np.array(parameters_of(network.motor.terms)) == name)
    return MotorFit(replace(network, motor=replace(network.motor, center=center)), runs).losses(z)
