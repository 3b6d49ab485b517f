"""Baselines fitted to the bench log: a PD with its gains alone, and a PD with armature and delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rmse

EVALUATIONS = 200
"""Largest number of evaluations of the objective."""
_SEGMENTS = 5
"""Number of log segments that the fit replays: one per excitation of the bench's preset ``rollout``."""


def trials(log: MotorLog, count: int) -> list[tuple[Trial, np.ndarray]]:
    """The first ``count`` segments of a bench log as trials, each with its recorded joint_pos (steps, n) [rad]."""
    found = []
    for part in list(log.segments())[:count]:
        assert part.external_torque is not None and part.load_inertia is not None
        dt = float(np.median(np.diff(part.time)))
        trial = Trial(part.position_target, part.external_torque, part.load_inertia[0], dt)
        found.append((trial, part.joint_pos))
    return found


GAINS = ("kp", "kd", "torque_limit")
"""Constants that are fitted for an ideal PD."""
EVERYTHING = (*GAINS, "armature", "delay")
"""Constants that are fitted for the tuned PD."""
_START = {"armature": 0.001, "delay": 0.008}


def fit_pd(
    log: MotorLog, nominal: IdealPd, free: tuple[str, ...], progress: Callable[[int], None] | None = None
) -> IdealPd:
    """Fit one PD, shared by all motors, with the least closed-loop error on the bench log.

    Nelder-Mead over the logarithms of the ``free`` constants; the objective is the mean over motors of the joint
    RMSE [rad] when the log's commands and loads are replayed on the dynamometer.

    Args:
        log: a bench log.
        nominal: initial kp, kd and torque_limit; armature and delay, if free, start at 0.001 kg·m² and 0.008 s.
        free: GAINS or EVERYTHING; the other constants stay nominal.
        progress: called after every evaluation.

    Returns:
        A PD of one motor; `repeated` copies it for several.
    """
    cases, count = trials(log, _SEGMENTS), log.num_joints
    first = np.log([_START.get(name, float(getattr(nominal, name)[0])) for name in free])

    def model(values: np.ndarray) -> IdealPd:
        chosen = {name: np.array([value]) for name, value in zip(free, np.exp(values), strict=True)}
        return replace(nominal, **chosen)

    def cost(values: np.ndarray) -> float:
        motors = repeated(model(values), count)
        errors = [rmse(run(motors, trial).joint_pos, truth, axis=0) for trial, truth in cases]
        if progress is not None:
            progress(1)
        return float(np.mean(errors))

    options = {"maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-6, "initial_simplex": _simplex(first)}
    return model(minimize(cost, first, method="Nelder-Mead", options=options).x)


def _simplex(first: np.ndarray) -> np.ndarray:
    return np.vstack([first, *(first + 0.3 * row for row in np.eye(len(first)))])


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """``num_motors`` copies of the first motor of ``model``."""
    return IdealPd.uniform(
        num_motors, model.kp[0], model.kd[0], model.torque_limit[0], model.armature[0], model.delay[0]
    )
