"""The file of a prior, checked against the robot or the log that it is meant for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import UNKNOWN_TORQUE_SCALE, MotorPrior, limit_text, unidentified_limits
from motorprior.bench.recording import BENCH
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog, motion_digest
from motorprior.pipeline.training_log import MOTIONS
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


def load_prior(path: Path, robot: Robot) -> MotorPrior:
    """A prior that this robot can be simulated with.

    Raises:
        ArtifactError: a file that is no prior.
        ConfigError: a prior of another robot, or one that does not fit its physics step.
    """
    return _loaded(path, lambda prior: prior.require(robot.name, robot.physics_dt))


def told_gains(prior: MotorPrior, robot: Robot) -> np.ndarray | None:
    """(2, joints) gains that the robot tells its motors, if they are in the prior's unit; otherwise the prior's own."""
    if prior.network.gain_unit != PHYSICAL_GAINS:
        return None
    return np.array([[joint.kp for joint in robot.joints], [joint.kd for joint in robot.joints]])


def doubts(prior: MotorPrior, robot: Robot) -> list[str]:
    """A line for each limit of a prior's motors that its logs did not show, and one for gains that are not the robot's.

    Beside a torque it tells what the robot says. One more line tells where logs did not show how large torques are.
    """
    found = _gains_in_doubt(prior, robot)
    if hidden := prior.metrics.get(UNKNOWN_TORQUE_SCALE):
        found.append(
            f"note: the logs of {hidden:.0f} of the prior's {len(prior.mean)} motors do not show how large torques "
            f"are: its motors may be several times too strong or too weak for {robot.name}"
        )
    return found + [_doubt(name, value, robot) for name, value in unidentified_limits(prior.metrics).items()]


def _gains_in_doubt(prior: MotorPrior, robot: Robot) -> list[str]:
    described = told_gains(prior, robot)
    if prior.gains is None or described is None:
        return []
    named = set(prior.joint_names) >= set(robot.joint_names)
    order = [prior.joint_names.index(name) for name in robot.joint_names] if named else []
    both = (prior.gains[:, order], described) if named else tuple(map(_range, (prior.gains, described)))
    if np.allclose(*both, rtol=0.01):
        return []
    (kp, kd), (own_kp, own_kd) = ([f"{least:.3g} to {most:.3g}" for least, most in _range(gains)] for gains in both)
    stated, told = f"kp {kp} and kd {kd}", f"kp {own_kp} and kd {own_kd}"
    if stated == told:
        told = "the same for other joints"
    return [
        f"note: the prior's logs state {stated}, the description of {robot.name} says {told}: simulated motors are "
        "told what the description says"
    ]


def _range(gains: np.ndarray) -> np.ndarray:
    """(2, 2) least and most, columns, of kp and kd, rows."""
    return np.stack([gains.min(axis=1), gains.max(axis=1)], axis=1)


def _doubt(name: str, value: float, robot: Robot) -> str:
    said = f"note: a {limit_text(name, value)} of the prior was not seen in its logs"
    described = max(joint.torque_limit for joint in robot.joints)
    if name == "torque_limit" and described < value:
        said += f" (the description of {robot.name}: {described:.3g} at most)"
    return f"{said}; what is trained on it may count on that. Log motions that reach the limit"


def trained_on(prior: MotorPrior, log: MotorLog) -> bool:
    """Whether the motion of this log is one that the prior was trained on, as far as its provenance says."""
    motions = prior.provenance.get(MOTIONS)
    return isinstance(motions, list) and motion_digest(log) in motions


def prior_and_robot(path: Path, log: MotorLog, robot: str | None) -> tuple[MotorPrior, Robot | None]:
    """A prior for the motors of a log, and the robot that is meant: none where the log's own name of it is enough.

    Without ``robot`` prior and log must name the same one, whatever it is; the log of a bench, which names none, is of
    the default robot.

    Raises:
        ArtifactError: a file that is no prior, or no such robot.
        ConfigError: a prior of another robot.
    """
    if robot is None and log.robot != BENCH:
        return _loaded(path, lambda prior: require_robot_of(prior, log)), None
    given = load_robot(robot or DEFAULT_ROBOT)
    return load_prior(path, given), given


def _loaded(path: Path, require: Callable[[MotorPrior], None]) -> MotorPrior:
    try:
        prior = MotorPrior.load(path)
        require(prior)
        _require_all_motors(prior)
    except (ArtifactError, ConfigError) as error:
        remedy = error.remedy or "use a prior that `motorprior identify` wrote"
        raise type(error)(error.problem, where=path, remedy=remedy) from error
    return prior


def require_robot_of(prior: MotorPrior, log: MotorLog) -> None:
    """Refuse a log of another robot than the prior's.

    Raises:
        ConfigError: names both.
    """
    if prior.robot != log.robot:
        raise ConfigError(
            f"the prior is of robot {prior.robot!r}, the log of {log.robot!r}",
            remedy="identify a prior from logs of that robot, or give robot if the log is of another than it says",
        )


def _require_all_motors(prior: MotorPrior) -> None:
    """Refuse a prior that does not hold one mean per motor of the bench it says it is from."""
    bench = prior.provenance.get("bench")
    said = bench.get("motors") if isinstance(bench, dict) else None
    if said is not None and said != len(prior.mean):
        raise ArtifactError(
            f"it has {len(prior.mean)} training motors, its bench {str(said)[:20]}", remedy="identify it again"
        )
