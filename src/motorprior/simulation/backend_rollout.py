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
    """Runs episodes on a backend, which has the randomization and episode_steps of ``walk``; one per thread."""

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig):
        self._robot = robot
        sensors = partial(walk.randomization.sensors, robot)
        self._env = WalkEnv(robot, backend, walk.task, walk.episode_steps, sensors, walk.commands, walk.gait)

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace has base poses and measured joint angles, and there is no motion."""
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
        fault, trace_rows = info["fault"], np.array(rows).reshape(-1, 7 + joints)
        where, no_motion = np.zeros(2) if fault else info["base_pos"][:2], np.zeros((0, 6 + 2 * joints))
        speed_error = self._env.speed_errors / count
        return Episode(total, count, speed_error, where, fault, count, mean, m2, trace_rows, no_motion)

    def close(self) -> None:
        """Close the backend."""
        self._env.close()
