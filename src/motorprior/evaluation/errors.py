"""Errors of motor models on logs, and the warnings that follow from them.

All models simulate the joints from recorded commands and loads, without feedback from the recorded
motion. Errors are simulated minus recorded angles, the latter smoothed where readings are noisy
(`smoothing`); no mean is removed.

    free run    starts from the recorded joint and from the hidden state of a simulation that followed the recording
                until then (`window_runs`): over 1 s, or over a whole segment after the warm-up at
                its beginning
    replay      starts from the first row of a segment with a static rotor (`dynamometer.run`)
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
from motorprior.identification.physics.term_selection import TERM_OF, min_difference
from motorprior.identification.physics.window_runs import MotorsOnLoads
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import relative_operating_conditions, seconds_since_cold
from motorprior.logs.motor_log import MotorLog, condition_text
from motorprior.logs.operations import static_joints
from motorprior.progress import Note, Progress
from motorprior.signals import rms

PRIOR = "prior"
TUNED_PD = "tuned_pd"
SIMPLER = (
    "ideal_pd",
    TUNED_PD,
    "pure_delay",
    "second_order",
    "servo_limits",
    "coulomb_viscous",
    "stribeck",
)
MAX_UNEXPLAINED = 0.35  # share of the tuned PD's error above which a model lacks physics
ENCODER_ERROR = 0.002  # [rad], counts as explained: an encoder of 12 bits resolves 1.5 mrad
# [rad]; an error that is larger, or not finite, counts as this one: the simulation diverged
MAX_ERROR = math.tau
_MAX_SEGMENTS = 20  # maximum number of segments of a replay
# quantities of the quick report: errors of free runs of whole segments and of 1 s
WHOLE_RUN_RMSE = "real_motors_rmse"
FREE_RUN_RMSE = "real_motors_free_run_rmse"


def capped(errors: np.ndarray, limit: np.ndarray | float = MAX_ERROR) -> np.ndarray:
    """The errors, at most ``limit``, which is also the error of a simulation that diverged."""
    return np.minimum(np.where(np.isnan(errors), limit, errors), limit)


def summary(errors: Mapping[str, float]) -> tuple[str, str, str]:
    """Median, mean and maximum [mrad]."""
    values = np.array(list(errors.values()))
    statistics = (np.median(values), np.mean(values), np.max(values))
    median, mean, maximum = (
        f"{1e3 * each:.1f}" if each < MAX_ERROR else "diverged" for each in statistics
    )
    return median, mean, f"{maximum} ({list(errors)[int(values.argmax())]})"


def replay_errors(
    motors: MotorsOnLoads, log: MotorLog, nominal: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Replay at most _MAX_SEGMENTS segments of a log with known loads, at their gains and under their conditions.

    ``nominal`` are the conditions of the motors' recipe. Returns recorded - simulated angles [rad],
    both read by the same encoder, and velocities of the simulated joints [rad/s], each (steps of
    all segments, M).
    """
    parts = log.segment_slices()
    work = seconds_since_cold(log)
    chosen = np.linspace(0, len(parts) - 1, min(_MAX_SEGMENTS, len(parts))).round().astype(int)
    errors = []
    velocities = []
    for rows in (parts[index] for index in chosen):
        part = log.rows(rows)
        case = trial_of(part)
        recorded = part.joint_pos
        simulated = run(_at_segment(motors, part, nominal, float(np.median(work[rows]))), case)
        errors.append(
            recorded - (simulated.encoder_pos if log.encoder == "rotor" else simulated.joint_pos)
        )
        velocities.append(simulated.joint_vel)
    return np.concatenate(errors), np.concatenate(velocities)


def _at_segment(
    motors: MotorsOnLoads, part: MotorLog, nominal: Mapping[str, float], seconds: float
) -> Actuator:
    """The motors at the gains and under the conditions of a segment, ``seconds`` after a cold start."""
    gains = part.gains
    if isinstance(motors, GainScaledPd):
        return motors.pd if gains is None else motors.at(gains)
    if not isinstance(motors, GreyBoxActuator):
        return motors
    conditions = OperatingConditions(
        motors.model.warmth(motors.z, seconds), *relative_operating_conditions(part, nominal)
    )
    return replace(
        motors, conditions=conditions, gains=gains if motors.model.gain_unit else motors.gains
    )


