"""The door to Gymnasium: importing this module registers ``motorprior/Walk-v0``.

That a module does something at import is Gymnasium's own protocol.

    import gymnasium, motorprior.environments
    env = gymnasium.make("motorprior/Walk-v0", engine="mujoco", actuator="prior", prior="prior.safetensors")

A fatal error of MuJoCo (``mju_error``: out of memory, a broken model) ends the process with one line on standard error,
as compiled code has no one to raise to: save your training from time to time.

The words are those of ``motorprior walk``. Two defaults are not: here the motors are the physical ones of the shipped
fleet, there those of a prior, which must be given; and here nothing but the motors differs between episodes, there
``randomization`` is `simulation.randomization.ROBUST`. Observation and action are those of its policies.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.env import WalkEnv
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.task import TaskWeights
from motorprior.pipeline.motor_choice import ACTUATORS, ActuatorName, MotorChoice, MotorSource, motor_sampler
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.engines import Scene
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.vector_env import WalkVectorEnv
from motorprior.simulation.world_config import WorldConfig

ENV_ID = "motorprior/Walk-v0"
_FILES = ("prior", "posterior")
_NUMBERS = ("kp", "kd", "torque_limit", "armature", "delay", "coulomb", "spread", "latent_spread", "roughness")


@dataclass(frozen=True)
class EnvOptions:
    """What ``gymnasium.make`` and ``gymnasium.make_vec`` take as keywords.

    Attributes:
        robot: a legged one: a name, the path of a .toml file, or what `load_robot` gave.
        motors: the motors of an episode, instead of all that follows down to ``delay``: a prior, a posterior, a fleet,
            fixed motors, or a function that draws them from a generator.
        engine: "mujoco" or "pybullet".
        actuator: "prior" (samples of a learned prior), "fleet" (physical motors) or "pd".
        prior: file of the prior, for "prior".
        posterior: file of `motorprior adapt`: those motors only.
        fleet: name or file; the physical motors, and the nominal gains of the PD; the robot's own if not given.
        kp: gain of the PD [N·m/rad]; the nominal one if not given.
        kd: gain of the PD [N·m·s/rad]; the nominal one if not given.
        torque_limit: of the PD [N·m]; the nominal one if not given.
        armature: reflected inertia of the PD's motors [kg·m²].
        delay: of the PD's target [s].
        coulomb: friction of the PD's motors [N·m].
        spread: share by which every constant of the PD differs between motors and episodes [-].
        latent_spread: factor on the standard deviation of z of the prior [-].
        limit_follows_gain: torque limits of a posterior's motors follow their gains (`MotorChoice`).
        task: reward.
        randomization: what else differs between episodes.
        commands: of speed and yaw rate, drawn for every episode; all that the robot is built for if not given.
        gait: which leg steps when: trot, walk, pace, bound or pronk.
        roughness: height of bumps [m]; PyBullet only. The ground ends 4 m from the start.
        episode_steps: control steps until truncation.

    Raises:
        ConfigError: an unknown actuator, or a value of another type.
    """

    robot: str | Path | Robot = DEFAULT_ROBOT
    motors: MotorSource | None = None
    engine: str = "mujoco"
    actuator: str = "fleet"
    prior: str | Path | None = None
    posterior: str | Path | None = None
    fleet: str | Path | None = None
    kp: float | None = None
    kd: float | None = None
    torque_limit: float | None = None
    armature: float = 0.0
    delay: float = 0.0
    coulomb: float = 0.0
    spread: float = 0.0
    latent_spread: float = 1.0
    limit_follows_gain: bool = False
    task: TaskWeights = field(default_factory=TaskWeights)
    randomization: Randomization = field(default_factory=Randomization)
    commands: Commands = field(default_factory=Commands)
    gait: GaitName = "trot"
    roughness: float = 0.0
    episode_steps: int = 500

    def __post_init__(self) -> None:
        """Refuse values of another type; their bounds are checked where they are used."""
        if self.actuator not in ACTUATORS:
            raise ConfigError(f"actuator {self.actuator!r} is unknown", remedy=f"use one of {ACTUATORS}")
        for name in (*_FILES, "fleet"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, (str, Path)):
                raise ConfigError(f"{name} {value!r} is not the name of a file", remedy="give a path as text")
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is not None:
                require_number(name, value)
        if not isinstance(self.limit_follows_gain, bool):
            raise ConfigError(
                f"limit_follows_gain {self.limit_follows_gain!r} is neither True nor False", remedy="give one of them"
            )
        for name, kind in (("task", TaskWeights), ("randomization", Randomization), ("commands", Commands)):
            value = getattr(self, name)
            if not isinstance(value, kind):
                raise ConfigError(
                    f"{name} {value!r} is not a {kind.__name__}", remedy=f"import it: from {kind.__module__} import "
                    f"{kind.__name__}",
                )  # fmt: skip

    @classmethod
    def of(cls, words: dict[str, Any]) -> EnvOptions:
        """From keywords; None is what is not given.

        Raises:
            TypeError: an unknown keyword, ``render_mode`` among them: what libraries expect that try keywords.
            ConfigError: see `EnvOptions`.
        """
        known = [each.name for each in fields(cls)]
        for word in words:
            if word not in known:
                raise TypeError(f"got an unexpected keyword argument {word!r}; use some of {', '.join(known)}")
        return cls(**{name: value for name, value in words.items() if value is not None})

    def scene(self) -> Scene:
        """What is simulated.

        Raises:
            ConfigError, ArtifactError: settings that do not fit together, or a file that cannot be used.
        """
        robot = self.commands.on(as_robot(self.robot))
        walk = WalkConfig(self.episode_steps, self.task, self.randomization, self.commands, self.gait)
        if self.motors is not None:
            draw, physics_dt = motor_sampler(self.motors, robot)
        else:
            choice = self._choice()
            draw, physics_dt = choice.sampler(robot), choice.physics_dt(robot)
        return Scene(robot, self.engine, draw, physics_dt, walk, Terrain(self.roughness))

    def _choice(self) -> MotorChoice:
        names = {each.name for each in fields(MotorChoice)} - {"actuator", "name", *_FILES}
        values: dict[str, Any] = {name: getattr(self, name) for name in names}
        values["fleet"] = None if self.fleet is None else str(self.fleet)
        for name in _FILES:
            file = getattr(self, name)
            values[name] = None if file is None else Path(file)
        kind: ActuatorName = self.actuator  # pyright: ignore[reportAssignmentType]
        return MotorChoice(actuator=kind, **values)


def make_env(robot: str | Path | Robot = DEFAULT_ROBOT, motors: MotorSource | None = None, **options: Any) -> WalkEnv:
    """Make one Gymnasium environment whose every episode draws new motors.

    Args:
        robot: a legged one: a name, the path of a .toml file, or what `load_robot` gave.
        motors: a prior, a posterior or a fleet to draw from; motors, the same in every episode; or a function that
            draws them from a generator. The physical motors of the robot's own fleet if not given.
        options: see `EnvOptions`.

    Returns:
        An environment with the observations and actions of the policies of `train_policy`.

    Raises:
        ConfigError, ArtifactError: settings that do not fit together, or a file that cannot be used.
        TypeError: an unknown option.
    """
    scene = EnvOptions.of({"robot": robot, "motors": motors, **options}).scene()
    walk, sensors = scene.walk, partial(scene.walk.randomization.sensors, scene.robot)
    return WalkEnv(
        scene.robot, scene.backend(), walk.task, walk.episode_steps, draw_sensors=sensors, commands=walk.commands,
        gait=walk.gait,
    )  # fmt: skip


def make_vector_env(
    robot: str | Path | Robot = DEFAULT_ROBOT,
    motors: MotorSource | None = None,
    *,
    num_envs: int = 1,
    threads: int = 1,
    **options: Any,
) -> WalkVectorEnv:
    """Make many environments in one, whose episodes run compiled.

    Args:
        robot: see `make_env`.
        motors: see `make_env`.
        num_envs: environments.
        threads: that step them.
        options: see `EnvOptions`.

    Returns:
        A Gymnasium vector environment.

    Raises:
        ConfigError, ArtifactError: see `make_env`; or another engine than MuJoCo.
        TypeError: an unknown option.
    """
    scene = EnvOptions.of({"robot": robot, "motors": motors, **options}).scene()
    if scene.engine != "mujoco":
        raise ConfigError(
            f"many environments at once are for MuJoCo, not {scene.engine!r}", remedy='use vectorization_mode="async"'
        )
    world = WorldConfig.of(scene.robot, physics_dt=scene.physics_dt)
    return WalkVectorEnv(num_envs, scene.draw_motors, world, scene.walk, threads)


gymnasium.register(
    ENV_ID,
    entry_point="motorprior.environments:make_env",
    vector_entry_point="motorprior.environments:make_vector_env",
)
