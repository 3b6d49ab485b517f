"""The posterior of z for the motors of a log."""

from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_posterior import MotorPosterior, kp_ratio
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import SIGNED, TERMS
from motorprior.evaluation.errors import evaluate_replay, notes_on_log, replay_errors
from motorprior.evaluation.outliers import Outliers, loss_p_value, outliers
from motorprior.evaluation.reference import WITHOUT_TORQUE, residual_scale, windows_per_block
from motorprior.exceptions import LogError, listed
from motorprior.identification.latents.latent_fit import LatentPosterior, fit_posterior
from motorprior.identification.presets import Recipe, recipe_of
from motorprior.identification.windows import TrainingData, training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.operations import moved
from motorprior.priors.fit_prior import trained_on
from motorprior.priors.prior_file import require_adaptable
from motorprior.progress import SILENT, WARNED, Progress

FALSE_ALARMS = 0.01  # share of logs of the prior's own fleet that the outlier test rejects
# A motor is weak if its kp is below this share of the central motor's [-] and its log(kp) so many
# prior standard deviations below the mean. A robot is weak if the median of its motors is. Either
# happens by chance in 2 % of healthy robots of 12 motors that share a third of the variance.
WEAK_MOTOR = 0.7
WEAK_ROBOT = 0.85
_FAR_MOTOR = 2.93
_FAR_ROBOT = 1.33


def adapt(
    prior: MotorPrior,
    log: MotorLog,
    *,
    allow_outliers: bool = False,
    progress: Progress = WARNED,
) -> MotorPosterior:
    """Find the motors of a log in a prior's latent space.

    Args:
        prior: of motors of this kind.
        log: with load_inertia and external_torque, at the prior's sample period; a few seconds are
            enough.
        allow_outliers: also if motors are outliers of the prior.
        progress: receives the motors' errors on the log, and notes on weak and static motors; by
            default warnings are Python warnings.

    Returns:
        The posterior, whose `MotorPosterior.sample` draws these motors.

    Raises:
        LogError: the log lacks a channel, has another period, is shorter than a window, or has
            outliers.
        ConfigError: the log names another robot than the prior.
        ArtifactError: a prior without latents, or of another version.
    """
    log = checked(log, where=log.source)
    require_adaptable(prior, log)
    note_training_log(prior, log, progress)
    with progress.start(f"adapt to {log.num_joints} motors, {log.duration:.1f} s", 1) as task:
        found = adapt_to(prior, log)
        p_values, reasons = outlier_test(prior, log, found)
        task.advance()
    if named := [
        f"{name}: {reason}" for name, reason in zip(log.joint_names, reasons, strict=True) if reason
    ]:
        problem = f"outliers of the prior's fleet (p < {FALSE_ALARMS / log.num_joints:.2g}): {listed(named, 5)}"
        if not allow_outliers:
            remedy = "check the log with `motorprior logs check`, train a prior on such motors, or set allow_outliers"
            raise LogError(problem, where=log.source, argument="allow_outliers", remedy=remedy)
        progress.warn(problem)
    if progress is not SILENT:  # tuning a PD to compare with takes time
        recipe = recipe_of(prior)
        for note in notes_on_log(log, recipe):
            progress.report(note)
        if isinstance(prior.model, GreyBox):
            evaluate_replay(prior.model.motors(found.mean), None, log, recipe, progress)
        if advice := advice_on_weak_motors(prior, log.joint_names, found.mean):
            progress.note(advice)
    gains = log.gains if prior.model.gain_unit else None
    p_value = tuple(p_values.tolist())
    return MotorPosterior(
        prior, found.mean, found.covariance, log.joint_names, log.duration, p_value, gains
    )


def adapt_to(prior: MotorPrior, log: MotorLog) -> LatentPosterior:
    """Posterior of every motor of the log; that of one that did not move is the prior. Raises `LogError` as `adapt`."""
    preset, data, temperature, _ = _prepared(prior, log)
    mean, std, misfit = prior.predicted(log)
    found = fit_posterior(prior.model, data, preset, temperature, prior=(mean, std))
    still = ~moved(log)
    found.mean[still] = mean[still]
    found.covariance[still] = std[still, :, None] ** 2 * np.eye(mean.shape[1])
    if not isinstance(prior.model, GreyBox):
        return found
    motors = prior.model.motors(found.mean)
    nominal = recipe_of(prior).nominal_conditions
    own = residual_scale(prior.metrics, *replay_errors(motors, log, nominal))
    return replace(found, misfit=np.where(still, misfit, own))