@dataclass(frozen=True)
class LogErrors:
    """Root mean square errors of simulated angles [rad]."""

    logs: tuple[str, ...]  # L names
    joints: tuple[str, ...]  # J names
    models: dict[str, np.ndarray]  # (L, J) by model; NaN where a joint is not excited

    def unexplained(self, model: str) -> np.ndarray:
        """(J,) √(max(e² - ENCODER_ERROR², 0)) / e_PD with the mean errors e over the logs [-]."""
        errors = (self.models[name] for name in (model, TUNED_PD))
        with np.errstate(invalid="ignore"):  # NaN for joints that are not excited in any log
            error, baseline = (
                np.nansum(each, axis=0) / np.isfinite(each).sum(axis=0) for each in errors
            )
        return np.sqrt(np.maximum(error**2 - ENCODER_ERROR**2, 0.0)) / np.maximum(baseline, 1e-9)

    def warnings(self, model: str) -> list[str]:
        """Warnings of simpler models with less error, and of joints where too much of the tuned PD's error remains."""
        mean = {name: 1e3 * float(np.nanmean(values)) for name, values in self.models.items()}
        logs = shorten(", ".join(self.logs), 200, placeholder=" …")
        remedy = "try preset long_runs, another seed or longer logs"
        lines = [
            f"{name} replays {logs} better than {model}: {mean[name]:.2f} instead of {mean[model]:.2f} mrad "
            f"-> do not use this model; {remedy}"
            for name in SIMPLER
            if mean.get(name, np.inf) < mean[model]
        ]
        share = self.unexplained(model)
        if (large := np.flatnonzero(share > MAX_UNEXPLAINED)).size:
            named = listed(
                [f"{self.joints[joint]} {100 * share[joint]:.0f} %" for joint in large], 10
            )
            lines.append(
                f"more than {100 * MAX_UNEXPLAINED:.0f} % of the tuned PD's error remains on {logs}: {named}. "
                "The model lacks physics of these motors, they differ from the prior's, or the fit did not converge -> "
                f"do not interpret their constants; {remedy}"
            )
        return lines


def evaluate_replay(
    motors: MotorsOnLoads,
    tuned: MotorsOnLoads | None,
    log: MotorLog,
    recipe: Recipe,
    progress: Progress,
) -> LogErrors:
    """Errors of PRIOR and TUNED_PD in replays of the log that the motors were fitted to; notes state them.

    ``tuned`` is a PD that was tuned to the log; it is tuned here if not given.
    """
    models = {PRIOR: motors, TUNED_PD: tuned or fitted_tuned_pd(log, progress)}
    errors = {
        name: capped(rms(replay_errors(model, log, recipe.nominal_conditions)[0], axis=0))[None]
        for name, model in models.items()
    }
    replayed = LogErrors((log.source,), log.joint_names, errors)
    found = (
        (name, *summary(dict(zip(log.joint_names, values[0], strict=True))))
        for name, values in errors.items()
    )
    lines = [
        f"{name} median {median}, mean {mean}, max {maximum}"
        for name, median, mean, maximum in found
    ]
    progress.note(f"replayed log, joint RMSE [mrad]: {'; '.join(lines)}")
    for warning in replayed.warnings(PRIOR):
        progress.warn(warning)
    return replayed


def notes_on_log(log: MotorLog, recipe: Recipe) -> list[Note]:
    """Notes on static joints, and on operating conditions that the recipe was not fitted to."""
    notes = []
    if static := static_joints(log):
        remedy = "exclude these joints, or record them in motion"
        names = ", ".join(static)
        text = f"did not move: {names}; their constants are not identifiable -> {remedy}"
        notes.append(Note("warning", text))
    for name, lowest, nominal, highest in recipe.operating_conditions:
        modelled = TERM_OF[name] in recipe.terms
        if getattr(log, name) is None:
            if modelled:
                assumed = condition_text(name, nominal, nominal)
                notes.append(Note("info", f"the log has no {name}: {assumed} is assumed"))
            continue
        means = np.array([part.operating_conditions[name] for part in log.segments()])
        margin = min_difference(name, nominal)
        if means.min() < lowest - margin or means.max() > highest + margin:
            effect = "extrapolated" if modelled else "not modelled"
            here = condition_text(name, means.min(), means.max())
            fitted = condition_text(name, lowest, highest)
            remedy = "check its unit, or identify with logs of both"
            text = f"{name} is {here}, in the prior's logs {fitted}: its effect is {effect}"
            notes.append(Note("warning", f"{text} -> {remedy}"))
    return notes
