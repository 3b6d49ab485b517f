"""The posterior of z for the motors of a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from motorprior.actuator.geared_motor_constants import named_multiples, with_logged_gains
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.recording import BENCH
from motorprior.bounds import require_number
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog, stated_gains_of
from motorprior.logs.validity import checked
from motorprior.pipeline.fit_report import other_conditions, told_at_rest, told_quality
from motorprior.pipeline.prior_file import prior_and_robot, require_robot_of, trained_on
from motorprior.pipeline.progress import SILENT, WARNED, Progress
from motorprior.pipeline.recipe import recipe_of
from motorprior.pipeline.stage import description, is_finished, locked, working
from motorprior.pipeline.weak_motors import advice_on_weak_motors

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.latents.grey_box_fit import LatentPrior
    from motorprior.identification.latents.latent_fit import Posterior
    from motorprior.identification.presets import Preset
    from motorprior.identification.training_data.windows import TrainingData

POSTERIOR = "posterior.safetensors"
_ODD_NAMED = 5
"""Most motors unlike the fleet that an error names, which is one line; the command's table has all."""
FALSE_ALARMS = 0.01
"""About this share of the logs of the prior's own fleet is called unlike it, however many motors a log has."""


@dataclass(frozen=True)
class Adapt:
    """Find where in the prior's latent space the motors of a log are."""

    prior: Path
    """Prior that `motorprior identify` wrote."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period."""
    out: Path
    """Folder for posterior.safetensors."""
    seconds: float | None = None
    """Use the first seconds of the log only [s]; all of it if not given."""
    anyway: bool = False
    """Write the posterior even if the log is unlike anything the prior knows."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). If none is given, the prior
    must be of the robot that the log names."""


Show: TypeAlias = "Callable[[MotorLog, Posterior, OutlierTest, dict[str, np.ndarray]], None]"


def first_seconds(log: MotorLog, seconds: float | None) -> MotorLog:
    """The first rows of a log; a last segment cut to a single row is left out."""
    if seconds is None:
        return log
    period = float(np.median(np.diff(log.time)))
    kept = log.rows(slice(0, max(2, round(seconds / period))))
    last = kept.segment_slices()[-1]
    return kept.rows(slice(0, last.start)) if last.stop - last.start < 2 else kept


def first_and_rest(log: MotorLog, seconds: float) -> tuple[MotorLog, MotorLog]:
    """`first_seconds`, and what follows; of a segment of which a single row is left there, nothing.

    Raises:
        ConfigError: nothing would be left.
    """
    require_number("seconds", seconds, 0.0, log.duration)
    first = first_seconds(log, seconds)
    rest = log.rows(slice(first.num_rows, None))
    starts = [part.start for part in rest.segment_slices() if part.stop - part.start > 1]
    if not starts:
        problem = f"seconds {seconds:g}: nothing is left of {log.duration:.4g} s of log"
        raise ConfigError(problem, where=log.source, remedy="give fewer seconds", argument="seconds")
    return first, rest.rows(slice(starts[0], None))


@dataclass(frozen=True)
class OutlierTest:
    """Whether the M motors of a log are like those of the prior's fleet.

    Attributes:
        p_value: (M,) twice the smaller of two p-values, at most 1: that of the fit of its log
            (`reference.loss_p_value`) and that of the distance of its constants (`outliers`).
        reason: (M,) what deviates most of a motor that is called unlike the fleet; "" of the others.
    """

    p_value: np.ndarray
    reason: tuple[str, ...]


def adapt_to(prior: MotorPrior, path: str | Path, log: MotorLog, where: str) -> Posterior:
    """Posterior of every motor of the log.

    Raises:
        LogError: the log lacks a channel, has another period, or is shorter than a window.
        ArtifactError: a prior without latents or without the figures of its own errors.
    """
    from motorprior.identification.latents.latent_fit import adapt as fit_posterior

    preset, data, temperature, _ = _prepared(prior, path, log, where)
    return fit_posterior(prior.network, data, preset, temperature, prior=_prior_of(prior, log))


def _prior_of(prior: MotorPrior, log: MotorLog) -> LatentPrior:
    from motorprior.identification.latents.grey_box_fit import SAME_JOINT_STD, LatentPrior

    known = prior.has_names(log.joint_names)
    return LatentPrior(prior.expected(log.joint_names), np.where(known, SAME_JOINT_STD, 1.0))


