"""Error of motors that replay a log with known loads in closed loop: commands and loads go in, motion comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.logs.motor_log import MotorLog, stated_gain_rows, stated_gains_of
from motorprior.signals import rmse

_BROKEN = 1e3  # Error of a simulation that broke down [rad]


def trials(log: MotorLog) -> list[tuple[Trial, np.ndarray]]:
    """The segments of a log as trials, each with its recorded joint_pos (steps, n) [rad].

    Joints begin as they were recorded: a real one sags, and a stretch of a log may begin in motion. Where the encoders
    are on the rotors, which are not the joints, they begin at rest at the first target.
    """
    found = []
    for part in log.segments():
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


# Function from the motors of a log and one of its segments to the motors with the gains that they have in it: what
# `in_proportion` returns, or `as_they_are`
Told = Callable[[Actuator, MotorLog], Actuator]


def as_they_are(motors: Actuator, part: MotorLog) -> Actuator:
    """Motors that are told nothing of a segment."""
    return motors


def in_proportion(log: MotorLog) -> Told:
    """What gives a PD of a whole log the gains of a segment, in proportion to those that the log states, if any.

    Medians are over segments and joints (`told_pd.GainScaledPd`).
    """
    medians = _stated_medians(log)
    if medians is None:
        return as_they_are

    def told(motors: Actuator, part: MotorLog) -> Actuator:
        gains = stated_gains_of(part)
        if gains is None or not isinstance(motors, IdealPd):
            return motors
        return GainScaledPd(motors, medians).at(gains)

    return told


def following_gains(pd: IdealPd, log: MotorLog) -> IdealPd | GainScaledPd:
    """A PD that was fitted to a log, such that it follows the gains that other logs state, if this one states any."""
    medians = _stated_medians(log)
    return pd if medians is None else GainScaledPd(pd, medians)


def _stated_medians(log: MotorLog) -> np.ndarray | None:
    """(2,) of the stated kp and kd over segments and joints; None of a log that states none."""
    rows = stated_gain_rows(log)
    return None if rows is None else np.median(rows[:, [part.start for part in log.segment_slices()]], axis=(1, 2))


def closed_loop_error(
    log: MotorLog, progress: Callable[[int], None] | None = None, told: Told = as_they_are
) -> Callable[[Actuator], float]:
    """Mean over the log's motors of the joint RMSE [rad] of its commands and loads on the dynamometer.

    Takes models of all of them; one that broke down has an error of 1000 rad. ``progress`` is called after every one;
    ``told`` is what the models are told of each segment.
    """
    cases = list(zip(trials(log), log.segments(), strict=True))

    def error(motors: Actuator) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            found = np.mean(
                [rmse(run(told(motors, part), trial).joint_pos, truth, axis=0) for (trial, truth), part in cases]
            )
        if progress is not None:
            progress(1)
        return float(found) if np.isfinite(found) else _BROKEN

    return error
