"""The posterior of z for the motors of a log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.geared_motor_constants import named_multiples, with_logged_gains
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.recording import BENCH
from motorprior.exceptions import ArtifactError, LogError, listed
from motorprior.identification.evaluation.model_errors import evaluate_replay, log_warnings
from motorprior.identification.prior_file import recipe_of, require_same_robot, trained_on
from motorprior.identification.weak_motors import advice_on_weak_motors
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog
from motorprior.logs.validity import checked
from motorprior.progress import SILENT, WARNED, Progress

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.latents.latent_fit import Posterior
    from motorprior.identification.presets import Preset
    from motorprior.identification.training_data.windows import TrainingData

FALSE_ALARMS = 0.01  # share of logs of the prior's own fleet that the outlier test rejects


@dataclass(frozen=True)
class OutlierTest:
    """Whether the M motors of a log are outliers of the prior's fleet.

    Attributes:
        p_value: (M,) twice the smaller of two p-values, at most 1: that of the fit to its log
            (`reference.loss_p_value`) and that of the distance of its constants (`outliers`).
        reason: (M,) the largest deviation of each outlier; "" of the others.
    """

    p_value: np.ndarray
    reason: tuple[str, ...]


def adapt(prior: MotorPrior, log: MotorLog, *, anyway: bool = False, progress: Progress = WARNED) -> MotorPosterior:
    """Find the motors of a log in a prior's latent space.

    Args:
        prior: of motors of this kind.
        log: with load_inertia and external_torque, at the prior's sample period; a few seconds are enough.
        anyway: also if motors are outliers of the prior.
        progress: receives the motors' errors on the log, and notes on weak and static motors; by default warnings are
            Python warnings.

    Returns:
        The posterior, whose `MotorPosterior.sample` draws these motors.

    Raises:
        LogError: the log lacks a channel, has another period, is shorter than a window, or has outliers.
        ConfigError: the log names another robot than the prior.
        ArtifactError: a prior without latents or without the metrics of its own errors.
    """
    log = checked(log, where=log.source)
    _note_training_log(prior, log, log.source, progress)
    if log.robot != BENCH:
        require_same_robot(prior, log)
    found = adapt_to(prior, "the prior", log, log.source)
    outliers = outlier_test(prior, "the prior", log, log.source, found)
    if not anyway:
        _require_no_outliers(log, outliers, log.source)
    _note_findings(prior, log, found, progress)
    return _posterior(prior, log, found, outliers)


def adapt_to(prior: MotorPrior, path: str | Path, log: MotorLog, where: str) -> Posterior:
    """Posterior of every motor of the log; ``path`` and ``where``, the files of prior and log, are for errors.

    Raises:
        LogError: the log lacks a channel, has another period, or is shorter than a window.
        ArtifactError: a prior without latents or without the metrics of its own errors.
    """
    from motorprior.identification.latents.latent_fit import SAME_JOINT_STD, LatentPrior, fit_posterior

    preset, data, temperature, _ = _prepared(prior, path, log, where)
    std = np.where(np.isin(log.joint_names, prior.joint_names), SAME_JOINT_STD, 1.0)
    expected = LatentPrior(prior.expected(log.joint_names), std)
    return fit_posterior(prior.network, data, preset, temperature, prior=expected)


def outlier_test(prior: MotorPrior, path: str | Path, log: MotorLog, where: str, found: Posterior) -> OutlierTest:
    """Whether the motors that `adapt_to` found in this log are outliers of the prior's fleet; raises as `adapt_to`."""
    from motorprior.identification.evaluation.reference import loss_p_value, num_blocks
    from motorprior.identification.latents.outliers import outliers

    preset, data, temperature, which = _prepared(prior, path, log, where)
    p_fit = loss_p_value(prior.metrics, found.loss, num_blocks(found.windows, preset), which)
    reason, p_value = ["large error on its log"] * len(p_fit), p_fit
    if len(prior.mean) > 1:
        far = outliers(prior.network, prior.mean, found.mean, data, preset, temperature)
        p_value = np.minimum(1.0, 2.0 * np.minimum(p_fit, far.p_value))
        for motor in np.flatnonzero(far.p_value < p_fit):
            reason[motor] = f"{far.latent[motor]} {far.deviation[motor]:+.1f} standard deviations from the fleet's"
    return OutlierTest(p_value, tuple(np.where(p_value < FALSE_ALARMS / len(p_value), reason, "").tolist()))


