"""The walking task as a Gymnasium environment, and whole episodes of it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from motorprior.backend import BackendState
from motorprior.bounds import require_array
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import action_size, body_of
from motorprior.locomotion.control_step import (
    begin_gait,
    command_step,
    complete_observation,
    evaluate_step,
    new_gait,
    observe,
)
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.scene import Episode, Scene, SimulatedBackend, WalkConfig, WalkSimulator


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    The backend must hold each target for the robot's control period. Without ``walk`` the sensors are perfect, on level
    ground. ``gait`` is the state of the gait.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, robot: Robot, backend: SimulatedBackend, walk: WalkConfig | None = None):
        joints = [4.0 * np.pi] * robot.num_joints
        # |tilt| [rad], |rates| [rad/s], |joints| [rad], |drift| [m], |heading error| [rad], |commands|, phase
        bounds = np.array([np.pi, np.pi, 1e3, 1e3, 1e3, *joints, 10.0, 1.0, 10.0, 10.0, 1.0, 1.0])
        self.observation_space = Box(-bounds, bounds, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (action_size(robot.num_joints),), np.float64)
        self._robot, self._backend, self._walk = robot, backend, walk or WalkConfig()
        self._body, self._weights = body_of(robot), self._walk.task.array()
        self.gait = new_gait(self._body)
        self._sensors, self._schedule = self._walk.inputs(robot, 0)
        self._steps, self._running = 0, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; without a seed the env's own generator draws one. ``options`` is unused.

        Returns the observation and the info that `step` describes; raises SimulationFault if the backend has a fault.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        state = self._backend.reset(drawn)
        if state.fault != 0:
            raise SimulationFault(f"the backend reports fault {int(state.fault)} at reset")
        self._steps, self._running = 0, True
        self._sensors, self._schedule = self._walk.inputs(self._robot, drawn)
        begin_gait(self._body, self.gait)
        observe(self._body, state, self.gait.observation)
        return self._observed(state), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step with an (actions,) action, clipped to [-1, 1].

        Returns:
            Observation, reward [m], terminated (fell or fault), truncated (time is up), and an info with fault, phase,
            command in force (2,) [m/s, rad/s], position_target and measured_joint_pos (joints,) [rad], base_pos (3,)
            [m] and base_quat (4,).
        """
        if not self._running:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        command_step(self._body, self.gait, require_array("action", action, self.action_space.shape or ()))
        state = self._backend.step(self.gait.target.copy())
        earned, terminated = evaluate_step(self._body, self.gait, state, self._weights)
        self._steps += 1
        observation = self._observed(state) if state.fault == 0 else self.gait.observation.copy()
        truncated = not terminated and self._steps >= self._walk.episode_steps
        self._running = not (terminated or truncated)
        return observation, float(earned), bool(terminated), truncated, self._info(state)

    def close(self) -> None:
        """Close the backend."""
        self._backend.close()

    def _observed(self, state: BackendState) -> np.ndarray:
        complete_observation(self._body, self.gait, self._sensors, self._schedule, self._steps, state.base_quat)
        return self.gait.observation.copy()

    def _info(self, state: BackendState) -> dict[str, Any]:
        return {
            "fault": int(state.fault),
            "phase": self.gait.phase,
            "command": self.gait.velocity_command.copy(),
            "position_target": self.gait.target.copy(),
            "measured_joint_pos": np.array(state.measured_joint_pos),
            "base_pos": np.array(state.base_pos),
            "base_quat": np.array(state.base_quat),
        }


def simulator_of(scene: Scene) -> WalkSimulator | BackendSimulator:
    """Simulator of whole episodes of a scene, compiled with MuJoCo."""
    if scene.walk.engine == "mujoco":
        return WalkSimulator(scene)
    return BackendSimulator(scene.robot, SimulatedBackend(scene), scene.walk)


class BackendSimulator:
    """Runs whole episodes with the interpreter between control steps; one per thread.

    On MuJoCo the results equal those of the compiled `WalkSimulator` bit for bit.
    """

    def __init__(self, robot: Robot, backend: SimulatedBackend, walk: WalkConfig):
        self._env = WalkEnv(robot, backend, walk)

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace has base poses and measured joint angles, and there is no motion."""
        observation, info = self._env.reset(seed=seed)
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        joints = len(info["measured_joint_pos"])
        action, total, steps, ended, rows = np.zeros(action_size(joints)), 0.0, 0, False, []
        while not ended:
            if trace:
                rows.append(np.concatenate([info["base_pos"], info["base_quat"], info["measured_joint_pos"]]))
            update_stats(observation, steps, mean, m2)
            act(policy, observation, action)
            observation, earned, terminated, truncated, info = self._env.step(action)
            total, steps, ended = total + earned, steps + 1, terminated or truncated
        fault, poses = info["fault"], np.array(rows).reshape(-1, 7 + joints)
        where, no_motion = np.zeros(2) if fault else info["base_pos"][:2], np.zeros((0, 6 + 2 * joints))
        return Episode(total, steps, self._env.gait.speed_errors / steps, where, fault, mean, m2, poses, no_motion)

    def close(self) -> None:
        """Close the backend."""
        self._env.close()
