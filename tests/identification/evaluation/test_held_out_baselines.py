"""A simpler model that simulates held-out chunks of a log better is named, and no other one."""

from dataclasses import replace

import numpy as np
from motor_logs import log_of

import motorprior as mp
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.bench.dynamometer import run, trial_of
from motorprior.evaluation.held_out_baselines import better_baselines
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.presets import PRESETS
from motorprior.progress import SILENT

RECIPE = PRESETS["quick"]
DELAY = 25  # of a stiff drive [rows]
MEAN = np.zeros((1, len(PARAMETERS)))  # latents of the initial motor


def motors() -> GreyBox:
    return grey_box(initial_center(()), (), RECIPE)


def stiff_drive() -> mp.MotorLog:
    """A joint that follows its commands after DELAY, with a small load."""
    time = RECIPE.period * np.arange(6000)
    target = 0.4 * np.sin(2.0 * np.pi * (0.3 + 0.05 * time) * time)
    pos = np.concatenate([np.zeros(DELAY), target[:-DELAY]])
    load = {
        "load_inertia": np.full((len(time), 1), 0.002),
        "external_torque": np.zeros((len(time), 1)),
    }
    return log_of(time, target, pos, **load)


def test_a_stiff_drive_is_a_response_of_its_command():
    (warning,) = better_baselines(motors(), MEAN, stiff_drive(), RECIPE, 0, SILENT)

    assert warning.startswith(("pure_delay", "second_order", "servo_limits")), warning
    assert "not fitted to" in warning


def test_a_log_that_the_motors_explain_has_no_better_baseline():
    log = stiff_drive()
    model = motors()
    response = run(model.motors(MEAN), trial_of(log))
    own = replace(log, joint_pos=response.joint_pos)

    assert better_baselines(model, MEAN, own, RECIPE, 0, SILENT) == []
