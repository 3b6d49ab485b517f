"""The file of a prior: whether it fits a robot or a log, and notes on what its logs do not identify."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import (
    UNIDENTIFIED,
    UNKNOWN_TORQUE_SCALE,
    MotorPrior,
    limit_text,
    robot_gains,
)
from motorprior.bench.dynamometer import BENCH
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.presets import recipe_of
from motorprior.logs.motor_log import MotorLog, range_text
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
    if prior.robot and log.robot not in (BENCH, prior.robot, ""):
        remedy = "identify a prior from logs of that robot; convert logs of a bench by `motorprior logs import` with "
        remedy += "--robot and --as-joint; in Python, prior.for_robot states that the robot has these motors"
        raise ConfigError(
            f"the prior is of robot {prior.robot!r}, the log of {log.robot!r}", remedy=remedy
        )


def prior_notes(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    """Notes on other gains than the robot's, classes without logs, soft gears, and what the logs do not identify."""
    yield from _gain_note(prior, robot)
    several = len(prior.classes.names) > 1
    recorded = prior.classes.names
    for name in dict.fromkeys(prior.joint_classes(robot)):
        if several and name not in recorded:
            yield (
                f"no logs of the joint class {name}, only of {', '.join(recorded)}: its motors are sampled from "
                "the distribution over all classes"
            )
    yield from _gear_note(prior, robot)
    if unknown := prior.metrics.get(UNKNOWN_TORQUE_SCALE):
        yield (
            f"the logs do not identify the torque scale of {unknown:.0f} of the prior's {len(prior.mean)} "
            f"motors, which may be several times too strong or too weak for {robot.name}"
        )
    highest = max(joint.torque_limit for joint in robot.joints)
    for name, value in unidentified_limits(prior.metrics).items():
        limit = (
            f" ({robot.name} has at most {highest:.3g})"
            if name == "torque_limit" and highest < value
            else ""
        )
        yield (
            f"the logs do not identify the prior's {limit_text(name, value)}{limit}; a policy may over-rely on "
            "it. Log motions that reach the limit"
        )


def unidentified_limits(metrics: Mapping[str, float]) -> dict[str, float]:
    """Values by name of the limits that the training logs do not identify, from the metrics of a prior."""
    return {
        name.removeprefix(UNIDENTIFIED): value
        for name, value in metrics.items()
        if name.startswith(UNIDENTIFIED)
    }


def _gain_note(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    own = robot_gains(prior, robot)
    logged = prior.gains
    if logged is None or own is None:
        return
    if set(prior.joint_names) >= set(robot.joint_names):
        logged = logged[:, [prior.joint_names.index(name) for name in robot.joint_names]]
    ranges = [np.stack([gains.min(axis=1), gains.max(axis=1)], axis=1) for gains in (logged, own)]
    if not np.allclose(*ranges, rtol=0.01):
        in_logs, in_robot = (f"kp {range_text(*kp)} and kd {range_text(*kd)}" for kp, kd in ranges)
        yield f"the logs of the prior have {in_logs}; the simulated motors use those of {robot.name}: {in_robot}"


def _gear_note(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    motors = prior.sample(robot, 0, spread=0.0)
    if not isinstance(motors, GreyBoxActuator) or not robot.legs:
        return
    values = motors.constants()
    ratio = values["gear_stiffness"] / values["kp"]
    if ratio.min() < SOFT_GEAR:
        yield (
            f"the gear stiffness of {robot.joint_names[int(ratio.argmin())]} is {ratio.min():.2g} times its "
            "position gain; logs of suspended legs barely identify it. If the robot falls, identify with preset rigid"
        )
