"""The walking task as a Gymnasium environment on any backend, simulated, virtual or real."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from motorprior.bounds import require_count, require_finite
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.body import action_size
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.control_step import evaluate_step
from motorprior.locomotion.gait_controller import GaitController
from motorprior.locomotion.sensing import SensorErrors, apply_sensor_errors, perfect_sensors
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.robot import Robot

if TYPE_CHECKING:
    from motorprior.backend import Backend, BackendState


def observation_bounds(num_joints: int) -> np.ndarray:
    """Bounds: |tilt| [rad], |rates| [rad/s], |joints| [rad], |drift| [m], |heading error| [rad], |commands|, phase."""
    return np.array([np.pi, np.pi, 1e3, 1e3, 1e3, *[4.0 * np.pi] * num_joints, 10.0, 1.0, 10.0, 10.0, 1.0, 1.0])


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    Args:
        robot: with legs.
        backend: simulated or real robot; must hold each target for the robot's control period.
        weights: coefficients of the reward.
        episode_steps: control steps until truncation.
        draw_sensors: sensor errors and direction of gravity from the backend's seed and ``episode_steps``; perfect
            sensors on level ground if None. A backend with sloping ground needs them.
        commands: drawn by the backend's seed; the robot's whole range if not given.
        gait: see `locomotion.gaits`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(
        self,
        robot: Robot,
        backend: Backend,
        weights: TaskWeights | None = None,
        episode_steps: int = 500,
        draw_sensors: Callable[[int, int], SensorErrors] | None = None,
        commands: Commands | Timetable | None = None,
        gait: str = "trot",
    ):
        require_count("episode_steps", episode_steps)
        bounds, self._action_shape = observation_bounds(robot.num_joints), (action_size(robot.num_joints),)
        self.observation_space = Box(-bounds, bounds, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, self._action_shape, np.float64)
        self._controller, self._backend = GaitController(robot, robot.control_dt, gait), backend
        self._robot, self._commands, self._schedule = robot, commands or Commands(), np.zeros((0, 2))
        self._weights = (weights or TaskWeights()).array()
        self._episode_steps = episode_steps
        self._draw_sensors = draw_sensors
        self._sensors = perfect_sensors()
        self._steps = 0
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of the backend; drawn by the env's own generator if not given.
            options: unused.

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
        self._controller.reset()
        if self._draw_sensors is not None:
            self._sensors = self._draw_sensors(drawn, self._episode_steps)
        self._schedule = self._commands.schedule(self._robot, drawn, self._episode_steps)
        self._controller.read(state)
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
        raw = require_finite("action", action, self._action_shape)
        state = self._backend.step(self._controller.command(raw))
        earned, terminated = self._evaluate(state)
        self._steps += 1
        observation = self._observed(state) if state.fault == 0 else self._controller.observation.copy()
        truncated = not terminated and self._steps >= self._episode_steps
        self._running = not (terminated or truncated)
        return observation, earned, terminated, truncated, self._info(state)

    @property
    def speed_errors(self) -> float:
        """See `GaitState.speed_errors` [m/s]."""
        return self._controller.gait.speed_errors

    def close(self) -> None:
        """Close the backend."""
        self._backend.close()

    def _observed(self, state: BackendState) -> np.ndarray:
        """Apply sensor errors and the command to the true readings of this control step."""
        apply_sensor_errors(self._sensors, self._steps, state.base_quat, self._controller.observation)
        forward, yaw_rate = self._schedule[min(self._steps, self._episode_steps - 1)]
        return self._controller.follow(forward, yaw_rate).copy()

    def _evaluate(self, state: BackendState) -> tuple[float, bool]:
        """Reward [m] and end of the episode; writes the readings of the observation."""
        controller = self._controller
        earned, terminated = evaluate_step(
            controller.body, state.base_pos, state.base_quat, state.base_lin_vel, state.base_ang_vel,
            state.measured_joint_pos, state.foot_pos, float(state.torque_squared_sum), int(state.fault),
            controller.gait, controller.control_dt, self._weights, controller.observation,
        )  # fmt: skip
        return float(earned), bool(terminated)

    def _info(self, state: BackendState) -> dict[str, Any]:
        return {
            "fault": int(state.fault),
            "phase": self._controller.gait.phase,
            "command": self._controller.gait.twist.copy(),
            "position_target": self._controller.target,
            "measured_joint_pos": np.array(state.measured_joint_pos),
            "base_pos": np.array(state.base_pos),
            "base_quat": np.array(state.base_quat),
        }
