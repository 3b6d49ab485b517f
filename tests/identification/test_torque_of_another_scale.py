"""A torque column from the motor's current does not change the constants of a motor."""

from dataclasses import replace
from pathlib import Path

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
from motorprior.logs.load_log import load_log
from motorprior.logs.motor_log import MotorLog


def with_motor_torque(log: MotorLog, factor: float) -> MotorLog:
    """The log with ``factor`` times the torque of the motor, before rotor and friction."""
    velocity = derivative(log.joint_pos, 1)
    acceleration = derivative(log.joint_pos, 2)
    friction = MOTOR["coulomb"] * np.sign(velocity) + MOTOR["viscous_damping"] * velocity
    inertia = INERTIA + MOTOR["armature"]
    torque = inertia * acceleration + WEIGHT * np.sin(log.joint_pos) + friction
    return MotorLog(**{**vars(log), "joint_torque": factor * torque})


def late(log: MotorLog, seconds: float) -> MotorLog:
    """The log with its torque column later by some rows."""
    assert log.joint_torque is not None
    rows = round(seconds / PERIOD)
    first = np.repeat(log.joint_torque[:1], rows, axis=0)
    return replace(log, joint_torque=np.concatenate([first, log.joint_torque[:-rows]]))


def reversed_torque(log: MotorLog) -> MotorLog:
    """The log with the opposite sign of its torque column."""
    assert log.joint_torque is not None
    return replace(log, joint_torque=-log.joint_torque)


def is_used(log: MotorLog) -> tuple[bool, str]:
    """Whether a fit uses the torque column, and the note on it."""
    recipe = with_logged_settings(PRESETS["quick"], log)
    data, notes = with_usable_torque(log, training_data(log, recipe, log.source), recipe)
    return data.has_torque, " ".join(note.text for note in notes)


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


@pytest.mark.parametrize("seconds", [0.01, 0.02, 0.03])
def test_a_late_torque_is_named_and_not_used(seconds: float):
    used, note = is_used(late(with_motor_torque(swing(16.0, 1, stated_gains=None), 1.0), seconds))

    assert not used
    named = float(note.split(" ms late -> correct its sign and time")[0].split(", ")[-1])
    assert named == pytest.approx(1e3 * seconds, abs=3.0)


def test_a_torque_of_the_opposite_sign_is_named_and_not_used():
    used, note = is_used(with_motor_torque(swing(16.0, 1, stated_gains=None), -1.0))

    assert not used
    assert "left -0.9" in note
    assert "correct its sign" in note


def test_the_current_of_a_servo_is_used_only_at_the_time_and_sign_of_its_load(shared_data: Path):
    folder = shared_data / "cases" / "16-current-as-torque"
    log = load_log(folder / "log.csv", columns=folder / "map_1.0.toml")

    assert is_used(log) == (True, "")
    for wrong in (late(log, 0.01), late(log, 0.02), late(log, 0.03), reversed_torque(log)):
        assert not is_used(wrong)[0]
