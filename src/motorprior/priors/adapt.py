"""The posterior of z for the motors of a log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.fit_metrics import LossStatistics
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_posterior import MotorPosterior, kp_ratio
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import SIGNED, TERMS
from motorprior.evaluation.errors import evaluate_replay, notes_on_log, replay_errors
from motorprior.evaluation.outliers import Outliers, loss_p_value, outliers
from motorprior.evaluation.training_errors import residual_scale, windows_per_block
from motorprior.exceptions import LogError, listed
from motorprior.identification.latents.latent_fit import LatentPosterior, fit_posterior
from motorprior.identification.presets import Recipe, recipe_of
from motorprior.identification.windows import (
    TrainingData,
    subsampled,
    training_data,
    with_window_that_fits,
)
from motorprior.logs.command_modes import unmeasured_scales
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.operations import moved
from motorprior.priors.fit_prior import MAX_ROWS, trained_on
from motorprior.priors.foreign_torques import foreign_torques
from motorprior.priors.prior_file import require_adaptable
from motorprior.progress import PYTHON_WARNINGS, SILENT, Progress

FALSE_ALARMS = 0.01  # share of logs of the prior's own fleet that the outlier test rejects
# A motor is weak if its kp is below both of two bounds: a share of the central motor's kp [-], and
# a number of prior standard deviations of log(kp) below the mean. A robot is weak if the median of
# its motors is below both bounds for robots. In 2 % of healthy robots, a motor is weak by chance,
# and in 2 % the robot is, for robots of 12 motors that share a third of the variance.
WEAK_MOTOR_SHARE = 0.7
WEAK_ROBOT_SHARE = 0.85
_WEAK_MOTOR_DEVIATIONS = 2.93
_WEAK_ROBOT_DEVIATIONS = 1.33
_OTHER_MOTORS = "the prior is of other motors: fit this log itself with mp.fit_prior (identify)"


@dataclass(frozen=True)
class Outlier:
    """A motor that is an outlier of the prior's fleet."""

    index: int  # joint of the log
    reason: str  # its largest deviation, for the user


def adapt(
    prior: MotorPrior,
    log: MotorLog,
    *,
    allow_outliers: bool = False,
    progress: Progress = PYTHON_WARNINGS,
) -> MotorPosterior:
    """Find the motors of a log in a prior's latent space.

    Args:
        prior: of motors of this kind.
        log: with load_inertia and external_torque, at the prior's sample period; a few seconds are
            enough, and of a long log two minutes per motor are used, as in `fit_prior`.
        allow_outliers: whether to adapt even if motors are outliers of the prior.
        progress: receives the motors' errors on the log, foreign torques, and notes on weak and
            static motors; by default warnings are Python warnings.

    Returns:
        The posterior, whose `MotorPosterior.sample` draws these motors.

    Raises:
        LogError: the log lacks a channel, has another period, is shorter than a window, or has
            outliers.
        ConfigError: the log names another robot than the prior.
        ArtifactError: a prior without latents, or of another version.
    """
    log = checked(log)
    require_adaptable(prior, log)
    note_training_log(prior, log, progress)
    note_command_mode(prior, log, progress)

    with progress.start(f"adapt to {log.num_joints} motors, {log.duration:.1f} s", 1) as task:
        posterior = adapt_to(prior, log, progress)
        p_values, outlying_motors = outlier_test(prior, log, posterior)
        task.advance()

    _report_outliers(log, outlying_motors, allow_outliers, progress)
    if progress is not SILENT:  # tuning a PD to compare with takes time
        _report_fit(prior, log, posterior, progress)

    return MotorPosterior(
        prior,
        posterior.mean,
        posterior.covariance,
        log.joint_names,
        log.duration,
        tuple(p_values.tolist()),
        _gains(prior, log),
    )


def _gains(prior: MotorPrior, log: MotorLog) -> np.ndarray | None:
    """(2, J) gains of the motors of a log; those of the prior if torques were commanded."""
    if not prior.model.gain_unit or log.gains is not None:
        return log.gains if prior.model.gain_unit else None
    return prior.sampled_gains(prior.joint_classes(log))


