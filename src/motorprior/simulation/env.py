"""The walking task as a Gymnasium environment on any backend, simulated, virtual or real, and whole episodes of it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.backend import Backend, BackendState
from motorprior.bounds import require_finite
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import action_size, body_of
from motorprior.locomotion.control_step import begin_gait, command_step, complete_observation, evaluate_step, new_gait
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.locomotion.task import observe
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode
from motorprior.simulation.scene import Scene, WalkConfig


def spaces(num_joints: int) -> tuple[Box, Box]:
    """Observations and actions.

    Bounds: |tilt| [rad], |rates| [rad/s], |joints| [rad], |drift| [m], |heading error| [rad], |commands|, phase.
    """
    bounds = np.array([np.pi, np.pi, 1e3, 1e3, 1e3, *[4.0 * np.pi] * num_joints, 10.0, 1.0, 10.0, 10.0, 1.0, 1.0])
    return Box(-bounds, bounds, dtype=np.float64), Box(-1.0, 1.0, (action_size(num_joints),), np.float64)


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    The backend must hold each target for the robot's control period. Without ``walk`` the sensors are perfect, on level
    ground. ``gait`` is the state of the gait.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig | None = None):
        self.observation_space, self.action_space = spaces(robot.num_joints)
        self._robot, self._backend, self._walk = robot, backend, walk or WalkConfig()
        self._body, self._weights = body_of(robot, self._walk.gait), self._walk.task.array()
        self.gait = new_gait(self._body)
        self._sensors, self._schedule = self._walk.inputs(robot, 0)
        self._steps, self._running = 0, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; without a seed of the backend the env's own generator draws one. ``options`` is unused.

        Returns:
            Observation, shape (observations,), and the info that `step` describes.

        Raises:
            SimulationFault: the backend reports a fault.
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
        """Advance by one control step.

        Args:
            action: shape (actions,), clipped to [-1, 1].

        Returns:
            Observation, reward [m], terminated (fell or fault), truncated (time is up), and an info
            with fault, phase, command in force (2,) [m/s, rad/s], position_target (joints,) [rad], measured_joint_pos
            (joints,) [rad], base_pos (3,) [m] and base_quat (4,).
        """
        if not self._running:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        command_step(self._body, self.gait, require_finite("action", action, self.action_space.shape or ()))
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
            "command": self.gait.twist.copy(),
            "position_target": self.gait.target.copy(),
            "measured_joint_pos": np.array(state.measured_joint_pos),
            "base_pos": np.array(state.base_pos),
            "base_quat": np.array(state.base_quat),
        }


class BackendSimulator:
    """Runs whole episodes on any backend, with the interpreter between control steps; one per thread.

    On MuJoCo the results equal those of the compiled `rollout.WalkSimulator` bit for bit.
    """

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig):
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


class SimulatedBackend:
    """A robot in the engine of a scene, with new motors and conditions in every episode.

    Raises:
        ConfigError: a robot that has no model for the engine.
    """

    def __init__(self, scene: Scene):
        self._scene, self.world = scene, scene.world()
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose; ``seed`` determines everything random."""
        self._motors = self._scene.begin(self.world, seed)
        return self.world.state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (self._scene.robot.num_joints,))
        return self.world.state(self._motors, self.world.hold(self._motors, target))

    def close(self) -> None:
        """Close the engine."""
        self.world.close()
