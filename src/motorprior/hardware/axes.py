"""The robot's own angles and the library's: signs, and telemetry as a `BackendState`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.robot import Robot
from motorprior.robots.wire import Wire

_SIGNED = ("pos", "vel", "cur", "pref", "vref", "cref", "lcur")


def to_wire(wire: Wire, angles: np.ndarray) -> np.ndarray:
    """(joints,) angles of the library as the robot counts them [rad]."""
    return wire.joint_signs * angles


def from_wire(wire: Wire, telemetry: Telemetry) -> Telemetry:
    """The same telemetry with every joint's series in the library's signs; its own inverse."""
    signs, series = wire.joint_signs, {name: getattr(telemetry, name) for name in _SIGNED}
    return replace(telemetry, **{name: signs * value for name, value in series.items() if value is not None})


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


def backend_state(robot: Robot, telemetry: Telemetry, torque: np.ndarray, fault: int = 0) -> BackendState:
    """The state that a robot's own sensors show, in the form that every backend reports.

    Not measured are x, y and the linear velocity, which are 0, and the height, which follows from the longest leg as
    if that stood on flat ground: max over legs of leg.drop(joint_pos) · cos(roll) · cos(pitch).

    Args:
        robot: described.
        telemetry: in the library's signs.
        torque: (joints,) of the motors [N·m].
        fault: 0, or the number of a fault.
    """
    down = max((leg.drop(telemetry.pos) for leg in robot.legs), default=0.0)
    return BackendState(
        base_pos=np.array([0.0, 0.0, down * math.cos(telemetry.roll) * math.cos(telemetry.pitch)]),
        base_quat=quaternion(telemetry.roll, telemetry.pitch, telemetry.yaw),
        base_lin_vel=np.zeros(3),
        base_ang_vel=np.array([telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate]),
        measured_joint_pos=telemetry.pos.copy(),
        foot_pos=np.full((len(robot.legs), 3), np.nan),
        torque_squared_sum=float(np.sum(np.square(torque))),
        fault=fault,
    )
