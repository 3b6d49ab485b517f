"""The door to Gymnasium: importing this module registers ``motorprior/PupperWalk-v0``.

That a module does something at import is Gymnasium's own protocol.

    import gymnasium, motorprior.environments
    env = gymnasium.make("motorprior/PupperWalk-v0", engine="mujoco", actuator="prior", prior="prior.safetensors")

The words are those of ``motorprior walk``. Observation and action are those of its policies.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import gymnasium

from motorprior.backend import Backend
from motorprior.cli.motors import MotorChoice
from motorprior.exceptions import ConfigError
from motorprior.locomotion.env import PupperWalkEnv
from motorprior.locomotion.task import TaskWeights
from motorprior.simulation.bullet_backend import PybulletBackend
from motorprior.simulation.mujoco_backend import DrawMotors, MujocoBackend
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.vector_env import WalkVectorEnv
from motorprior.simulation.world import WorldConfig

ENV_ID = "motorprior/PupperWalk-v0"
ENGINES = ("mujoco", "pybullet")
ACTUATORS = ("prior", "pd", "fleet")


def make_env(
    engine: str = "mujoco",
    actuator: str = "fleet",
    prior: str | Path | None = None,
    posterior: str | Path | None = None,
    fleet: str = "pupper_v2",
    task: TaskWeights | None = None,
    randomization: Randomization | None = None,
    roughness: float = 0.0,
    episode_steps: int = 500,
    **pd: float,
) -> PupperWalkEnv:
    """One environment whose every episode draws new motors.

    Args:
        engine: "mujoco" or "pybullet".
        actuator: "prior" (samples of a learned prior), "fleet" (physical motors) or "pd".
        prior: file of the prior, for "prior".
        posterior: file of `motorprior adapt`: those motors only.
        fleet: name or file; the physical motors, and the nominal gains of the PD.
        task: reward.
        randomization: what else differs between episodes.
        roughness: height of bumps [m]; PyBullet only.
        episode_steps: control steps until truncation.
        **pd: kp, kd, torque_limit, armature, delay of a PD, as in ``motorprior walk``.

    Raises:
        ConfigError, ArtifactError: settings that do not fit together, or a file that cannot be used.
    """
    choice = _choice(actuator, prior, posterior, fleet, pd)
    varied = randomization or Randomization()
    backend = _backend(engine, choice, varied, Terrain(roughness), episode_steps)
    return PupperWalkEnv(backend, task, episode_steps, draw_sensors=varied.sensors)


def make_vector_env(
    num_envs: int = 1,
    threads: int = 1,
    engine: str = "mujoco",
    actuator: str = "fleet",
    prior: str | Path | None = None,
    posterior: str | Path | None = None,
    fleet: str = "pupper_v2",
    task: TaskWeights | None = None,
    randomization: Randomization | None = None,
    episode_steps: int = 500,
    **pd: float,
) -> WalkVectorEnv:
    """``num_envs`` environments of `make_env`'s settings, compiled, on ``threads`` threads.

    Raises:
        ConfigError, ArtifactError: see `make_env`; or another engine than MuJoCo.
    """
    if engine != "mujoco":
        raise ConfigError(
            f"many environments at once are for MuJoCo, not {engine!r}", remedy='use vectorization_mode="async"'
        )
    choice = _choice(actuator, prior, posterior, fleet, pd)
    walk = WalkConfig(episode_steps, task or TaskWeights(), randomization or Randomization())
    return WalkVectorEnv(num_envs, choice.drawer(), WorldConfig(physics_dt=choice.physics_dt), walk, threads)


def _choice(
    actuator: str, prior: str | Path | None, posterior: str | Path | None, fleet: str, pd: dict[str, float]
) -> MotorChoice:
    known = ("kp", "kd", "torque_limit", "armature", "delay")
    if actuator not in ACTUATORS or not set(pd) <= set(known):
        wrong = actuator if actuator not in ACTUATORS else sorted(set(pd) - set(known))[0]
        raise ConfigError(f"{wrong!r} is unknown", remedy=f"actuator is one of {ACTUATORS}, a PD has {known}")
    files = [None if file is None else Path(file) for file in (prior, posterior)]
    kind: Literal["prior", "pd", "fleet"] = actuator  # pyright: ignore[reportAssignmentType]
    return MotorChoice(kind, files[0], files[1], fleet=fleet, **pd)


def _backend(
    engine: str, choice: MotorChoice, randomization: Randomization, terrain: Terrain, episode_steps: int
) -> Backend:
    draw: DrawMotors = choice.drawer()
    if engine == "pybullet":
        return PybulletBackend(draw, None, randomization, terrain, episode_steps)
    if engine != "mujoco":
        raise ConfigError(f"engine {engine!r} is unknown", remedy=f"use one of {ENGINES}")
    if terrain.roughness:
        raise ConfigError("rough ground is for PyBullet only", remedy='use engine="pybullet", or leave it out')
    return MujocoBackend(draw, WorldConfig(physics_dt=choice.physics_dt), randomization, episode_steps)


gymnasium.register(
    ENV_ID,
    entry_point="motorprior.environments:make_env",
    vector_entry_point="motorprior.environments:make_vector_env",
)
