"""A whole walking episode in one compiled call: policy, trajectory generator, motors, physics, reward, termination.

It calls the same compiled functions in the same order as `locomotion.env.WalkEnv` on `MujocoBackend`, so the results
are the same bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.bounds import require_count, require_finite
from motorprior.compiled import njit
from motorprior.locomotion.body import Body, action_size, body_of, observation_size
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.control_step import (
    GaitState,
    begin_gait,
    command_step,
    evaluate_step,
    follow_command,
    new_gait,
    update_stats,
)
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.locomotion.sensing import SensorErrors, apply_sensor_errors
from motorprior.locomotion.task import TaskWeights, observe
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.simulation.world_step import WorldArrays, find_fault, hold_target, read_joints


@dataclass(frozen=True)
class WalkConfig:
    """Settings of an episode.

    Attributes:
        episode_steps: maximum number of control steps.
        task: reward coefficients.
        randomization: of each episode, in addition to the motors.
        commands: speed and yaw rate.
        gait: see `locomotion.gaits`.

    Raises:
        ConfigError: episode_steps is not a whole number of at least 1.
    """

    episode_steps: int = 500
    task: TaskWeights = field(default_factory=TaskWeights)
    randomization: Randomization = field(default_factory=Randomization)
    commands: Commands | Timetable = field(default_factory=Commands)
    gait: GaitName = "trot"

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)


@dataclass(frozen=True)
class Episode:
    """Result of an episode.

    Attributes:
        total: sum of rewards [m].
        steps: control steps until the fall or the time limit.
        speed_error: mean over the steps of |filtered forward speed - commanded speed| [m/s].
        displacement: (2,) forward and left [m].
        fault: 0 or a key of `world_step.FAULTS`.
        count: number of observations.
        mean: (observations,) their mean.
        m2: (observations,) Σ (x - mean)².
        trace: (steps, 7 + joints) qpos before every control step; empty if not requested.
        motion: (steps, 6 + 2 joints) qvel before every control step and the torque on the joints in the physics step
            before it [N·m]; empty if not requested or not available from the engine.
    """

    total: float
    steps: int
    speed_error: float
    displacement: np.ndarray
    fault: int
    count: int
    mean: np.ndarray
    m2: np.ndarray
    trace: np.ndarray
    motion: np.ndarray


class WalkState(NamedTuple):
    """State and scratch memory of one walking robot, without world and motors."""

    observation: np.ndarray
    action: np.ndarray
    gait: GaitState
    commands: np.ndarray  # (steps, 2) speed [m/s] and yaw rate [rad/s]; the last row stays in force
    measured: np.ndarray  # (joints,) scratch: encoder readings [rad]
    feet: np.ndarray  # (legs, 3) scratch: centres of the feet [m]


def new_walk_state(num_joints: int, num_legs: int, commands: np.ndarray) -> WalkState:
    """Memory of a robot; `begin_walk` initialises it."""
    observation, action = np.zeros(observation_size(num_joints)), np.zeros(action_size(num_joints))
    gait, feet = new_gait(num_joints, num_legs), np.zeros((num_legs, 3))
    return WalkState(observation, action, gait, commands, np.zeros(num_joints), feet)


@njit(cache=True, nogil=True, inline="always")
def complete_observation(
    body: Body, sensors: SensorErrors, walker: WalkState, step: int, base_quat: np.ndarray, control_dt: float
) -> None:
    """Apply sensor errors and the command to the true readings of control step ``step``."""
    apply_sensor_errors(sensors, step, base_quat, walker.observation)
    row = min(step, walker.commands.shape[0] - 1)
    forward, yaw_rate = walker.commands[row, 0], walker.commands[row, 1]
    follow_command(body, walker.gait, forward, yaw_rate, control_dt, walker.observation)


@njit(cache=True, nogil=True, inline="always")
def begin_walk(
    body: Body, world: WorldArrays, motors: ActuatorArrays, sensors: SensorErrors, walker: WalkState, control_dt: float
) -> None:
    """First observation of an episode, after the world's reset."""
    begin_gait(body, walker.gait)
    read_joints(world, motors, walker.measured)
    observe(world.qpos[3:7], world.qvel[3:6], walker.measured, body.nominal_pose, walker.observation)
    complete_observation(body, sensors, walker, 0, world.qpos[3:7], control_dt)


