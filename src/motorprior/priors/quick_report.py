"""Quick report of logs: PDs and a prior if loads are known, else responses, on held-out rows."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from motorprior.actuator.constants import Constants
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.evaluation.errors import FREE_RUN_RMSE, PRIOR, TUNED_PD, WHOLE_RUN_RMSE
from motorprior.evaluation.free_runs import (
    FREE_RUN,
    WHOLE_RUN,
    MotorModel,
    Validation,
    free_runs,
    validation_of,
)
from motorprior.evaluation.splits import Split, excited_in_any, long_segments, split
from motorprior.exceptions import LogError, listed
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.baselines.response_fit import (
    RESPONSE_CONSTANTS,
    ResponseMotors,
    at_bounds,
    fitted_responses,
)
from motorprior.identification.physics.window_runs import whole_runs
from motorprior.identification.presets import identification_preset, recipe_of
from motorprior.logs.loads import with_placeholder_load
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog
from motorprior.logs.operations import drop_repeats, joined, resample
from motorprior.logs.prepare_log import PERIOD
from motorprior.priors.fit_prior import fit_prior
from motorprior.progress import Note, Progress
from motorprior.robots.robot import Robot

QUANTITIES = {FREE_RUN: FREE_RUN_RMSE, WHOLE_RUN: WHOLE_RUN_RMSE}  # errors of each span
PRESET = "quick"
# training log of all joints for motors and for responses, and maximum per joint [s]; the fit takes
# most of the minute
MOTOR_SECONDS = 144.0
RESPONSE_SECONDS = 72.0
MAX_SECONDS = 48.0
TEST_SECONDS = 120.0
SECOND_ORDER = "second_order"
SERVO_LIMITS = "servo_limits"
# constant of servo_limits, factor to its unit, and unit
REPORTED = {
    "delay": ("delay", 1.0, "s"),
    "bandwidth": ("rate", 0.5 / np.pi, "Hz"),
    "dead_band": ("band", 1.0, "rad"),
    "gain": ("gain", 1.0, "1"),
    "offset": ("offset", 1.0, "rad"),
    "speed_limit": ("speed", 1.0, "rad/s"),
    "acceleration_limit": ("acceleration", 1.0, "rad/s²"),
}


def report_on_motors(
    logs: Mapping[str, MotorLog], robot: Robot | None, seed: int, folder: Path, progress: Progress
) -> tuple[Validation, str]:
    """Fit a prior and a PD to prepared logs, and evaluate them on the logs' test rows.

    Args:
        logs: with loads, by name.
        robot: of the logs, if it is known.
        seed: of the fit.
        folder: of the prior.
        progress: where to report to.

    Returns:
        Errors, warnings and constants; and the rule by which the logs were split.
    """
    motor_split = _split(logs, MOTOR_SECONDS)
    train_logs = list(motor_split.train.values())
    train = joined(train_logs)
    tuned = fitted_tuned_pd(train, progress)

    warnings: list[str] = []

    def collect(note: Note) -> None:
        progress.report(note)
        if note.severity == "warning":
            warnings.append(note.text)

    collecting = Progress(collect, progress.print_line)
    prior = fit_prior(train_logs, PRESET, seed, out=folder, progress=collecting)

    models: dict[str, MotorModel] = {TUNED_PD: tuned}
    ideal_pd = _ideal_pd(train, robot)
    if ideal_pd is not None:
        models["ideal_pd"] = ideal_pd
    models[PRIOR] = prior.model.motors(prior.predicted(train).mean)
    if train.num_joints > 1:
        class_means = prior.classes.mean_and_std(prior.joint_classes(train))[0]
        models["prior_mean"] = prior.model.motors(class_means)

    recipe = recipe_of(prior)
    runs = {name: free_runs(log, recipe) for name, log in motor_split.test.items()}
    validation = validation_of(
        motor_split.test, runs, QUANTITIES, models, PRIOR, plotted=(TUNED_PD, PRIOR)
    )
    warnings += validation.warnings
    return replace(validation, warnings=warnings, constants=prior.constants()), motor_split.rule


def report_on_responses(
    logs: Mapping[str, MotorLog], seed: int, progress: Progress
) -> tuple[Validation, str]:
    """Fit responses, which need no load, and evaluate them; see `report_on_motors`."""
    response_split = _split(logs, RESPONSE_SECONDS, _on_grid)
    recipe = identification_preset("rollout")
    train = joined(list(response_split.train.values()))
    models = fitted_responses(train, recipe, seed, progress)
    if not models:
        raise LogError(
            f"{train.command_mode} commands, and the loads are unknown",
            where=train.source,
            remedy="give the robot, whose model gives the loads, or log the loads",
        )
    runs = {}
    for name, log in response_split.test.items():
        runs[name] = {WHOLE_RUN: whole_runs(with_placeholder_load(log), recipe)}
    validation = validation_of(
        response_split.test,
        runs,
        {WHOLE_RUN: WHOLE_RUN_RMSE},
        models,
        SERVO_LIMITS,
        plotted=(SECOND_ORDER, SERVO_LIMITS),
    )

    constants, warnings = _constants_of(models[SERVO_LIMITS], train.joint_names)
    return replace(validation, warnings=warnings, constants=constants), response_split.rule


def _split(
    logs: Mapping[str, MotorLog],
    seconds: float,
    change: Callable[[MotorLog], MotorLog] = lambda log: log,
) -> Split:
    """Training and test rows of the logs, for the joints that are excited.

    ``seconds`` is the duration of the training rows, summed over joints; ``change`` is applied to
    the training and the test rows of each log.
    """
    excited = excited_in_any(logs)
    if not excited:
        remedy = "record with a moving command"
        raise LogError(f"{', '.join(logs)}: no joint is excited", remedy=remedy)

    recorded_split = split(logs, min(MAX_SECONDS, seconds / len(excited)), TEST_SECONDS)
    train = {name: change(log) for name, log in recorded_split.train.items()}
    test = {name: change(log) for name, log in recorded_split.test.items()}
    return Split(train, test, recorded_split.rule).with_joints(excited_in_any(train))


def _on_grid(log: MotorLog) -> MotorLog:
    """The log on a grid, without static segments, repeated rows and short segments.

    A response follows each reading, so that a repeated reading would count as delay.
    """
    moves = np.zeros(log.num_rows, dtype=bool)
    for segment in log.segment_slices():
        moves[segment] = np.ptp(log.joint_pos[segment], axis=0).any()
    moving = drop_repeats(log.rows(moves) if moves.any() else log)
    long = long_segments(moving)
    return resample(log if long is None else long, PERIOD)


def _constants_of(
    responses: ResponseMotors, joint_names: tuple[str, ...]
) -> tuple[Constants, list[str]]:
    """Constants of responses with limits that a joint needs, and warnings of those at bounds."""
    fitted = dict(zip(RESPONSE_CONSTANTS, responses.constants.T, strict=True))
    bounds = at_bounds(responses)
    values = {}
    units = {}
    identified = {}
    warnings = []
    for name, (key, factor, unit) in REPORTED.items():
        # a part that no joint needs
        if np.allclose(fitted[key], RESPONSE_CONSTANTS[key], atol=1e-6):
            continue
        at_bound = bounds.get(key, np.zeros(len(joint_names), bool))  # an offset has no bounds
        values[name] = factor * fitted[key]
        units[name] = unit
        identified[name] = not at_bound.any()
        if at_bound.any():
            joints = []
            for joint in np.flatnonzero(at_bound):
                joints.append(f"{joint_names[joint]} {values[name][joint]:.3g} {unit}")
            problem = f"{name} at a bound of the search, so not identifiable"
            warnings.append(f"{problem}: {listed(joints, 6)}")
    return Constants.of(values, units, identified), warnings


def _ideal_pd(log: MotorLog, robot: Robot | None) -> MotorModel | None:
    """A PD with the logged gains or, without any, with the robot's gains.

    None if neither has gains in N·m/rad.
    """
    limit = np.full(log.num_joints, 1e9)
    joints = []
    if robot is not None:
        joints = [robot.joint_names.index(name) for name in log.joint_names]
        limit = np.array([robot.joints[index].torque_limit for index in joints])

    zeros = np.zeros(log.num_joints)
    ones = np.ones(log.num_joints)
    if log.logged_kd is not None and log.gain_unit == PHYSICAL_GAINS:
        return GainScaledPd(IdealPd.without_friction(ones, ones, limit, zeros, zeros), np.ones(2))
    gains = None if robot is None else robot.gains
    if gains is None or log.logged_kp is not None:
        return None
    kp, kd = gains[:, joints]
    return IdealPd.without_friction(kp, kd, limit, zeros, zeros)
