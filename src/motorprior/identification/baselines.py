"""The baselines, tuned with care: an ideal PD, and a PD with armature and delay fitted to the bench logs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rmse

_SEGMENTS = 5
"""Segments of the log that the fit replays: one of each excitation of the bench's wide preset."""


def trials(log: MotorLog, count: int) -> list[tuple[Trial, np.ndarray]]:
    """The first ``count`` segments of a bench log as trials, each with the joint_pos (steps, n) it gave."""
    found = []
    for part in list(log.segments())[:count]:
        assert part.external_torque is not None and part.load_inertia is not None
        dt = float(np.median(np.diff(part.time)))
        trial = Trial(part.position_target, part.external_torque, part.load_inertia[0], dt)
        found.append((trial, part.joint_pos))
    return found


def _pd(values: np.ndarray, num_motors: int) -> IdealPd:
    kp, kd, torque_limit, armature, delay = np.exp(values)
    return IdealPd.uniform(num_motors, kp, kd, torque_limit, armature, delay)


def fit_tuned_pd(log: MotorLog, start: IdealPd, progress: Callable[[int], None] | None = None) -> IdealPd:
    """One set of kp, kd, torque limit, armature and delay for all motors: least closed-loop joint RMSE.

    Nelder-Mead over the logarithms, from ``start`` with 1 g·m² of armature and 8 ms of delay; the objective is the mean
    over motors of the joint RMSE [rad] when the log's commands and loads are replayed on the dynamometer.

    Returns:
        A PD for one motor, to be repeated for as many as are simulated.
    """
    cases, count = trials(log, _SEGMENTS), log.num_joints

    def cost(values: np.ndarray) -> float:
        model = _pd(values, count)
        errors = [rmse(run(model, trial).joint_pos, truth, axis=0) for trial, truth in cases]
        if progress is not None:
            progress(1)
        return float(np.mean(errors))

    first = np.log([start.kp[0], start.kd[0], start.torque_limit[0], 0.001, 0.008])
    options = {"maxfev": 200, "xatol": 1e-3, "fatol": 1e-6, "initial_simplex": _simplex(first)}
    return _pd(minimize(cost, first, method="Nelder-Mead", options=options).x, 1)


def _simplex(first: np.ndarray) -> np.ndarray:
    return np.vstack([first, *(first + 0.3 * row for row in np.eye(len(first)))])


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """The first motor of ``model``, ``num_motors`` times."""
    return IdealPd.uniform(
        num_motors, model.kp[0], model.kd[0], model.torque_limit[0], model.armature[0], model.delay[0]
    )
