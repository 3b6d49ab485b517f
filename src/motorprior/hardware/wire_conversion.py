"""Wire values to library values: joint signs and attitude; and the firmware's control law."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.hardware.protocol import Telemetry
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
