"""The step between a robot's state and its next position targets, for every loop that is not compiled.

The Gymnasium environment and the deployment on a robot share it; it needs numpy alone where numba is not installed.
"""

from __future__ import annotations

import numpy as np

from motorprior.backend import BackendState
from motorprior.locomotion.body import body_of, observation_size
from motorprior.locomotion.control_step import begin_gait, command_step, follow_command, new_gait
from motorprior.locomotion.task import observe
from motorprior.robots.robot import Robot


class GaitController:
    """Memory of the gait. Order: reset, then observe and command in turn.

    `command` computes the targets of the present phase and advances it, so `observe` sees the phase of the next ones.

    Attributes:
        body: of the robot, for compiled code.
        control_dt: control period [s].
        gait: memory of the gait, for compiled code.
        observation: (observations,) the last one; overwritten by the next.

    Args:
        robot: a legged one.
        control_dt: see attributes.
        gait: which leg steps when, see `locomotion.gaits`.

    Raises:
        ConfigError: the robot cannot walk, or not in this gait.
    """

    def __init__(self, robot: Robot, control_dt: float, gait: str = "trot"):
        self.body, self.control_dt, self.gait = (
            body_of(robot, gait),
            control_dt,
            new_gait(robot.num_joints, len(robot.legs)),
        )
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
        """Fill the readings of `observation` with what the sensors of a state show."""
        joint_pos, pose = state.measured_joint_pos, self.body.nominal_pose
        observe(state.base_quat, state.base_ang_vel, joint_pos, pose, self.observation)

    def follow(self, forward: float, yaw_rate: float) -> np.ndarray:
        """Complete `observation` after `read`: once per control step, as it counts time.

        Args:
            forward: commanded speed [m/s].
            yaw_rate: commanded yaw rate [rad/s], to the left.
        """
        follow_command(self.body, self.gait, float(forward), float(yaw_rate), self.control_dt, self.observation)
        return self.observation

    def command(self, action: np.ndarray) -> np.ndarray:
        """(joints,) position targets [rad] for an action (actions,), see `control_step.command_step`; a copy."""
        command_step(self.body, action, self.observation, self.gait, self.control_dt)
        return self.target
