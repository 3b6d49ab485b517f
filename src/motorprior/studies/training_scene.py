"""The simulation in which a policy was trained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import Robot
from motorprior.schema import Schema, number, one_of
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.engines import ENGINES, Engine, Scene
from motorprior.simulation.motors import motors_from_json, simulated_motors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.terrain import Terrain
from motorprior.studies import twin


@dataclass(frozen=True)
class TrainedWalk:
    """Attributes: name; robot with the policy's speed range; policy; training condition; its training simulation."""

    name: str
    robot: Robot
    policy: Policy
    condition: str
    simulator: WalkSimulator | BackendSimulator


def trained_walk(
    path: Path,
    robot: Robot,
    engine: Engine | None = None,
    walk: WalkConfig | None = None,
    commands: Commands | None = None,
) -> TrainedWalk:
    """A policy with its training simulation.

    Args:
        path: the policy's file.
        robot: of the policy.
        engine: of the simulation; that of the training if not given.
        walk: the episode, with the policy's gait; 5 s with the training's randomization if not given.
        commands: of the default episode; `straight_ahead` if not given.

    Raises:
        ArtifactError, ConfigError: a damaged policy or one of another control period, missing motors, or an engine
            that is not installed.
    """
    policy, robot = policy_for(path, robot)
    if walk is None:
        commands = commands or twin.straight_ahead(robot)
        walk = WalkConfig(twin.DURATION_STEPS, randomization=_randomization(policy, path), commands=commands)
    scene = training_scene(policy, path, robot, walk, engine)
    condition = simulated_motors(motors_from_json(policy.provenance.get("motors"), path), robot).condition
    return TrainedWalk(path.parent.name, robot, policy, condition, scene.simulator())


def policy_for(path: Path, robot: Robot) -> tuple[Policy, Robot]:
    """A policy of this robot, and the robot with the policy's speed range.

    Raises:
        ArtifactError, ConfigError: a damaged policy, of another robot or another control period.
    """
    policy = Policy.load(path)
    policy.require_robot(robot, path)
    policy.require_clock(robot.control_dt, path)
    return policy, robot.with_speed_range(policy.forward)


def training_scene(
    policy: Policy,
    path: Path,
    robot: Robot,
    walk: WalkConfig,
    engine: Engine | None = None,
) -> Scene:
    """The simulation in which a policy was trained.

    Args:
        policy: the trained policy.
        path: its file, for errors and to find the files of its motors.
        robot: with the policy's speed range.
        walk: the episode, with the policy's gait.
        engine: instead of that of the training.

    Raises:
        ArtifactError, ConfigError: missing motors, or damaged provenance.
    """
    text = motors_from_json(policy.provenance.get("motors"), path)
    try:
        motors = simulated_motors(text, robot)
    except (ArtifactError, ConfigError) as error:
        where = path if error.where is None else f"{path}: {error.where}"
        raise type(error)(f"motors of its training: {error.problem}", where=where, remedy=error.remedy) from error
    stated: dict[str, Any] = {"engine": "mujoco", "roughness": 0.0}
    stated |= {key: policy.provenance[key] for key in stated if key in policy.provenance}
    Schema({"engine": one_of(*ENGINES), "roughness": number()}, "train again").check(stated, path)
    engine = engine or cast(Engine, stated["engine"])
    terrain = Terrain(float(stated["roughness"]) if engine == "pybullet" else 0.0)
    return Scene(robot, engine, motors.draw, motors.physics_dt, replace(walk, gait=policy.gait), terrain)


def _randomization(policy: Policy, path: Path) -> Randomization:
    """Randomization of its training; none if the provenance has none."""
    try:
        return Randomization(**policy.provenance.get("randomization", {}))
    except (TypeError, ConfigError) as error:
        raise ArtifactError(f"its randomization: {error}", where=path, remedy="train again") from error
