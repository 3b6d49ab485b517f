"""A torque column from the motor's current does not change the constants of a motor."""

import numpy as np
import pytest
from scipy.signal import savgol_filter
from swinging_weights import INERTIA, KP, MOTOR, PERIOD, WEIGHT, swing

from motorprior.identification.explanations.attempt import Attempts
from motorprior.identification.physics.motor_fit import fit_rigid_motors
from motorprior.identification.physics.motor_problem import grey_box
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS, with_logged_settings
from motorprior.identification.torque_use import with_usable_torque
from motorprior.identification.windows import spread_windows, training_data
from motorprior.logs.motor_log import MotorLog


def with_motor_torque(log: MotorLog, factor: float) -> MotorLog:
    """The log with ``factor`` times the torque of the motor, before rotor and friction."""
    velocity = derivative(log.joint_pos, 1)
    acceleration = derivative(log.joint_pos, 2)
    friction = MOTOR["coulomb"] * np.sign(velocity) + MOTOR["viscous_damping"] * velocity
    inertia = INERTIA + MOTOR["armature"]
    torque = inertia * acceleration + WEIGHT * np.sin(log.joint_pos) + friction
    return MotorLog(**{**vars(log), "joint_torque": factor * torque})


def derivative(angles: np.ndarray, order: int) -> np.ndarray:
    """Smooth derivative of angles (T, J)."""
    return np.asarray(savgol_filter(angles, 51, 3, order, PERIOD, axis=0))


@pytest.mark.parametrize("factor", [1.0, 1.4, 1.96])
def test_gain_and_rotor_are_those_of_the_known_load(factor: float):
    log = with_motor_torque(swing(16.0, 1, stated_gains=None), factor)
    recipe = with_logged_settings(PRESETS["quick"], log)
    data, _ = with_usable_torque(log, training_data(log, recipe, log.source), recipe)
    runs = WindowRuns(spread_windows(data, recipe), recipe)

    simplest = fit_rigid_motors(runs, (), seed=0)
    attempts = Attempts(grey_box(simplest.center, (), recipe), simplest.offsets, runs)
    attempts.unchanged(np.array([0]))

    constants = attempts.model.constants(attempts.fitted)
    assert constants["kp"][0] == pytest.approx(KP, rel=0.05)
    assert constants["armature"][0] == pytest.approx(MOTOR["armature"], rel=0.2)
