"""The posterior of z for new motors, from seconds of log; the network's weights stay fixed.

    minimise  U(z) = N·loss(z)/T + ½|z|²,     covariance = (I + N·G(z)/T)⁻¹

(of a joint whose name is that of a training motor of a robot ½|z - m|²/d², m that motor's mean, d SAME_JOINT_STD).
loss is the prior's training objective, averaged over N windows that do not overlap, and G its Gauss-Newton matrix. The
temperature T is the mean loss of the training motors, so that a window fitted as well as theirs counts as one
observation (a generalised posterior with a Laplace approximation). U of a grey box is minimised by `grey_box_fit`, that
of a network by Adam on random subsets of the windows, then by Gauss-Newton steps on all windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents import grey_box_fit
from motorprior.identification.latents.grey_box_fit import LatentPrior, Posterior, inverse_precision
from motorprior.identification.networks.motor_loss import MotorLoss, motor_loss
from motorprior.identification.networks.network import Parameters
from motorprior.identification.physics.motor_fit import MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

STEPS, BATCH = 300, 16  # Adam steps, and windows per step
POLISHES = 6  # Gauss-Newton steps after Adam
# random search before Adam, since U has many local minima: samples per round, windows, standard deviation per round
STARTS, SCREENED_WINDOWS, SEARCH_RADII = 48, 24, (1.0, 1.0, 0.5, 0.25, 0.12)


def tiled_windows(data: TrainingData, preset: Preset) -> np.ndarray:
    """(M, N, length, channels) windows whose free parts do not overlap, each preceded by its history."""
    length = preset.history + preset.window
    starts, last = [], -preset.window
    for start in data.starts:
        if start >= last + preset.window or start < last:
            starts.append(int(start))
            last = int(start)
    return np.stack([data.series[:, start : start + length] for start in starts], axis=1)


def adapt(
    network: LatentNetwork,
    data: TrainingData,
    preset: Preset,
    temperature: float,
    steps: int = STEPS,
    start: np.ndarray | None = None,
    prior: LatentPrior | None = None,
) -> Posterior:
    """Posterior of every motor in ``data``; its scales must be those of the network.

    Args:
        network: of the prior.
        data: logs of the new motors, stacked.
        preset: the prior's recipe.
        temperature: T, mean window loss of the prior's training motors (`reference.reference_metrics`).
        steps: number of Adam steps, for a network.
        start: (M, Z) initial latents; found by a random search if not given.
        prior: of grey boxes; N(0, I) if not given.
    """
    if network.motor is not None:
        return grey_box_fit.adapt(network, data, preset, temperature, start, prior)
    windows = jnp.asarray(tiled_windows(data, preset))
    fit = _Fit(*motor_loss(network, preset, data.measured), windows, temperature)
    first = fit.best_starts(network.num_latents) if start is None else jnp.asarray(start, jnp.float32)
    modes = fit.polish(first, fit.descend(first, steps))
    losses = fit.functions.losses(fit.parameters, modes, windows)
    return Posterior(
        np.asarray(modes, np.float64), fit.covariance(modes), np.asarray(losses, np.float64), windows.shape[1]
    )


def laplace_covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """(M, Z, Z) Laplace covariance at known modes z (M, Z); formula in the module docstring."""
    if network.motor is not None:
        return grey_box_fit.covariance(network, data, preset, z, temperature)
    windows = jnp.asarray(tiled_windows(data, preset))
    fit = _Fit(*motor_loss(network, preset, data.measured), windows, temperature)
    return fit.covariance(jnp.asarray(z, jnp.float32))


def window_losses(network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray) -> np.ndarray:
    """(M, N) loss of each of the non-overlapping windows, with the motors at latents z (M, Z)."""
    if network.motor is not None:
        return MotorFit(network, WindowRuns(data, preset)).window_losses(z)
    functions, parameters = motor_loss(network, preset, data.measured)
    windows = jnp.asarray(tiled_windows(data, preset))
    return np.asarray(functions.window_losses(parameters, jnp.asarray(z, jnp.float32), windows), np.float64)


@dataclass(frozen=True)
class _Fit:
    """The minimisation problem: compiled functions, network parameters, windows (M, N, length, channels), and T."""

    functions: MotorLoss
    parameters: Parameters
    windows: jnp.ndarray
    temperature: float

    @property
    def count(self) -> int:
        """N, the number of windows per motor."""
        return self.windows.shape[1]

    def energies(self, z: jnp.ndarray) -> jnp.ndarray:
        """(M,) energy U / N on all windows."""
        return self.functions.energies(self.parameters, z, self.windows, self.temperature, float(self.count))

    def best_starts(self, latents: int) -> jnp.ndarray:
        """(M, Z) best of a random search on evenly spaced windows, with draws around the best so far, ever closer."""
        rng, motors = np.random.default_rng(0), self.windows.shape[0]
        picked = np.linspace(0, self.count - 1, min(SCREENED_WINDOWS, self.count)).astype(int)
        best, screened = jnp.zeros((motors, latents), jnp.float32), self.windows[:, picked]
        for radius in SEARCH_RADII:
            draws = radius * rng.standard_normal((STARTS, latents))
            draws[0] = 0.0
            candidates = best[:, None, :] + jnp.asarray(draws, jnp.float32)
            winner = jnp.argmin(self.functions.screen(self.parameters, candidates, screened), axis=1)
            best = candidates[jnp.arange(motors), winner]
        return best

    def descend(self, start: jnp.ndarray, steps: int) -> jnp.ndarray:
        """(M, Z) latents after Adam on random subsets of the windows, the same subsets for every motor."""
        rng = np.random.default_rng(1)
        picked = np.stack([rng.permutation(self.count)[: min(BATCH, self.count)] for _ in range(steps)])
        return self.functions.descend(
            self.parameters, start, self.windows, jnp.asarray(picked), self.temperature, float(self.count)
        )

    def polish(self, start: jnp.ndarray, found: jnp.ndarray) -> jnp.ndarray:
        """(M, Z) latents after POLISHES damped Gauss-Newton steps from the better of ``start`` and ``found``.

        A step is kept only if it lowers the energy on all windows. So the result is never worse than the start, even
        though gradients are unreliable in windows in which a motor reaches the end of its backlash.
        """
        values, others = self.energies(start), self.energies(found)
        z = jnp.where((others < values)[:, None], found, start)
        values, damping = jnp.minimum(values, others), jnp.full(len(z), 1e-2)
        identity = jnp.eye(z.shape[1])
        for _ in range(POLISHES):
            curvature = self.functions.curvatures(self.parameters, z, self.windows) / self.temperature
            matrix = curvature + (1.0 / self.count + damping[:, None, None]) * identity
            slope = self.functions.slopes(self.parameters, z, self.windows, self.temperature, float(self.count))
            candidate = z - jnp.linalg.solve(matrix, slope[..., None])[..., 0]
            tried = self.energies(candidate)
            better = tried < values
            z, values = jnp.where(better[:, None], candidate, z), jnp.where(better, tried, values)
            damping = jnp.where(better, 0.1 * damping, 10.0 * damping)
        return z

    def covariance(self, z: jnp.ndarray) -> np.ndarray:
        """(M, Z, Z) Laplace approximation (I + N·G/T)⁻¹, with negative eigenvalues of G set to 0."""
        curvature = np.asarray(self.functions.curvatures(self.parameters, z, self.windows), np.float64)
        return inverse_precision(curvature * self.count / self.temperature, np.ones(len(curvature)))