def _prepared(
    prior: MotorPrior, path: str | Path, log: MotorLog, where: str
) -> tuple[Preset, TrainingData, float, str]:
    """Recipe, data, temperature, and the `reference.metric_suffix` of the metrics of the outlier test."""
    from motorprior.identification.evaluation.reference import has_reference_metrics, metric_suffix
    from motorprior.identification.training_data.windows import training_data, with_window_that_fits

    preset = with_window_that_fits(recipe_of(prior, path), log)
    if prior.network.num_latents == 0 or not has_reference_metrics(prior.metrics, preset.objective == "rollout"):
        raise ArtifactError(
            "it has no latents, or lacks the metrics of its own errors", where=path,
            remedy="identify it with preset rollout",
        )  # fmt: skip
    data = training_data(log, preset, where)
    # A prior that was trained without torques uses positions only, even if the log has torques.
    knows_torque = f"loss_mean{metric_suffix(False)}" in prior.metrics or preset.objective == "torque"
    measured = replace(data.measured, torque=data.measured.torque and knows_torque)
    data = replace(data, measured=measured)
    which = metric_suffix(measured.torque) if knows_torque else ""
    return preset, data, prior.metrics[f"loss_mean{which}"], which


def motor_constants(prior: MotorPrior, log: MotorLog, latents: np.ndarray) -> dict[str, np.ndarray]:
    """(M,) constants by name [SI] of motors (M, Z) at the gains in their log; empty for a network.

    Constants in units of a firmware are multiples with names of their own (`named_multiples`).
    """
    if prior.network.motor is None:
        return {}
    values, gains = prior.network.constants(latents), log.gains
    if prior.network.gain_unit == PHYSICAL_GAINS and gains is not None:
        return with_logged_gains(values, *gains)
    return named_multiples(values) if prior.network.gain_unit else values


def _note_training_log(prior: MotorPrior, log: MotorLog, where: str, progress: Progress) -> None:
    if trained_on(prior, log):
        progress.note(f"warning: the prior was trained on {where}: losses and p-values of its motors are biased")


def _note_findings(prior: MotorPrior, log: MotorLog, found: Posterior, progress: Progress) -> None:
    if progress is SILENT:
        return  # tuning a PD to compare with takes time
    recipe = recipe_of(prior, "the prior")
    for line in log_warnings(log, recipe):
        progress.note(line)
    if prior.network.motor is not None:
        evaluate_replay(LatentActuator(prior.network, found.mean), log, recipe, progress)
    if advice := advice_on_weak_motors(prior, log.joint_names, found.mean):
        progress.note(advice)


def _posterior(prior: MotorPrior, log: MotorLog, found: Posterior, outliers: OutlierTest) -> MotorPosterior:
    outlier_p_value = tuple(float(value) for value in outliers.p_value)
    gains = log.gains if prior.network.gain_unit else None
    return MotorPosterior(prior, found.mean, found.covariance, log.joint_names, log.duration, outlier_p_value, gains)


def _require_no_outliers(log: MotorLog, outliers: OutlierTest, path: str | Path) -> None:
    named = [f"{name}: {reason}" for name, reason in zip(log.joint_names, outliers.reason, strict=True) if reason]
    if named:
        raise LogError(
            f"outliers of the prior's fleet (p < {FALSE_ALARMS / log.num_joints:.2g}): {listed(named, 5)}", where=path,
            remedy="check the log with `motorprior logs check`, train a prior on such motors, or set anyway",
            argument="anyway",
        )  # fmt: skip
