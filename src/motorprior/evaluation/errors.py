"""Errors of motor models on logs, and the warnings that follow from them.

All models simulate the joints from recorded commands and loads, without feedback from the recorded
motion. Errors are differences between simulated and recorded angles; no mean is removed. Noisy
recorded angles are smoothed before (`smoothing`). Free runs give simulated minus recorded angles,
and replays give recorded minus simulated angles.

    free run    runs over 1 s, or over a whole segment after the warm-up at its beginning. The joint
                starts in the recorded state. The hidden state of the motor comes from a second
                simulation, which follows the recording up to the start (`window_runs`).
    replay      runs from the first row of a segment, with a static rotor (`dynamometer.run`)
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from textwrap import shorten

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import GainScaledPd
from motorprior.actuator.optional_terms import OperatingConditions
from motorprior.bench.dynamometer import run, trial_of
from motorprior.exceptions import listed
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.physics.term_selection import TERM_OF, min_condition_difference
from motorprior.identification.physics.window_runs import TorqueMotors
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import relative_operating_conditions, seconds_since_cold
from motorprior.logs.command_modes import reference_gains
from motorprior.logs.motor_log import MotorLog, operating_condition_text
from motorprior.logs.operations import static_joints
from motorprior.progress import Note, Progress
from motorprior.signals import rms

PRIOR = "prior"
TUNED_PD = "tuned_pd"
PER_MOTOR = "per_motor"
SIMPLER_MODELS = (
    "ideal_pd",
    TUNED_PD,
    "pure_delay",
    "second_order",
    "servo_limits",
    "coulomb_viscous",
    "stribeck",
    PER_MOTOR,
)
PREFER_IT = "prefer it there"  # remedy for a model with larger errors than a simpler one
MAX_UNEXPLAINED = 0.35  # share of the tuned PD's error above which samples of a prior vary more
MIN_ADVANTAGE = 0.1  # share by which the error of a simpler model must be smaller
# error [rad] that no model can explain; an encoder of 12 bits resolves 1.5 mrad
ENCODER_ERROR = 0.002
# maximum error [rad]: a simulation with a larger error, or an error that is not finite, diverged
MAX_ERROR = math.tau
_MAX_SEGMENTS = 20  # maximum number of segments of a replay
# quantities of the quick report: errors of free runs of whole segments and of 1 s
WHOLE_RUN_RMSE = "real_motors_rmse"
FREE_RUN_RMSE = "real_motors_free_run_rmse"


def capped(errors: np.ndarray, limit: np.ndarray | float = MAX_ERROR) -> np.ndarray:
    """The errors, at most ``limit``, which is also the error of a simulation that diverged."""
    return np.minimum(np.where(np.isnan(errors), limit, errors), limit)


def summary(errors: Mapping[str, float]) -> tuple[str, str, str]:
    """Median, mean and maximum of errors [rad] as texts [mrad]; the maximum with its name."""
    values = np.array(list(errors.values()))
    name_of_maximum = list(errors)[int(values.argmax())]
    maximum = _milli(np.max(values))
    return _milli(np.median(values)), _milli(np.mean(values)), f"{maximum} ({name_of_maximum})"


def _milli(error: np.floating) -> str:
    """An error [rad] in mrad."""
    return f"{1e3 * error:.1f}" if error < MAX_ERROR else "diverged"


def replay_errors(
    motors: TorqueMotors, log: MotorLog, nominal: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Replay at most _MAX_SEGMENTS segments of a log with known loads.

    The motors have the gains and the operating conditions of each segment; ``nominal`` are the
    operating conditions of their recipe.

    Returns:
        Recorded minus simulated angles [rad], both at the side of the gear where the encoder is,
        and velocities of the simulated joints [rad/s], each (steps of all segments, M).
    """
    segments = log.segment_slices()
    seconds = seconds_since_cold(log)
    count = min(_MAX_SEGMENTS, len(segments))
    replayed = np.linspace(0, len(segments) - 1, count).round().astype(int)

    errors = []
    velocities = []
    for index in replayed:
        rows = segments[index]
        segment = log.rows(rows)
        median_seconds = float(np.median(seconds[rows]))
        actuator = _at_segment(motors, segment, nominal, median_seconds)
        response = run(actuator, trial_of(segment))
        simulated = response.encoder_pos if log.encoder == "rotor" else response.joint_pos
        errors.append(segment.joint_pos - simulated)
        velocities.append(response.joint_vel)
    return np.concatenate(errors), np.concatenate(velocities)


def _at_segment(
    motors: TorqueMotors, segment: MotorLog, nominal: Mapping[str, float], seconds: float
) -> Actuator:
    """The motors at the gains and operating conditions of a segment.

    The segment was recorded ``seconds`` after a cold start.
    """
    gains = segment.gains
    if isinstance(motors, GainScaledPd):
        if gains is None:
            return motors.pd
        return motors.at(gains)
    if not isinstance(motors, GreyBoxActuator):
        return motors

    warmth = motors.model.warmth(motors.z, seconds)
    supply, temperature_rise = relative_operating_conditions(segment, nominal)
    operating_conditions = OperatingConditions(warmth, supply, temperature_rise)
    if segment.command_mode == "torque":
        gains = reference_gains(segment)
    if not motors.model.gain_unit:
        gains = motors.gains
    return replace(motors, operating_conditions=operating_conditions, gains=gains)


