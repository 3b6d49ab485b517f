"""A whole walking episode on any backend: the Gymnasium loop, with the interpreter between control steps.

On `MujocoBackend` the results equal those of the compiled `rollout.WalkSimulator` bit for bit.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from motorprior.backend import Backend
from motorprior.locomotion.body import action_size
from motorprior.locomotion.control_step import update_stats
from motorprior.locomotion.env import WalkEnv
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode, WalkConfig, checked_policy


class BackendSimulator:
    """Runs episodes on a backend; one per thread.

    Args:
        robot: whose backend it is.
        backend: made with the randomization and the episode_steps of ``walk``.
        walk: episode.
    """

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig):
        self._robot = robot
        sensors = partial(walk.randomization.sensors, robot)
        self._env = WalkEnv(
            robot, backend, walk.task, walk.episode_steps,
            draw_sensors=sensors, commands=walk.commands, gait=walk.gait,
        )  # fmt: skip

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace holds base poses and the joint angles as measured, there is no motion."""
        joints = self._robot.num_joints
        policy = checked_policy(joints, policy)
        observation, info = self._env.reset(seed=seed)
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        action = np.zeros(action_size(joints))
        total, count, ended, rows = 0.0, 0, False, []
        while not ended:
            if trace:
                rows.append(np.concatenate([info["base_pos"], info["base_quat"], info["measured_joint_pos"]]))
            count = update_stats(observation, count, mean, m2)
            act(policy, observation, action)
            observation, earned, terminated, truncated, info = self._env.step(action)
            total, ended = total + earned, terminated or truncated
        fault = info["fault"]
        where = np.zeros(2) if fault else info["base_pos"][:2]
        trace_rows = np.array(rows).reshape(-1, 7 + joints)
        off = self._env.speed_errors / count
        return Episode(total, count, off, where, fault, count, mean, m2, trace_rows, np.zeros((0, 6 + 2 * joints)))

    def close(self) -> None:
        """Close the backend."""
        self._env.close()
