"""Position targets from a robot's state, for loops that are not compiled.

The Gymnasium environment and the deployment on a robot share it; without numba it runs on numpy alone.
"""

from __future__ import annotations

import numpy as np

from motorprior.backend import BackendState
from motorprior.locomotion.body import body_of, observation_size
from motorprior.locomotion.control_step import begin_gait, command_step, follow_command, new_gait
from motorprior.locomotion.task import observe
from motorprior.robots.robot import Robot


class GaitController:
    """State of a gait. Per control step: `read`, `follow`, `command`.

    Attributes:
        body: of the robot, for compiled code.
        control_dt: control period [s].
        gait: state, for compiled code.
        observation: (observations,) the last one; overwritten by the next.

    Raises:
        ConfigError: the robot cannot walk, or not in this gait.
    """

    def __init__(self, robot: Robot, control_dt: float, gait: str = "trot"):
        self.body, self.control_dt = body_of(robot, gait), control_dt
        self.gait = new_gait(robot.num_joints, len(robot.legs))
        self.observation = np.zeros(observation_size(robot.num_joints))
        self.reset()

    @property
    def target(self) -> np.ndarray:
        """(joints,) position targets [rad] of the last command, the nominal pose before the first one; a copy."""
        return self.gait.target.copy()

    def reset(self) -> None:
        """Begin an episode: phase and filter at 0, no speed, targets at the nominal pose."""
        begin_gait(self.body, self.gait)

    def read(self, state: BackendState) -> None:
        """Write the sensor readings of a state into `observation`."""
        joint_pos, pose = state.measured_joint_pos, self.body.nominal_pose
        observe(state.base_quat, state.base_ang_vel, joint_pos, pose, self.observation)

    def follow(self, forward: float, yaw_rate: float) -> np.ndarray:
        """Complete `observation` after `read`, once per control step, with the command [m/s], [rad/s to the left]."""
        follow_command(self.body, self.gait, float(forward), float(yaw_rate), self.control_dt, self.observation)
        return self.observation

    def command(self, action: np.ndarray) -> np.ndarray:
        """(joints,) position targets [rad] for an action (actions,), see `control_step.command_step`; a copy."""
        command_step(self.body, action, self.observation, self.gait, self.control_dt)
        return self.target