def outlier_test(
    prior: MotorPrior, log: MotorLog, found: LatentPosterior
) -> tuple[np.ndarray, list[str]]:
    """Whether the M motors that `adapt_to` found in this log are outliers of the prior's fleet.

    Returns (M,) p-values, min(1, 2·min p) of the fit to the log (`outliers.loss_p_value`) and of
    the constants (`outliers.outliers`), and the largest deviation of each outlier, "" of the
    others.
    """
    preset, data, temperature, which = _prepared(prior, log)
    p_fit = loss_p_value(
        prior.metrics, found.loss, found.windows / windows_per_block(preset), which
    )
    reason = ["large error on its log"] * len(p_fit)
    p_value = p_fit
    if len(prior.mean) > len(prior.classes.names):
        classes = prior.joint_classes(log)
        far = outliers(
            prior.model, prior.mean, found.mean, data, preset, temperature, prior.classes, classes
        )
        # the distance of a class that was never recorded is unknown
        is_known = np.isin(classes, prior.classes.names) | (len(prior.classes.names) == 1)
        far = replace(far, p_value=np.where(is_known, far.p_value, 1.0))
        p_value = np.where(moved(log), np.minimum(1.0, 2.0 * np.minimum(p_fit, far.p_value)), 1.0)
        for motor in np.flatnonzero(far.p_value < p_fit):
            reason[motor] = _distance_text(classes[motor], far, int(motor))
    return p_value, np.where(p_value < FALSE_ALARMS / len(p_value), reason, "").tolist()


def _distance_text(joint_class: str, far: Outliers, motor: int) -> str:
    """For example "coulomb 2.1 times that of the class calf (+5.3 standard deviations)"."""
    name = far.latent[motor]
    of = f"the class {joint_class}" if joint_class else "the fleet"
    is_factor = name in parameters_of(tuple(TERMS)) and name not in SIGNED
    distance = float(far.distance[motor])
    text = f"{np.exp(distance):.2g} times that of {of}" if is_factor else f"far from that of {of}"
    return f"{name} {text} ({far.deviation[motor]:+.1f} standard deviations)"


def _prepared(prior: MotorPrior, log: MotorLog) -> tuple[Recipe, TrainingData, float, str]:
    """Recipe, data, temperature, and suffix of the names of the metrics for the outlier test."""
    preset = with_window_that_fits(recipe_of(prior), log)
    data = training_data(log, preset, log.source)
    # A prior that was trained without torques uses positions only, even if the log has torques.
    knows_torque = f"loss_mean{WITHOUT_TORQUE}" in prior.metrics or preset.objective == "torque"
    data = replace(data, has_torque=data.has_torque and knows_torque)
    which = WITHOUT_TORQUE if knows_torque and not data.has_torque else ""
    return preset, data, prior.metrics[f"loss_mean{which}"], which


def note_training_log(prior: MotorPrior, log: MotorLog, progress: Progress) -> None:
    """A warning if the prior was trained on this log."""
    if trained_on(prior, log):
        text = "errors, losses and p-values on it do not validate the prior"
        progress.warn(f"the prior was trained on {log.source}: {text}")


def advice_on_weak_motors(prior: MotorPrior, names: tuple[str, ...], latents: np.ndarray) -> str:
    """Advice if some of the motors (M, Z) have a much smaller kp than the prior's central motor, else ""."""
    if not isinstance(prior.model, GreyBox):
        return ""
    central = prior.classes.mean_and_std(prior.joint_classes(names))[0]
    share, (motor_bound, robot_bound) = (
        kp_ratio(prior.model, latents, central),
        weak_below(prior.model),
    )
    weak = np.flatnonzero(share < (1.0 if np.median(share) < robot_bound else motor_bound))
    if not weak.size:
        return ""
    named = listed([f"{names[motor]} {share[motor]:.2f}" for motor in weak], 10)
    return (
        f"weak motors, as shares of the central motor's kp: {named}. If they give less torque per ampere, their torque "
        "limits are also lower, which in-air logs barely identify -> train on this posterior with limit_follows_gain"
    )


def weak_below(model: GreyBox) -> tuple[float, float]:
    """Shares of the central motor's kp below which a motor, and the median of a robot's motors, is weak [-]."""
    samples = np.random.default_rng(0).standard_normal((1000, model.num_latents))
    deviation = float(np.std(np.log(kp_ratio(model, samples))))
    bounds = np.exp(-_FAR_MOTOR * deviation), np.exp(-_FAR_ROBOT * deviation)
    return min(WEAK_MOTOR, float(bounds[0])), min(WEAK_ROBOT, float(bounds[1]))
