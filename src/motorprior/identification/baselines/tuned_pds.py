"""PDs fitted to a log with known loads, the same for all its motors: gains alone, or armature and delay besides.

Of a log that shows neither clearly, a slow rotor and a late one are alike, and a search from one of them does not find
the other. So it begins at the best of many gains and limits with each of some armatures and delays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines.pd_fit import Effort, beginnings, fit_to_the_end, pd_motors
from motorprior.identification.baselines.replay_error import Told, as_they_are, closed_loop_error
from motorprior.logs.motor_log import MotorLog

GAINS = ("kp", "kd", "torque_limit")
"""Constants that are fitted for an ideal PD."""
EVERYTHING = (*GAINS, "armature", "delay")
"""Constants that are fitted for the tuned PD."""
FRICTION = (*EVERYTHING, "coulomb")
"""Constants that are fitted for a PD with friction."""
_SIZES = tuple(product((2.0, 8.0, 32.0, 128.0), (0.02, 0.06, 0.18), (1.5, 15.0, 150.0)))
"""kp [N·m/rad], kd/kp [s] and torque_limit [N·m] that are tried: of small servos to large direct drives."""
_LAGS = {"armature": (0.001, 0.02), "delay": (0.008, 0.04)}
"""[kg·m²], [s]; with each of these a search begins, at the best of the sizes with them."""
_EFFORT = Effort(first=80, rounds=3, evaluations=200)
TUNING = len(_SIZES) * 4 + _EFFORT.most(4)
"""About how often `tuned_pd` reports."""
GAINS_ALONE = _EFFORT.most(1)
"""About how often `best_gains` reports."""


def tuned_pd(log: MotorLog, progress: Callable[[int], None] | None = None, told: Told = as_they_are) -> IdealPd:
    """One PD with armature and delay for all M motors of the log, with the least closed-loop error; M copies of it.

    Nothing needs to be known of the motors. The whole log counts: motions of a real one show other things each.

    Args:
        log: with known loads.
        progress: called after every evaluation.
        told: what the PD is told of each segment.
    """
    error = closed_loop_error(log, progress, told)

    def cost(constants: Mapping[str, float]) -> float:
        return error(pd_motors(constants, log.num_joints))

    sizes = [{"kp": kp, "kd": kp * share, "torque_limit": limit} for kp, share, limit in _SIZES]
    best = [min((size | lag for size in sizes), key=cost) for lag in beginnings({}, EVERYTHING, _LAGS)]
    return _pd(fit_to_the_end(log, best, EVERYTHING, progress, _EFFORT, told).constants, log.num_joints)


def best_gains(log: MotorLog, nominal: IdealPd, progress: Callable[[int], None] | None = None) -> IdealPd:
    """One ideal PD for all M motors of the log, fitted from the gains and the limit of a nominal one; M copies of it.

    Args:
        log: with known loads.
        nominal: whose first motor has the constants to begin with.
        progress: called after every evaluation.
    """
    start = {name: float(values[0]) for name, values in vars(nominal).items()}
    return _pd(fit_to_the_end(log, [start], GAINS, progress, _EFFORT).constants, log.num_joints)


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """``num_motors`` copies of the first motor of ``model``."""
    return _pd({name: float(values[0]) for name, values in vars(model).items()}, num_motors)


def _pd(constants: Mapping[str, float], count: int) -> IdealPd:
    return IdealPd.uniform(count, **constants)
