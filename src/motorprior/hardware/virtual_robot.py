"""A virtual robot: a simulated firmware in simulated time, and a port for it in real time.

The firmware behaves like Nate711/DJIPupperTests (MIT) after homing. It holds its pose; a target
starts position mode; ``idle`` takes the current away; an angle beyond 2π or a current beyond 10 A
ends in 0 A and "ERROR" every millisecond until it is switched off. It has no watchdog. As in some
versions, it ignores all other keys of a command with ``pos``.
"""

import contextlib
import os
import pty
import select
import time
import tty
from collections.abc import Callable
from typing import Protocol

import numpy as np

from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.robots.robot import MotorCommand, Robot, SensorReadings

MAX_ANGLE = 2.0 * np.pi  # largest joint angle without an error [rad]
MAX_CURRENT = 10.0  # largest motor current without an error [A]
# modes of the firmware
HOLDING = "holding"
POSITION = "position"
IDLE = "idle"
ERROR = "error"
_IMU_KEYS = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class RobotMechanics(Protocol):
    """Motors and mechanics of a robot. Joints have the robot's signs."""

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        """Simulate under a constant command; the current control runs at 1 kHz or faster."""

    def sense(self) -> SensorReadings:
        """The present readings."""
        ...


class Firmware:
    """Simulated firmware of a robot, which moves its ``mechanics``.

    The telemetry ``period`` [ms] is 5 in older versions. ``with_currents``: it sends motor
    currents. Without ``with_imu`` it sends zeros as attitude and rates, as the current version
    does.
    """

    def __init__(
        self,
        robot: Robot,
        mechanics: RobotMechanics,
        period: int = 10,
        with_currents: bool = False,
        with_imu: bool = True,
    ):
        self.period = period
        self._mechanics = mechanics
        self._with_currents = with_currents
        self._with_imu = with_imu
        self._wire = robot.require_wire()
        self._joints = robot.num_joints
        self._reader = FrameReader(Command, self._joints)
        # kp [A/rad], kd [A·s/rad] and current limit [A] in force
        self.gains = (self._wire.kp, self._wire.kd, self._wire.max_current)
        self._sensors = mechanics.sense()
        self._target = self._sensors.pos.copy()
        self._text: list[str] = ["LED on", "Holding"]
        self.mode = HOLDING
        self.now = 0  # time since the start [ms]

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        for message in self._reader.feed(data):
            if isinstance(message, Command) and self.mode != ERROR:
                self.execute(message)

    def advance(self, milliseconds: int) -> bytes:
        """Simulate; returns the bytes sent meanwhile."""
        sent = bytearray()
        end = self.now + milliseconds
        while self.now < end:
            sent += "".join(f"{line}\r\n" for line in self._text).encode()
            self._text.clear()
            to_next_frame = self.period - self.now % self.period
            step = 1 if self.mode == ERROR else min(end - self.now, to_next_frame)
            self._mechanics.advance(step, self._motor_command())
            self.now += step
            if self.mode == ERROR:
                self._text.append("ERROR")
            if self.now % self.period == 0:
                self._read_sensors()
                sent += framed(self._telemetry(), self._joints)
        return bytes(sent)

    def _motor_command(self) -> MotorCommand:
        kp, kd, max_current = self.gains
        has_current = self.mode in (HOLDING, POSITION)
        on = np.full(self._joints, float(has_current))
        return MotorCommand(self._target, kp * on, kd * on, max_current)

    def _read_sensors(self) -> None:
        """Read the sensors; an angle or current beyond its limit is an error."""
        sensors = self._mechanics.sense()
        self._sensors = sensors
        max_angle = np.abs(sensors.pos).max()
        max_current = np.abs(sensors.current).max()
        if max_angle > MAX_ANGLE or max_current > MAX_CURRENT:
            self.mode = ERROR

    def execute(self, command: Command) -> None:
        """Execute a command from the host."""
        if command.pos is not None:  # other keys of that command are ignored
            self._target = command.pos.copy()
            self.mode = POSITION
            return
        kp, kd, max_current = self.gains
        self.gains = (
            kp if command.kp is None else command.kp,
            kd if command.kd is None else command.kd,
            max_current if command.max_current is None else command.max_current,
        )
        if command.idle:
            self.mode = IDLE

    def _telemetry(self) -> Telemetry:
        sensors = self._sensors
        imu_values = np.zeros(len(_IMU_KEYS))
        if self._with_imu:
            imu_values = np.concatenate([sensors.attitude, sensors.rates])
        imu = dict(zip(_IMU_KEYS, imu_values.tolist(), strict=True))
        current = sensors.current if self._with_currents else None
        return Telemetry(ts=self.now, pos=sensors.pos, vel=sensors.vel, cur=current, **imu)


class VirtualRobot:
    """A virtual robot in real time.

    A host opens its pseudo-terminal ``port`` like the port of a Teensy.
    """

    def __init__(self, firmware: Firmware):
        self.firmware = firmware
        # The first step may compile the motors' law for some seconds, which a host that has opened
        # the port would take for a robot that is switched off.
        firmware.advance(firmware.period)
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)

    def run(self, ended: Callable[[], bool]) -> None:
        """Move until ``ended`` returns True; then unplug."""
        try:
            started = time.monotonic() - 1e-3 * self.firmware.now
            while not ended():
                self._step(started)
        finally:
            os.close(self._slave)
            os.close(self._master)

    def _step(self, started: float) -> None:
        firmware = self.firmware
        next_frame = firmware.now + firmware.period - firmware.now % firmware.period  # [ms]
        timeout = max(0.0, started + 1e-3 * next_frame - time.monotonic())
        ready, _, _ = select.select([self._master], [], [], timeout)
        received = self._read() if ready else b""

        passed = int(1e3 * (time.monotonic() - started)) - firmware.now  # [ms]
        sent = firmware.advance(passed)
        firmware.receive(received)
        if sent:
            # as on a real port, a host that does not read loses frames
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, sent)

    def _read(self) -> bytes:
        with contextlib.suppress(OSError):
            return os.read(self._master, 4096)
        return b""
