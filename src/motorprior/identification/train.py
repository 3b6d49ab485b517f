"""Fit a motor prior: one network, and a mean and a log-variance of z per motor.

minimise  loss(windows, z) + kl_weight·mean_i KL(N(μ_i, σ_i²) ‖ N(0, I))
with z_i = μ_i + exp(½·log_var_i)·ε, ε ~ N(0, I), as in the paper if the preset is ``noisy``; otherwise z_i = μ_i, and
the variances are computed afterwards (`standard_posterior`). A preset with ``physics_first`` fits the motors'
constants, refines them on longer runs (`motor_fit`), and trains only the residual network this way (`residual`).

Optional terms are selected on some motors and some rows (`term_selection`), where a gain may be due to chance. All
motors are therefore fitted with the selected terms and with the logged ones alone; the selected ones are kept if they
save MIN_GAIN of the loss of all motors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, repeat

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import UNIDENTIFIED, UNKNOWN_TORQUE_SCALE, limit_text
from motorprior.actuator.optional_terms import TERMS
from motorprior.exceptions import MotorPriorError, listed
from motorprior.identification.evaluation.reference import aggregate_posterior_kl
from motorprior.identification.latents.standardise import assumed_std, standard_posterior
from motorprior.identification.networks.descent import CHUNK, Checkpoints, Report, descend
from motorprior.identification.networks.network import Parameters, export, initial_parameters
from motorprior.identification.physics import term_selection
from motorprior.identification.physics.identifiability import unidentifiable_limits, unknown_torque_scale
from motorprior.identification.physics.initial_motor import with_motor
from motorprior.identification.physics.motor_fit import STAGES, FleetFit, fit_motors, longer_runs
from motorprior.identification.physics.motor_problem import fixed_constants, motor_search
from motorprior.identification.physics.term_selection import Selection, min_difference, select_terms
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.residual import MIN_GAIN, FittedMotors, refined_motors, with_residual, without_residual
from motorprior.identification.training_data.windows import TrainingData, subsampled

WORK = CHUNK * (len(TERMS) + STAGES)  # of the fit of physics, in Adam steps


@dataclass(frozen=True)
class Identified:
    """A trained network with the posteriors of the training motors."""

    network: LatentNetwork  # of the prior
    mean: np.ndarray  # (M, Z)
    log_var: np.ndarray  # (M, Z)
    preset: Preset  # the recipe, with the terms that were selected and without a network that was rejected
    # mean losses: of every `descent.CHUNK` steps, or of the finished fits on the recipe's own windows
    losses: np.ndarray
    # ``saved_TERM`` and ``saved_residual``, shares of the held-out loss that a term or the residual network
    # saves; ``not_shown_LIMIT`` and ``unknown_torque_size``, see `identifiability`
    metrics: dict[str, float]
    notes: tuple[str, ...]  # lines for the user

    @property
    def aggregate_kl(self) -> float:
        """KL divergence of the mixture of all posteriors from N(0, I) [nat]."""
        return aggregate_posterior_kl(self.mean, self.log_var) if self.mean.size else 0.0


def work_of(preset: Preset) -> int:
    """Sum of the work that `identify` reports, if nothing diverges."""
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
        report: called with the work since the last call, often 0, and a text; an exception that it raises ends the fit.
        checkpoints: where an interrupted training resumes.

    Raises:
        MotorPriorError: the training diverged.
    """
    assumed = None
    if preset.physics_first:
        found, assumed = _physics_first(data, preset, seed, report, checkpoints)
    else:
        start = _initial(data, preset, np.random.default_rng([seed, 0]))
        trained, losses = descend(start, data, preset, seed, report, checkpoints)
        mean, log_var = (np.asarray(trained[name], np.float64) for name in ("mean", "log_var"))
        found = Identified(export(trained["network"], preset, data.scales), mean, log_var, preset, losses, {}, ())
    if preset.standardise:
        network, mean, log_var = standard_posterior(found.network, data, found.preset, found.mean, assumed)
        found = replace(found, network=network, mean=mean, log_var=log_var)
    return found


def _initial(data: TrainingData, preset: Preset, rng: np.random.Generator) -> Parameters:
    motors, latents = len(data.series), preset.num_latents
    return {
        "network": initial_parameters(rng, preset),
        "mean": jnp.asarray(0.1 * rng.standard_normal((motors, latents)), jnp.float32),
        "log_var": jnp.full((motors, latents), -2.0, jnp.float32),  # a weak type would compile a chunk twice
    }


def _physics_first(
    data: TrainingData, preset: Preset, seed: int, report: Report, checkpoints: Checkpoints | None
) -> tuple[Identified, np.ndarray]:
    """The fitted motors, and the assumed standard deviations (Z,) of their latents."""
    runs = WindowRuns(data, preset, heartbeat=lambda: report(0, ""))
    physics = _fit_physics(data, preset, runs, seed, report, checkpoints)
    found = physics.fit
    preset = replace(preset, terms=found.terms, num_latents=len(found.center))
    metrics = {f"saved_{name}": value for name, value in physics.saved.items()}
    notes = _notes_on_terms(physics, preset)
    fitted = FittedMotors(with_motor(without_residual(data.scales, preset), found.center, found.terms), found.offsets)
    longer = longer_runs(data, preset, runs)
    report(0, "refining constants")
    motors = refined_motors(fitted, longer, preset)
    if preset.num_neurons:
        motors, saved, note = with_residual(fitted, motors, data, preset, seed, longer, report)
        metrics |= {} if saved is None else {"saved_residual": saved}
        preset = preset if motors.network.num_neurons else replace(preset, num_neurons=0)
        notes.append(note)
    notes += _notes_on_identifiability(motors, longer, data.joint_names, metrics)
    log_var, losses = np.zeros_like(motors.z), motor_search(motors.network, runs).losses(motors.z).mean(keepdims=True)
    assumed = assumed_std(found.terms, fixed_constants(found.terms, runs))
    return Identified(motors.network, motors.z, log_var, preset, losses, metrics, tuple(notes)), assumed


