"""A whole walking episode on any backend: the Gymnasium loop, with the interpreter between control steps.

On `MujocoBackend` it gives bit for bit what the compiled `rollout.WalkSimulator` gives.
"""

from __future__ import annotations

import numpy as np

from motorprior.backend import Backend
from motorprior.locomotion.control_step import accumulate_moments
from motorprior.locomotion.env import PupperWalkEnv
from motorprior.locomotion.policy import ACTION_SIZE, OBSERVATION_SIZE, act
from motorprior.simulation.rollout import Episode, WalkConfig, checked_policy


class BackendSimulator:
    """Runs episodes on a backend; one per thread.

    Args:
        backend: made with the randomization and the episode_steps of ``walk``.
        walk: episode.
    """

    def __init__(self, backend: Backend, walk: WalkConfig):
        self._env = PupperWalkEnv(backend, walk.task, walk.episode_steps, draw_sensors=walk.randomization.sensors)

    def run(
        self,
        weights: np.ndarray,
        observation_mean: np.ndarray,
        observation_std: np.ndarray,
        seed: int,
        trace: bool = False,
    ) -> Episode:
        """See `WalkSimulator.run`; the trace holds base poses and the joint angles as measured."""
        policy = checked_policy(weights, observation_mean, observation_std)
        observation, info = self._env.reset(seed=seed)
        mean, m2, action = np.zeros(OBSERVATION_SIZE), np.zeros(OBSERVATION_SIZE), np.zeros(ACTION_SIZE)
        total, count, ended, rows = 0.0, 0, False, []
        while not ended:
            if trace:
                rows.append(np.concatenate([info["base_pos"], info["base_quat"], info["measured_joint_pos"]]))
            count = accumulate_moments(observation, count, mean, m2)
            act(*policy, observation, action)
            observation, earned, terminated, truncated, info = self._env.step(action)
            total, ended = total + earned, terminated or truncated
        fault = info["fault"]
        where = np.zeros(2) if fault else info["base_pos"][:2]
        return Episode(total, count, where, fault, count, mean, m2, np.array(rows).reshape(-1, 19))

    def close(self) -> None:
        """Close the backend."""
        self._env.close()
