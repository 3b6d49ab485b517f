"""Gains that a log states in N·m/rad: its simulated motors have them, in place of those that a fleet says."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.families import TrueMotors
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog, stated_gains_of
from motorprior.logs.stated import gains_in_words

Motors = TypeVar("Motors", TrueMotors, IdealPd)


def stated_constants(log: MotorLog) -> frozenset[str]:
    """Constants of a fleet that a log states: none where its gains are in units of a firmware."""
    if log.stated_kp is None or log.gain_unit != PHYSICAL_GAINS:
        return frozenset()
    return frozenset({"kp"} if log.stated_kd is None else {"kp", "kd_over_kp"})


def at_stated_gains(motors: Motors, log: MotorLog) -> Motors:
    """These motors, one per joint of the log, with the gains that it states; of a log that states none, themselves.

    kp and kd are those of the log. Where it states kp alone, kd = stated kp·kd/kp of the motors. An integral's gain,
    which foreign motors may have, stays theirs: no log states it.
    """
    gains = stated_gains_of(log)
    if gains is None or not stated_constants(log):
        return motors
    kp, kd = gains
    return replace(motors, kp=kp, kd=kp * motors.kd / motors.kp if log.stated_kd is None else kd)


def told_of_gains(log: MotorLog) -> str:
    """For the user: which gains a log states, and whether simulated motors have them; empty where it states none."""
    said = " and ".join(gains_in_words(log))
    if not said:
        return ""
    if not stated_constants(log):
        return f"it states {said}, of which no fleet knows the N·m/rad: motors have the fleet's"
    return f"it states {said}: motors have these in place of the fleet's"
