"""The residual network of a grey box: trained after the physics, kept only where it earns its place.

It sees the history of errors and joint velocities and adds its torque at the joint. Constants and latents stay as the
physics were fitted. It is trained on every second segment of the logs and judged on the others, and kept if there, over
the motors' logarithms,

    the rollout loss falls by more than LEAST_GAIN, and the errors of position do not rise.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.motor_fit import MotorFit
from motorprior.identification.presets import Preset
from motorprior.identification.window_runs import WindowRuns

LEAST_GAIN = 0.03
"""Share of the held-out loss that a residual must save."""


def without_residual(scales: dict[str, float], preset: Preset) -> LatentNetwork:
    """A network of no neurons: a grey box is given its motor afterwards."""
    nothing, numbers, taps, latents = np.zeros, cast(Any, scales), preset.taps, preset.num_latents
    return LatentNetwork(
        w1=nothing((2 * len(taps), 0)), v1=nothing((latents, 0)), b1=nothing(0), w2=nothing((0, 0)), b2=nothing(0),
        w3=nothing(0), b3=nothing(()), log_armature=nothing(()), armature_slope=nothing(latents), taps=taps,
        period=preset.period, **numbers, has_armature=False, gain_unit=preset.gain_unit,
    )  # fmt: skip


def gain(
    without: LatentNetwork, with_it: LatentNetwork, runs: WindowRuns, z: np.ndarray, judged: np.ndarray
) -> tuple[float, float]:
    """Shares of the loss and of the root mean square position error that a residual saves on the ``judged`` windows.

    Args:
        without: the physics alone.
        with_it: the same physics and the residual.
        runs: logs of M motors.
        z: (M, Z) their latents.
        judged: (N,) mask of windows.
    """
    before, after = (_errors(network, runs, z, judged) for network in (without, with_it))
    loss, position = 1.0 - np.exp(np.mean(np.log(after / before), axis=1))
    return float(loss), float(position)


def _errors(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, judged: np.ndarray) -> np.ndarray:
    """(2, M) loss and root mean square position error of every motor."""
    losses = MotorFit(network, runs, judged).window_losses(z).mean(axis=1)
    found = [runs.residuals(network, z[[motor]], np.array([motor]))[0, judged, 0] for motor in range(len(z))]
    return np.stack([losses, np.sqrt(np.mean(np.square(found, dtype=np.float64), axis=(1, 2)))])
