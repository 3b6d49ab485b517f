"""A trained policy and the simulation in which it was trained, from the record in its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from motorprior.bounds import one_of
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import Robot
from motorprior.schema import Schema
from motorprior.simulation.motors import SimulatedMotors, motors_from_json, simulated_motors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import ENGINES, Engine, Scene, WalkConfig


@dataclass(frozen=True)
class TrainedPolicy:
    """Attributes: path of the policy's file; robot with the policy's speed range; policy."""

    path: Path
    robot: Robot
    policy: Policy

    @classmethod
    def load(cls, path: Path, robot: Robot) -> TrainedPolicy:
        """Read a policy of this robot.

        Raises:
            ArtifactError, ConfigError: a damaged policy, of another robot or another control period.
        """
        policy = Policy.load(path)
        policy.require_robot(robot, path)
        return cls(path, robot.with_speed_range(policy.forward), policy)

    @property
    def motors(self) -> SimulatedMotors:
        """The motors of its training; raises `ArtifactError` or `ConfigError` if they are not recorded or missing."""
        text = motors_from_json(self.policy.provenance.get("motors"), self.path)
        try:
            return simulated_motors(text, self.robot)
        except (ArtifactError, ConfigError) as error:
            where = self.path if error.where is None else f"{self.path}: {error.where}"
            raise type(error)(f"motors of its training: {error.problem}", where=where, remedy=error.remedy) from error

    @property
    def randomization(self) -> Randomization:
        """Randomization of its training; none if the file records none, `ArtifactError` if it is invalid."""
        try:
            return Randomization(**self.policy.provenance.get("randomization", {}))
        except (TypeError, ConfigError) as error:
            raise ArtifactError(f"its randomization: {error}", where=self.path, remedy="train again") from error

    def scene(self, walk: WalkConfig, engine: Engine | None = None) -> Scene:
        """The simulation of its training.

        Args:
            walk: the episode; it gets the policy's gait.
            engine: instead of that of the training.

        Raises:
            ArtifactError, ConfigError: missing motors, a damaged record, or an engine that is not installed.
        """
        motors = self.motors
        recorded = {"engine": self.policy.provenance.get("engine", "mujoco")}
        Schema({"engine": one_of(*ENGINES)}, "train again").check(recorded, self.path)
        walk = replace(walk, gait=self.policy.gait, engine=engine or cast(Engine, recorded["engine"]))
        return Scene(self.robot, motors.draw, walk, motors.physics_dt)