@dataclass(frozen=True)
class LogErrors:
    """Root mean square errors of simulated angles [rad]."""

    logs: tuple[str, ...]  # L names
    joints: tuple[str, ...]  # J names
    models: dict[str, np.ndarray]  # (L, J) by model; NaN where a joint is not excited

    def unexplained(self, model: str) -> np.ndarray:
        """(J,) √(max(e² - ENCODER_ERROR², 0)) / e_PD with the mean errors e over the logs [-]."""
        error = self._mean_over_logs(model)
        pd_error = self._mean_over_logs(TUNED_PD)
        unexplained_error = np.sqrt(np.maximum(error**2 - ENCODER_ERROR**2, 0.0))
        return unexplained_error / np.maximum(pd_error, 1e-9)

    def _mean_over_logs(self, model: str) -> np.ndarray:
        """(J,) mean error [rad]; NaN for joints that are not excited in any log."""
        errors = self.models[model]
        with np.errstate(invalid="ignore"):
            return np.nansum(errors, axis=0) / np.isfinite(errors).sum(axis=0)

    def warnings(self, model: str, remedy: str = PREFER_IT) -> list[str]:
        """Warnings that simpler models have errors that are smaller by more than MIN_ADVANTAGE."""
        mean = {name: 1e3 * float(np.nanmean(values)) for name, values in self.models.items()}
        logs = shorten(", ".join(self.logs), 200, placeholder=" …")
        warnings = []
        for name in SIMPLER_MODELS:
            if mean.get(name, np.inf) < (1.0 - MIN_ADVANTAGE) * mean[model]:
                warnings.append(
                    f"{name} has smaller errors on {logs} than {model}: {mean[name]:.2f} instead "
                    f"of {mean[model]:.2f} mrad -> {remedy}"
                )
        return warnings


def evaluate_replay(
    motors: TorqueMotors,
    tuned: TorqueMotors | None,
    log: MotorLog,
    recipe: Recipe,
    progress: Progress,
    remedy: str = PREFER_IT,
) -> LogErrors:
    """Errors of PRIOR and TUNED_PD in replays of the log that the motors were fitted to.

    The errors and their warnings are reported. ``tuned`` is a PD that was tuned to the log; it is
    tuned here if not given; ``remedy`` is for motors with larger errors than the PD.
    """
    models = {PRIOR: motors, TUNED_PD: tuned or fitted_tuned_pd(log, progress)}
    errors = {}
    texts = []
    for name, model in models.items():
        differences, _ = replay_errors(model, log, recipe.nominal_conditions)
        by_joint = capped(rms(differences, axis=0))
        errors[name] = by_joint[None]
        median, mean, maximum = summary(dict(zip(log.joint_names, by_joint, strict=True)))
        texts.append(f"{name} median {median}, mean {mean}, max {maximum}")

    progress.note(f"replayed log, joint RMSE [mrad]: {'; '.join(texts)}")
    replayed = LogErrors((log.source,), log.joint_names, errors)
    for warning in replayed.warnings(PRIOR, remedy):
        progress.warn(warning)
    return replayed


def notes_on_log(log: MotorLog, recipe: Recipe) -> list[Note]:
    """Notes on static joints, slowly logged commands, and unknown operating conditions."""
    notes = []
    if log.slow_commands:
        joints = [f"{name} {1e3 * period:.3g} ms" for name, period in log.slow_commands.items()]
        text = (
            f"commands were sent between the logged ones ({listed(joints, 6)}): the constants of "
            "these joints count as not identified -> log every command that is sent"
        )
        notes.append(Note("warning", text))
    static = static_joints(log)
    if static:
        remedy = "exclude these joints, or record them in motion"
        names = ", ".join(static)
        text = f"did not move: {names}; their constants are not identifiable -> {remedy}"
        notes.append(Note("warning", text))

    for name, lowest, nominal, highest in recipe.operating_conditions:
        modelled = TERM_OF[name] in recipe.terms
        if getattr(log, name) is None:
            if modelled:
                assumed = operating_condition_text(name, nominal, nominal)
                notes.append(Note("info", f"the log has no {name}: {assumed} is assumed"))
            continue
        means = np.array([segment.operating_conditions[name] for segment in log.segments()])
        margin = min_condition_difference(name, nominal)
        if means.min() < lowest - margin or means.max() > highest + margin:
            effect = "extrapolated" if modelled else "not modelled"
            logged = operating_condition_text(name, means.min(), means.max())
            fitted = operating_condition_text(name, lowest, highest)
            remedy = "check its unit, or identify with logs of both"
            text = f"{name} is {logged}, in the prior's logs {fitted}: its effect is {effect}"
            notes.append(Note("warning", f"{text} -> {remedy}"))
    return notes
