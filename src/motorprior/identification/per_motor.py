"""The per-motor baseline with backlash: every motor fitted by itself, nothing shared, no network.

In the manner of PACE (Bjelonic et al., 2025), whose motors have no backlash.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.adapt import adapt
from motorprior.identification.network import export, initial_parameters
from motorprior.identification.posterior import standard_posterior
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData

_WEAK = 1e-3
"""Temperature of the fit: a motor's own windows leave the search's N(0, I) no say."""


def fit_motors(data: TrainingData, preset: Preset) -> tuple[LatentNetwork, np.ndarray, np.ndarray]:
    """Servo, delay, friction, rotor, gear and backlash of every motor, fitted to its own log in closed loop.

    The loss is that of rollout over all windows of the log; a global search, Adam and Gauss-Newton steps over
    the logarithms of the 14 constants find the minimum (`adapt`).

    Args:
        data: logs of the motors.
        preset: ``per_motor``.

    Returns:
        A network, and means and log-variances (M, Z) of the motors, standardised as any prior's: what the fitted
        motors are together is where a new motor's fit starts from.
    """
    servo = _servo(preset, data.scales)
    return standard_posterior(servo, data, preset, adapt(servo, data, preset, _WEAK).mean)


def _servo(preset: Preset, scales: dict[str, float]) -> LatentNetwork:
    """One latent per constant, about the small servo that every training starts from; its network is silent."""
    start = initial_parameters(np.random.default_rng(0), replace(preset, per_motor=False))
    return export(start, preset, scales)
