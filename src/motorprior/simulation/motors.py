"""The motors of a simulated robot, chosen by a text (`actuator.registry`) or given as objects."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from motorprior.actuator import registry
from motorprior.actuator.actuator import Actuator, require_motors
from motorprior.actuator.fleet import Fleet
from motorprior.actuator.fleet_motors import fleet_motors
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.pd_motors import nominal_gains
from motorprior.actuator.posterior_motors import motors_of_posterior
from motorprior.actuator.prior_motors import prior_motors
from motorprior.actuator.registry import DrawMotors, EpisodeMotors
from motorprior.bounds import TABLE, TEXT
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.robot import Robot
from motorprior.schema import Schema
from motorprior.stage import digest

MotorSource: TypeAlias = str | MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors
"""A text; a prior, posterior or fleet to sample in every episode; fixed motors; or a function.

The function gets a generator and returns the motors of an episode.
"""
_PROVENANCE = Schema({"text": TEXT, "files": TABLE}, "train it again", name="its motors")
_FILE = Schema({"path": TEXT, "sha256": TEXT}, "train it again", name="a file of its motors")


class SimulatedMotors(NamedTuple):
    """The motors of a robot's episodes."""

    draw: DrawMotors
    physics_dt: float  # physics step [s]
    condition: str  # name in a study
    prior: MotorPrior | None  # prior that the motors are samples of
    files: list[Path]  # files that the motors depend on
    nominal: IdealPd | None  # PD of `pd_motors.nominal_gains`; None for an arm without gains


def simulated_motors(motors: MotorSource, robot: Robot) -> SimulatedMotors:
    """The motors of a robot's episodes, sampled once to find errors and the physics step.

    Raises:
        ConfigError: an unknown name or option, a value out of range, or motors of another robot or
            number.
        ArtifactError: a file that cannot be read.
    """
    options: registry.Options = {}
    fleet = motors if isinstance(motors, Fleet) else None
    if isinstance(motors, str):
        episode_motors, options = registry.motors_from_text(motors, robot)
        fleet = options.get("fleet")
    else:
        episode_motors = _episode_motors(motors, robot)

    first_motors = episode_motors.draw(np.random.default_rng(0))
    require_motors(first_motors, robot.num_joints)
    _require_position_commands(first_motors)
    return SimulatedMotors(
        draw=episode_motors.draw,
        physics_dt=robot.physics_step(first_motors.kind.max_step),
        condition=episode_motors.condition,
        prior=episode_motors.prior,
        files=[Path(options[name]) for name in registry.file_options(options)],
        nominal=None if robot.gains is None else nominal_gains(robot, fleet),
    )


def _require_position_commands(motors: Actuator) -> None:
    """Raise ConfigError for motors without the gains that position targets need."""
    if isinstance(motors, GreyBoxActuator) and motors.command_mode in ("velocity", "torque"):
        raise ConfigError(
            f"the motors follow {motors.command_mode} commands, and position targets are sent",
            remedy="log the gains in N·m/rad: the motors then have the gains of the robot's "
            "description; or drive them in your own loop by mp.DrivenJoints",
            argument="motors",
        )


def _episode_motors(
    motors: MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors, robot: Robot
) -> EpisodeMotors:
    if isinstance(motors, MotorPrior):
        return prior_motors(robot, motors)
    if isinstance(motors, MotorPosterior):
        return motors_of_posterior(robot, motors)
    if isinstance(motors, Fleet):
        return fleet_motors(robot, motors)
    if isinstance(motors, Callable):
        return EpisodeMotors(motors)
    return EpisodeMotors(lambda rng: motors)


def motors_as_json(text: str, folder: Path) -> dict[str, Any]:
    """The motors of a training, for the provenance of its policy in ``folder``.

    They are the text, and the digest of each file. The path of a file is relative to the policy's
    folder, so that both can be moved together.
    """
    name, options = registry.parsed(text)
    files = {option: Path(options[option]) for option in registry.file_options(options)}
    records = {}
    for option, file in files.items():
        relative_path = Path(os.path.relpath(file.resolve(), folder.resolve()))
        records[option] = {"path": relative_path.as_posix(), "sha256": digest(file)}
    file_names = {option: file.name for option, file in files.items()}
    return {"text": registry.motor_text(name, **(options | file_names)), "files": records}


def motors_from_json(data: Any, policy: Path) -> str:
    """The text from `motors_as_json`, stored in the file ``policy``, with the paths of the files.

    A file is searched for at its path relative to the policy's folder, and in that folder. Only a
    file with the same digest is used.

    Raises:
        ArtifactError: other keys or types.
        ConfigError: a file is missing or has changed, or the text is wrong.
    """
    if not isinstance(data, dict):
        raise ArtifactError(
            "its provenance does not record the motors of its training",
            where=policy,
            remedy="train it with `motorprior walk`, or evaluate it on a twin",
        )
    _PROVENANCE.check(data, policy)
    name, options = registry.parsed(data["text"])
    for option in registry.file_options(options):
        record = data["files"].get(option)
        _FILE.check(record, policy)
        options[option] = _file_with_digest(option, Path(options[option]).name, record, policy)
    return registry.motor_text(name, **options)


def _file_with_digest(option: str, file_name: str, record: dict[str, str], policy: Path) -> Path:
    for path in (policy.parent / record["path"], policy.parent / file_name):
        if path.is_file() and digest(path) == record["sha256"]:
            return path
    recorded = f"{file_name} with SHA-256 {record['sha256'][:16]}…"
    raise ConfigError(
        f"the {option} it was trained on, {recorded}, is missing or changed",
        where=policy,
        remedy="put it back, or into the policy's folder, or train the policy again",
    )
