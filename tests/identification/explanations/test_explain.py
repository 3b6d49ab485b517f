"""A fit whose inputs contradict the model is explained by the right cause, with its value."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import two_link_arm
from swinging_weights import KD, KP, PERIOD, World, swing

from motorprior.identification.explanations.attempt import Attempts
from motorprior.identification.explanations.explain import Explanations, explain
from motorprior.identification.physics.motor_fit import fit_rigid_motors
from motorprior.identification.physics.motor_problem import grey_box
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS, with_logged_settings
from motorprior.identification.windows import spread_windows, training_data
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined

SECONDS = 16.0


def explained(log: MotorLog) -> Explanations:
    """Explanations of motors that are fitted to some windows of the log as it is."""
    recipe = with_logged_settings(PRESETS["quick"], log)
    data = training_data(log, recipe, log.source)
    runs = WindowRuns(spread_windows(data, recipe), recipe)
    fit = fit_rigid_motors(runs, (), seed=0)
    attempts = Attempts(grey_box(fit.center, fit.terms, recipe), fit.offsets, runs)
    attempts.unchanged(np.arange(log.num_joints))
    return explain(log, data, recipe, attempts.model, attempts.fitted)


def lead(time: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Command with the velocity feed-forward kd/kp times its rate."""
    return command + KD / KP * np.gradient(command, PERIOD, axis=0)


