"""The residual network of a grey box: trained after the physics, kept only if it improves held-out data.

It sees the history of errors and joint velocities and adds its torque at the joint. It is trained on every second
segment of the logs, with constants and latents as the physics were fitted; then the latents are refined with it, as
they are without it (`fleet_fit`), both on these segments. On the other segments, over the motors' logarithms,

    the rollout loss must fall by more than LEAST_GAIN, and the errors of position must not rise.

If it is kept, the latents are refined with it on all segments. The constants themselves were fitted to all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.standardise import MIN_MOTORS
from motorprior.identification.networks.descent import Checkpoints, DivergedError, Report, descend
from motorprior.identification.networks.network import export, import_parameters, initial_parameters
from motorprior.identification.physics.fleet_fit import refined
from motorprior.identification.physics.motor_fit import MotorFit
from motorprior.identification.physics.term_selection import held_out_windows
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData, window_starts

LEAST_GAIN = 0.03  # share of the held-out loss that a residual must save


@dataclass(frozen=True)
class FittedMotors:
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
    physics: FittedMotors,
    data: TrainingData,
    preset: Preset,
    seed: int,
    report: Report,
    checkpoints: Checkpoints | None,
) -> LatentNetwork:
    """The network with a residual that was trained on the windows at ``data.starts`` (see `train_starts`)."""
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
    if len(physics.z) < MIN_MOTORS:
        learned |= {"v1": start["v1"]}  # samples lie where no motor was: its dependence on z would be extrapolated
    made = export(learned, preset, data.scales)
    return replace(made, motor=physics.network.motor)  # float64, as it was fitted


def refined_motors(
    motors: FittedMotors, longer: WindowRuns, preset: Preset, chosen: np.ndarray | None = None
) -> FittedMotors:
    """On runs, or the ``chosen`` (N,) of them, that are longer than the recipe's; unchanged if there are none."""
    if longer.preset.window <= preset.window:
        return motors
    return replace(motors, z=refined(motors.network, motors.z, longer, preset.physics_first == "together", chosen))


def train_starts(data: TrainingData, preset: Preset, longer: Preset, test: np.ndarray) -> np.ndarray:
    """First rows of the recipe's windows whose free parts overlap no ``test`` window (N,) of the ``longer`` ones.

    What precedes the first and follows the last longer window of a segment counts as that window's.
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


def saved_by_residual(
    without: FittedMotors, with_residual: FittedMotors, runs: WindowRuns, test: np.ndarray
) -> tuple[float, float]:
    """Shares of the loss and of the RMS position error that a residual saves on the ``test`` windows (N,)."""
    before, after = (_errors(motors.network, runs, motors.z, test) for motors in (without, with_residual))
    loss, position = 1.0 - np.exp(np.mean(np.log(after / before), axis=1))
    return float(loss), float(position)


def _errors(network: LatentNetwork, runs: WindowRuns, z: np.ndarray, test: np.ndarray) -> np.ndarray:
    losses = MotorFit(network, runs, test).window_losses(z).mean(axis=1)
    found = [runs.residuals(network, z[[motor]], np.array([motor]))[0, test, 0] for motor in range(len(z))]
    return np.stack([losses, np.sqrt(np.mean(np.square(found, dtype=np.float64), axis=(1, 2)))])


@dataclass(frozen=True)
class ResidualTraining:
    """Training and evaluation of a residual network."""

    data: TrainingData
    preset: Preset
    seed: int
    runs: WindowRuns
    report: Report
    checkpoints: Checkpoints | None

    def best_of(
        self, fitted: FittedMotors, without: FittedMotors, metrics: dict[str, float]
    ) -> tuple[FittedMotors, str]:
        """``without``, or refined motors with a residual where it passes the test; and a note.

        ``fitted`` is physics alone, from short runs, ``without`` the same, refined. The share of the loss that the
        residual saves goes to ``metrics``.
        """
        test = held_out_windows(self.runs)
        if test.all() or not test.any():
            return without, "residual network: rejected, the log is too short to test it"
        train = replace(self.data, starts=train_starts(self.data, self.preset, self.runs.preset, test))
        try:
            network = trained_residual(fitted, train, self.preset, self.seed, self.report, self.checkpoints)
        except DivergedError:
            return without, "residual network: rejected, its training diverged"
        candidate = FittedMotors(network, fitted.z)
        before, after = (refined_motors(each, self.runs, self.preset, ~test) for each in (fitted, candidate))
        loss, position = saved_by_residual(before, after, self.runs, test)
        metrics["saved_residual"] = loss
        text = f"saves {100 * loss:.1f} % of the held-out loss and {100 * position:.1f} % of the position error"
        if loss > LEAST_GAIN and position >= 0.0:
            return refined_motors(candidate, self.runs, self.preset), f"residual network: {text}"
        return without, f"residual network: rejected, {text}"
