"""The residual network of a grey box: trained after the physics, kept only if it improves held-out data.

Its inputs are the history of errors and joint velocities, its torque acts on the joint. It is trained on every second
segment of the logs, with fixed constants and latents; then the latents are refined with it and, for comparison, without
it (`motor_fit`), both on these segments. On the other segments, in geometric means over the motors,

    the rollout loss must fall by more than MIN_GAIN, and the errors of position must not rise.

If it is kept, the latents are refined with it on all segments. The constants themselves were fitted to all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.standardise import MIN_MOTORS
from motorprior.identification.networks.descent import DivergedError, Report, descend
from motorprior.identification.networks.network import export, import_parameters, initial_parameters
from motorprior.identification.physics.motor_fit import refined
from motorprior.identification.physics.motor_problem import window_losses
from motorprior.identification.physics.term_selection import held_out_windows
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData, window_starts
from motorprior.signals import rms

MIN_GAIN = 0.03  # share of the held-out loss that a residual must save


@dataclass(frozen=True)
class FittedMotors:
    """A network and the latents (M, Z) of M motors."""

    network: LatentNetwork
    z: np.ndarray


def without_residual(scales: dict[str, float], preset: Preset) -> LatentNetwork:
    """A network without neurons, to which `with_motor` adds a grey box's motor."""
    zeros, numbers, taps, latents = np.zeros, cast(Any, scales), preset.taps, preset.num_latents
    return LatentNetwork(
        w1=zeros((2 * len(taps), 0)), v1=zeros((latents, 0)), b1=zeros(0), w2=zeros((0, 0)), b2=zeros(0), w3=zeros(0),
        b3=zeros(()), log_armature=zeros(()), armature_slope=zeros(latents), taps=taps, period=preset.period, **numbers,
        has_armature=False, gain_unit=preset.gain_unit,
    )  # fmt: skip


def refined_motors(
    motors: FittedMotors, longer: WindowRuns, preset: Preset, chosen: np.ndarray | None = None
) -> FittedMotors:
    """Refine on ``longer`` runs, or their ``chosen`` (N,) windows; unchanged if no longer than the recipe's."""
    if longer.preset.window <= preset.window:
        return motors
    return replace(motors, z=refined(motors.network, motors.z, longer, preset.physics_first == "together", chosen))


def with_residual(
    fitted: FittedMotors,
    without: FittedMotors,
    data: TrainingData,
    preset: Preset,
    seed: int,
    runs: WindowRuns,
    report: Report,
) -> tuple[FittedMotors, float | None, str]:
    """Train a residual network for the ``fitted`` physics, and test it on long free ``runs``.

    ``without`` are the fitted motors refined on these runs. Returns refined motors with a residual if it passes the
    test, otherwise ``without``; the share of the held-out loss that it saves, None if it was not tested; and a note.
    """
    test = held_out_windows(runs)
    if test.all() or not test.any():
        return without, None, "residual network: rejected, the log is too short to test it"
    train = replace(data, starts=train_starts(data, preset, runs.preset, test))
    try:
        candidate = FittedMotors(_trained(fitted, train, preset, seed, report), fitted.z)
    except DivergedError:
        return without, None, "residual network: rejected, its training diverged"
    before, after = (_errors(refined_motors(each, runs, preset, ~test), runs, test) for each in (fitted, candidate))
    loss, position = (float(share) for share in 1.0 - np.exp(np.mean(np.log(after / before), axis=1)))
    text = f"saves {100 * loss:.1f} % of the held-out loss and {100 * position:.1f} % of the position error"
    if loss > MIN_GAIN and position >= 0.0:
        return refined_motors(candidate, runs, preset), loss, f"residual network: {text}"
    return without, loss, f"residual network: rejected, {text}"


def train_starts(data: TrainingData, preset: Preset, longer: Preset, test: np.ndarray) -> np.ndarray:
    """First rows of the recipe's windows whose free parts overlap no ``test`` window (N,) of the ``longer`` ones.

    Rows before the first and after the last longer window of a segment count as that window's.
    """
    taken, index = np.zeros(data.series.shape[1], bool), 0
    for part in data.parts:
        count = max(0, (part.stop - part.start - 1 - longer.history) // longer.window)
        if count:
            window = (np.arange(part.stop - part.start) - longer.history) // longer.window
            taken[part] = test[index + np.clip(window, 0, count - 1)]
        index += count
    before, starts = np.concatenate([[0], np.cumsum(taken)]), window_starts(data.parts, preset, "")
    free = starts + preset.history
    return starts[before[free + preset.window] == before[free]]


def _trained(physics: FittedMotors, data: TrainingData, preset: Preset, seed: int, report: Report) -> LatentNetwork:
    """The network with a residual that was trained on the windows at ``data.starts``."""
    start = initial_parameters(np.random.default_rng([seed, 0]), preset) | {"w3": jnp.zeros(preset.num_neurons)}
    start |= {"v1": jnp.zeros((preset.num_latents, preset.num_neurons))}
    motor = import_parameters(physics.network)
    start |= {"motor_center": motor["motor_center"], "motor_slope": jnp.diagonal(motor["motor_slope"])}
    trainable = {
        "network": start,
        "mean": jnp.asarray(physics.z, jnp.float32),
        "log_var": jnp.full(physics.z.shape, -2.0, jnp.float32),
    }
    learned = descend(trainable, data, preset, seed, report)[0]["network"]
    if len(physics.z) < MIN_MOTORS:
        learned |= {"v1": start["v1"]}  # few motors: the dependence on z would be extrapolated in samples
    return replace(export(learned, preset, data.scales), motor=physics.network.motor)  # float64, as it was fitted


def _errors(motors: FittedMotors, runs: WindowRuns, test: np.ndarray) -> np.ndarray:
    """(2, M) loss and RMS position error on the ``test`` windows (N,)."""
    network, z = motors.network, motors.z
    losses = window_losses(network, runs, z, test).mean(axis=1)
    found = [runs.residuals(network, z[[motor]], np.array([motor]))[0, test, 0] for motor in range(len(z))]
    return np.stack([losses, rms(np.asarray(found, np.float64), axis=(1, 2))])
