"""The residual network of a grey box: trained after the physics, kept only where it earns its place.

It sees the history of errors and joint velocities and adds its torque at the joint. It is trained on every second
segment of the logs, beside constants and latents as the physics were fitted. Then the latents settle with it, as they
do without it (`settling`), both on these segments. It is judged on the other segments and kept if there, over the
motors' logarithms,

    the rollout loss falls by more than LEAST_GAIN, and the errors of position do not rise.

If it is kept, the latents settle with it on all segments. The constants themselves were fitted to all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.standardise import MOTORS_AT_LEAST
from motorprior.identification.networks.descent import Checkpoints, Report, descend
from motorprior.identification.networks.network import export, import_parameters, initial_parameters
from motorprior.identification.physics.motor_fit import MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData, window_starts

LEAST_GAIN = 0.03  # Share of the held-out loss that a residual must save


@dataclass(frozen=True)
class Fleet:
    """A network and the latents (M, Z) of M motors."""

    network: LatentNetwork
    z: np.ndarray


def without_residual(scales: dict[str, float], preset: Preset) -> LatentNetwork:
    """A network of no neurons: a grey box is given its motor afterwards."""
    nothing, numbers, taps, latents = np.zeros, cast(Any, scales), preset.taps, preset.num_latents
    return LatentNetwork(
        w1=nothing((2 * len(taps), 0)), v1=nothing((latents, 0)), b1=nothing(0), w2=nothing((0, 0)), b2=nothing(0),
        w3=nothing(0), b3=nothing(()), log_armature=nothing(()), armature_slope=nothing(latents), taps=taps,
        period=preset.period, **numbers, has_armature=False, gain_unit=preset.gain_unit,
    )  # fmt: skip


def trained_residual(
    physics: Fleet, data: TrainingData, preset: Preset, seed: int, report: Report, checkpoints: Checkpoints | None
) -> LatentNetwork:
    """The network with a residual that was trained on the windows at ``data.starts`` (see `starts_of_seen`)."""
    start = initial_parameters(np.random.default_rng([seed, 0]), preset) | {"w3": jnp.zeros(preset.num_neurons)}
    start |= {"v1": jnp.zeros((preset.num_latents, preset.num_neurons))}
    motor = import_parameters(physics.network)
    start |= {"motor_center": motor["motor_center"], "motor_slope": jnp.diagonal(motor["motor_slope"])}
    trainable = {
        "network": start,
        "mean": jnp.asarray(physics.z, jnp.float32),
        "log_var": jnp.full(physics.z.shape, -2.0, jnp.float32),
    }
    trained, _ = descend(trainable, data, preset, seed, report, checkpoints)
    learned = trained["network"]
    if len(physics.z) < MOTORS_AT_LEAST:
        learned |= {"v1": start["v1"]}  # draws go where no motor was: what it learned of z would be extrapolated
    made = export(learned, preset, data.scales)
    return replace(made, motor=physics.network.motor)  # float64, as it was fitted


def starts_of_seen(data: TrainingData, preset: Preset, longer: Preset, judged: np.ndarray) -> np.ndarray:
    """First rows of the recipe's windows whose free parts touch no window that is ``judged`` (N,) of a ``longer`` one.

    What precedes the first and follows the last longer window of a segment counts as that window's.
    """
    taken, index = np.zeros(data.series.shape[1], bool), 0
    for part in data.parts:
        count = max(0, (part.stop - part.start - 1 - longer.history) // longer.window)
        if count:
            window = (np.arange(part.stop - part.start) - longer.history) // longer.window
            taken[part] = judged[index + np.clip(window, 0, count - 1)]
        index += count
    before, starts = np.concatenate([[0], np.cumsum(taken)]), window_starts(data.parts, preset, "")
    free = starts + preset.history
    return starts[before[free + preset.window] == before[free]]


def gain(without: Fleet, with_it: Fleet, runs: WindowRuns, judged: np.ndarray) -> tuple[float, float]:
    """Shares of the loss and of the root mean square position error that a residual saves on the ``judged`` windows.

    Args:
        without: the physics alone.
        with_it: the same central motor and the residual.
        runs: logs of M motors.
        judged: (N,) mask of windows.
    """
    before, after = (_errors(fleet.network, runs, fleet.z, judged) for fleet in (without, with_it))
    loss, position = 1.0 - np.exp(np.mean(np.log(after / before), axis=1))
    return float(loss), float(position)


def _errors(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, judged: np.ndarray) -> np.ndarray:
    """(2, M) loss and root mean square position error of every motor."""
    losses = MotorFit(network, runs, judged).window_losses(z).mean(axis=1)
    found = [runs.residuals(network, z[[motor]], np.array([motor]))[0, judged, 0] for motor in range(len(z))]
    return np.stack([losses, np.sqrt(np.mean(np.square(found, dtype=np.float64), axis=(1, 2)))])
