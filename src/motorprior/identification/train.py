"""Fit a motor prior: one network, and a mean and a log-variance of z per motor.

minimise  loss(windows, z) + kl_weight·mean_i KL(N(μ_i, σ_i²) ‖ N(0, I))
with z_i = μ_i + exp(½·log_var_i)·ε, ε ~ N(0, I), as in the paper if the preset is ``noisy``; otherwise z_i = μ_i, and
the variances are computed afterwards (`standard_posterior`). A preset with ``physics_first`` fits the motors' constants
by `physics_fit`, trains only the residual network this way (`residual`), and lets the constants settle (`settling`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import UNIDENTIFIED, UNKNOWN_TORQUE_SCALE, limit_text
from motorprior.exceptions import listed
from motorprior.identification.judging.distribution import aggregate_posterior_summary
from motorprior.identification.latents.assumed_spread import assumed_spread
from motorprior.identification.latents.standardise import standard_posterior
from motorprior.identification.networks.descent import Checkpoints, DivergedError, Report, descend
from motorprior.identification.networks.network import Parameters, export, initial_parameters
from motorprior.identification.physics.felt import WORSE, limits_not_felt, sizes_not_felt
from motorprior.identification.physics.fleet_fit import held_constants
from motorprior.identification.physics.motor_fit import MotorFit
from motorprior.identification.physics.settling import longer_runs, settled
from motorprior.identification.physics.term_selection import held_out_windows, least_difference
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.physics_fit import WORK, Physics, fit_physics
from motorprior.identification.presets import Preset
from motorprior.identification.residual import (
    LEAST_GAIN,
    Fleet,
    gain,
    starts_of_seen,
    trained_residual,
    without_residual,
)
from motorprior.identification.training_data.windows import TrainingData

_NAMED = 6  # Motors that a note names


@dataclass(frozen=True)
class Identified:
    """A trained network with the posteriors of the training motors, mean and log_var (M, Z).

    Attributes:
        network: of the prior.
        mean: (M, Z).
        log_var: (M, Z).
        preset: the recipe, with the terms that were found and without a network that brought nothing.
        losses: mean losses: of every `descent.CHUNK` steps, or of the finished fits on the recipe's own windows.
        aggregate_kl: KL divergence of the mixture of all posteriors from N(0, I) [nat].
        metrics: what was found on the way: ``saved_TERM``, the share of the held-out loss that a term saves, and
            ``saved_residual``, that of the residual network; ``not_shown_LIMIT`` and ``unknown_torque_size``, see
            `felt`.
        notes: what a user should know of it, line by line.
    """

    network: LatentNetwork
    mean: np.ndarray
    log_var: np.ndarray
    preset: Preset
    losses: np.ndarray
    aggregate_kl: float
    metrics: dict[str, float]
    notes: tuple[str, ...]


def work_of(preset: Preset) -> int:
    """Sum of the numbers that `identify` reports, if nothing diverges."""
    return (WORK if preset.physics_first else 0) + (preset.steps if preset.trains else 0)


def identify(
    data: TrainingData,
    preset: Preset,
    seed: int,
    report: Report = lambda work, text: None,
    checkpoints: Checkpoints | None = None,
) -> Identified:
    """Train a prior. The same data, preset and seed give the same bytes, also after an interruption.

    Args:
        data: logs.
        preset: recipe.
        seed: of weights, windows, noise and searches.
        report: called with parts of `work_of` and what to say of them; with 0 several times a second during a fit of
            physics, so that what it raises ends the fit soon.
        checkpoints: where an interrupted training goes on.

    Raises:
        MotorPriorError: the training diverged.
    """
    if preset.physics_first:
        return _physics_first(data, preset, seed, report, checkpoints)
    trained, losses = descend(
        _initial(data, preset, np.random.default_rng([seed, 0])), data, preset, seed, report, checkpoints
    )
    network = export(trained["network"], preset, data.scales)
    mean, log_var = (np.asarray(trained[name], np.float64) for name in ("mean", "log_var"))
    return _finished(network, mean, log_var, data, preset, losses, {}, ())


def _finished(
    network: LatentNetwork,
    mean: np.ndarray,
    log_var: np.ndarray,
    data: TrainingData,
    preset: Preset,
    losses: np.ndarray,
    metrics: dict[str, float],
    notes: tuple[str, ...],
    assumed: np.ndarray | None = None,
) -> Identified:
    if preset.standardise:
        network, mean, log_var = standard_posterior(network, data, preset, mean, assumed)
    divergence = aggregate_posterior_summary(mean, log_var).kl if mean.size else 0.0
    return Identified(network, mean, log_var, preset, losses, float(divergence), metrics, notes)


def _initial(data: TrainingData, preset: Preset, rng: np.random.Generator) -> Parameters:
    motors, latents = len(data.series), preset.num_latents
    return {
        "network": initial_parameters(rng, preset),
        "mean": jnp.asarray(0.1 * rng.standard_normal((motors, latents)), jnp.float32),
        "log_var": jnp.full((motors, latents), -2.0, jnp.float32),  # a weak type would compile a chunk twice
    }


def _physics_first(
    data: TrainingData, preset: Preset, seed: int, report: Report, checkpoints: Checkpoints | None
) -> Identified:
    runs = WindowRuns(data, preset, beat=lambda: report(0, ""))
    physics = fit_physics(data, preset, runs, seed, report, checkpoints)
    found, saved = physics.fit, physics.saved
    preset = replace(preset, terms=found.terms, num_latents=len(found.center))
    metrics = {f"saved_{name}": value for name, value in saved.items()}
    notes = _notes_on_terms(physics, preset)
    fitted = Fleet(found.network(without_residual(data.scales, preset)), found.offsets)
    longer = longer_runs(data, preset, runs)
    report(0, "constants settle")
    fleet = _settled(fitted, longer, preset)
    if preset.num_neurons:
        stored = None if checkpoints is None else _Beside(checkpoints, physics.arrays())
        residual = _Residual(data, preset, seed, longer, report, stored)
        fleet, note = residual.beside(fitted, fleet, metrics)
        preset = preset if fleet.network.num_neurons else replace(preset, num_neurons=0)
        notes.append(note)
    notes += _limits_not_shown(fleet, longer, data.joint_names, metrics)
    notes += _size_not_shown(fleet, longer, data.joint_names, metrics)
    log_var, losses = np.zeros_like(fleet.z), MotorFit(fleet.network, runs).losses(fleet.z).mean(keepdims=True)
    assumed = assumed_spread(found.terms, held_constants(found.terms, runs))
    return _finished(fleet.network, fleet.z, log_var, data, preset, losses, metrics, tuple(notes), assumed)


def _settled(fleet: Fleet, longer: WindowRuns, preset: Preset, chosen: np.ndarray | None = None) -> Fleet:
    """On runs, or the ``chosen`` (N,) of them, that are longer than the recipe's; as it is if there are none."""
    if longer.preset.window <= preset.window:
        return fleet
    return replace(fleet, z=settled(fleet.network, fleet.z, longer, preset.physics_first == "together", chosen))


