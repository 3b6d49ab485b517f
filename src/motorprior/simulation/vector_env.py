"""Many walking robots as one Gymnasium environment: each thread steps its share in one compiled call."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba.typed import List

from motorprior.actuator.kernels import without_refcounts
from motorprior.bounds import require_count, require_finite
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import body_of
from motorprior.simulation.env import spaces
from motorprior.simulation.rollout import begin_walk, complete, drawn_walker, walk_step
from motorprior.simulation.scene import Scene
from motorprior.simulation.world import World


@njit(cache=True, nogil=True)
def _step(body, worlds, walkers, share, actions, weights, steps, out):
    """One control step of the robots in ``share``; ``out`` is (observations, rewards, over, faults, phases)."""
    observations, rewards, over, faults, phases = out
    for index in share:
        world, walker = without_refcounts(worlds[index]), without_refcounts(walkers[index])
        walker.action[:] = actions[index]
        rewards[index], over[index], faults[index] = walk_step(body, world, walker, weights)
        phases[index] = walker.gait.scalars[0]
        steps[index] += 1
        if faults[index] == 0:
            complete(body, world, walker, steps[index])
        observations[index] = walker.gait.observation


class WalkVectorEnv(VectorEnv):
    """N robots; the step after the end of an episode resets that robot, with reward 0.

    Observations, rewards and terminations are bit for bit those of N `env.WalkEnv` of the scene in a
    `gymnasium.vector.SyncVectorEnv`, on any number of threads. Infos: fault, phase and base_pos.

    Args:
        scene: of every robot.
        num_envs: N.
        threads: up to N.

    Raises:
        ConfigError: another engine than MuJoCo, or a number out of range.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, scene: Scene, num_envs: int, threads: int = 1):
        require_count("num_envs", num_envs)
        require_count("threads", threads)
        if scene.walk.engine != "mujoco":
            remedy = 'use vectorization_mode="async"'
            raise ConfigError(f"vector environments are for MuJoCo, not {scene.walk.engine!r}", remedy=remedy)
        self.num_envs, self._scene, self._body = num_envs, scene, body_of(scene.robot, scene.walk.gait)
        self.single_observation_space, self.single_action_space = spaces(scene.robot.num_joints)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._worlds = [World(scene.robot, scene.physics_dt) for _ in range(num_envs)]
        self._rngs, self._weights = [seeding.np_random(None)[0] for _ in range(num_envs)], scene.walk.task.array()
        self._pool, self._threads, self._begun = ThreadPoolExecutor(threads), threads, False
        self._steps, self._over = np.zeros(num_envs, np.int64), np.zeros(num_envs, bool)
        self._observations = np.zeros(self.observation_space.shape or ())
        self._rewards, self._phases, self._faults = np.zeros(num_envs), np.zeros(num_envs), np.zeros(num_envs, np.int64)
        walkers = [drawn_walker(scene, self._body, world, 0) for world in self._worlds]
        arrays = [world.arrays for world in self._worlds]
        self._lists: Any = (List(arrays), List(walkers))  # pyright: ignore[reportCallIssue]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin N episodes. From one seed, robot i gets seed + i; without, it uses its own generator."""
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
        actions = require_finite("actions", actions, self.action_space.shape or ())
        resting = self._over.copy()
        running, terminated = np.flatnonzero(~resting), np.zeros(self.num_envs, bool)
        out = (self._observations, self._rewards, terminated, self._faults, self._phases)
        shares = [running[first :: self._threads] for first in range(self._threads)]
        jobs = [np.ascontiguousarray(share) for share in shares if len(share)]

        def step(share: np.ndarray) -> None:
            worlds, walkers = self._lists
            _step(self._body, worlds, walkers, share, actions, self._weights, self._steps, out)

        list(self._pool.map(step, jobs))
        for index in np.flatnonzero(resting):
            self._begin(int(index), None)
            self._rewards[index] = 0.0
        truncated = ~terminated & ~resting & (self._steps >= self._scene.walk.episode_steps)
        self._over = terminated | truncated
        return self._observations.copy(), self._rewards.copy(), terminated, truncated, self._info()

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._pool.shutdown()

    def _seeds(self, seed: int | list[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        return [seed + index for index in range(self.num_envs)] if isinstance(seed, int) else seed

    def _begin(self, index: int, seed: int | None) -> None:
        drawn = int(self._rngs[index].integers(2**31)) if seed is None else seed
        world, (worlds, walkers) = self._worlds[index], self._lists
        walker = drawn_walker(self._scene, self._body, world, drawn)
        begin_walk(self._body, world.arrays, walker)
        worlds[index], walkers[index], self._observations[index] = world.arrays, walker, walker.gait.observation
        self._steps[index], self._phases[index], self._faults[index], self._over[index] = 0, 0.0, 0, False

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, bool)
        base = np.array([world.arrays.qpos[:3] for world in self._worlds])
        values = {"fault": self._faults.copy(), "phase": self._phases.copy(), "base_pos": base}
        return values | {f"_{name}": every for name in values}
