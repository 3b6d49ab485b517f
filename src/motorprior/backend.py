"""Interface of a simulated robot: reset, step, close; MuJoCo and PyBullet implement it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np


class BackendState(NamedTuple):
    """State of a robot after a control step; compiled code takes it as it is."""

    base_pos: np.ndarray  # (3,) [m], world; x is the initial heading, z up
    base_quat: np.ndarray  # (4,) rotation_base_to_world (w, x, y, z)
    base_lin_vel: np.ndarray  # (3,) [m/s], world
    base_ang_vel: np.ndarray  # (3,) [rad/s], base frame
    measured_joint_pos: np.ndarray  # (joints,) [rad] at the encoders
    foot_pos: np.ndarray  # (legs, 3) centres of the feet [m], world; NaN if unknown
    torque_squared_sum: float  # Σ over joints of torque², mean over the physics steps of the control step [(N·m)²]
    fault: int = 0  # 0, or the number of a fault that ended the episode


class Backend(Protocol):
    """A robot that holds position targets."""

    def reset(self, seed: int) -> BackendState:
        """Begin an episode; ``seed`` determines everything random."""
        ...

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold the (joints,) targets [rad] for one control period."""
        ...

    def close(self) -> None:
        """Release the robot."""
        ...
