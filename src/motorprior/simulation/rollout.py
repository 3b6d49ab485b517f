"""A whole walking episode in one compiled call: policy, generator, motors, physics, reward, end.

It calls the same compiled pieces in the same order as `locomotion.env.PupperWalkEnv` on `MujocoBackend`, and
gives bit for bit what they give; only the interpreter is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.borrowed import borrowed
from motorprior.locomotion.bounds import require_count, require_finite
from motorprior.locomotion.control_step import accumulate_moments, command_step, evaluate_step
from motorprior.locomotion.policy import ACTION_SIZE, OBSERVATION_SIZE, act
from motorprior.locomotion.sensing import Sensors, sense
from motorprior.locomotion.task import TaskWeights, observe
from motorprior.robots.pupper_v2.spec import NUM_JOINTS
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import World, WorldArrays, WorldConfig, find_fault, hold_target, read_joints


@dataclass(frozen=True)
class WalkConfig:
    """An episode.

    Attributes:
        episode_steps: control steps at most.
        task: reward coefficients.
        randomization: what differs between episodes besides the motors.

    Raises:
        ConfigError: episode_steps is no whole number of at least 1.
    """

    episode_steps: int = 250
    task: TaskWeights = field(default_factory=TaskWeights)
    randomization: Randomization = field(default_factory=Randomization)

    def __post_init__(self) -> None:
        """Refuse episodes that have no steps."""
        require_count("episode_steps", self.episode_steps)


@dataclass(frozen=True)
class Episode:
    """What happened.

    Attributes:
        total: sum of rewards [m].
        steps: control steps until the fall or the end of time.
        displacement: (2,) forward and left [m].
        fault: 0 or a key of `world.FAULTS`.
        count: observations; mean (18,) and m2 (18,) are their Welford statistics.
        mean: see count.
        m2: see count.
        trace: (steps, 19) qpos before every control step, if it was asked for.
    """

    total: float
    steps: int
    displacement: np.ndarray
    fault: int
    count: int
    mean: np.ndarray
    m2: np.ndarray
    trace: np.ndarray


class Walker(NamedTuple):
    """What one walking robot needs besides world and motors; state and scratch."""

    observation: np.ndarray
    action: np.ndarray
    filter_state: np.ndarray
    command: np.ndarray
    target: np.ndarray
    measured: np.ndarray


def new_walker() -> Walker:
    """Of a robot that has not walked yet."""
    sizes = (OBSERVATION_SIZE, ACTION_SIZE, ACTION_SIZE, ACTION_SIZE, NUM_JOINTS, NUM_JOINTS)
    return Walker(*(np.zeros(size) for size in sizes))


@njit(cache=True, nogil=True, inline="always")
def begin_walk(world: WorldArrays, motors: ActuatorArrays, sensors: Sensors, walker: Walker) -> None:
    """First observation of an episode, after the world's reset; the phase is 0."""
    walker.filter_state[:] = 0.0
    read_joints(world, motors, walker.measured)
    observe(world.qpos[3:7], world.qvel[3:6], walker.measured, 0.0, walker.observation)
    sense(sensors, 0, walker.observation)


@njit(cache=True, nogil=True, inline="always")
def walk_step(
    world: WorldArrays, motors: ActuatorArrays, walker: Walker, phase: float, control_dt: float, task: np.ndarray
) -> tuple[float, float, bool, int]:
    """One control step of ``walker.action``, up to the true observation.

    Returns:
        The new phase, the reward [m], whether the episode is over, and the fault.
    """
    qpos, qvel = world.qpos, world.qvel
    phase = command_step(walker.action, walker.filter_state, phase, control_dt, walker.command, walker.target)
    previous_x = qpos[0]
    squared = hold_target(world, motors, walker.target)
    fault = find_fault(world)
    read_joints(world, motors, walker.measured)
    reward, ended = evaluate_step(
        qpos[:3], qpos[3:7], qvel[:3], qvel[3:6], walker.measured, squared, fault,
        previous_x, phase, control_dt, task, walker.observation,
    )  # fmt: skip
    return phase, reward, ended, fault


