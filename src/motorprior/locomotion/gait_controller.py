"""The step between a robot's state and its next position targets, for every loop that is not compiled.

The Gymnasium environment and the deployment on a robot share it; it needs numpy alone where numba is not installed.
"""

from __future__ import annotations

import numpy as np

from motorprior.backend import BackendState
from motorprior.locomotion.body import action_size, body_of, observation_size
from motorprior.locomotion.control_step import command_step
from motorprior.locomotion.task import observe
from motorprior.robots.robot import Robot


class GaitController:
    """Phase and filter of the gait. Order: reset, then observe and command in turn.

    `command` computes the targets of the present phase and advances it, so `observe` sees the phase of the next ones.

    Attributes:
        body: of the robot, for compiled code.
        control_dt: control period [s].
        phase: in the cycle of the gait, in [0, 1).
        observation: (observations,) the last one; overwritten by the next.

    Args:
        robot: a legged one.
        control_dt: see attributes.

    Raises:
        ConfigError: the robot cannot walk.
    """

    def __init__(self, robot: Robot, control_dt: float):
        self.body, self.control_dt, self.phase = body_of(robot), control_dt, 0.0
        self.observation = np.zeros(observation_size(robot.num_joints))
        self._filter_state, self._command = np.zeros((2, action_size(robot.num_joints)))
        self._target = robot.nominal_pose

    @property
    def target(self) -> np.ndarray:
        """(joints,) position targets [rad] of the last command, the nominal pose before the first one; a copy."""
        return self._target.copy()

    def reset(self) -> None:
        """Begin an episode: phase and filter at 0, targets at the nominal pose."""
        self.phase = 0.0
        self._filter_state[:] = 0.0
        self._target[:] = self.body.nominal_pose

    def observe(self, state: BackendState) -> np.ndarray:
        """`observation` of a state at the present phase, see `task.observe`."""
        joint_pos, pose = state.measured_joint_pos, self.body.nominal_pose
        observe(state.base_quat, state.base_ang_vel, joint_pos, self.phase, pose, self.observation)
        return self.observation

    def command(self, action: np.ndarray) -> np.ndarray:
        """(joints,) position targets [rad] for an action (actions,), see `control_step.command_step`; a copy."""
        self.phase = command_step(
            self.body, action, self._filter_state, self.phase, self.control_dt, self._command, self._target
        )
        return self.target
