"""A whole walking episode in one compiled call: policy, generator, motors, physics, reward, end.

It calls the same compiled functions in the same order as `locomotion.env.WalkEnv` on `MujocoBackend`, without the
interpreter between them, and gives the same results bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.borrowed import borrowed
from motorprior.bounds import require_count, require_finite
from motorprior.compiled import njit
from motorprior.locomotion.body import Body, action_size, body_of, observation_size
from motorprior.locomotion.control_step import accumulate_moments, command_step, evaluate_step
from motorprior.locomotion.policy import act
from motorprior.locomotion.sensing import Sensors, sense
from motorprior.locomotion.task import TaskWeights, observe
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import World, WorldArrays, WorldConfig, find_fault, hold_target, read_joints


@dataclass(frozen=True)
class WalkConfig:
    """Settings of an episode.

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
    """Outcome of an episode.

    Attributes:
        total: sum of rewards [m].
        steps: control steps until the fall or the time limit.
        displacement: (2,) forward and left [m].
        fault: 0 or a key of `world.FAULTS`.
        count: observations; mean and m2 (observations,) are their Welford statistics.
        mean: see count.
        m2: see count.
        trace: (steps, 7 + joints) qpos before every control step, if it was asked for.
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
    """State and scratch memory of one walking robot, besides world and motors."""

    observation: np.ndarray
    action: np.ndarray
    filter_state: np.ndarray
    command: np.ndarray
    target: np.ndarray
    measured: np.ndarray


def new_walker(num_joints: int) -> Walker:
    """Initial state of a robot."""
    actions = action_size(num_joints)
    sizes = (observation_size(num_joints), actions, actions, actions, num_joints, num_joints)
    return Walker(*(np.zeros(size) for size in sizes))


@njit(cache=True, nogil=True, inline="always")
def begin_walk(body: Body, world: WorldArrays, motors: ActuatorArrays, sensors: Sensors, walker: Walker) -> None:
    """First observation of an episode, after the world's reset; the phase is 0."""
    walker.filter_state[:] = 0.0
    read_joints(world, motors, walker.measured)
    observe(world.qpos[3:7], world.qvel[3:6], walker.measured, 0.0, body.nominal_pose, walker.observation)
    sense(sensors, 0, walker.observation)


@njit(cache=True, nogil=True, inline="always")
def walk_step(
    body: Body,
    world: WorldArrays,
    motors: ActuatorArrays,
    walker: Walker,
    phase: float,
    control_dt: float,
    task: np.ndarray,
) -> tuple[float, float, bool, int]:
    """One control step of ``walker.action``, up to the true observation.

    Returns:
        The new phase, the reward [m], whether the episode is over, and the fault.
    """
    qpos, qvel = world.qpos, world.qvel
    phase = command_step(body, walker.action, walker.filter_state, phase, control_dt, walker.command, walker.target)
    previous_x = qpos[0]
    squared = hold_target(world, motors, walker.target)
    fault = find_fault(world)
    read_joints(world, motors, walker.measured)
    reward, ended = evaluate_step(
        body, qpos[:3], qpos[3:7], qvel[:3], qvel[3:6], walker.measured, squared, fault,
        previous_x, phase, control_dt, task, walker.observation,
    )  # fmt: skip
    return phase, reward, ended, fault


@njit(cache=True, nogil=True)
def _episode(
    body: Body,
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
    mean, m2, body = borrowed(mean), borrowed(m2), borrowed(body)
    phase, total, steps, fault = 0.0, 0.0, 0, 0
    begin_walk(body, world, motors, sensors, s)
    for step in range(max_steps):
        if trace.shape[0] > 0:
            trace[step] = world.qpos
        accumulate_moments(s.observation, step, mean, m2)
        act(weights, obs_mean, obs_std, s.observation, s.action)
        phase, reward, ended, fault = walk_step(body, world, motors, s, phase, control_dt, task)
        total += reward
        steps = step + 1
        if ended:
            break
        sense(sensors, steps, s.observation)
    return total, steps, fault


def checked_policy(
    num_joints: int, weights: np.ndarray, mean: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, mean and standard deviation as arrays for compiled code; shapes as in `locomotion.policy.Policy`.

    Raises:
        ConfigError: another shape, or a number that is not finite.
    """
    observations = observation_size(num_joints)
    return (
        require_finite("weights", weights, (action_size(num_joints), observations + 1)),
        require_finite("observation_mean", mean, (observations,)),
        require_finite("observation_std", std, (observations,)),
    )


class WalkSimulator:
    """Runs episodes; one per thread.

    Args:
        draw_motors: the motors of an episode, from a generator seeded by the episode's seed.
        world: robot and physics.
        walk: episode.

    Attributes:
        world: the robot.
    """

    def __init__(self, draw_motors: DrawMotors, world: WorldConfig, walk: WalkConfig | None = None):
        self._body = body_of(world.robot)
        self.world = World(world)
        self._draw = draw_motors
        self._walk = walk or WalkConfig()
        self._task = self._walk.task.array()
        self._walker = new_walker(world.robot.num_joints)

    def run(
        self,
        weights: np.ndarray,
        observation_mean: np.ndarray,
        observation_std: np.ndarray,
        seed: int,
        trace: bool = False,
    ) -> Episode:
        """One episode of a linear policy on the motors that ``seed`` draws.

        Raises:
            ConfigError: weights, mean or standard deviation of another shape, or not finite.
        """
        robot = self.world.config.robot
        policy = checked_policy(robot.num_joints, weights, observation_mean, observation_std)
        steps = self._walk.episode_steps
        conditions = self._walk.randomization.conditions(robot, seed, steps)
        motors = self.world.reset(self._draw(np.random.default_rng(seed)), conditions=conditions)
        sensors = self._walk.randomization.sensors(robot, seed, steps)
        weights = np.asfortranarray(policy[0])  # the inner loop of `act` runs over the actions
        mean, m2 = np.zeros_like(policy[1]), np.zeros_like(policy[1])
        qpos = np.zeros((steps if trace else 0, len(self.world.arrays.qpos)))
        total, done, fault = _episode(
            self._body, self.world.arrays, motors, weights, *policy[1:], self._task, sensors,
            self.world.config.control_dt, steps, self._walker, mean, m2, qpos,
        )  # fmt: skip
        base = self.world.arrays.qpos[:2]
        where = np.zeros(2) if fault else base.copy()
        return Episode(total, done, where, fault, done, mean, m2, qpos[:done])

    def close(self) -> None:
        """Nothing to give back."""
