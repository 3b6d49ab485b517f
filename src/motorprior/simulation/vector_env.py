"""Many walking robots as one Gymnasium environment: each thread steps its share in one compiled call."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba.typed import List

from motorprior.actuator.kernels import without_refcounts
from motorprior.bounds import require_count, require_finite
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import action_size, body_of
from motorprior.locomotion.env import observation_bounds
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.rollout import WalkConfig, begin_walk, complete_observation, new_walk_state, walk_step
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig


@njit(cache=True, nogil=True)
def _begin(body, worlds, motors, sensors, walkers, index, control_dt, observations):
    """First observation of one robot."""
    world, sensor = without_refcounts(worlds[index]), without_refcounts(sensors[index])
    begin_walk(body, world, without_refcounts(motors[index]), sensor, without_refcounts(walkers[index]), control_dt)
    observations[index] = walkers[index].observation


@njit(cache=True, nogil=True)
def _step(body, worlds, motors, sensors, walkers, share, actions, control_dt, task, steps, out):
    """One control step of the robots in ``share``; ``out`` is (observations, rewards, over, faults, phases)."""
    observations, rewards, over, faults, phases = out
    for index in share:
        world, walker = without_refcounts(worlds[index]), without_refcounts(walkers[index])
        walker.action[:] = actions[index]
        rewards[index], over[index], faults[index] = walk_step(
            body, world, without_refcounts(motors[index]), walker, control_dt, task
        )
        phases[index] = walker.gait.scalars[0]
        steps[index] += 1
        if faults[index] == 0:
            complete_observation(
                body, without_refcounts(sensors[index]), walker, steps[index], world.qpos[3:7], control_dt
            )
        observations[index] = walker.observation


class WalkVectorEnv(VectorEnv):
    """N robots; the step after the end of an episode resets that robot, with reward 0.

    Observations, rewards and terminations are bit for bit those of N `locomotion.env.WalkEnv` on `MujocoBackend` in a
    `gymnasium.vector.SyncVectorEnv`, on any number of threads. Infos: fault, phase and base_pos.

    Args:
        num_envs: N.
        draw_motors: the motors of an episode, from a generator seeded by the episode's seed.
        config: robot and physics.
        walk: episode.
        threads: up to N.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, num_envs: int, draw_motors: DrawMotors, config: WorldConfig, walk: WalkConfig, threads: int = 1):
        require_count("num_envs", num_envs)
        require_count("threads", threads)
        self.num_envs, self._walk, self._draw, self._dt = num_envs, walk, draw_motors, config.control_dt
        self._robot, self._body = config.robot, body_of(config.robot, walk.gait)
        bounds = observation_bounds(config.robot.num_joints)
        self.single_observation_space = Box(-bounds, bounds, dtype=np.float64)
        self.single_action_space = Box(-1.0, 1.0, (action_size(config.robot.num_joints),), np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._worlds, self._task = [World(config) for _ in range(num_envs)], walk.task.array()
        self._rngs = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._pool, self._threads, self._begun = ThreadPoolExecutor(threads), threads, False
        self._steps, self._over = np.zeros(num_envs, np.int64), np.zeros(num_envs, bool)
        self._observations = np.zeros((num_envs, len(bounds)))
        self._rewards, self._phases, self._faults = np.zeros(num_envs), np.zeros(num_envs), np.zeros(num_envs, np.int64)
        parts = [self._drawn(index, 0) for index in range(num_envs)]
        self._lists: Any = tuple(List(column) for column in zip(*parts, strict=True))  # pyright: ignore[reportCallIssue]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin N episodes.

        Args:
            seed: N seeds, or one: robot i gets seed + i. A robot without a seed uses its own generator.
            options: unused.
        """
        self._begun = True
        for index, own in zip(range(self.num_envs), self._seeds(seed), strict=True):
            if own is not None:
                self._rngs[index] = seeding.np_random(own)[0]
            self._begin(index, own)
        return self._observations.copy(), self._info()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every robot by one control step, or reset it if its episode is over.

        Args:
            actions: (N, actions), clipped to [-1, 1].

        Raises:
            ConfigError: no reset before; actions of another shape, or not finite.
        """
        if not self._begun:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        actions = require_finite("actions", actions, (self.num_envs, action_size(self._robot.num_joints)))
        resting = self._over.copy()
        running, terminated = np.flatnonzero(~resting), np.zeros(self.num_envs, bool)
        out = (self._observations, self._rewards, terminated, self._faults, self._phases)
        shares = [running[first :: self._threads] for first in range(self._threads)]
        jobs = [np.ascontiguousarray(share) for share in shares if len(share)]
        list(self._pool.map(lambda share: self._step_share(share, actions, out), jobs))
        for index in np.flatnonzero(resting):
            self._begin(int(index), None)
            self._rewards[index] = 0.0
        truncated = ~terminated & ~resting & (self._steps >= self._walk.episode_steps)
        self._over = terminated | truncated
        return self._observations.copy(), self._rewards.copy(), terminated, truncated, self._info()

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._pool.shutdown()

    def _seeds(self, seed: int | list[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        return [seed + index for index in range(self.num_envs)] if isinstance(seed, int) else seed

    def _step_share(self, share: np.ndarray, actions: np.ndarray, out: tuple) -> None:
        worlds, motors, sensors, walkers = self._lists
        _step(self._body, worlds, motors, sensors, walkers, share, actions, self._dt, self._task, self._steps, out)

    def _drawn(self, index: int, seed: int) -> tuple[Any, ...]:
        """World, motors, sensors and walker of a new episode."""
        world, episode_steps, varied = self._worlds[index], self._walk.episode_steps, self._walk.randomization
        motors = self._draw(np.random.default_rng(seed))
        arrays = world.reset(motors, conditions=varied.conditions(self._robot, seed, episode_steps))
        sensors = varied.sensors(self._robot, seed, episode_steps)
        commands = self._walk.commands.schedule(self._robot, seed, episode_steps)
        return world.arrays, arrays, sensors, new_walk_state(self._robot.num_joints, len(self._robot.legs), commands)

    def _begin(self, index: int, seed: int | None) -> None:
        drawn = int(self._rngs[index].integers(2**31)) if seed is None else seed
        for column, part in zip(self._lists, self._drawn(index, drawn), strict=True):
            column[index] = part
        self._steps[index], self._phases[index], self._faults[index] = 0, 0.0, 0
        self._over[index] = False
        worlds, motors, sensors, walkers = self._lists
        _begin(self._body, worlds, motors, sensors, walkers, index, self._dt, self._observations)

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, bool)
        base = np.array([world.arrays.qpos[:3] for world in self._worlds])
        values = {"fault": self._faults.copy(), "phase": self._phases.copy(), "base_pos": base}
        return values | {f"_{name}": every for name in values}
