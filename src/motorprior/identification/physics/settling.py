"""Last steps of a fit to short free runs, on longer ones, with the residual network that the motors have.

Long free runs show constants that short ones confuse, but a search on them ends in poor optima, since a simulation that
is soon wrong tells little of what comes later. So short runs find the neighbourhood, and longer ones the place. A
residual was trained beside constants that short runs found, and the constants settle with it once more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor_constants import LOG_REACH
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.fleet_fit import (
    fleet_belief,
    held_constants,
    left_open,
    weak_belief,
)
from motorprior.identification.physics.motor_fit import NARROW, WIDE, Belief, Fit, MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

LONGER = 200  # About how many steps the longer runs have
SPARED = 0.2  # Largest share of the rows in the recipe's windows that longer windows may leave out
FEWEST = 10  # Least number of longer windows of a motor; what fewer show is mostly noise
# Reach of the differences, and Gauss-Newton steps at most: wide ones see over ripples, narrow ones find the bottom
TURNS = ((WIDE, 10), (NARROW, 10), (0.01, 10))


def longer_runs(data: TrainingData, preset: Preset, runs: WindowRuns) -> WindowRuns:
    """Free runs of about LONGER steps that fill most segments, or ``runs``, those of the recipe, if these show more.

    They do if they are as long, if segments are so short that longer windows leave out more than SPARED of the rows, or
    if there are fewer than FEWEST longer windows.
    """
    rooms = np.array([part.stop - part.start - 1 - preset.history for part in data.parts])
    room = int(np.median(rooms[rooms >= preset.window]))
    window = room // max(1, round(room / LONGER))
    if window <= preset.window:
        return runs
    longer = WindowRuns(data, replace(preset, window=window), beat=runs.beat)
    enough = longer.windows * window >= (1.0 - SPARED) * runs.windows * preset.window
    return longer if enough and longer.windows >= FEWEST else runs


def settled(
    network: LatentNetwork, z: np.ndarray, runs: WindowRuns, together: bool, chosen: np.ndarray | None = None
) -> np.ndarray:
    """(M, Z) latents after steps that lower loss and belief on these runs (`motor_fit`).

    The belief is that of `fleet_fit` about each motor, made once, where the fit is; of a motor alone it is next to
    nothing, around where the fit is.

    Args:
        network: with a motor, and a residual or none; both stay as they are.
        z: (M, Z) where the fit is.
        runs: longer than those of the fit.
        together: whether the motors are a belief about each.
        chosen: (N,) mask of the windows that count; all if not given.
    """
    motor = network.motor
    assert motor is not None
    fit = MotorFit(network, runs, chosen)
    held = held_constants(motor.terms, runs)
    alone = replace(weak_belief(z.shape[1]), mean=z).holding(held)
    belief = _belief_of_all(fit, z, held) if together and len(z) > 1 else alone
    belief, found = replace(belief, mean=np.where(held, z, belief.mean)), z
    for reach, steps in TURNS:
        found = fit.polish(found, belief, steps, reach).z
    return np.where(held, z, np.clip(found, -LOG_REACH, LOG_REACH))


def _belief_of_all(fit: MotorFit, z: np.ndarray, held: np.ndarray) -> Belief:
    """Of each motor, by how far all of them are apart and what their logs leave open."""
    loss = fit.losses(z)
    found = Fit(z, loss, loss)
    first = fleet_belief(found, fit.windows, 0.0).holding(held)
    return fleet_belief(found, fit.windows, left_open(fit, found, first)).holding(held)
