"""The motors of a simulated robot, chosen by a text (`actuator.registry`) or given as objects."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from motorprior.actuator import registry
from motorprior.actuator.actuator import Actuator, require_motors
from motorprior.actuator.ideal_pd import FRICTION_PD, IdealPd, described_pd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior, robot_gains
from motorprior.actuator.registry import DrawMotors, EpisodeMotors, register
from motorprior.bench.fleet import Fleet, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_names
from motorprior.bounds import MAX_NUMBER, TABLE, TEXT, require_number
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.priors.prior_file import load_prior
from motorprior.robots.robot import Robot
from motorprior.schema import Schema
from motorprior.stage import digest

MotorSource: TypeAlias = str | MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors
"""A text; a prior, posterior or fleet, sampled for every episode; fixed motors; or a function of a generator."""
_PROVENANCE = Schema({"text": TEXT, "files": TABLE}, "train it again", name="its motors")
_FILE = Schema({"path": TEXT, "sha256": TEXT}, "train it again", name="a file of its motors")
_PD_BOUNDS = {"delay": 1.0, "spread": 0.9}  # delay [s]: the delay line holds so many physics steps


class SimulatedMotors(NamedTuple):
    """The motors of a robot's episodes."""

    draw: DrawMotors
    physics_dt: float  # physics step [s]
    condition: str  # name in a study
    prior: MotorPrior | None  # that they are samples of
    files: list[Path]  # that they depend on
    # PD gains: of the center of their fleet, or of the robot's; otherwise of its description
    nominal: IdealPd


def simulated_motors(motors: MotorSource, robot: Robot) -> SimulatedMotors:
    """The motors of a robot's episodes, sampled once to find errors and the physics step.

    ConfigError or ArtifactError for an unknown kind or option, a value out of range, a file that
    cannot be read, or motors of another robot or number.
    """
    options = {}
    fleet = motors if isinstance(motors, Fleet) else None
    if isinstance(motors, str):
        found, options = registry.motors_from_text(motors, robot)
        fleet = options.get("fleet")
    else:
        found = _episode_motors(motors, robot)
    first = found.draw(np.random.default_rng(0))
    require_motors(first, robot.num_joints)
    physics_dt = robot.physics_step(first.kind.max_step)
    files = [Path(options[name]) for name in registry.file_options(options)]
    return SimulatedMotors(
        found.draw, physics_dt, found.condition, found.prior, files, nominal_gains(robot, fleet)
    )


def _episode_motors(
    motors: MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors, robot: Robot
) -> EpisodeMotors:
    if isinstance(motors, MotorPrior):
        return prior_motors(robot, motors)
    if isinstance(motors, MotorPosterior):
        return _of_posterior(motors, robot)
    if isinstance(motors, Fleet):
        return EpisodeMotors(
            lambda rng: motors.sample(robot.num_joints, rng, of_one_robot=True).actuator(), "oracle"
        )
    return EpisodeMotors(motors if isinstance(motors, Callable) else (lambda rng: motors))


@register("fleet")
def fleet_motors(robot: Robot, fleet: str | None = None) -> EpisodeMotors:
    """Physical motors, the oracle: of a fleet by name or .toml file, or of the robot's own."""
    return _episode_motors(load_robot_fleet(robot, fleet), robot)


@register("prior")
def prior_motors(
    robot: Robot,
    file: str | MotorPrior,
    latent_spread: float = 1.0,
    frozen: str = "",
    of_robot: str = "",
) -> EpisodeMotors:
    """Samples of a learned prior; latent_spread is a factor on the standard deviation of z, 0: the mean motors [-].

    frozen names constants that all motors have from the mean motor: friction, delay, armature or
    gear. of_robot is the robot or bench of the prior, if this robot has the same motors.
    """
    require_number("latent_spread", latent_spread)
    prior = _loaded(file, robot, of_robot) if isinstance(file, str) else file
    prior.require(robot.name, robot.physics_dt)
    if frozen:
        prior = prior.with_frozen(frozen)
    name = prior.preset
    if latent_spread != 1.0:
        name = f"{name}, z × {latent_spread:g}"
    return EpisodeMotors(lambda rng: prior.sample(robot, rng, spread=latent_spread), name, prior)


def _loaded(file: str, robot: Robot, of_robot: str) -> MotorPrior:
    if not of_robot:
        return load_prior(Path(file), robot)
    prior = MotorPrior.load(file)
    if prior.robot != of_robot:
        raise ConfigError(
            f"of_robot={of_robot}, but the prior is of {prior.robot!r}",
            where=file,
            remedy="correct it",
        )
    return prior.for_robot(robot.name)


@register("posterior")
def posterior_motors(
    robot: Robot,
    file: str,
    prior: str,
    limit_follows_gain: bool = False,
    prior_share: float = 0.0,
    of_robot: str = "",
) -> EpisodeMotors:
    """Samples of the posterior of one motor or of all the robot's, and the prior that it belongs to.

    prior_share is a share of the prior's standard deviation of z in addition to the posterior's
    [-]. of_robot is as for a prior.

    limit_follows_gain scales the torque limit of each motor with its kp: for motors that give less
    torque per ampere, from a log that does not reach the limit.
    """
    of_prior = _loaded(prior, robot, of_robot)
    try:
        found = MotorPosterior.load(file, MotorPrior.load(prior))
        return _of_posterior(replace(found, prior=of_prior), robot, limit_follows_gain, prior_share)
    except ConfigError as error:
        raise ConfigError(error.problem, where=file, remedy=error.remedy) from error