@dataclass(frozen=True)
class _Residual:
    """How a residual network is trained and judged."""

    data: TrainingData
    preset: Preset
    seed: int
    runs: WindowRuns
    report: Report
    checkpoints: Checkpoints | None

    def beside(self, fitted: Fleet, fleet: Fleet, metrics: dict[str, float]) -> tuple[Fleet, str]:
        """``fleet``, or ``fitted`` with a residual, settled, where it earns its place; and a note on it.

        Args:
            fitted: physics alone, as short runs found them.
            fleet: the same, settled.
            metrics: where the share of the loss goes that it saves.
        """
        judged = held_out_windows(self.runs)
        if judged.all() or not judged.any():
            return fleet, "residual network: left out, the log is too short to judge it"
        seen = replace(self.data, starts=starts_of_seen(self.data, self.preset, self.runs.preset, judged))
        try:
            network = trained_residual(fitted, seen, self.preset, self.seed, self.report, self.checkpoints)
        except DivergedError:
            return fleet, "residual network: left out, its training diverged"
        candidate = Fleet(network, fitted.z)
        without, with_it = (_settled(each, self.runs, self.preset, ~judged) for each in (fitted, candidate))
        less, closer = gain(without, with_it, self.runs, judged)
        metrics["saved_residual"] = less
        if less > LEAST_GAIN and closer >= 0.0:
            settled_with_it = _settled(candidate, self.runs, self.preset)
            return settled_with_it, f"residual network: saves {100 * less:.0f} % of the held-out loss"
        return fleet, (
            f"residual network: left out, it changes the held-out loss by {-100 * less:+.1f} % and the held-out "
            f"error of position by {-100 * closer:+.1f} %"
        )


