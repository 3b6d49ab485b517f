"""Several walking environments as one, stepped on threads: backends that release the interpreter lock overlap."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from motorprior.exceptions import ConfigError
from motorprior.locomotion.env import PupperWalkEnv


class PupperWalkVectorEnv(VectorEnv):
    """N environments; one whose episode is over is reset by the next step, whose reward is then zero.

    It gives what `gymnasium.vector.SyncVectorEnv` gives in the mode `AutoresetMode.NEXT_STEP`, on any number of
    threads.

    Args:
        envs: at least one, all with the same spaces.
        threads: at most one per environment is of use.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, envs: Sequence[PupperWalkEnv], threads: int = 1):
        if not envs or threads < 1:
            raise ConfigError(f"{len(envs)} environments on {threads} threads", remedy="use at least one of each")
        space, actions = envs[0].observation_space, envs[0].action_space
        assert isinstance(space, Box)
        self.num_envs, self._envs = len(envs), list(envs)
        self.single_observation_space, self.single_action_space = space, actions
        self.observation_space, self.action_space = batch_space(space, len(envs)), batch_space(actions, len(envs))
        self._shares = [range(first, len(envs), threads) for first in range(min(threads, len(envs)))]
        self._pool = ThreadPoolExecutor(len(self._shares))
        self._over = np.zeros(len(envs), bool)
        self._observations = np.zeros((len(envs), *space.shape))
        self._rewards = np.zeros(len(envs))
        self._ends = np.zeros((2, len(envs)), bool)
        self._infos: list[dict[str, Any]] = [{} for _ in envs]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin N episodes; from one seed, environment i gets seed + i."""
        seeds = [seed + i if isinstance(seed, int) else None for i in range(self.num_envs)]
        seeds = list(seed) if isinstance(seed, list) else seeds
        for index, (env, own) in enumerate(zip(self._envs, seeds, strict=True)):
            self._observations[index], self._infos[index] = env.reset(seed=own)
        self._over[:] = False
        return self._observations.copy(), self._info()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one control step, or reset it if its episode is over.

        Args:
            actions: (N, 16).

        Returns:
            Observations (N, 18), rewards (N,), terminated (N,), truncated (N,), infos.
        """
        actions = np.asarray(actions, dtype=np.float64)
        if len(actions) != self.num_envs:
            raise ConfigError(f"actions of {len(actions)} environments, there are {self.num_envs}")
        list(self._pool.map(lambda share: self._step_share(share, actions), self._shares))
        terminated, truncated = self._ends.copy()
        self._over = terminated | truncated
        return self._observations.copy(), self._rewards.copy(), terminated, truncated, self._info()

    def close_extras(self, **kwargs: Any) -> None:
        """Close every environment."""
        self._pool.shutdown()
        for env in self._envs:
            env.close()

    def _step_share(self, share: range, actions: np.ndarray) -> None:
        for index in share:
            env = self._envs[index]
            if self._over[index]:
                self._observations[index], self._infos[index] = env.reset()
                self._rewards[index], self._ends[:, index] = 0.0, False
            else:
                observation, reward, *ends, info = env.step(actions[index])
                self._observations[index], self._rewards[index], self._infos[index] = observation, reward, info
                self._ends[:, index] = ends

    def _info(self) -> dict[str, Any]:
        merged: dict[str, Any] = {}
        for index, info in enumerate(self._infos):
            merged = self._add_info(merged, info, index)
        return merged