def outlier_test(prior: MotorPrior, path: str | Path, log: MotorLog, where: str, found: Posterior) -> OutlierTest:
    """Whether the motors that `adapt_to` ``found`` in this log are like those that the prior was trained on.

    Raises:
        LogError, ArtifactError: see `adapt_to`.
    """
    from motorprior.identification.judging.reference import loss_p_value, num_blocks
    from motorprior.identification.latents.outliers import outliers

    preset, data, temperature, which = _prepared(prior, path, log, where)
    badly = loss_p_value(prior.metrics, found.loss, num_blocks(found.windows, preset), which)
    reason, p_value = ["it fits its log badly"] * len(badly), badly
    if len(prior.mean) > 1:
        far = outliers(prior.network, prior.mean, found.mean, data, preset, temperature)
        p_value = np.minimum(1.0, 2.0 * np.minimum(badly, far.p_value))
        for motor in np.flatnonzero(far.p_value < badly):
            reason[motor] = f"its {far.latent[motor]} is {far.deviation[motor]:+.1f} deviations from theirs"
    odd = p_value < _bound(len(badly))
    return OutlierTest(p_value, tuple(text if is_odd else "" for text, is_odd in zip(reason, odd, strict=True)))


def _bound(motors: int) -> float:
    """p-value below which one of so many motors is called unlike the fleet [-]."""
    return FALSE_ALARMS / motors


def _prepared(
    prior: MotorPrior, path: str | Path, log: MotorLog, where: str
) -> tuple[Preset, TrainingData, float, str]:
    """Recipe, data, temperature, and the `reference.ending` of the metrics of its outlier test."""
    from motorprior.identification.judging.reference import ending, has_reference_metrics
    from motorprior.identification.training_data.windows import training_data, with_window_that_fits

    preset = with_window_that_fits(recipe_of(prior, path), log)
    if prior.network.num_latents == 0 or not has_reference_metrics(prior.metrics, preset.objective == "rollout"):
        raise ArtifactError(
            "it has no latents, or does not know its own errors", where=path, remedy="identify it with preset rollout"
        )
    data = training_data(log, preset, where)
    # A prior that never saw torques judges by positions, whatever the log has.
    knows_torque = f"loss_mean{ending(False)}" in prior.metrics or preset.objective == "torque"
    measured = replace(data.measured, torque=data.measured.torque and knows_torque)
    data = replace(data, measured=measured)
    which = ending(measured.torque) if knows_torque else ""
    return preset, data, prior.metrics[f"loss_mean{which}"], which


def adapt(prior: MotorPrior, log: MotorLog, *, anyway: bool = False, progress: Progress = WARNED) -> MotorPosterior:
    """Find where in a prior's latent space the motors of a log are.

    Args:
        prior: of such motors.
        log: with load_inertia and external_torque, at the prior's sample period; seconds are enough.
        anyway: also if the log is unlike anything that the prior knows.
        progress: where the motors' errors on the log are told, weak motors, motors at rest, and what to do about it;
            without one, warnings are Python's.

    Returns:
        The posterior, whose `MotorPosterior.sample` draws these very motors.

    Raises:
        LogError: the log lacks a channel, has another period, is shorter than a window, or is unlike the prior's fleet.
        ConfigError: the log names another robot than the prior.
        ArtifactError: a prior without latents or without the figures of its own errors.
    """
    log = checked(log, where=log.source)
    _note_known(prior, log, log.source, progress)
    if log.robot != BENCH:
        require_robot_of(prior, log)
    found = adapt_to(prior, "the prior", log, log.source)
    outliers = outlier_test(prior, "the prior", log, log.source, found)
    if not anyway:
        _require_like_the_fleet(log, outliers, log.source)
    _tell(prior, log, found, progress)
    return _posterior(prior, log, found, outliers)


