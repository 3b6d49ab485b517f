"""A virtual robot: the firmware's behaviour, bytes in and bytes out in simulated time, and a port for it in real time.

After Nate711/DJIPupperTests (MIT), once it has homed: it holds its pose; a target starts position
mode; ``idle`` takes the current away; an angle beyond 2π or a current beyond 10 A ends in 0 A and
"ERROR" every millisecond until it is switched off. It has no watchdog. As in some versions, it
ignores all other keys of a command with ``pos``.
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

# [rad], [A]
MAX_ANGLE = 2.0 * np.pi
MAX_CURRENT = 10.0
HOLDING = "holding"
POSITION = "position"
IDLE = "idle"
ERROR = "error"
_BODY_KEYS = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class RobotBody(Protocol):
    """Motors and mechanics of a robot. Joints in the robot's signs."""

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        """Simulate under a constant command; the current control runs at 1 kHz or faster."""

    def sense(self) -> SensorReadings:
        """The present readings."""
        ...


class Firmware:
    """Simulated firmware of a robot, which moves ``body``.

    The telemetry ``period`` [ms] is 5 in older versions. The firmware sends motor currents only
    ``with_currents``, and zeros as attitude and rates, as in the current version, if not
    ``with_imu``.
    """

    def __init__(
        self,
        robot: Robot,
        body: RobotBody,
        period: int = 10,
        with_currents: bool = False,
        with_imu: bool = True,
    ):
        self.period = period
        self._body = body
        self._with_currents = with_currents
        self._with_imu = with_imu
        self._wire = robot.require_wire()
        self._joints = robot.num_joints
        self._reader = FrameReader(Command, self._joints)
        # in force [A/rad], [A·s/rad], [A]
        self.gains = (self._wire.kp, self._wire.kd, self._wire.max_current)
        self._sensors = body.sense()
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
        out = bytearray()
        end = self.now + milliseconds
        period = self.period
        while self.now < end:
            out += "".join(f"{line}\r\n" for line in self._text).encode()
            self._text.clear()
            step = 1 if self.mode == ERROR else min(end - self.now, period - self.now % period)
            (kp, kd, limit), on = (
                self.gains,
                np.full(self._joints, float(self.mode in (HOLDING, POSITION))),
            )
            self._body.advance(step, MotorCommand(self._target, kp * on, kd * on, limit))
            self.now += step
            if self.mode == ERROR:
                self._text.append("ERROR")
            if self.now % period == 0:
                self._sensors = sensors = self._body.sense()
                if (
                    np.abs(sensors.pos).max() > MAX_ANGLE
                    or np.abs(sensors.current).max() > MAX_CURRENT
                ):
                    self.mode = ERROR
                out += framed(self._telemetry(), self._joints)
        return bytes(out)

    def execute(self, command: Command) -> None:
        """Execute a command from the host."""
        if command.pos is not None:  # other keys of that command are ignored
            self._target = command.pos.copy()
            self.mode = POSITION
            return
        new = command.kp, command.kd, command.max_current
        kp, kd, limit = (
            old if value is None else value for value, old in zip(new, self.gains, strict=True)
        )
        self.gains = kp, kd, limit
        if command.idle:
            self.mode = IDLE

    def _telemetry(self) -> Telemetry:
        sensors = self._sensors
        measured = (
            np.concatenate([sensors.attitude, sensors.rates]) if self._with_imu else np.zeros(6)
        )
        body = dict(zip(_BODY_KEYS, measured.tolist(), strict=True))
        current = sensors.current if self._with_currents else None
        return Telemetry(ts=self.now, pos=sensors.pos, vel=sensors.vel, cur=current, **body)


class VirtualRobot:
    """A virtual robot in real time: a host opens the pseudo-terminal ``port`` like the port of a Teensy."""

    def __init__(self, firmware: Firmware):
        self.firmware = firmware
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)

    def run(self, ended: Callable[[], bool]) -> None:
        """Move until ``ended`` returns True; then unplug."""
        try:
            started = time.monotonic()
            while not ended():
                self._step(started)
        finally:
            os.close(self._slave)
            os.close(self._master)

    def _step(self, started: float) -> None:
        firmware = self.firmware
        next_frame = firmware.now + firmware.period - firmware.now % firmware.period  # [ms]
        timeout = max(0.0, started + 1e-3 * next_frame - time.monotonic())
        data = self._read() if select.select([self._master], [], [], timeout)[0] else b""
        out = firmware.advance(int(1e3 * (time.monotonic() - started)) - firmware.now)
        firmware.receive(data)
        if out:
            # as on a real port, a host that does not read loses frames
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, out)

    def _read(self) -> bytes:
        with contextlib.suppress(OSError):
            return os.read(self._master, 4096)
        return b""
