"""Explain a fit whose inputs contradict the model: which cause removes most of the error.

Every explanation of the registry is screened by a score test (`screen`), also where the error is
small. The promising ones are fitted together with the constants (`attempt`). An explanation is
reported if it leaves at most CURED of the error of a joint, and if one of its parameters is larger
than its interval and than a stated minimum. Of several that are equally good, the one with the
fewest parameters comes first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.exceptions import listed
from motorprior.identification.explanations.attempt import Attempt, Attempts
from motorprior.identification.explanations.changed_rows import (
    ChangedRows,
    LoggedRows,
    changed_rows,
)
from motorprior.identification.explanations.explanation import (
    Estimate,
    Facts,
    RowExplanation,
)
from motorprior.identification.explanations.rows import ROW_EXPLANATIONS
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData, spread_windows
from motorprior.logs.loads_bodies import LinkMass, gravity_levers, link_masses
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog
from motorprior.progress import Note
from motorprior.signals import rms

CURED = 0.4  # an explanation leaves at most this share of the error of a joint that it cures
# joints with a smaller error [rad] need no explanation; nor does an explanation count that leaves
# more than this share of the motion
MIN_ERROR = 0.5e-3
MISSING_PHYSICS = 0.03  # share of the motion that remains where physics is missing
_MAX_HALF_WIDTH = 1.5  # of the interval of an identified parameter, over its unit
_PREDICTED = 0.95  # share of the error that an explanation may leave by its score test
_EQUAL_SHARE = 0.15  # explanations with shares that differ by less are equally promising
# explanations of each joint that are fitted
_MIN_PREDICTED = 3
_MAX_PREDICTED = 8
_PROMISING = 0.8  # share of the error that a promising explanation leaves after a few steps
_MAX_PROMISING = 3  # of each joint
_EQUAL_VALUES = 0.03  # parameters of joints are equal if they differ by less, or by their intervals
# explanations are equally good if their errors differ by less than this factor, or this error [rad]
_EQUAL = 1.3
_EQUAL_ERROR = 0.25e-3
_ORDER_STEP = 0.1e-3  # errors that differ by less do not order explanations [rad]
_MAX_MOTORS = 10  # motors that are explained: those with the largest errors
_MAX_WINDOW = 250  # steps: short runs are fast, and have few local optima
_MIN_WINDOWS = 3  # that an explanation by rows must leave


@dataclass(frozen=True)
class Trial:
    """An explanation of all logs or of one, or of the zero of one joint, and its attempt."""

    name: str
    units: tuple[float, ...]  # of the parameters
    smallest: tuple[float, ...]  # parameters that count
    is_shared: bool
    is_even: bool  # see `Explanation`
    attempt: Attempt
    # (joint, estimate) -> problem and remedy
    describe: Callable[[int, Estimate], tuple[str, str]]
    turned_joint: int | None = None

    def share(self, errors: np.ndarray) -> np.ndarray:
        """(M,) remaining share of the errors (M,)."""
        return self.attempt.errors / np.maximum(errors, 1e-12)

    def estimate(self, joint: int) -> Estimate:
        """Parameters of one joint."""
        return Estimate(self.attempt.values[joint], self._half_widths([joint])[0])

    def _half_widths(self, joints: Sequence[int]) -> np.ndarray:
        """(n, P) half widths of the intervals of some joints."""
        half_widths = self.attempt.half_widths
        assert half_widths is not None
        return half_widths[list(joints)]

    def counts(self, joint: int) -> bool:
        """Whether a parameter is not small, and the log of a joint identifies all such parameters.

        A parameter that is near 0 may be unknown: a planar arm does not tell a small roll from 0.
        """
        if not self.units:
            return True
        estimate = self.estimate(joint)
        smallest = np.array(self.smallest)
        is_needed = (np.abs(estimate.values) > smallest) | np.isinf(smallest)
        is_identified = estimate.half_widths <= _MAX_HALF_WIDTH * np.array(self.units)
        return bool(np.all(is_identified[is_needed])) and estimate.count_above(smallest) > 0

    def common_estimate(self, joints: Sequence[int]) -> Estimate | None:
        """Parameters that several joints have in common, or None if they disagree."""
        values = self.attempt.values[list(joints)]
        half_widths = np.maximum(self._half_widths(joints), 1e-6)
        weights = half_widths**-2.0
        mean = np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
        is_equal = np.abs(values - mean) <= 2.0 * half_widths + _EQUAL_VALUES
        if not is_equal.all():
            return None
        return Estimate(mean, np.sum(weights, axis=0) ** -0.5)

    def parameters(self, joints: Sequence[int]) -> int:
        """Number of parameters for these joints that are not small; equal ones count once."""
        common = self.common_estimate(joints)
        if common is not None:
            return common.count_above(np.array(self.smallest))
        return len(self.units) * len(joints)


@dataclass(frozen=True)
class Explained:
    """Joints whose errors one cause explains."""

    joints: tuple[int, ...]
    trials: tuple[Trial, ...]  # the first is the best; the others are equally good


@dataclass(frozen=True)
class Explanations:
    """What explains the errors of a fit."""

    facts: Facts
    errors: np.ndarray  # (M,) of the best fit to the log as it is [rad]
    causes: tuple[Explained, ...]

    def notes(self) -> list[Note]:
        """Warnings of causes and of missing physics, and the joints whose figures stand."""
        return list(_notes(self.errors, self.causes, self.facts))


def explain(
    log: MotorLog, data: TrainingData, recipe: Recipe, model: GreyBox, outputs: np.ndarray
) -> Explanations:
    """Find what explains the errors of fitted motors.

    ``data`` are the rows of ``log`` that were fitted; ``outputs`` (M, K) are the decoder outputs of
    the motors, relative to the centre of ``model``, which decodes each constant from one latent.
    """
    recipe = replace(recipe, window=min(recipe.window, _MAX_WINDOW))
    levers = gravity_levers(log)
    segment_logs = _log_of_segments(log)
    first_rows = {rows.start: name for rows, name in zip(data.segments, segment_logs, strict=True)}

    subset = spread_windows(data, recipe)
    motors = np.arange(len(data.series))
    if len(motors) > _MAX_MOTORS:
        errors = WindowRuns(subset, recipe).errors(model.motors(outputs))
        worst = np.argsort(np.mean(errors[:, :, 0] ** 2, axis=(1, 2)))[-_MAX_MOTORS:]
        motors = np.sort(worst)
        levers = None

    runs = WindowRuns(subset, recipe, motors)
    log_names = _log_names(log, len(set(segment_logs)))
    attempts = Attempts(model, outputs[motors], runs)
    errors = attempts.errors_on(runs)
    joints = np.flatnonzero(errors > MIN_ERROR)

    masses: Sequence[LinkMass | None] = [None] * len(motors)
    if levers is not None and joints.size:
        masses = link_masses(log, subset.segments, levers.carries)
    facts = _facts(log, data, runs, model, outputs, motors, log_names, levers is not None, masses)
    if not joints.size:
        return Explanations(facts, errors, ())

    starts = np.array(sorted(first_rows))
    logs_of_runs = []
    for segment in subset.segments:
        first = int(starts[np.searchsorted(starts, segment.start, side="right") - 1])
        logs_of_runs.append(first_rows[first])

    data_of_motors = _of_motors(data, motors)
    logs = LoggedRows(log, runs, data_of_motors, subset, logs_of_runs, levers, masses)

    errors[joints] = attempts.unchanged(joints).errors[joints]
    joints = np.flatnonzero(errors > MIN_ERROR)
    is_bad = errors > MISSING_PHYSICS * facts.motion
    screened = _screened(attempts, joints, is_bad, changed_rows(joints, logs, facts))
    faulty_rows = _faulty_rows(logs, facts)
    begun = [
        *_row_trials(attempts, joints, logs, faulty_rows),
        *(_input_trial(attempts, candidate, facts) for candidate in screened),
    ]
    trials = _refined(attempts, begun, errors)
    return Explanations(facts, errors, tuple(causes_of(errors, trials)))


def _log_of_segments(log: MotorLog) -> list[int]:
    """Index of the log of each segment: a new log begins where the clock restarts."""
    indices = []
    index = 0
    end = -np.inf
    for segment in log.segment_slices():
        if log.time[segment.start] < end:
            index += 1
        end = log.time[segment.stop - 1]
        indices.append(index)
    return indices


def _log_names(log: MotorLog, count: int) -> tuple[str, ...]:
    """Names of the logs: their sources, if there are as many, else numbers."""
    sources = [source.strip() for source in log.source.split(";")]
    if len(sources) == count:
        return tuple(source.rsplit("/", 1)[-1] for source in sources)
    return tuple(f"log {index + 1}" for index in range(count))


def _of_motors(data: TrainingData, motors: np.ndarray) -> TrainingData:
    return replace(data, series=data.series[motors])


def _facts(
    log: MotorLog,
    data: TrainingData,
    runs: WindowRuns,
    model: GreyBox,
    outputs: np.ndarray,
    motors: np.ndarray,
    log_names: tuple[str, ...],
    has_gravity: bool,
    masses: Sequence[LinkMass | None],
) -> Facts:
    gains = None
    kd_over_kp = model.constants(outputs[motors])["kd_over_kp"]
    has_kd = runs.logs_kd
    if runs.recipe.gain_unit:
        kd_over_kp = kd_over_kp * runs.gains[1] / runs.gains[0]
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        gains = runs.gains
    names = tuple(log.joint_names[motor] for motor in motors)
    commands = ("velocity_target", "torque_feedforward")
    return Facts(
        commands=tuple(name for name in commands if getattr(log, name) is not None),
        joint_names=names,
        period=runs.recipe.period,
        logs=log_names,
        gains=gains,
        has_kd=has_kd,
        has_torque=data.has_torque,
        has_gravity=has_gravity,
        at_rotor=data.at_rotor,
        motion=np.std(log.joint_pos[:, motors], axis=0),
        kd_over_kp=kd_over_kp,
        link_mass=np.array([0.0 if mass is None else mass.mass for mass in masses]),
        link_reach=np.array([0.0 if mass is None else mass.reach for mass in masses]),
    )


def _refined(attempts: Attempts, begun: list[Trial], errors: np.ndarray) -> list[Trial]:
    """The most promising trials of each joint, fitted further.

    A trial is promising if it leaves less than _PROMISING of the errors (M,) after a few steps.
    """
    if not begun:
        return []
    first_errors = np.stack([trial.attempt.errors for trial in begun])  # (trials, M)
    rank = np.argsort(np.argsort(first_errors, axis=0), axis=0)
    is_promising = first_errors < _PROMISING * errors
    is_best = is_promising & (rank < _MAX_PROMISING)
    trials = []
    for trial, joints, best in zip(begun, is_promising, is_best, strict=True):
        if best.any():
            indices = np.flatnonzero(joints)
            attempt = attempts.refined(trial.attempt, indices)
            if trial.is_shared and trial.is_even:
                attempt = _with_common_signs(attempts, attempt, indices)
            trials.append(replace(trial, attempt=attempt))
    return trials


def _with_common_signs(attempts: Attempts, attempt: Attempt, joints: np.ndarray) -> Attempt:
    """The attempt with the same signs of the parameters of all ``joints`` that allow them.

    A joint whose error is the same with either sign may have the sign that another joint excludes.
    """
    signs = np.unique(np.sign(attempt.values[joints]), axis=0)
    if len(signs) == 1:
        return attempt

    changed = [attempts.with_signs(attempt, joints, of_all) for of_all in signs]
    best = min(changed, key=lambda with_signs: float(rms(with_signs.errors[joints])))
    is_equal = best.errors <= np.maximum(_EQUAL * attempt.errors, attempt.errors + _EQUAL_ERROR)
    assert attempt.half_widths is not None and best.half_widths is not None
    return replace(
        attempt,
        unknowns=np.where(is_equal[:, None], best.unknowns, attempt.unknowns),
        errors=np.where(is_equal, best.errors, attempt.errors),
        half_widths=np.where(is_equal[:, None], best.half_widths, attempt.half_widths),
    )


def _screened(
    attempts: Attempts, joints: np.ndarray, is_bad: np.ndarray, inputs: Iterator[ChangedRows]
) -> list[ChangedRows]:
    """The inputs, each with the joints whose errors it may explain.

    The score test decides; of joints that are fitted badly (M,), also candidates far away from the
    fitted motor.
    """
    unexplained = {joint: attempts.unexplained(joint) for joint in joints.tolist()}
    count = len(attempts.fitted)
    candidates = []
    shares = []
    for candidate in inputs:
        share = np.full(count, np.inf)
        predicted = np.zeros((count, len(candidate.explanation.units)))
        for joint in candidate.joints.tolist():
            share[joint], predicted[joint] = attempts.predicted_share(
                candidate.explanation,
                joint,
                candidate.is_changed,
                candidate.runs,
                unexplained[joint],
            )
            if is_bad[joint]:
                far_share = attempts.candidate_share(
                    candidate.explanation, joint, candidate.is_changed, candidate.runs
                )
                share[joint] = min(share[joint], far_share)
        candidates.append(replace(candidate, predicted=predicted))
        shares.append(share)
    if not candidates:
        return []

    table = np.stack(shares)  # (candidates, M); inf for joints that a candidate does not change
    has_guess = np.array([candidate.explanation.guess is not None for candidate in candidates])
    rank = np.argsort(np.argsort(table, axis=0), axis=0)
    is_possible = table < _PREDICTED
    is_near_best = (table < table.min(axis=0) + _EQUAL_SHARE) & (rank < _MAX_PREDICTED)
    is_chosen = is_possible & (is_near_best | (rank < _MIN_PREDICTED))
    # commands or angles of another unit are far beyond a score test
    is_chosen |= is_bad & has_guess[:, None] & ~np.isinf(table)
    screened = []
    for candidate, possible, chosen in zip(candidates, is_possible, is_chosen, strict=True):
        # several joints often have one cause
        if chosen.any():
            screened.append(replace(candidate, joints=np.flatnonzero(possible | chosen)))
    return screened


def _input_trial(attempts: Attempts, candidate: ChangedRows, facts: Facts) -> Trial:
    """A few steps of an explanation of inputs."""
    explanation = candidate.explanation
    scope = candidate.scope
    turned = candidate.turned
    attempt = attempts.begun(
        explanation, candidate.joints, candidate.is_changed, candidate.runs, candidate.predicted
    )
    where = "" if scope is None else f" in {facts.logs[scope]}"

    def describe(joint: int, estimate: Estimate) -> tuple[str, str]:
        described_joint = joint if turned is None else turned
        problem, remedy = explanation.describe(estimate, described_joint, facts)
        name = facts.joint_names[described_joint]
        problem = problem.replace("{of}", "" if turned is None else f" of {name}")
        return problem.replace("{joint}", name) + where, remedy.replace("{joint}", name)

    name = explanation.name if scope is None else f"{explanation.name} of log {scope}"
    is_shared = explanation.is_shared or turned is not None
    return Trial(
        name,
        explanation.units,
        explanation.smallest,
        is_shared,
        explanation.is_even,
        attempt,
        describe,
        turned,
    )


def _faulty_rows(logs: LoggedRows, facts: Facts) -> dict[str, np.ndarray]:
    """Mask (R, M) of the rows that each of `ROW_EXPLANATIONS` leaves out, by its name."""
    masks = {}
    for explanation in ROW_EXPLANATIONS:
        mask = np.zeros(logs.data.series.shape[:2], bool).T
        for segment in logs.data.segments:
            rows = logs.data.series[:, segment].transpose(1, 2, 0)
            mask[segment] = explanation.faulty(rows, facts.motion, logs.runs.recipe.period)
        masks[explanation.name] = mask
    return masks


def _row_trials(
    attempts: Attempts, joints: np.ndarray, logs: LoggedRows, faulty_rows: dict[str, np.ndarray]
) -> Iterator[Trial]:
    """Trials of `ROW_EXPLANATIONS`, each on the windows that it leaves."""
    recipe = logs.runs.recipe
    for explanation in ROW_EXPLANATIONS:
        mask = faulty_rows[explanation.name]
        in_runs = np.stack([mask[segment].any(axis=0) for segment in logs.subset.segments])

        # one joint at a time: the other joints keep their rows
        for joint in joints[in_runs[:, joints].any(axis=0)]:
            left = spread_windows(logs.data, recipe, mask[:, joint])
            if len(left.segments) >= _MIN_WINDOWS:
                left_runs = WindowRuns(left, recipe)
                attempt = attempts.begun(None, np.array([joint]), runs=left_runs)

                # the motor without these rows must not replay them
                faulty_runs = logs.runs.counting(in_runs[:, joint])
                error = attempts.errors_on(faulty_runs, attempt.unknowns)[joint]
                if attempt.errors[joint] < CURED * error:
                    yield _row_trial(explanation, attempt, mask, recipe)


def _row_trial(
    explanation: RowExplanation, attempt: Attempt, mask: np.ndarray, recipe: Recipe
) -> Trial:
    def describe(joint: int, estimate: Estimate) -> tuple[str, str]:
        rows = np.flatnonzero(mask[:, joint])
        seconds = recipe.period * len(rows)
        where = f"from {recipe.period * rows[0]:.3g} s to {recipe.period * rows[-1]:.3g} s"
        return explanation.problem.format(seconds=seconds, where=where), explanation.remedy

    return Trial(explanation.name, (), (), False, False, attempt, describe)


def causes_of(errors: np.ndarray, trials: Sequence[Trial]) -> list[Explained]:
    """What explains the errors (M,) [rad] of joints: the best trials, one cause after the other."""
    remaining = errors > MIN_ERROR
    causes = []
    while remaining.any():
        gains = [_gain(trial, errors, remaining) for trial in trials]
        best_gain = max(gains, default=0.0)
        if best_gain <= 0.0:
            break
        best = trials[int(np.argmax(gains))]
        joints = _cured(best, errors, remaining)
        left = rms(best.attempt.errors[joints])
        limit = max(_EQUAL * left, left + _EQUAL_ERROR)
        equal = []
        for trial in trials:
            counts = all(trial.counts(joint) for joint in joints.tolist())
            if counts and rms(trial.attempt.errors[joints]) <= limit:
                equal.append(trial)
        indices = tuple(joints.tolist())
        equal.sort(key=lambda trial: _order(trial, indices, float(left)))
        causes.append(Explained(indices, tuple(equal)))
        remaining[joints] = False

        # a further cause must explain what a shared one leaves of the other joints' errors
        if best.is_shared:
            errors = np.minimum(errors, best.attempt.errors)
            remaining &= errors > MIN_ERROR
    return causes


def _cured(trial: Trial, errors: np.ndarray, remaining: np.ndarray) -> np.ndarray:
    """Indices of the remaining joints that a trial cures.

    A cause that is shared cures none if the joints disagree about it.
    """
    is_cured = remaining & (trial.share(errors) < CURED)
    for joint in np.flatnonzero(is_cured):
        is_cured[joint] = trial.counts(int(joint))
    cured = np.flatnonzero(is_cured)
    if trial.is_shared and cured.size and trial.common_estimate(cured.tolist()) is None:
        return cured[:0]
    return cured


def _order(trial: Trial, joints: tuple[int, ...], least: float) -> tuple[int, int, int]:
    """Order of equally good trials: the error in coarse steps, then the number of parameters.

    Parameters that are not small count first, then all. ``least`` is the error of the best one
    [rad].
    """
    rise = float(rms(trial.attempt.errors[list(joints)])) - least
    steps = max(0, round(rise / (0.1 * least + _ORDER_STEP)))
    return steps, trial.parameters(joints), len(trial.units)


def _gain(trial: Trial, errors: np.ndarray, remaining: np.ndarray) -> float:
    """Sum over the cured joints of the logarithm of the factor by which the error falls."""
    cured = _cured(trial, errors, remaining)
    left = np.maximum(trial.attempt.errors[cured], _EQUAL_ERROR)
    return float(np.sum(np.log(errors[cured] / left)))


def _notes(errors: np.ndarray, causes: Sequence[Explained], facts: Facts) -> Iterator[Note]:
    """A warning per cause, one on joints without a cause, and a note on the other joints."""
    names = np.array(facts.joint_names)
    is_bad = np.zeros(len(names), bool)
    for cause in causes:
        joints = list(cause.joints)
        is_bad[joints] = True
        yield _note_on_cause(cause, errors, names)

    is_missing = ~is_bad & (errors > MISSING_PHYSICS * facts.motion) & (errors > 4.0 * MIN_ERROR)
    if is_missing.any():
        texts = []
        for joint in np.flatnonzero(is_missing):
            share = 100.0 * errors[joint] / max(facts.motion[joint], 1e-9)
            texts.append(
                f"{names[joint]} {1e3 * errors[joint]:.1f} mrad, {share:.0f} % of its motion"
            )
        yield Note(
            "warning",
            f"{listed(texts, 6)}: no single error of the log explains this, so the model lacks "
            "physics of these joints (contact, slip, a changing load, a nonlinear transmission), "
            "or the model of their load lacks a part",
        )
    is_good = ~is_bad & (errors <= 4.0 * MIN_ERROR)
    if (is_bad | is_missing).any() and is_good.any():
        largest = 1e3 * errors[is_good].max()
        good = listed(names[is_good].tolist(), 6)
        yield Note("info", f"the figures of {good} stand (errors up to {largest:.1f} mrad)")


def _note_on_cause(cause: Explained, errors: np.ndarray, names: np.ndarray) -> Note:
    joints = list(cause.joints)
    best = cause.trials[0]
    problem, remedy = _description(best, joints, names)
    before = 1e3 * rms(errors[joints])
    after = 1e3 * rms(best.attempt.errors[joints])
    text = f"{problem}; the error is then {after:.2g} instead of {before:.3g} mrad -> {remedy}"
    others = [_description(trial, joints, names)[0] for trial in cause.trials[1:4]]
    if others:
        text += f". Equally good: {'; or '.join(others)}"
    return Note("warning", text)


def _description(trial: Trial, joints: list[int], names: np.ndarray) -> tuple[str, str]:
    """Problem, after the names of the joints, and remedy; one problem per joint if they differ."""
    first = joints[0]
    common = trial.common_estimate(joints)
    if common is not None:
        problem, remedy = trial.describe(first, common)
        return f"{listed(names[joints].tolist(), 6)}: {problem}", remedy

    problems = []
    for joint in joints:
        problem, _ = trial.describe(joint, trial.estimate(joint))
        problems.append(f"{names[joint]}: {problem}")
    _, remedy = trial.describe(first, trial.estimate(first))
    return listed(problems, 4), remedy
