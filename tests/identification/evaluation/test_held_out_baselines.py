"""A simpler model that simulates held-out chunks of a log better is named, and no other one."""

from dataclasses import replace

import numpy as np
from motor_logs import log_of

import motorprior as mp
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import with_command_mode
from motorprior.bench.dynamometer import run, trial_of
from motorprior.evaluation.held_out_baselines import better_baselines
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.presets import PRESETS, with_logged_settings
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
    (note,) = better_baselines(motors(), MEAN, stiff_drive(), RECIPE, 0, SILENT)

    assert note.text.startswith(("pure_delay", "second_order", "servo_limits")), note
    assert "not fitted to" in note.text


def test_a_log_too_short_for_a_comparison_gets_a_note():
    short = stiff_drive().rows(slice(0, 900))
    (note,) = better_baselines(motors(), MEAN, short, RECIPE, 0, SILENT)

    assert note.severity == "info"
    assert "too short" in note.text


def test_a_rigid_motor_that_replays_torques_better_is_named():
    # a spring of 2 N·m/rad is the load
    time = RECIPE.period * np.arange(6000)
    torque = 0.6 * np.sin(2.0 * np.pi * (0.5 + 0.05 * time) * time)[:, None]
    load = {
        "load_inertia": np.full_like(torque, 0.01),
        "external_torque": np.zeros_like(torque),
        "load_stiffness": np.full_like(torque, -2.0),
    }
    silent = log_of(time, 0.0 * time, command_mode="torque", torque_feedforward=torque, **load)
    model = replace(motors(), command_mode="torque")
    recipe = with_logged_settings(RECIPE, silent)
    model = replace(model, gain_unit=recipe.gain_unit)
    motor = with_command_mode(model.motors(MEAN, gains=np.ones((2, 1))))
    angle = run(motor, trial_of(silent)).joint_pos
    log = replace(silent, joint_pos=angle, position_target=angle, external_torque=-2.0 * angle)
    heavy = MEAN.copy()  # four times the armature
    heavy[0, PARAMETERS.index("armature")] = np.log(4.0)

    (note,) = better_baselines(model, heavy, log, recipe, 0, SILENT)

    assert note.text.startswith("coulomb_viscous")
    assert not better_baselines(model, MEAN, log, recipe, 0, SILENT)


def test_a_log_that_the_motors_explain_has_no_better_baseline():
    log = stiff_drive()
    model = motors()
    response = run(model.motors(MEAN), trial_of(log))
    own = replace(log, joint_pos=response.joint_pos)

    assert better_baselines(model, MEAN, own, RECIPE, 0, SILENT) == []
