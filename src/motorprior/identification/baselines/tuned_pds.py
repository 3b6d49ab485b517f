"""PDs fitted to a log with known loads, the same for all its motors: gains alone, or armature and delay besides.

Of a log that shows neither clearly, a slow rotor and a late one are alike, and a search from one does not find the
other; nor does one that begins without a limit of torque find one. So searches begin with each of some armatures and
delays, at the best of some gains, without a limit, and again with the limit that suits what they found best. This is
on a part of the log; the best with and without a limit go on, on all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from math import prod

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines.pd_fit import Effort, PdFit, beginnings, fit_to_the_end, pd_motors
from motorprior.identification.baselines.replay_error import Told, as_they_are, closed_loop_error
from motorprior.logs.motor_log import MotorLog

GAINS = ("kp", "kd", "torque_limit")  # Constants that are fitted for an ideal PD
EVERYTHING = (*GAINS, "armature", "delay")  # Constants that are fitted for the tuned PD
FRICTION = (*EVERYTHING, "coulomb")  # Constants that are fitted for a PD with friction
# kp [N·m/rad] and kd/kp [s] that are tried: of small servos to large direct drives
_GAINS = tuple(product((2.0, 8.0, 32.0, 128.0), (0.02, 0.06, 0.18)))
_NO_LIMIT, _LIMITS = 1000.0, tuple(np.geomspace(0.4, 40.0, 13).tolist())  # [N·m]
_LAGS = {"armature": (0.001, 0.02), "delay": (0.008, 0.04)}  # [kg·m²], [s]
_STARTS = prod(map(len, _LAGS.values()))
_MOST_SEGMENTS, _MOST_ROWS = 16, 8000  # Of the part of a log that searches begin with
_BEGIN, _GO_ON = Effort(first=60, rounds=0), Effort(first=80, rounds=3, evaluations=150)
# About how often `tuned_pd` reports
TUNING = _STARTS * (len(_GAINS) + len(_LIMITS)) + 2 * _STARTS * _BEGIN.first + _GO_ON.most(2)
GAINS_ALONE = _GO_ON.most(1)  # About how often `best_gains` reports


def tuned_pd(log: MotorLog, progress: Callable[[int], None] | None = None, told: Told = as_they_are) -> IdealPd:
    """One PD with armature and delay for all M motors of the log, with the least closed-loop error; M copies of it.

    Nothing needs to be known of the motors. The whole log counts: motions of a real one show other things each.

    Args:
        log: with known loads.
        progress: called after every evaluation.
        told: what the PD is told of each segment.
    """
    part = _part(log)
    error = closed_loop_error(part, progress, told)

    def cost(constants: Mapping[str, float]) -> float:
        return error(pd_motors(constants, log.num_joints))

    gains = [{"kp": kp, "kd": kp * share} for kp, share in _GAINS]
    lags = beginnings({"torque_limit": _NO_LIMIT}, EVERYTHING, _LAGS)
    free = [_begun(part, min((lag | each for each in gains), key=cost), progress, told) for lag in lags]
    best = [min(({**each.constants, "torque_limit": limit} for limit in _LIMITS), key=cost) for each in free]
    limited = [_begun(part, each, progress, told) for each in best]
    starts = [min(found, key=lambda each: each.error).constants for found in (free, limited)]
    found = fit_to_the_end(log, starts, EVERYTHING, progress, _GO_ON, told)
    return _pd(found.constants, log.num_joints)


def _begun(part: MotorLog, start: Mapping[str, float], progress: Callable[[int], None] | None, told: Told) -> PdFit:
    """What a short search from these constants finds."""
    return fit_to_the_end(part, [start], EVERYTHING, progress, _BEGIN, told)


def _part(log: MotorLog) -> MotorLog:
    """Stretches from all over a log, each a segment, or all of it where it is short."""
    if log.num_rows <= _MOST_ROWS:
        return log
    segments = log.segment_slices()
    chosen = [
        segments[place] for place in np.linspace(0, len(segments) - 1, min(len(segments), _MOST_SEGMENTS), dtype=int)
    ]
    pieces = [
        piece
        for one in chosen
        for piece in np.array_split(np.arange(one.start, one.stop), _MOST_SEGMENTS // len(chosen))
    ]
    pieces = [piece[: _MOST_ROWS // len(pieces)] for piece in pieces]
    number = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    return replace(log.rows(np.concatenate(pieces)), segment=number)


def best_gains(log: MotorLog, nominal: IdealPd, progress: Callable[[int], None] | None = None) -> IdealPd:
    """One ideal PD for all M motors of the log, fitted from the gains and the limit of a nominal one; M copies of it.

    Args:
        log: with known loads.
        nominal: whose first motor has the constants to begin with.
        progress: called after every evaluation.
    """
    start = {name: float(values[0]) for name, values in vars(nominal).items()}
    return _pd(fit_to_the_end(log, [start], GAINS, progress, _GO_ON).constants, log.num_joints)


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """``num_motors`` copies of the first motor of ``model``."""
    return _pd({name: float(values[0]) for name, values in vars(model).items()}, num_motors)


def _pd(constants: Mapping[str, float], count: int) -> IdealPd:
    return IdealPd.uniform(count, **constants)
