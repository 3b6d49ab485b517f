"""The twin as the body of a virtual Pupper: where simulation and hardware meet."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.fleet import Fleet
from motorprior.hardware.firmware import Drive, Sensors
from motorprior.hardware.servo_law import servo_current
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.live_robot import LiveRobot

TWIN_STREAM = 0x7710
"""Separates the motors of virtual Puppers from those of benches, training and transfer studies."""


def draw_motors(fleet: Fleet, seed: int) -> MotorParameters:
    """The twelve motors of virtual Pupper number ``seed``."""
    return fleet.sample(np.random.default_rng([TWIN_STREAM, seed]), spec.NUM_JOINTS)


class TwinBody:
    """`hardware.firmware.Body` on `simulation.live_robot.LiveRobot`, in the robot's own signs.

    Attributes:
        live: the twin behind it.
        path: length of its way over the ground [m], in straight pieces of a second.
    """

    def __init__(self, motors: MotorParameters, hung: bool, seed: int):
        self.live = LiveRobot(motors, hung, np.random.default_rng([TWIN_STREAM, seed, 1]))
        self._drive: Drive | None = None
        self.path, self._lived, self._was_at = 0.0, 0, self.live.position()

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """See `Body.advance`."""
        last = self._drive
        if last is None or not _same_law(drive, last):
            self.live.set_gains(drive.kp, drive.kd, drive.max_current)
            self.live.block(drive.blocked)
        self._drive = drive
        self.live.advance(milliseconds, spec.JOINT_SIGNS * drive.target)
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
        pos, vel = spec.JOINT_SIGNS * state.joint_pos, spec.JOINT_SIGNS * state.joint_vel
        current = np.zeros(spec.NUM_JOINTS)
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