@register("pd")
def pd_motors(
    robot: Robot,
    kp: float | None = None,
    kd: float | None = None,
    torque_limit: float | None = None,
    armature: float = 0.0,
    delay: float = 0.0,
    coulomb: float = 0.0,
    spread: float = 0.0,
    fleet: str | None = None,
) -> EpisodeMotors:
    """An ideal PD with these constants in SI units; nominal kp, kd and torque_limit if not given.

    With spread [-], every constant is sampled for every motor and episode, uniformly within ± this
    share; the delay within ± this share of 20 ms.
    """
    given = {
        "kp": kp,
        "kd": kd,
        "torque_limit": torque_limit,
        "armature": armature,
        "delay": delay,
        "coulomb": coulomb,
    }
    given = {name: value for name, value in given.items() if value is not None}
    for name, value in {**given, "spread": spread}.items():
        require_number(name, value, maximum=_PD_BOUNDS.get(name, MAX_NUMBER))
    if coulomb and not armature:
        raise ConfigError(
            f"coulomb {coulomb:g} N·m without armature",
            remedy="give one: friction acts on the rotor",
        )
    model = nominal_gains(robot, fleet)
    model = replace(
        model, **{name: np.full(robot.num_joints, float(value)) for name, value in given.items()}
    )
    if spread:
        return EpisodeMotors(lambda rng: _randomized(model, spread, rng), "random_pd")
    name = FRICTION_PD.name if coulomb else "tuned_pd" if armature or delay else "ideal_pd"
    return EpisodeMotors(lambda rng: model, name)


def nominal_gains(robot: Robot, fleet: Fleet | str | None = None) -> IdealPd:
    """PD gains of the center of a fleet, by default of the robot's own; of its description if it has none."""
    if fleet is None and not robot.fleets:
        return described_pd(robot)
    return nominal_pd(load_robot_fleet(robot, fleet), robot.num_joints)


def _randomized(model: IdealPd, spread: float, rng: np.random.Generator) -> IdealPd:
    def drawn(values: np.ndarray) -> np.ndarray:
        return values * rng.uniform(1.0 - spread, 1.0 + spread, len(values))

    late = 0.02 * spread  # not a share of the delay, which may be 0
    columns = {
        name: drawn(getattr(model, name)) for name in ("kp", "kd", "torque_limit", "armature")
    }
    delay = rng.uniform(np.maximum(0.0, model.delay - late), model.delay + late)
    coulomb = drawn(model.coulomb) if model.coulomb.any() else model.coulomb
    return replace(model, **columns, delay=delay, coulomb=coulomb)


def _of_posterior(
    posterior: MotorPosterior,
    robot: Robot,
    limit_follows_gain: bool = False,
    prior_share: float = 0.0,
) -> EpisodeMotors:
    """Motors in the order of the robot's joints; one motor, or those of a bench, as they are."""
    posterior.prior.require(robot.name, robot.physics_dt)
    names = posterior.joint_names
    gains = robot_gains(posterior.prior, robot)
    count = robot.num_joints
    # errors now, not in the first episode
    posterior.sample(count, 0, gains, limit_follows_gain, prior_share)
    if len(names) > 1 and names != bench_names(len(names)):
        if unknown := sorted(set(names) - set(robot.joint_names)):
            raise ConfigError(
                f"joints {unknown} are not {robot.name}'s",
                remedy=f"name them {list(robot.joint_names)}",
            )
        posterior = posterior.take([names.index(name) for name in robot.joint_names])
    name = f"{posterior.prior.preset}, adapted"
    return EpisodeMotors(
        lambda rng: posterior.sample(count, rng, gains, limit_follows_gain, prior_share),
        name,
        posterior.prior,
    )


def motors_as_json(text: str, folder: Path) -> dict[str, Any]:
    """The motors of a training in the provenance of its policy in ``folder``: their text, and each file's digest.

    A file is searched for at its path relative to the policy's folder, so that both can be moved
    together, and in that folder. Only a file with the same digest is used.
    """
    kind, options = registry.parsed(text)
    files = {name: Path(options[name]) for name in registry.file_options(options)}
    names = {name: file.name for name, file in files.items()}
    records = {
        name: {
            "path": Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix(),
            "sha256": digest(file),
        }
        for name, file in files.items()
    }
    return {"text": registry.motor_text(kind, **(options | names)), "files": records}


def motors_from_json(data: Any, policy: Path) -> str:
    """The text from `motors_as_json`, stored in the file ``policy``, with the paths of the files.

    ArtifactError for other keys or types, ConfigError if a file is missing or has changed, or for a
    wrong text.
    """
    if not isinstance(data, dict):
        problem = "its provenance does not record the motors of its training"
        remedy = "evaluate it on a twin"
        raise ArtifactError(
            problem, where=policy, remedy=f"train it with `motorprior walk`, or {remedy}"
        )
    _PROVENANCE.check(data, policy)
    kind, options = registry.parsed(data["text"])
    for name in registry.file_options(options):
        record = data["files"].get(name)
        file = Path(options[name]).name
        _FILE.check(record, policy)
        paths = policy.parent / record["path"], policy.parent / file
        found = [path for path in paths if path.is_file() and digest(path) == record["sha256"]]
        if not found:
            stated = f"{file} with SHA-256 {record['sha256'][:16]}…"
            problem = f"the {name} it was trained on, {stated}, is missing or changed"
            remedy = "put it back, or into the policy's folder, or train the policy again"
            raise ConfigError(problem, where=policy, remedy=remedy)
        options[name] = found[0]
    return registry.motor_text(kind, **options)
