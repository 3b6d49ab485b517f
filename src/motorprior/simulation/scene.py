"""An episode: its settings, its engine, and the whole of it in one compiled call.

That call has the same compiled functions in the same order as `env.WalkEnv`, so the results are the same bit for bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.actuator.registry import DrawMotors
from motorprior.backend import BackendState
from motorprior.bounds import require_count
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import body_of
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import (
    GaitState,
    SensorErrors,
    TaskWeights,
    begin_gait,
    command_step,
    complete_observation,
    evaluate_step,
    new_gait,
    observe,
)
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import FAULTS, TOO_STIFF, World, hold_target, read_state

Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class WalkConfig:
    """Settings of a walking episode.

    Raises:
        ConfigError: a number out of range, or an unknown engine.
    """

    episode_steps: int = 500
    """Control steps until the time limit."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    randomization: Randomization = field(default_factory=Randomization)
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors, pushes."""
    commands: Commands = field(default_factory=Commands)
    """Commanded speeds and yaw rates; they may exceed the robot's usual range."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses several cores."""

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)
        if self.engine not in ENGINES:
            raise ConfigError(f"engine {self.engine!r} is unknown", remedy=f"use one of {ENGINES}", argument="engine")

    def inputs(self, robot: Robot, seed: int) -> tuple[SensorErrors, np.ndarray]:
        """Sensor errors and (steps, 2) commands [m/s], [rad/s] of the episode of this seed."""
        sensors = self.randomization.sensors(robot, seed, self.episode_steps)
        return sensors, self.commands.schedule(robot, seed, self.episode_steps)


@dataclass(frozen=True)
class Scene:
    """Simulation of a walking episode."""

    robot: Robot
    """With legs."""
    draw_motors: DrawMotors
    """The motors of an episode, from a generator seeded by the episode's seed."""
    walk: WalkConfig = field(default_factory=WalkConfig)
    physics_dt: float | None = None
    """MuJoCo's step [s]; the robot's own if not given. PyBullet's is always 1 ms."""

    def world(self) -> World | BulletWorld:
        """The robot in the engine, for `begin`."""
        return BulletWorld(self.robot) if self.walk.engine == "pybullet" else World(self.robot, self.physics_dt)

    def begin(self, world: World | BulletWorld, seed: int) -> ActuatorArrays:
        """Stand in the nominal pose on the motors and in the conditions of this seed; returns the motors' arrays."""
        conditions = self.walk.randomization.conditions(self.robot, seed, self.walk.episode_steps)
        return world.reset(self.draw_motors(np.random.default_rng(seed)), conditions=conditions)


class SimulatedBackend:
    """A robot in the engine of a scene, with new motors and conditions in every episode.

    Raises:
        ConfigError: a robot that has no model for the engine.
    """

    def __init__(self, scene: Scene):
        self._scene, self.world = scene, scene.world()

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose; ``seed`` determines everything random."""
        self._motors = self._scene.begin(self.world, seed)
        return self.world.state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad], finite float64, for one control step."""
        return self.world.state(self._motors, self.world.hold(self._motors, position_target))

    def close(self) -> None:
        """Close the engine."""
        self.world.close()


@dataclass(frozen=True)
class Episode:
    """Result of an episode."""

    total: float  # sum of rewards [m]
    steps: int  # control steps until the fall or the time limit
    speed_error: float  # mean over the steps of |filtered forward speed - commanded speed| [m/s]
    displacement: np.ndarray  # (2,) forward and left [m]
    fault: int  # 0 or a key of `world.FAULTS`
    mean: np.ndarray  # (observations,) mean of the observations, one per step
    m2: np.ndarray  # (observations,) Σ (x - mean)²
    trace: np.ndarray  # (steps, 7 + joints) qpos before every control step; empty if not requested
    # (steps, 6 + 2 joints) qvel before every control step, torque in the physics step before it [N·m]; empty as trace
    motion: np.ndarray


