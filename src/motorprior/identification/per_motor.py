"""The per-motor baseline with backlash: every motor is fitted by itself, without shared parameters or a network.

In the manner of PACE (Bjelonic et al., 2025), whose motors have no backlash.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latent_fit import adapt
from motorprior.identification.network import export, initial_parameters
from motorprior.identification.posterior import standard_posterior
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData

_WEAK = 1e-3
"""Temperature of the fit [-], so low that the prior N(0, I) has no influence on it."""


def fit_motors(data: TrainingData, preset: Preset) -> tuple[LatentNetwork, np.ndarray, np.ndarray]:
    """Fit servo, delay, friction, rotor, gear and backlash of every motor to its own log in closed loop.

    The loss is the rollout loss over all windows of the log. It is minimised over the logarithms of the 14 constants
    by a random search, Adam and Gauss-Newton steps (`adapt`).

    Args:
        data: logs of the motors.
        preset: the preset ``per_motor``.

    Returns:
        A network, and means and log-variances (M, Z) of the motors, standardised like those of any prior, so that the
        distribution of the fitted motors is the prior of a new motor's fit.
    """
    servo = _servo(preset, data.scales)
    return standard_posterior(servo, data, preset, adapt(servo, data, preset, _WEAK).mean)


def _servo(preset: Preset, scales: dict[str, float]) -> LatentNetwork:
    """A grey box with one latent per constant, centred on the initial motor of a training; its network gives 0 N·m."""
    start = initial_parameters(np.random.default_rng(0), replace(preset, per_motor=False))
    return export(start, preset, scales)
