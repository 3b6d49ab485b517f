"""The file of a prior: checks against a robot or a log, and notes on what its logs do not identify."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.motor_prior import UNKNOWN_TORQUE_SCALE, MotorPrior, limit_text, unidentified_limits
from motorprior.bench.recording import BENCH
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.presets import Preset
from motorprior.identification.training_log import MOTIONS
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog, logged_gains_of, motion_digest
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


def load_prior(path: Path, robot: Robot) -> MotorPrior:
    """A prior for the simulation of this robot.

    Raises:
        ArtifactError: not the file of a prior.
        ConfigError: a prior of another robot, or one that does not fit its physics step.
    """
    return _loaded(path, lambda prior: prior.require(robot.name, robot.physics_dt))


def prior_and_robot(path: Path, log: MotorLog, robot: str | None) -> tuple[MotorPrior, Robot | None]:
    """A prior for the motors of a log, and the robot; None if none is given and prior and log name the same one.

    The log of a bench names no robot: the default is assumed.

    Raises:
        ArtifactError: not the file of a prior, or no such robot.
        ConfigError: a prior of another robot.
    """
    if robot is None and log.robot != BENCH:
        return _loaded(path, lambda prior: require_same_robot(prior, log)), None
    given = load_robot(robot or DEFAULT_ROBOT)
    return load_prior(path, given), given


def require_same_robot(prior: MotorPrior, log: MotorLog) -> None:
    """Raise `ConfigError` unless prior and log name the same robot."""
    if prior.robot != log.robot:
        raise ConfigError(
            f"the prior is of robot {prior.robot!r}, the log of {log.robot!r}",
            remedy="identify a prior from logs of that robot, or give robot if the log names the wrong one",
        )


def _loaded(path: Path, require: Callable[[MotorPrior], None]) -> MotorPrior:
    try:
        prior = MotorPrior.load(path)
        require(prior)
    except (ArtifactError, ConfigError) as error:
        remedy = error.remedy or "use a prior that `motorprior identify` wrote"
        raise type(error)(error.problem, where=path, remedy=remedy) from error
    return prior


def recipe_of(prior: MotorPrior, where: str | Path) -> Preset:
    """The recipe that a prior was trained with.

    Raises:
        ArtifactError: it is missing, or of another version.
    """
    try:
        recipe = prior.provenance["recipe"]
        if recipe.keys() != {field.name for field in fields(Preset)}:
            raise KeyError("other entries")
        return Preset(**{name: _hashable(value) for name, value in recipe.items()})
    except (KeyError, AttributeError, TypeError) as error:
        problem = f"its provenance does not hold a recipe of this version ({error})"
        raise ArtifactError(problem, where=where, remedy="identify it again") from error


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def trained_on(prior: MotorPrior, log: MotorLog) -> bool:
    """Whether the provenance of the prior lists the motion of this log."""
    motions = prior.provenance.get(MOTIONS)
    return isinstance(motions, list) and motion_digest(log) in motions


def robot_gains(prior: MotorPrior, robot: Robot) -> np.ndarray | None:
    """(2, joints) kp and kd of the robot's description, if the prior's motors scale with gains in SI units."""
    if prior.network.gain_unit != PHYSICAL_GAINS:
        return None
    return np.array([[joint.kp for joint in robot.joints], [joint.kd for joint in robot.joints]])


def gains_for(prior: MotorPrior, robot: Robot, log: MotorLog) -> np.ndarray | None:
    """Gains in the log, if they are in the prior's unit; otherwise the robot's."""
    logged = logged_gains_of(log) if log.gain_unit == prior.network.gain_unit else None
    return robot_gains(prior, robot) if logged is None else logged


def prior_notes(prior: MotorPrior, robot: Robot) -> list[str]:
    """Notes on limits that the logs of a prior did not reach, and on gains that differ from the robot's."""
    notes = _gain_note(prior, robot)
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


def _gain_note(prior: MotorPrior, robot: Robot) -> list[str]:
    own, logged = robot_gains(prior, robot), prior.gains
    if logged is None or own is None:
        return []
    if set(prior.joint_names) >= set(robot.joint_names):
        logged = logged[:, [prior.joint_names.index(name) for name in robot.joint_names]]
    ranges = [np.stack([gains.min(axis=1), gains.max(axis=1)], axis=1) for gains in (logged, own)]
    if np.allclose(*ranges, rtol=0.01):
        return []
    texts = [f"kp {kp[0]:.3g} to {kp[1]:.3g} and kd {kd[0]:.3g} to {kd[1]:.3g}" for kp, kd in ranges]
    return [
        f"note: the logs of the prior have {texts[0]}, the description of {robot.name} has {texts[1]}: the simulated "
        "motors use the latter"
    ]
