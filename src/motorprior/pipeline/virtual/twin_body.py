"""The twin as the body of a virtual robot: where simulation and hardware meet."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.families import geared
from motorprior.bench.fleet import Fleet
from motorprior.hardware.servo_law import servo_current
from motorprior.hardware.virtual.firmware import Drive, Sensors
from motorprior.robots.robot import Robot
from motorprior.simulation.live_robot import LiveRobot

TWIN_STREAM = 0x7710
"""Separates the motors of virtual robots from those of benches, training and transfer studies."""


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> MotorParameters:
    """The motors of virtual robot number ``seed``, whose firmware sets their gains over the wire.

    Each is drawn for itself: what is not known of the fleet's centre averages out over a robot, so that virtual robots
    differ from each other by less than half as much as the twins of a transfer study.

    Raises:
        ConfigError: a fleet of another family than the geared motors.
    """
    return geared(fleet.sample(robot.num_joints, np.random.default_rng([TWIN_STREAM, seed])))


class TwinBody:
    """`hardware.virtual.firmware.Body` on `simulation.live_robot.LiveRobot`, in the robot's own signs.

    Attributes:
        live: the twin behind it.
        path: length of its way over the ground [m], in straight pieces of a second.
    """

    def __init__(self, robot: Robot, motors: MotorParameters, hung: bool, seed: int):
        self._signs = robot.require_wire().joint_signs
        self.live = LiveRobot(robot, motors, hung, np.random.default_rng([TWIN_STREAM, seed, 1]))
        self._drive: Drive | None = None
        self.path, self._lived, self._was_at = 0.0, 0, self.live.position()

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """See `Body.advance`."""
        last = self._drive
        if last is None or not _same_law(drive, last):
            self.live.set_gains(drive.kp, drive.kd, drive.max_current)
            self.live.block(drive.blocked)
        self._drive = drive
        self.live.advance(milliseconds, self._signs * drive.target)
        self._measure_path(milliseconds)

    def _measure_path(self, milliseconds: int) -> None:
        before, self._lived = self._lived, self._lived + milliseconds
        if self._lived // 1000 > before // 1000:
            now = self.live.position()
            self.path += float(np.hypot(*(now - self._was_at)))
            self._was_at = now

    def sense(self) -> Sensors:
        """See `Body.sense`; the current is that of the law at the present target."""
        state = self.live.state()
        pos, vel = self._signs * state.joint_pos, self._signs * state.joint_vel
        current = np.zeros_like(pos)
        if (drive := self._drive) is not None:
            current = servo_current(drive.target, pos, vel, drive.kp, drive.kd, drive.max_current)
        return Sensors(pos, vel, current, state.attitude, state.rates)


def _same_law(one: Drive, other: Drive) -> bool:
    return (
        np.array_equal(one.kp, other.kp)
        and np.array_equal(one.kd, other.kd)
        and one.max_current == other.max_current
        and one.blocked == other.blocked
    )
