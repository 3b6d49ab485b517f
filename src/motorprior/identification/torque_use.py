"""Whether a fit uses a torque column.

A column with another sign or another time than the torque of the known loads is not used: gains and
friction make up for it, so that the angles hardly show it.

A torque from the motor's current is not the torque on the joint: rotor and gear friction are
between both, and its torque constant may be wrong. A fit to it has larger errors of the angles and
wrong constants. Motors are fitted to half of the windows with and without the column, and compared
on the other half. The column is used only if it does not raise the error of held-out angles.
"""

from dataclasses import replace

import numpy as np

from motorprior.exceptions import listed
from motorprior.identification.explanations.attempt import Attempts
from motorprior.identification.physics.motor_fit import fit_rigid_motors
from motorprior.identification.physics.motor_problem import grey_box
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData, spread_windows
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.torque_column import torque_column
from motorprior.progress import Note

_MAX_RISE = 1.1  # of the held-out error by the column
_MIN_ERROR = 0.1e-3  # smaller errors are equal [rad]
_RESTARTS = 2
_MAX_MOTORS = 3  # motors that are fitted


def with_usable_torque(
    log: MotorLog, data: TrainingData, recipe: Recipe
) -> tuple[TrainingData, list[Note]]:
    """The data, without torques if these contradict the loads or raise the held-out error.

    There is a note if torques are left out.
    """
    if not data.has_torque or data.command_mode in ("velocity", "torque"):
        return data, []

    count = len(data.series)
    motors = np.unique(np.linspace(0, count - 1, min(count, _MAX_MOTORS)).astype(int))
    descriptions = []
    contradictions = 0
    for motor in motors.tolist():
        column = torque_column(log, motor)
        if column is not None:
            descriptions.append(f"{log.joint_names[motor]} {column}")
            contradictions += column.contradicts_load
    by_loads = f"by the known loads it is {listed(descriptions, 4)}"
    without_torque = replace(data, has_torque=False)
    if 2 * contradictions > len(motors):
        text = f"joint_torque is not used: {by_loads} -> correct its sign and time to use it"
        return without_torque, [Note("warning", text)]

    windows = spread_windows(data, recipe)
    train = replace(windows, segments=windows.segments[::2])
    test = replace(windows, segments=windows.segments[1::2], has_torque=False)
    if not test.segments:
        return data, []

    errors_with = _held_out_errors(train, test, recipe, motors)
    errors_without = _held_out_errors(replace(train, has_torque=False), test, recipe, motors)
    rise = np.median(np.maximum(errors_with, _MIN_ERROR) / np.maximum(errors_without, _MIN_ERROR))
    if rise <= _MAX_RISE:
        return data, []

    text = (
        f"joint_torque is not used: the error of held-out angles is "
        f"{1e3 * np.median(errors_with):.2g} mrad with it and "
        f"{1e3 * np.median(errors_without):.2g} without"
    )
    if descriptions:
        text += f"; {by_loads}"
    return without_torque, [Note("warning", text)]


def _held_out_errors(
    train: TrainingData, test: TrainingData, recipe: Recipe, motors: np.ndarray
) -> np.ndarray:
    """(m,) position errors [rad] on the test windows of some motors, fitted to other windows."""
    runs = WindowRuns(train, recipe, motors)
    simplest = fit_rigid_motors(runs, recipe.logged_terms, seed=0)
    model = grey_box(simplest.center, simplest.terms, recipe)
    attempts = Attempts(model, simplest.offsets, runs, _RESTARTS)
    attempts.unchanged(np.arange(len(motors)))
    return attempts.errors_on(WindowRuns(test, recipe, motors))