@dataclass(frozen=True)
class _Physics:
    """The fit of all motors, and the share of the loss that each term saved."""

    fit: FleetFit
    saved: dict[str, float]

    def arrays(self) -> dict[str, np.ndarray]:
        """For a checkpoint."""
        has = np.array([name in self.fit.terms for name in TERMS], np.float64)
        saved = np.array([self.saved.get(name, np.nan) for name in TERMS])
        fitted = {"center": self.fit.center, "offsets": self.fit.offsets, "fitted": self.fit.loss}
        return {"has_term": has, "saved": saved} | fitted

    @classmethod
    def from_arrays(cls, kept: dict[str, np.ndarray]) -> _Physics:
        """From a checkpoint."""
        terms = tuple(name for name, has in zip(TERMS, kept["has_term"], strict=True) if has)
        saved = {name: float(share) for name, share in zip(TERMS, kept["saved"], strict=True) if np.isfinite(share)}
        return cls(FleetFit(kept["center"], kept["offsets"], kept["fitted"], terms), saved)


def _fit_physics(
    data: TrainingData, preset: Preset, runs: WindowRuns, seed: int, report: Report, checkpoints: Checkpoints | None
) -> _Physics:
    """The fit, or that of an interrupted training; raises `MotorPriorError` if every simulation diverges."""
    kept = checkpoints.load() if checkpoints is not None else None
    if kept is not None:
        report(WORK, "constants already fitted")
        return _Physics.from_arrays(kept)
    bare = without_residual(data.scales, preset)
    part = subsampled(data, preset, max(term_selection.MAX_ROWS, term_selection.MIN_WINDOWS * preset.window))
    chosen = _selected(bare, part, preset, seed, report)
    few = runs if part is data else WindowRuns(part, preset, heartbeat=runs.heartbeat)
    fit = partial(fit_motors, bare, runs, together=preset.physics_first == "together", seed=seed, part=few)
    found = fit(chosen.terms, report=lambda: report(CHUNK, "constants"))
    if set(chosen.terms) - set(preset.logged_terms):
        without = fit(preset.logged_terms, report=lambda: report(0, "without terms"))
        found = found if found.loss.mean() <= (1.0 - MIN_GAIN) * without.loss.mean() else without
    if not found.loss.max() < 1e6:
        raise MotorPriorError(
            f"the simulation of joint {int(found.loss.argmax())} of the log diverges with every motor",
            remedy="check the log with `motorprior logs check`",
        )
    physics = _Physics(found, chosen.saved)
    if checkpoints is not None:
        checkpoints.save(physics.arrays())
    return physics


def _selected(bare: LatentNetwork, part: TrainingData, preset: Preset, seed: int, report: Report) -> Selection:
    if not preset.tries_terms:
        report(CHUNK * len(TERMS), "no terms are tried")
        return Selection(preset.logged_terms, {})
    motors = len(part.series)
    some = np.unique(np.linspace(0, motors - 1, min(term_selection.MAX_MOTORS, motors)).astype(int))
    few = WindowRuns(part, preset, some, heartbeat=lambda: report(0, ""))
    work = chain(repeat(CHUNK, len(TERMS)), repeat(0))  # the number of later rounds is unknown
    chosen = select_terms(bare, few, seed, lambda text: report(next(work), text))
    if not chosen.saved:
        report(CHUNK * len(TERMS), "the log is too short to select terms")
    return chosen


def _notes_on_terms(physics: _Physics, preset: Preset) -> list[str]:
    chosen = [f"{name} (logged)" if name in preset.logged_terms else name for name in physics.fit.terms]
    notes = [f"optional terms: {', '.join(chosen) or ('none' if physics.saved else 'none was tried')}"]
    notes += [
        f"warning: {name} varies from {low:.3g} to {high:.3g} in these logs, which a recipe without optional "
        "terms ignores -> use preset rollout or long_runs"
        for name, low, nominal, high in preset.conditions
        if not preset.tries_terms and high - low >= min_difference(name, nominal)
    ]
    return notes


def _notes_on_identifiability(
    motors: FittedMotors, runs: WindowRuns, names: tuple[str, ...], metrics: dict[str, float]
) -> list[str]:
    """Notes on limits and on a scale of torques that the logs do not identify, also added to ``metrics``."""

    def logs(hidden: np.ndarray) -> str:
        named = f" ({listed([names[motor] for motor in np.flatnonzero(hidden)], 6)})" if names else ""
        return f"warning: the logs of {hidden.sum()} of {len(hidden)} motors{named} do not identify"

    notes = []
    for name, hidden in unidentifiable_limits(motors.network, runs, motors.z).items():
        value = float(motors.network.constants(motors.z)[name][hidden].max())
        metrics[f"{UNIDENTIFIED}{name}"] = value
        notes.append(f"{logs(hidden)} the fitted {limit_text(name, value)}; policies may over-rely on it")
    hidden = unknown_torque_scale(motors.network, runs, motors.z)
    if hidden.any():
        metrics[UNKNOWN_TORQUE_SCALE] = float(hidden.sum())
        notes.append(
            f"{logs(hidden)} the scale of torques; only ratios of kp, torque limit, armature and friction are physical "
            "-> log kp in N·m/rad, or motions under larger loads"
        )
    return notes
