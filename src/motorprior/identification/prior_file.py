"""The file of a prior: whether it fits a robot or a log, and notes on what its logs do not identify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import (
    UNKNOWN_TORQUE_SCALE,
    MotorPrior,
    limit_text,
    robot_gains,
    unidentified_limits,
)
from motorprior.bench.dynamometer import BENCH
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.presets import recipe_of
from motorprior.logs.motor_log import MotorLog, range_text

if TYPE_CHECKING:
    from motorprior.robots.robot import Robot

SOFT_GEAR = 5.0  # gear stiffness over position gain [-]; below, a note


def load_prior(path: Path, of: Robot | MotorLog) -> MotorPrior:
    """A prior for the simulation of a robot, or for the motors of a log; errors for one that does not fit."""
    prior = MotorPrior.load(path)
    try:
        if isinstance(of, MotorLog):
            require_adaptable(prior, of)
        else:
            prior.require(of.name, of.physics_dt)
    except (ArtifactError, ConfigError) as error:
        raise type(error)(error.problem, where=path, remedy=error.remedy) from error
    return prior


def require_adaptable(prior: MotorPrior, log: MotorLog) -> None:
    """Check that a prior has latents, a recipe of this version, and the robot of the log; a bench's log names none."""
    recipe_of(prior)
    if prior.model.num_latents == 0:
        raise ArtifactError("it has no latents", remedy="identify it with preset rollout")
    if prior.robot and log.robot not in (BENCH, prior.robot):
        remedy = (
            "identify a prior from logs of that robot; a bench's logs become such by `motorprior logs import` with "
        )
        remedy += "--robot and --as-joint; in Python, prior.for_robot states that the robot has these motors"
        raise ConfigError(f"the prior is of robot {prior.robot!r}, the log of {log.robot!r}", remedy=remedy)


def prior_notes(prior: MotorPrior, robot: Robot) -> list[str]:
    """Notes on limits that the logs of a prior did not reach, other gains than the robot's, and soft gears."""
    notes = [*_gain_note(prior, robot), *_class_note(prior, robot), *_gear_note(prior, robot)]
    if hidden := prior.metrics.get(UNKNOWN_TORQUE_SCALE):
        notes.append(
            f"note: the torque scale of {hidden:.0f} of the prior's {len(prior.mean)} motors is not identifiable from "
            f"its logs: they may be several times too strong or too weak for {robot.name}"
        )
    highest = max(joint.torque_limit for joint in robot.joints)
    for name, value in unidentified_limits(prior.metrics).items():
        limit = f" ({robot.name} has at most {highest:.3g})" if name == "torque_limit" and highest < value else ""
        notes.append(
            f"note: the prior's {limit_text(name, value)} is not identifiable from its logs{limit}; a policy may "
            "over-rely on it. Log motions that reach the limit"
        )
    return notes


def _gear_note(prior: MotorPrior, robot: Robot) -> list[str]:
    """A note on gears that are too soft for a robot that walks."""
    motors = prior.sample(robot, 0, spread=0.0)
    if not isinstance(motors, GreyBoxActuator) or not robot.legs:
        return []
    values = motors.constants()
    ratio = values["gear_stiffness"] / values["kp"]
    worst = int(np.argmin(ratio))
    if ratio[worst] >= SOFT_GEAR:
        return []
    return [
        f"note: the gear of {robot.joint_names[worst]} is {ratio[worst]:.2g} times as stiff as its position gain, and "
        "logs of suspended legs barely identify it. If the robot falls, identify with preset rigid"
    ]


def _class_note(prior: MotorPrior, robot: Robot) -> list[str]:
    """A note on classes of joints that were never recorded."""
    names, several = dict.fromkeys(prior.classes_of(robot)), len(prior.classes.names) > 1
    unknown = [name for name in names if several and name not in prior.classes.names]
    known = ", ".join(prior.classes.names)
    return [
        f"note: no joint of the class {name} was recorded (but {known}): its motors are sampled from the distribution "
        "over all classes"
        for name in unknown
    ]


def _gain_note(prior: MotorPrior, robot: Robot) -> list[str]:
    own, logged = robot_gains(prior, robot), prior.gains
    if logged is None or own is None:
        return []
    if set(prior.joint_names) >= set(robot.joint_names):
        logged = logged[:, [prior.joint_names.index(name) for name in robot.joint_names]]
    ranges = [np.stack([gains.min(axis=1), gains.max(axis=1)], axis=1) for gains in (logged, own)]
    if np.allclose(*ranges, rtol=0.01):
        return []
    texts = [f"kp {range_text(*kp)} and kd {range_text(*kd)}" for kp, kd in ranges]
    return [
        f"note: the logs of the prior have {texts[0]}, the description of {robot.name} has {texts[1]}: the simulated "
        "motors use the latter"
    ]