@njit(cache=True, nogil=True, inline="always")
def walk_step(
    body: Body, world: WorldArrays, motors: ActuatorArrays, walker: WalkState, control_dt: float, task: np.ndarray
) -> tuple[float, bool, int]:
    """One control step of ``walker.action``, up to the true readings; returns reward [m], end of episode, fault."""
    qpos, qvel = world.qpos, world.qvel
    command_step(body, walker.action, walker.observation, walker.gait, control_dt)
    squared = hold_target(world, motors, walker.gait.target)
    fault = find_fault(world)
    read_joints(world, motors, walker.measured)
    for leg in range(walker.feet.shape[0]):
        walker.feet[leg] = world.geoms[world.feet[leg]]
    reward, ended = evaluate_step(
        body, qpos[:3], qpos[3:7], qvel[:3], qvel[3:6], walker.measured, walker.feet, squared, fault,
        walker.gait, control_dt, task, walker.observation,
    )  # fmt: skip
    return reward, ended, fault


@njit(cache=True, nogil=True)
def _episode(
    body: Body,
    world: WorldArrays,
    motors: ActuatorArrays,
    policy: PolicyArrays,
    task: np.ndarray,
    sensors: SensorErrors,
    control_dt: float,
    max_steps: int,
    s: WalkState,
    mean: np.ndarray,
    m2: np.ndarray,
    trace: np.ndarray,
) -> tuple[float, int, int]:
    """Return total reward, steps and fault."""
    world, motors, sensors = without_refcounts(world), without_refcounts(motors), without_refcounts(sensors)
    s, policy, task = without_refcounts(s), without_refcounts(policy), without_refcounts(task)
    mean, m2, body = without_refcounts(mean), without_refcounts(m2), without_refcounts(body)
    total, steps, fault, nq, nv = 0.0, 0, 0, world.qpos.shape[0], world.qvel.shape[0]
    begin_walk(body, world, motors, sensors, s, control_dt)
    for step in range(max_steps):
        if trace.shape[0] > 0:
            trace[step, :nq] = world.qpos
            trace[step, nq : nq + nv] = world.qvel
            trace[step, nq + nv :] = world.torque
        update_stats(s.observation, step, mean, m2)
        act(policy, s.observation, s.action)
        reward, ended, fault = walk_step(body, world, motors, s, control_dt, task)
        total += reward
        steps = step + 1
        if ended:
            break
        complete_observation(body, sensors, s, steps, world.qpos[3:7], control_dt)
    return total, steps, fault


def checked_policy(num_joints: int, policy: PolicyArrays) -> PolicyArrays:
    """The policy's arrays for compiled code; ConfigError for another shape or a number that is not finite."""
    observations, actions, units = observation_size(num_joints), action_size(num_joints), len(policy.hidden)
    weights = require_finite("weights", policy.weights, (actions, observations + 1))
    return PolicyArrays(
        np.asfortranarray(weights),  # the inner loop of `act` runs over the actions
        require_finite("hidden", policy.hidden, (units, observations + 1)),
        require_finite("readout", policy.readout, (units, actions)),
        require_finite("observation_mean", policy.mean, (observations,)),
        require_finite("observation_std", policy.std, (observations,)),
    )


class WalkSimulator:
    """Runs episodes; one per thread.

    Args:
        draw_motors: the motors of an episode, from a generator seeded by the episode's seed.
        world: robot and physics.
        walk: episode.
    """

    def __init__(self, draw_motors: DrawMotors, world: WorldConfig, walk: WalkConfig | None = None):
        self._walk = walk or WalkConfig()
        self._body = body_of(world.robot, self._walk.gait)
        self.world = World(world)
        self._draw = draw_motors
        self._task = self._walk.task.array()
        self._walker = new_walk_state(world.robot.num_joints, len(world.robot.legs), np.zeros((1, 2)))

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """One episode of a policy; ``seed`` draws motors, conditions and commands.

        Raises:
            ConfigError: arrays of another shape, or not finite.
        """
        robot, world = self.world.config.robot, self.world
        policy, steps = checked_policy(robot.num_joints, policy), self._walk.episode_steps
        conditions = self._walk.randomization.conditions(robot, seed, steps)
        motors = world.reset(self._draw(np.random.default_rng(seed)), conditions=conditions)
        sensors = self._walk.randomization.sensors(robot, seed, steps)
        walker = self._walker._replace(commands=self._walk.commands.schedule(robot, seed, steps))
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        qpos, qvel, torque = world.arrays.qpos, world.arrays.qvel, world.arrays.torque
        rows = np.zeros((steps if trace else 0, len(qpos) + len(qvel) + len(torque)))
        total, done, fault = _episode(
            self._body, world.arrays, motors, policy, self._task, sensors,
            world.config.control_dt, steps, walker, mean, m2, rows,
        )  # fmt: skip
        where = np.zeros(2) if fault else qpos[:2].copy()
        poses, motion = np.ascontiguousarray(rows[:done, : len(qpos)]), rows[:done, len(qpos) :]
        speed_error = walker.gait.speed_errors / done
        return Episode(total, done, speed_error, where, fault, done, mean, m2, poses, motion)

    def close(self) -> None:
        """Nothing to close."""