def _notes_on_terms(physics: Physics, preset: Preset) -> list[str]:
    terms = physics.fit.terms
    chosen = ", ".join(f"{name} (stated)" if name in preset.stated_terms else name for name in terms)
    notes = [f"terms beyond the geared motor: {chosen or ('none' if physics.saved else 'none was tried')}"]
    notes += [
        f"warning: {name} is {least:.3g} to {most:.3g} in these logs, and this recipe does not try what that does: it "
        "counts as the motor -> use one that tries terms, rollout or long_runs"
        for name, least, usual, most in preset.conditions
        if not preset.tries_terms and most - least >= least_difference(name, usual)
    ]
    if physics.left_out:
        notes.append(
            f"left out again: {', '.join(physics.left_out)}, chosen by some motors and rows; of the loss of all they "
            f"save less than {100 * LEAST_GAIN:g} %"
        )
    return notes


def _whose(hidden: np.ndarray, names: tuple[str, ...]) -> str:
    """For example "the logs of 2 of 6 motors (elbow, wrist)"."""
    named = f" ({listed([names[motor] for motor in np.flatnonzero(hidden)], _NAMED)})" if names else ""
    return f"the logs of {hidden.sum()} of {len(hidden)} motors{named}"


def _limits_not_shown(fleet: Fleet, runs: WindowRuns, names: tuple[str, ...], metrics: dict[str, float]) -> list[str]:
    """Notes on limits that the logs do not feel; they go to ``metrics``, too."""
    notes = []
    for name, hidden in limits_not_felt(fleet.network, runs, fleet.z).items():
        metrics[f"{UNIDENTIFIED}{name}"] = hidden.most
        notes.append(
            f"warning: {_whose(hidden.motors, names)} do not show a {limit_text(name, hidden.most)}, the largest "
            f"that the fit gave them: with half of it, or with double, the loss of such a log is at most {WORSE:g} "
            "times what it is. A policy that is trained on this prior may count on it"
        )
    return notes


def _size_not_shown(fleet: Fleet, runs: WindowRuns, names: tuple[str, ...], metrics: dict[str, float]) -> list[str]:
    """A note on motors whose logs do not feel how large torques are; their number goes to ``metrics``, too."""
    hidden = sizes_not_felt(fleet.network, runs, fleet.z)
    if not hidden.any():
        return []
    metrics[UNKNOWN_TORQUE_SCALE] = float(hidden.sum())
    return [
        f"warning: {_whose(hidden, names)} do not show how large their torques are: with half of all torques and of "
        f"the rotor's inertia, or with double, the loss of such a log is at most {WORSE:g} times what it is. Only "
        "ratios of kp, torque limit, armature and friction are to be read as physics. Under another load these "
        "motors may be several times too strong or too weak. State kp in N·m/rad, or log motions in which the load "
        "pulls harder at the motors"
    ]


@dataclass(frozen=True)
class _Beside:
    """Checkpoints of a descent beside the arrays of the fit that came before it."""

    checkpoints: Checkpoints
    arrays: dict[str, np.ndarray]

    def load(self) -> dict[str, np.ndarray] | None:
        kept = self.checkpoints.load()
        return kept if kept is not None and "losses" in kept else None

    def save(self, state: dict[str, np.ndarray]) -> None:
        self.checkpoints.save(state | self.arrays)
