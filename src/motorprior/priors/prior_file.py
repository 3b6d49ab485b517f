"""The file of a prior: whether it fits a robot or a log, and what its logs do not identify."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior, limit_text, robot_gains
from motorprior.bench.dynamometer import BENCH
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.presets import recipe_of
from motorprior.logs.command_modes import unmeasured_scales
from motorprior.logs.motor_log import MotorLog, range_text
from motorprior.robots.robot import Robot

SOFT_GEAR = 5.0  # gear stiffness over position gain [-]; below, a note


def load_prior(path: Path, target: Robot | MotorLog) -> MotorPrior:
    """A prior for the simulation of a robot, or for the motors of a log.

    Raises ArtifactError or ConfigError for a prior that does not fit the robot or the log.
    """
    prior = MotorPrior.load(path)
    try:
        if isinstance(target, MotorLog):
            require_adaptable(prior, target)
        else:
            prior.require(target.name, target.physics_dt)
    except (ArtifactError, ConfigError) as error:
        raise type(error)(error.problem, where=path, remedy=error.remedy) from error
    return prior


def require_adaptable(prior: MotorPrior, log: MotorLog) -> None:
    """Check that a prior has latents, a recipe of this version, and the robot of the log.

    The log of a bench names no robot.
    """
    recipe_of(prior)
    if prior.model.num_latents == 0:
        raise ArtifactError("it has no latents", remedy="identify it with preset rollout")
    if prior.robot and log.robot not in (BENCH, prior.robot, ""):
        problem = f"the prior is of robot {prior.robot!r}, the log of {log.robot!r}"
        remedy = (
            "identify a prior from logs of that robot; convert logs of a bench by `motorprior logs "
            "import` with --robot and --as-joint; in Python, prior.for_robot states that the robot "
            "has these motors"
        )
        raise ConfigError(problem, remedy=remedy)


def prior_notes(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    """Notes on a prior for a robot.

    They are about other commands than position targets, other gains than the robot's, joint classes
    without logs, soft gears, and what the logs do not identify.
    """
    unmeasured = unmeasured_scales(prior.command_mode, "position")
    if unmeasured:
        yield (
            f"the prior's logs have {prior.command_mode} commands, and position targets are sent: "
            f"friction, armature and delay are measured, the scale of {unmeasured} is not; the "
            f"motors have exactly the gains of {robot.name}'s description"
        )
    yield from _gain_note(prior, robot)
    yield from _class_notes(prior, robot)
    yield from _gear_note(prior, robot)
    yield from _identifiability_notes(prior, robot)


def _class_notes(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    recorded = prior.classes.names
    if len(recorded) == 1:
        return
    for name in dict.fromkeys(prior.joint_classes(robot)):
        if name not in recorded:
            yield (
                f"no logs of the joint class {name}, only of {', '.join(recorded)}: its motors are "
                "sampled from the distribution over all classes"
            )


def _identifiability_notes(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    unknown = prior.metrics.unknown_torque_scales
    if unknown:
        yield (
            f"the logs do not identify the torque scale of {unknown} of the prior's "
            f"{len(prior.mean)} motors, which may be several times too strong or too weak for "
            f"{robot.name}"
        )

    robot_limit = max(joint.torque_limit for joint in robot.joints)
    for name, value in prior.metrics.unidentified_limits.items():
        limit = limit_text(name, value)
        if name == "torque_limit" and robot_limit < value:
            limit = f"{limit} ({robot.name} has at most {robot_limit:.3g})"
        yield (
            f"the logs do not identify the prior's {limit}; a policy may over-rely on it. Log "
            "motions that reach the limit"
        )


def _gain_note(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    simulated = robot_gains(prior, robot)
    logged = prior.gains
    if logged is None or simulated is None:
        return
    if set(prior.joint_names) >= set(robot.joint_names):
        columns = [prior.joint_names.index(name) for name in robot.joint_names]
        logged = logged[:, columns]

    logged_ranges = _ranges(logged)
    simulated_ranges = _ranges(simulated)
    if not np.allclose(logged_ranges, simulated_ranges, rtol=0.01):
        yield (
            f"the logs of the prior have {_gain_text(logged_ranges)}; the simulated motors use "
            f"those of {robot.name}: {_gain_text(simulated_ranges)}"
        )


def _ranges(gains: np.ndarray) -> np.ndarray:
    """(2, 2) minimum and maximum over the motors of kp and of kd."""
    return np.stack([gains.min(axis=1), gains.max(axis=1)], axis=1)


def _gain_text(ranges: np.ndarray) -> str:
    kp, kd = ranges
    return f"kp {range_text(*kp)} and kd {range_text(*kd)}"


def _gear_note(prior: MotorPrior, robot: Robot) -> Iterator[str]:
    if robot.legs:
        yield from soft_gear_notes(prior.sample(robot, 0, spread=0.0), robot.joint_names)


def soft_gear_notes(motors: Actuator, joint_names: Sequence[str]) -> Iterator[str]:
    """Note on the softest gear of the motors of suspended legs, if it is softer than SOFT_GEAR."""
    if not isinstance(motors, GreyBoxActuator):
        return
    values = motors.constants()
    ratio = values["gear_stiffness"] / values["kp"]
    if ratio.min() < SOFT_GEAR:
        joint = joint_names[int(ratio.argmin())]
        yield (
            f"the gear stiffness of {joint} is {ratio.min():.2g} times its position gain; logs of "
            "suspended legs barely identify it, and under its weight a robot with such gears may "
            "fall -> for walking identify with preset rigid"
        )