@njit(cache=True, nogil=True)
def _episode(
    world: WorldArrays,
    motors: ActuatorArrays,
    weights: np.ndarray,
    obs_mean: np.ndarray,
    obs_std: np.ndarray,
    task: np.ndarray,
    sensors: Sensors,
    control_dt: float,
    max_steps: int,
    s: Walker,
    mean: np.ndarray,
    m2: np.ndarray,
    trace: np.ndarray,
) -> tuple[float, int, int]:
    """Return total reward, steps and fault."""
    world, motors, sensors, s = borrowed(world), borrowed(motors), borrowed(sensors), borrowed(s)
    weights, obs_mean, obs_std, task = borrowed(weights), borrowed(obs_mean), borrowed(obs_std), borrowed(task)
    mean, m2 = borrowed(mean), borrowed(m2)
    phase, total, steps, fault = 0.0, 0.0, 0, 0
    begin_walk(world, motors, sensors, s)
    for step in range(max_steps):
        if trace.shape[0] > 0:
            trace[step] = world.qpos
        accumulate_moments(s.observation, step, mean, m2)
        act(weights, obs_mean, obs_std, s.observation, s.action)
        phase, reward, ended, fault = walk_step(world, motors, s, phase, control_dt, task)
        total += reward
        steps = step + 1
        if ended:
            break
        sense(sensors, steps, s.observation)
    return total, steps, fault


def checked_policy(weights: np.ndarray, mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (16, 19), mean (18,) and standard deviation (18,) that compiled code can read.

    Raises:
        ConfigError: another shape, or a number that is not finite.
    """
    return (
        require_finite("weights", weights, (ACTION_SIZE, OBSERVATION_SIZE + 1)),
        require_finite("observation_mean", mean, (OBSERVATION_SIZE,)),
        require_finite("observation_std", std, (OBSERVATION_SIZE,)),
    )


class WalkSimulator:
    """Runs episodes; one per thread.

    Args:
        draw_motors: the motors of an episode, from a generator seeded by the episode's seed.
        world: physics.
        walk: episode.

    Attributes:
        world: the robot.
    """

    def __init__(self, draw_motors: DrawMotors, world: WorldConfig | None = None, walk: WalkConfig | None = None):
        self.world = World(world or WorldConfig())
        self._draw = draw_motors
        self._walk = walk or WalkConfig()
        self._task = self._walk.task.array()
        self._walker = new_walker()

    def run(
        self,
        weights: np.ndarray,
        observation_mean: np.ndarray,
        observation_std: np.ndarray,
        seed: int,
        trace: bool = False,
    ) -> Episode:
        """One episode of a linear policy, weights (16, 19), on the motors that ``seed`` draws.

        Raises:
            ConfigError: weights, mean or standard deviation of another shape, or not finite.
        """
        policy = checked_policy(weights, observation_mean, observation_std)
        steps = self._walk.episode_steps
        conditions = self._walk.randomization.conditions(seed, steps)
        motors = self.world.reset(self._draw(np.random.default_rng(seed)), conditions=conditions)
        sensors = self._walk.randomization.sensors(seed, steps)
        mean, m2 = np.zeros(OBSERVATION_SIZE), np.zeros(OBSERVATION_SIZE)
        qpos = np.zeros((steps if trace else 0, len(self.world.arrays.qpos)))
        total, done, fault = _episode(
            self.world.arrays, motors, *policy, self._task, sensors, self.world.config.control_dt, steps,
            self._walker, mean, m2, qpos,
        )  # fmt: skip
        base = self.world.arrays.qpos[:2]
        where = np.zeros(2) if fault else base.copy()
        return Episode(total, done, where, fault, done, mean, m2, qpos[:done])

    def close(self) -> None:
        """Nothing to give back."""
