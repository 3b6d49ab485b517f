"""Wire values to library values: joint signs, telemetry to `BackendState`; and the firmware's control law."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.robot import Robot
from motorprior.robots.wire import Wire

Gain = np.ndarray | float  # of every joint, or the same for all


def from_wire(wire: Wire, telemetry: Telemetry) -> Telemetry:
    """The same telemetry with positions, velocities and currents in the library's signs; its own inverse."""
    signs = wire.joint_signs
    current = None if telemetry.cur is None else signs * telemetry.cur
    return replace(telemetry, pos=signs * telemetry.pos, vel=signs * telemetry.vel, cur=current)


def servo_current(
    target: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray, kp: Gain, kd: Gain, max_current: float
) -> np.ndarray:
    """(joints,) currents [A] of the firmware's control law, kp·(target - joint_pos) - kd·joint_vel, ±max_current.

    Angles are (joints,) [rad] and [rad/s] in any signs, gains in A/rad and A·s/rad, the limit in A.
    """
    return np.clip(kp * (target - joint_pos) - kd * joint_vel, -max_current, max_current)


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(4,) rotation_base_to_world (w, x, y, z) of intrinsic z-y'-x'' angles [rad]; inverse of `roll_pitch_yaw`."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.array([w, x, y, z])


def backend_state(robot: Robot, telemetry: Telemetry, torque: np.ndarray, fault: int = 0) -> BackendState:
    """The state that a robot's sensors measure, from telemetry in the library's signs and (joints,) ``torque`` [N·m].

    x, y and the linear velocity are not measured and are 0. The height is that of the longest leg on flat ground:
    max over legs of leg.hip_height(joint_pos)·cos(roll)·cos(pitch). ``fault`` is 0 or a backend's number of a fault.
    """
    height = max((leg.hip_height(telemetry.pos) for leg in robot.legs), default=0.0)
    return BackendState(
        base_pos=np.array([0.0, 0.0, height * math.cos(telemetry.roll) * math.cos(telemetry.pitch)]),
        base_quat=quaternion(telemetry.roll, telemetry.pitch, telemetry.yaw),
        base_lin_vel=np.zeros(3),
        base_ang_vel=np.array([telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate]),
        measured_joint_pos=telemetry.pos.copy(),
        foot_pos=np.full((len(robot.legs), 3), np.nan),
        torque_squared_sum=float(np.sum(np.square(torque))),
        fault=fault,
    )