def run_adapt(
    config: Adapt,
    progress: Progress = SILENT,
    show: Show = lambda log, found, outliers, constants: None,
) -> None:
    """Adapt, unless the folder holds this very posterior already.

    Args:
        config: settings.
        progress: where to report to.
        show: called with what was found, before a log unlike the fleet is refused; the constants are those of the
            posterior means, (M,) each, if the prior knows any.

    Raises:
        LogError: the log does not fit, or is unlike anything the prior knows and ``anyway`` is not set.
        ArtifactError: another command writes to the folder.
    """
    started = time.monotonic()
    if config.seconds is not None:
        require_number("seconds", config.seconds)
    whole = read_parquet(config.log)
    log = first_seconds(whole, config.seconds)
    prior, robot = prior_and_robot(config.prior, log, config.robot)
    wanted = description("adapt", asdict(config), [config.prior, config.log, *(robot.files if robot else ())])
    _note_known(prior, whole, str(config.log), progress)
    if is_finished(config.out, wanted):
        progress.note(f"{config.out / POSTERIOR} is there already, of the same log and settings")
        return
    with locked(config.out):  # long before it is written to: a log that is refused leaves what is there
        with progress.start(f"adapt to {log.num_joints} motors, {log.duration:.1f} s", 1) as task:
            found = adapt_to(prior, config.prior, log, str(config.log))
            outliers = outlier_test(prior, config.prior, log, str(config.log), found)
            task.advance()
        show(log, found, outliers, motor_constants(prior, log, found.mean))
        if not config.anyway:
            _require_like_the_fleet(log, outliers, config.log)
        with working(config.out, wanted, started):
            _posterior(prior, log, found, outliers).save(config.out / POSTERIOR)
    _tell(prior, log, found, progress)


def _tell(prior: MotorPrior, log: MotorLog, found: Posterior, progress: Progress) -> None:
    """What a user should know of the motors that were found; nothing is worked out for nobody."""
    if progress is SILENT:
        return
    recipe = recipe_of(prior, "the prior")
    for line in filter(None, (told_at_rest(log), *other_conditions(recipe, log))):
        progress.note(line)
    if prior.network.motor is not None:
        motors = LatentActuator(prior.network, found.mean)
        told_quality(motors, log, recipe, progress, of_the_log=False)
    if advice := advice_on_weak_motors(prior, log.joint_names, found.mean):
        progress.note(advice)


def motor_constants(prior: MotorPrior, log: MotorLog, latents: np.ndarray) -> dict[str, np.ndarray]:
    """(M,) constants by name [SI] of motors (M, Z) at the gains that the log of them states; none of a network.

    Where these are in units of a firmware, the multiples of them have names of their own (`named_multiples`).
    """
    if prior.network.motor is None:
        return {}
    values, gains = prior.network.constants(latents), stated_gains_of(log)
    if prior.network.gain_unit == PHYSICAL_GAINS and gains is not None:
        return with_logged_gains(values, *gains)
    return named_multiples(values) if prior.network.gain_unit else values


def _note_known(prior: MotorPrior, log: MotorLog, where: str, progress: Progress) -> None:
    if trained_on(prior, log):
        progress.note(f"warning: the prior was trained on {where}: losses and p-values of its motors are no test")


def _posterior(prior: MotorPrior, log: MotorLog, found: Posterior, outliers: OutlierTest) -> MotorPosterior:
    surprise = tuple(float(value) for value in outliers.p_value)
    gains = stated_gains_of(log) if prior.network.gain_unit else None
    return MotorPosterior(prior, found.mean, found.covariance, log.joint_names, log.duration, surprise, gains)


def _require_like_the_fleet(log: MotorLog, outliers: OutlierTest, path: str | Path) -> None:
    bound = _bound(log.num_joints)
    odd = zip(log.joint_names, outliers.p_value, outliers.reason, strict=True)
    unlike = [f"{name}: {reason}" for name, p_value, reason in odd if p_value < bound]
    if unlike:
        more = [f"and {len(unlike) - _ODD_NAMED} more"] if len(unlike) > _ODD_NAMED else []
        shown = "; ".join([*unlike[:_ODD_NAMED], *more])
        raise LogError(
            f"motors are unlike any the prior was trained on (p-values below {bound:.2g}, as one log in "
            f"{1 / FALSE_ALARMS:.0f} of its fleet has): {shown}",
            where=path,
            remedy="check the log with `motorprior logs check`, train a prior on such motors, or set anyway",
            argument="anyway",
        )
