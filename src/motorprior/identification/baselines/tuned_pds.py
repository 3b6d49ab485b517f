"""Baselines fitted to a log with known loads: a PD with its gains alone, with armature and delay, and with friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.logs.motor_log import MotorLog, stated_gain_rows, stated_gains_of
from motorprior.signals import rmse

EVALUATIONS = 200
"""Largest number of evaluations of the objective, unless told otherwise."""
_SEGMENTS = 5
"""Number of segments of a bench log that a fit replays: one per excitation of the bench's preset ``rollout``."""


def trials(log: MotorLog, count: int | None = None) -> list[tuple[Trial, np.ndarray]]:
    """The first ``count`` segments of a log, or all, as trials, each with its recorded joint_pos (steps, n) [rad].

    Joints begin as they were recorded: a real one sags, and a stretch of a log may begin in motion. Where the encoders
    are on the rotors, which are not the joints, they begin at rest at the first target.
    """
    found = []
    for part in list(log.segments())[:count]:
        assert part.external_torque is not None and part.load_inertia is not None
        trial = Trial(part.position_target, part.external_torque, part.load_inertia[0], part.period)
        if part.load_stiffness is not None:
            at_zero = part.external_torque - part.load_stiffness * part.joint_pos
            trial = replace(trial, external_torque=at_zero, load_stiffness=part.load_stiffness)
        if part.encoder == "joint":
            trial = replace(trial, joint_pos=part.joint_pos[0], joint_vel=_first(part.joint_vel))
        found.append((trial, part.joint_pos))
    return found


def _first(rows: np.ndarray | None) -> np.ndarray | None:
    return None if rows is None else rows[0]


Told = Callable[[Actuator, MotorLog], Actuator]
"""Function from the motors of a log and one of its segments to the motors with the gains that they have in it: what
`in_proportion` returns, or `as_they_are`."""


def as_they_are(motors: Actuator, part: MotorLog) -> Actuator:
    """Motors that are told nothing of a segment."""
    return motors


def in_proportion(log: MotorLog) -> Told:
    """What gives a PD of a whole log the gains of a segment, in proportion to those that the log states, if any.

        kp' = kp·stated kp / median stated kp,   kd' = kd·stated kd / median stated kd

    Medians are over segments and joints; where one is 0 that gain stays as it is.
    """
    rows = stated_gain_rows(log)
    if rows is None:
        return as_they_are
    middle = np.median(rows[:, [part.start for part in log.segment_slices()]], axis=(1, 2))[:, None]

    def told(motors: Actuator, part: MotorLog) -> Actuator:
        gains = stated_gains_of(part)
        if gains is None or not isinstance(motors, IdealPd):
            return motors
        kp, kd = np.where(middle > 0.0, gains / np.where(middle > 0.0, middle, 1.0), 1.0)
        return replace(motors, kp=motors.kp * kp, kd=motors.kd * kd)

    return told


GAINS = ("kp", "kd", "torque_limit")
"""Constants that are fitted for an ideal PD."""
EVERYTHING = (*GAINS, "armature", "delay")
"""Constants that are fitted for the tuned PD."""
FRICTION = (*EVERYTHING, "coulomb")
"""Constants that are fitted for a PD with friction."""
START = {"armature": 0.001, "delay": 0.008, "coulomb": 0.02}
"""Where the fit of a constant begins, that a nominal PD does not have [kg·m²], [s], [N·m]."""
_BROKEN = 1e3
"""Error of a simulation that broke down [rad]."""
_BEGINNINGS = tuple(product((2.0, 8.0, 32.0, 128.0), (0.02, 0.06, 0.18), (1.5, 15.0, 150.0)))
"""kp [N·m/rad], kd/kp [s] and torque_limit [N·m] of which a PD's tuning begins at the best."""
TUNING = len(_BEGINNINGS) + EVALUATIONS
"""About how often `tuned_pd` reports."""


def fit_pd(
    log: MotorLog,
    nominal: IdealPd,
    free: tuple[str, ...],
    progress: Callable[[int], None] | None = None,
    segments: int | None = _SEGMENTS,
    told: Told = as_they_are,
) -> IdealPd:
    """Fit one PD, shared by all motors, with the least closed-loop error on the bench log.

    Nelder-Mead over the logarithms of the ``free`` constants; the objective is the mean over motors of the joint
    RMSE [rad] when the log's commands and loads are replayed on the dynamometer.

    Args:
        log: a bench log.
        nominal: initial kp, kd and torque_limit; armature and delay, if free, start at 0.001 kg·m² and 0.008 s.
        free: GAINS or EVERYTHING; the other constants stay nominal.
        progress: called after every evaluation.
        segments: so many of the log's first are replayed; all if None.
        told: what the PD is told of each segment.

    Returns:
        A PD of one motor; `repeated` copies it for several.
    """
    error = closed_loop_error(log, progress, segments, told)
    first = np.log([START.get(name, float(getattr(nominal, name)[0])) for name in free])

    def model(values: np.ndarray) -> IdealPd:
        chosen = {name: np.array([value]) for name, value in zip(free, np.exp(values), strict=True)}
        return replace(nominal, **chosen)

    def cost(values: np.ndarray) -> float:
        return error(repeated(model(values), log.num_joints))

    return model(least(cost, first).x)


def tuned_pd(log: MotorLog, progress: Callable[[int], None] | None = None, told: Told = as_they_are) -> IdealPd:
    """One PD with armature and delay for all motors of the log, tuned from the best of many gains; M copies of it.

    Nothing needs to be known of the motors: the gains that are tried span small servos and large direct drives. The
    whole log counts: motions of a real one show other things each. ``told`` is what the PD is told of each segment.
    """
    error = closed_loop_error(log, progress, None, told)
    starts = [IdealPd.uniform(1, kp, kp * share, limit) for kp, share, limit in _BEGINNINGS]
    best = min(starts, key=lambda start: error(repeated(start, log.num_joints)))
    return repeated(fit_pd(log, best, EVERYTHING, progress, None, told), log.num_joints)


def closed_loop_error(
    log: MotorLog,
    progress: Callable[[int], None] | None,
    segments: int | None = None,
    told: Told = as_they_are,
) -> Callable[[Actuator], float]:
    """Mean over the log's motors of the joint RMSE [rad] of its commands and loads on the dynamometer.

    Takes models of all of them; one that broke down has an error of 1000 rad. ``progress`` is called after every one.
    The first ``segments`` of the log are replayed, or all; ``told`` is what the models are told of each.
    """
    cases = list(zip(trials(log, segments), log.segments(), strict=False))

    def error(motors: Actuator) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            found = np.mean(
                [rmse(run(told(motors, part), trial).joint_pos, truth, axis=0) for (trial, truth), part in cases]
            )
        if progress is not None:
            progress(1)
        return float(found) if np.isfinite(found) else _BROKEN

    return error


def least(cost: Callable[[np.ndarray], float], first: np.ndarray, evaluations: int = EVALUATIONS) -> OptimizeResult:
    """Nelder-Mead search over (N,) numbers from ``first``, with so many evaluations at most."""
    simplex = np.vstack([first, *(first + 0.3 * row for row in np.eye(len(first)))])
    options = {"maxfev": evaluations, "xatol": 1e-3, "fatol": 1e-6, "initial_simplex": simplex}
    return minimize(cost, first, method="Nelder-Mead", options=options)


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """``num_motors`` copies of the first motor of ``model``."""
    return IdealPd.uniform(
        num_motors, model.kp[0], model.kd[0], model.torque_limit[0], model.armature[0], model.delay[0]
    )