def _report_outliers(
    log: MotorLog, outlying_motors: Sequence[Outlier], allow_outliers: bool, progress: Progress
) -> None:
    """Warn about outliers, with the reason of each; LogError unless they are allowed."""
    if not outlying_motors:
        return
    level = FALSE_ALARMS / log.num_joints
    texts = [f"{log.joint_names[motor.index]}: {motor.reason}" for motor in outlying_motors]
    problem = f"outliers of the prior's fleet (p < {level:.2g}): {listed(texts, 5)}"
    if not allow_outliers:
        remedy = (
            "check the log with `motorprior logs check`, train a prior on such motors, or set "
            "allow_outliers"
        )
        raise LogError(problem, where=log.source, argument="allow_outliers", remedy=remedy)
    progress.warn(problem)


def _report_fit(
    prior: MotorPrior, log: MotorLog, posterior: LatentPosterior, progress: Progress
) -> None:
    """Report doubts about the log, the motors' errors on it, and weak motors."""
    recipe = recipe_of(prior)
    for note in notes_on_log(log, recipe):
        progress.report(note)
    if isinstance(prior.model, GreyBox):
        motors = prior.model.motors(posterior.mean)
        evaluate_replay(motors, None, log, recipe, progress, _OTHER_MOTORS)
    advice = advice_on_weak_motors(prior, log.joint_names, posterior.mean)
    if advice:
        progress.note(advice)


def adapt_to(prior: MotorPrior, log: MotorLog, progress: Progress = SILENT) -> LatentPosterior:
    """Posterior of every motor of the log.

    A motor that did not move keeps its prior, and so does one on which a foreign torque acts, which
    is reported (`foreign_torques`): `LatentPosterior.keeps_prior`. The loss is that of the adapted
    motor. Raises `LogError` as `adapt`.
    """
    recipe, data, losses = _recipe_data_and_losses(prior, log)
    predicted = prior.predicted(log)
    mean, std, predicted_misfit = predicted
    posterior = fit_posterior(prior.model, data, recipe, losses.mean, prior=(mean, std))

    keeps_prior = ~moved(log)
    if isinstance(prior.model, GreyBox):
        for torque in foreign_torques(prior, log, data, recipe, posterior, predicted, losses.mean):
            keeps_prior[torque.index] = True
            progress.warn(torque.text(log.joint_names[torque.index]))
    prior_variance = std[keeps_prior, :, None] ** 2
    posterior.mean[keeps_prior] = mean[keeps_prior]
    posterior.covariance[keeps_prior] = prior_variance * np.eye(mean.shape[1])
    posterior = replace(posterior, keeps_prior=keeps_prior)
    if not isinstance(prior.model, GreyBox):
        return posterior

    motors = prior.model.motors(posterior.mean)
    errors, velocity = replay_errors(motors, log, recipe_of(prior).nominal_conditions)
    residual_scales = residual_scale(prior.metrics.residuals, errors, velocity)
    return replace(posterior, misfit=np.where(keeps_prior, predicted_misfit, residual_scales))


def outlier_test(
    prior: MotorPrior, log: MotorLog, posterior: LatentPosterior
) -> tuple[np.ndarray, list[Outlier]]:
    """Test whether the M motors of a log, after `adapt_to`, are outliers of the prior's fleet.

    Returns:
        The p-values (M,), and the outliers. The p-value combines two tests, of the fit to the log
        (`outliers.loss_p_value`) and of the constants (`outliers.outliers`): it is twice the
        smaller p-value of the two, at most 1. It is 1 for a motor that keeps its prior.
    """
    recipe, data, losses = _recipe_data_and_losses(prior, log)
    blocks = posterior.windows / windows_per_block(recipe)
    fit_p_value = loss_p_value(losses, posterior.loss, blocks)
    reasons = ["large error on its log"] * len(fit_p_value)
    p_value = fit_p_value

    # a distance from a class needs a variance, and so at least one class with two training motors
    if len(prior.mean) > len(prior.classes.names):
        joint_classes = prior.joint_classes(log)
        tested = outliers(prior, posterior.mean, data, recipe, losses.mean, joint_classes)
        # the distance from a class that was never recorded is unknown
        has_one_class = len(prior.classes.names) == 1
        is_recorded = np.isin(joint_classes, prior.classes.names) | has_one_class
        distance_p_value = np.where(is_recorded, tested.p_value, 1.0)

        p_value = np.minimum(1.0, 2.0 * np.minimum(fit_p_value, distance_p_value))
        for motor in np.flatnonzero(distance_p_value < fit_p_value):
            reasons[motor] = _distance_text(joint_classes[motor], tested, int(motor))

    p_value = np.where(posterior.keeps_prior, 1.0, p_value)
    outlying_motors = []
    for motor in np.flatnonzero(p_value < FALSE_ALARMS / len(p_value)):
        outlying_motors.append(Outlier(int(motor), reasons[motor]))
    return p_value, outlying_motors


