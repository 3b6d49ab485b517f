"""Error of motors that replay a log with known loads in closed loop, from commands and loads to motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rmse

# (motors of a log, one of its segments) -> the motors at the gains of that segment
AtGains = Callable[[Actuator, MotorLog], Actuator]


def trials(log: MotorLog) -> list[tuple[Trial, np.ndarray]]:
    """The segments of a log as trials, each with its recorded joint_pos (steps, n) [rad].

    Joints start in the recorded state or, if the encoders are on the rotors, with zero velocity at the first target.
    """
    found = []
    for part in log.segments():
        assert part.external_torque is not None and part.load_inertia is not None
        trial = Trial(part.position_target, part.external_torque, part.load_inertia[0], part.period)
        if part.load_stiffness is not None:
            at_zero = part.external_torque - part.load_stiffness * part.joint_pos
            trial = replace(trial, external_torque=at_zero, load_stiffness=part.load_stiffness)
        if part.encoder == "joint":
            velocity = None if part.joint_vel is None else part.joint_vel[0]
            trial = replace(trial, joint_pos=part.joint_pos[0], joint_vel=velocity)
        found.append((trial, part.joint_pos))
    return found


def unchanged(motors: Actuator, part: MotorLog) -> Actuator:
    """The motors themselves, for models that ignore gains."""
    return motors


def scaled_gains(log: MotorLog) -> AtGains:
    """Function that scales a log's PD to a segment's gains (`GainScaledPd`); `unchanged` for a log without gains."""
    medians = _median_gains(log)
    if medians is None:
        return unchanged

    def at_gains(motors: Actuator, part: MotorLog) -> Actuator:
        gains = part.gains
        if gains is None or not isinstance(motors, IdealPd):
            return motors
        return GainScaledPd(motors, medians).at(gains)

    return at_gains


def with_scaled_gains(pd: IdealPd, log: MotorLog) -> IdealPd | GainScaledPd:
    """A PD that was fitted to a log, scaled to the gains of other logs if this one has gains."""
    medians = _median_gains(log)
    return pd if medians is None else GainScaledPd(pd, medians)


def _median_gains(log: MotorLog) -> np.ndarray | None:
    gains = [part.gains for part in log.segments() if part.gains is not None]
    return np.median(gains, axis=(0, 2)) if gains else None


def closed_loop_error(
    log: MotorLog, progress: Callable[[int], None] | None = None, at_gains: AtGains = unchanged
) -> Callable[[Actuator], float]:
    """Function from models of a log's motors to their mean joint RMSE [rad] when they replay it on the dynamometer.

    A simulation that diverges has an error of 1000 rad. ``progress`` is called after every simulation.
    """
    cases = list(zip(trials(log), log.segments(), strict=True))

    def error(motors: Actuator) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            replays = [(run(at_gains(motors, part), trial).joint_pos, recorded) for (trial, recorded), part in cases]
            found = np.mean([rmse(simulated, recorded, axis=0) for simulated, recorded in replays])
        if progress is not None:
            progress(1)
        return float(found) if np.isfinite(found) else 1e3

    return error
