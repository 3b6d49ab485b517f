"""The robot's own angles and the library's: signs, and telemetry as a `BackendState`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.pupper_v2 import spec

_SIGNED = ("pos", "vel", "cur", "pref", "vref", "cref", "lcur")


def to_wire(angles: np.ndarray) -> np.ndarray:
    """(12,) angles of the library as the robot counts them [rad]."""
    return spec.JOINT_SIGNS * angles


def from_wire(telemetry: Telemetry) -> Telemetry:
    """The same telemetry with every joint's series in the library's signs; its own inverse."""
    series = {name: getattr(telemetry, name) for name in _SIGNED}
    return replace(telemetry, **{name: spec.JOINT_SIGNS * value for name, value in series.items() if value is not None})


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(4,) rotation_base_to_world (w, x, y, z) of intrinsic z-y'-x'' angles [rad]; inverse of `roll_pitch_yaw`."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def backend_state(telemetry: Telemetry, torque: np.ndarray, fault: int = 0) -> BackendState:
    """What the robot knows of itself, as every backend tells it.

    It does not know where it is: x, y and the linear velocity are 0. Its height follows from the longest leg, as
    if that stood on flat ground.

    Args:
        telemetry: in the library's signs.
        torque: (12,) of the motors [N·m].
        fault: 0, or the number of a fault.
    """
    down = spec.leg_drop(telemetry.pos.reshape(4, 3)).max() * math.cos(telemetry.roll) * math.cos(telemetry.pitch)
    return BackendState(
        base_pos=np.array([0.0, 0.0, down]),
        base_quat=quaternion(telemetry.roll, telemetry.pitch, telemetry.yaw),
        base_lin_vel=np.zeros(3),
        base_ang_vel=np.array([telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate]),
        measured_joint_pos=telemetry.pos.copy(),
        torque_squared_sum=float(np.sum(np.square(torque))),
        fault=fault,
    )