def late(time: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Command 90 ms later, longer than a motor's delay can be."""
    rows = round(0.09 / PERIOD)
    return np.concatenate([np.repeat(command[:1], rows, axis=0), command[:-rows]])


# fields of the world, stated gains, and equally good explanations, each with its parameters and
# their tolerances
CASES: dict[str, tuple[dict[str, Any], float | None, dict[str, list[tuple[float, float]]]]] = {
    "drive multiplies the gains": (
        {},
        0.25,
        {"stated_gains": [(np.log(4.0), 0.1)], "load": [(-np.log(4.0), 0.1), (-np.log(4.0), 0.2)]},
    ),
    "gains in another unit": (
        {},
        8.0,
        {"stated_gains": [(-np.log(8.0), 0.1)], "load": [(np.log(8.0), 0.1), (np.log(8.0), 0.2)]},
    ),
    "heavier load": ({"load": 2.0}, 1.0, {"load": [(np.log(2.0), 0.1), (np.log(2.0), 0.2)]}),
    "gravity compensation": ({"compensation": 1.0}, 1.0, {"weight": [(1.0, 0.06)]}),
    "scaled actions": (
        {"command": lambda time, command: 0.25 * command},
        1.0,
        {"command_scale": [(np.log(0.25), 0.05), (0.0, 0.1)]},
    ),
    "actions about a default": (
        {"command": lambda time, command: 0.5 * command - 0.7},
        1.0,
        {"command_scale": [(np.log(0.5), 0.05), (-0.7, 0.05)]},
    ),
    "zero of another day": ({"hangs_at": -0.4}, 1.0, {"zero": [(0.4, 0.03)]}),
    "another gear ratio": (
        {"ratio": 1.5},
        1.0,
        {"joint_scale": [(np.log(1.5), 0.03)]},
    ),
    "velocity target": ({"command": lead}, 1.0, {"velocity_target": [(KD / KP, 0.2 * KD / KP)]}),
    "late command": ({"command": late}, 1.0, {"delay": [(0.09, 0.02)]}),
    "end stop": ({"stop": 0.55}, 1.0, {"end_stop": []}),
    "torque off": ({"off_after": 0.7 * SECONDS}, None, {"no_response": []}),
    "load that is 30 % too heavy": (
        {"load": 1.0 / 1.3},
        1.0,
        {
            "stated_gains": [(np.log(1.3), 0.05)],
            "load": [(-np.log(1.3), 0.05), (-np.log(1.3), 0.2)],
        },
    ),
    "60 % of the weight compensated": (
        {"compensation": 0.6},
        1.0,
        {"weight": [(0.6, 0.06)]},
    ),
}


@pytest.mark.parametrize(("world", "gains", "expected"), CASES.values(), ids=list(CASES))
def test_the_cause_is_named_with_its_value(
    world: dict[str, Any], gains: float | None, expected: dict[str, list[tuple[float, float]]]
):
    has_steps = "velocity_target" not in expected  # a step has no rate
    log = swing(SECONDS, 1, 1, World(**world), gains, has_steps)

    explanations = explained(log)

    (cause,) = explanations.causes
    trials = {trial.name: trial for trial in cause.trials}
    assert cause.trials[0].name in expected
    assert expected.keys() <= trials.keys()
    for name, parameters in expected.items():
        assert trials[name].attempt.errors[0] < 0.3 * explanations.errors[0]
        if parameters:
            values = trials[name].estimate(0).values
            true_values, tolerances = np.transpose(parameters)
            assert np.all(np.abs(values - true_values) < tolerances), values


def test_a_feed_forward_torque_of_the_other_sign_is_named_with_its_factor():
    # the controller compensates gravity
    log = swing(SECONDS, 1, 1, World(compensation=1.0), 1.0, True)
    assert log.external_torque is not None
    wrong = replace(log, command_mode="mit", torque_feedforward=log.external_torque)

    (cause,) = explained(wrong).causes

    trials = {trial.name: trial for trial in cause.trials}
    assert trials["feedforward_scale"].estimate(0).values[0] == pytest.approx(-2.0, abs=0.1)


def test_torque_that_is_off_for_a_while_is_named_with_the_rows_of_the_fall():
    log = swing(SECONDS, 12, 1, World(off_after=0.4 * SECONDS, on_after=0.6 * SECONDS))

    explanations = explained(log)

    (cause,) = explanations.causes
    (trial,) = cause.trials
    assert trial.name == "no_response"
    assert trial.attempt.errors[0] < 1e-3


def test_gravity_compensation_is_named_without_stated_gains():
    log = swing(SECONDS, 20, 1, World(compensation=1.0), None)

    (cause,) = explained(log).causes

    assert cause.trials[0].name == "weight"
    assert cause.trials[0].estimate(0).values[0] == pytest.approx(1.0, abs=0.06)


def test_commands_in_degrees_have_their_scale():
    log = swing(SECONDS, 14)
    degrees = replace(log, position_target=np.degrees(log.position_target))

    (cause,) = explained(degrees).causes

    assert cause.trials[0].name == "command_scale"
    assert np.exp(cause.trials[0].estimate(0).values[0]) == pytest.approx(np.pi / 180.0, rel=0.02)


def test_a_kd_in_another_unit_is_named():
    log = swing(SECONDS, 11)
    assert log.logged_kd is not None

    (cause,) = explained(replace(log, logged_kd=4.0 * log.logged_kd)).causes

    assert cause.trials[0].name == "stated_kd"
    assert np.exp(cause.trials[0].estimate(0).values[0]) == pytest.approx(0.25, rel=0.1)


def test_another_clock_in_one_log_is_named():
    def later(time: np.ndarray, command: np.ndarray) -> np.ndarray:
        rows = round(0.026 / PERIOD)
        return np.concatenate([np.repeat(command[:1], rows, axis=0), command[:-rows]])

    logs = [swing(SECONDS, 15), swing(SECONDS, 16, 1, World(command=later))]

    (cause,) = explained(joined(logs)).causes

    trials = {trial.name: trial for trial in cause.trials}
    assert trials["delay_of_log of log 1"].estimate(0).values[0] == pytest.approx(0.026, abs=2e-3)


def test_an_end_stop_at_the_other_side_is_named():
    log = swing(SECONDS, 19, 1, World(stop=0.5))
    assert log.external_torque is not None
    mirrored = replace(
        log,
        position_target=-log.position_target,
        joint_pos=-log.joint_pos,
        external_torque=-log.external_torque,
    )

    (cause,) = explained(mirrored).causes

    assert [trial.name for trial in cause.trials] == ["end_stop"]


def test_a_factor_on_gains_may_be_one_on_the_load():
    (note,) = explained(swing(SECONDS, 1, 1, World(load=2.0))).notes()

    assert "the weight of the load is" in note.text
    assert "Equally good: left: the stated kp and kd are" in note.text


@pytest.mark.parametrize("gains", [1.0, None])
def test_a_log_without_contradictions_needs_no_explanation(gains: float | None):
    explanations = explained(swing(SECONDS, 2, 2, stated_gains=gains))

    assert explanations.causes == ()
    assert explanations.notes() == []


def test_only_the_log_and_the_joint_at_fault_are_named():
    good = swing(SECONDS, 3, 2)
    bad = swing(SECONDS, 4, 2, World(hangs_at=np.array([0.0, 0.35])))
    named = [
        joined([good]),
        MotorLog(**{**vars(bad), "source": "day2"}),
    ]

    explanations = explained(joined(named))

    (cause,) = explanations.causes
    assert cause.joints == (1,)
    assert cause.trials[0].name == "zero of log 1"
    warning, information = explanations.notes()
    assert "right" in warning.text
    assert "day2" in warning.text
    assert "moved by 0.3" in warning.text
    assert "left" not in warning.text
    assert "left" in information.text


def test_a_note_never_asks_for_another_seed():
    log = swing(SECONDS, 5, 1, World(command=lambda time, command: command * (1.0 + 0.4 * command)))

    notes = explained(log).notes()

    assert any("lacks physics" in note.text for note in notes)
    assert not any("seed" in note.text for note in notes)


def test_a_part_that_the_model_of_the_load_lacks_is_named_with_its_mass(tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path)
    log = two_link_arm.swing(arm, SECONDS, 1, tool_mass=0.3)

    explanations = explained(log)

    (cause,) = explanations.causes
    best = cause.trials[0]
    assert cause.joints == (0, 1)
    assert best.name == "mass_of_link"
    estimate = best.common_estimate(cause.joints)
    assert estimate is not None
    moment, log_distance = estimate.values
    distance = two_link_arm.FOREARM_REACH * np.exp(log_distance)
    assert moment * two_link_arm.FOREARM_MASS * two_link_arm.FOREARM_REACH == pytest.approx(
        0.3 * 0.3, rel=0.1
    )
    assert distance == pytest.approx(0.3, abs=0.06)
    (note,) = explanations.notes()
    assert note.text.startswith("shoulder, elbow: the model of the load lacks 0.0")


TILT = np.deg2rad(20.0)


@pytest.mark.parametrize(("axes", "states_gains"), [("yx", False), ("yx", True), ("yy", True)])
def test_the_roll_of_a_tilted_base_is_named(axes: str, states_gains: bool, tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path, axes=axes)
    log = two_link_arm.swing(
        arm, SECONDS, 1, tilt=(TILT, 0.0), axes=axes, states_gains=states_gains
    )

    explanations = explained(log)

    (cause,) = explanations.causes
    tilt = next(trial for trial in cause.trials if trial.name == "tilt")
    estimate = tilt.common_estimate(cause.joints)
    assert estimate is not None
    # the side to which the plane of a planar arm is tilted has no effect
    sign = np.sign(estimate.values[0]) if axes == "yy" else 1.0
    assert sign * estimate.values[0] == pytest.approx(TILT, abs=np.deg2rad(3.0))
    assert estimate.values[1] == pytest.approx(0.0, abs=np.deg2rad(3.0))
    low, high = np.sort([sign * estimate.low[0], sign * estimate.high[0]])
    assert low < TILT < high


def test_a_planar_arm_on_a_pitched_base_has_another_zero_of_its_first_joint(tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path, axes="yy")
    log = two_link_arm.swing(arm, SECONDS, 4, tilt=(0.0, -0.7 * TILT), axes="yy")

    (cause,) = explained(log).causes

    trials = {trial.name: trial for trial in cause.trials}
    assert {"tilt", "zero"} <= trials.keys()
    assert trials["zero"].turned_joint == 0
    assert trials["tilt"].estimate(0).values[1] == pytest.approx(-0.7 * TILT, abs=0.03)


def test_one_zero_in_one_log_is_the_only_cause(tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path, axes="zyy")
    days = [
        two_link_arm.swing(arm, SECONDS, 4, axes="zyy"),
        two_link_arm.swing(arm, SECONDS, 5, axes="zyy", elbow_zero=0.25),
    ]

    (cause,) = explained(joined(days)).causes

    best = cause.trials[0]
    assert best.name == "zero of log 1"
    assert best.turned_joint == 2
    estimate = best.common_estimate(cause.joints)
    assert estimate is not None
    assert estimate.values[0] == pytest.approx(-0.25, abs=0.03)


@pytest.mark.parametrize("axes", ["yx", "zyy"])
def test_an_arm_whose_inputs_are_right_needs_no_explanation(axes: str, tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path, axes=axes)

    assert explained(two_link_arm.swing(arm, SECONDS, 7, axes=axes)).causes == ()


def test_the_zero_of_one_joint_explains_the_errors_of_the_joint_that_carries_it(tmp_path: Path):
    arm = two_link_arm.robot_of(tmp_path)
    log = two_link_arm.swing(arm, SECONDS, 2, elbow_zero=0.25)

    explanations = explained(log)

    (cause,) = explanations.causes
    best = cause.trials[0]
    assert best.name == "zero"
    assert best.turned_joint == 1
    assert 1 in cause.joints
    assert best.estimate(1).values[0] == pytest.approx(-0.25, abs=0.03)