def require_walks(episodes: Sequence[Episode], name: str) -> None:
    """Raise SimulationFault, with their number, if a walk of policy ``name`` diverged: it is no fall."""
    if faults := Counter(FAULTS[episode.fault] for episode in episodes if episode.fault):
        problem = f"{faults.total()} of {len(episodes)} walks of {name} had a simulation fault ({', '.join(faults)})"
        raise SimulationFault(f"{problem}: such walks cannot be evaluated", remedy=TOO_STIFF)


class Walker(NamedTuple):
    """A robot in an episode, without its world."""

    motors: ActuatorArrays
    sensors: SensorErrors
    schedule: np.ndarray  # (steps, 2) commanded speed [m/s] and yaw rate [rad/s]; the last row stays in force
    gait: GaitState
    action: np.ndarray  # (actions,)
    measured: np.ndarray  # (joints,) scratch: encoder readings [rad]
    feet: np.ndarray  # (legs, 3) scratch: centres of the feet [m]


@njit(cache=True, nogil=True)
def _episode(body, world, walker, policy, weights, max_steps, mean, m2, trace):
    """Return total reward, steps and fault."""
    body, world, walker = without_refcounts(body), without_refcounts(world), without_refcounts(walker)
    policy, weights = without_refcounts(policy), without_refcounts(weights)
    mean, m2 = without_refcounts(mean), without_refcounts(m2)
    motors, sensors, schedule, gait, action, measured, feet = walker
    total, steps, fault, nq, nv = 0.0, 0, 0, world.qpos.shape[0], world.qvel.shape[0]
    begin_gait(body, gait)
    observe(body, read_state(world, motors, 0.0, measured, feet), gait.observation)
    for step in range(max_steps):
        complete_observation(body, gait, sensors, schedule, step, world.qpos[3:7])
        if trace.shape[0] > 0:
            trace[step, :nq] = world.qpos
            trace[step, nq : nq + nv] = world.qvel
            trace[step, nq + nv :] = world.torque
        update_stats(gait.observation, step, mean, m2)
        act(policy, gait.observation, action)
        command_step(body, gait, action)
        squared = hold_target(world, motors, gait.target)
        state = read_state(world, motors, squared, measured, feet)
        reward, ended = evaluate_step(body, gait, state, weights)
        total, steps, fault = total + reward, step + 1, state.fault
        if ended:
            break
    return total, steps, fault


class WalkSimulator:
    """Runs episodes of a scene in MuJoCo; one per thread."""

    def __init__(self, scene: Scene):
        self._scene, self._body = scene, body_of(scene.robot)
        self.world, self._weights = World(scene.robot, scene.physics_dt), scene.walk.task.array()

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """One episode of a policy of the robot; ``seed`` draws motors, conditions and commands."""
        world, steps = self.world, self._scene.walk.episode_steps
        motors, gait = self._scene.begin(world, seed), new_gait(self._body)
        inputs = self._scene.walk.inputs(self._scene.robot, seed)
        measured, feet = np.zeros_like(gait.target), np.zeros((len(gait.feet), 3))
        walker = Walker(motors, *inputs, gait, np.zeros_like(gait.command), measured, feet)
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        qpos, qvel, torque = world.arrays.qpos, world.arrays.qvel, world.arrays.torque
        rows = np.zeros((steps if trace else 0, len(qpos) + len(qvel) + len(torque)))
        arguments = world.arrays, walker, policy, self._weights, steps, mean, m2, rows
        total, done, fault = _episode(self._body, *arguments)
        where, speed_error = np.zeros(2) if fault else qpos[:2].copy(), gait.speed_errors / done
        poses, motion = np.ascontiguousarray(rows[:done, : len(qpos)]), rows[:done, len(qpos) :]
        return Episode(total, done, speed_error, where, fault, mean, m2, poses, motion)

    def close(self) -> None:
        """Nothing to close."""