def _distance_text(joint_class: str, tested: Outliers, motor: int) -> str:
    """For example "coulomb 2.1 times that of the class calf (+5.3 standard deviations)"."""
    constant = tested.latent[motor]
    population = f"the class {joint_class}" if joint_class else "the fleet"
    distance = float(tested.distance[motor])

    is_factor = constant in parameters_of(tuple(TERMS)) and constant not in SIGNED
    text = f"far from that of {population}"
    if is_factor:
        text = f"{np.exp(distance):.2g} times that of {population}"
    return f"{constant} {text} ({tested.deviation[motor]:+.1f} standard deviations)"


def _recipe_data_and_losses(
    prior: MotorPrior, log: MotorLog
) -> tuple[Recipe, TrainingData, LossStatistics]:
    """Recipe and data of an adaptation, and the losses of the training motors on such data."""
    recipe = with_window_that_fits(recipe_of(prior), log)
    data = training_data(log, recipe, log.source)
    if recipe.grey_boxes:
        data = subsampled(data, recipe, MAX_ROWS)

    # A prior that was trained without torques uses positions only, even if the log has torques.
    was_torque_used = (
        prior.metrics.losses_without_torque is not None or recipe.objective == "torque"
    )
    data = replace(data, has_torque=data.has_torque and was_torque_used)

    # a prior without torques has a single set of losses, which counts as the one with torques
    uses_main_losses = data.has_torque or not was_torque_used
    losses = prior.metrics.losses_for(has_torque=uses_main_losses)
    return recipe, data, losses


def note_training_log(prior: MotorPrior, log: MotorLog, progress: Progress) -> None:
    """Warn if the prior was trained on this log."""
    if trained_on(prior, log):
        text = "errors, losses and p-values on it do not validate the prior"
        progress.warn(f"the prior was trained on {log.source}: {text}")


def note_command_mode(prior: MotorPrior, log: MotorLog, progress: Progress) -> None:
    """Warn if the prior was trained in another command mode than that of the log."""
    if prior.command_mode == log.command_mode:
        return
    unmeasured = unmeasured_scales(prior.command_mode, log.command_mode)
    if unmeasured:
        progress.warn(
            f"{log.source} has {log.command_mode} commands, the prior's logs "
            f"{prior.command_mode} commands: friction, armature and delay carry over, the scale of "
            f"{unmeasured} does not -> log commands of both modes"
        )


def advice_on_weak_motors(prior: MotorPrior, names: tuple[str, ...], latents: np.ndarray) -> str:
    """Advice if some of the motors (M, Z) have a much smaller kp than the prior's central motor.

    Otherwise "".
    """
    if not isinstance(prior.model, GreyBox):
        return ""
    central_latents, _ = prior.classes.mean_and_std(prior.joint_classes(names))
    share = kp_ratio(prior.model, latents, central_latents)
    motor_bound, robot_bound = weak_below(prior.model)

    # the advice names the weak motors; of a weak robot, every motor below the central motor
    is_weak_robot = np.median(share) < robot_bound
    bound = 1.0 if is_weak_robot else motor_bound
    weak = np.flatnonzero(share < bound)
    if not weak.size:
        return ""
    motors = listed([f"{names[motor]} {share[motor]:.2f}" for motor in weak], 10)
    return (
        f"weak motors, as shares of the central motor's kp: {motors}. If they give less torque per "
        "ampere, their torque limits are also lower, which in-air logs barely identify -> train on "
        "this posterior with limit_follows_gain"
    )


def weak_below(model: GreyBox) -> tuple[float, float]:
    """Bounds of the kp of a weak motor, and of the median kp of a weak robot [-].

    They are shares of the kp of the central motor.
    """
    samples = np.random.default_rng(0).standard_normal((1000, model.num_latents))
    deviation = float(np.std(np.log(kp_ratio(model, samples))))
    motor_bound = float(np.exp(-_WEAK_MOTOR_DEVIATIONS * deviation))
    robot_bound = float(np.exp(-_WEAK_ROBOT_DEVIATIONS * deviation))
    return min(WEAK_MOTOR_SHARE, motor_bound), min(WEAK_ROBOT_SHARE, robot_bound)
