"""The firmware's behaviour without a port: bytes in and bytes out, in simulated time.

After Nate711/DJIPupperTests (MIT): it homes by itself, then holds its pose; a target starts position mode; ``idle``
removes the current; an angle beyond 2π or a current beyond 10 A ends in 0 A and "ERROR" every millisecond until it is
switched off. It has no watchdog. Assumptions: it ignores targets while homing; homing ends in the crouch pose. As in
some versions, it ignores all other keys of a command with ``pos``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from motorprior.hardware.framing import FrameReader, framed
from motorprior.hardware.protocol import Command, Telemetry
from motorprior.robots.robot import Robot

HOMING_CURRENT, HOMING_SPEED = 6.0, 1.5  # [A], [rad/s]
MAX_ANGLE, MAX_CURRENT = 2.0 * np.pi, 10.0  # [rad], [A]
HOMING, HOLDING, POSITION, IDLE, ERROR = "homing", "holding", "position", "idle", "error"


@dataclass(frozen=True)
class Drive:
    """Input of the current control: i = kp·(target - q) - kd·dq, within ±max_current."""

    target: np.ndarray  # (joints,) [rad]
    kp: np.ndarray  # (joints,) [A/rad]; 0 for a motor that is off
    kd: np.ndarray  # (joints,) [A·s/rad]
    max_current: float  # [A]

    def current(self, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """(joints,) currents [A] at (joints,) angles [rad] and velocities [rad/s]."""
        wanted = self.kp * (self.target - joint_pos) - self.kd * joint_vel
        return np.clip(wanted, -self.max_current, self.max_current)


@dataclass(frozen=True)
class SensorReadings:
    """Sensor readings of a robot, joints in the robot's signs."""

    pos: np.ndarray  # (joints,) [rad]
    vel: np.ndarray  # (joints,) [rad/s]
    current: np.ndarray  # (joints,) [A]
    attitude: np.ndarray  # roll, pitch, yaw [rad]
    rates: np.ndarray  # about the body's axes [rad/s]
    temperature: np.ndarray | None = None  # (joints,) of the motors [°C], if measured
    battery: float | None = None  # [V], if measured


class RobotBody(Protocol):
    """Motors and mechanics of a robot. Joints in the robot's signs."""

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """Simulate under a constant drive; the current control runs at 1 kHz or faster."""

    def sense(self) -> SensorReadings:
        """The present readings."""
        ...


@dataclass(frozen=True)
class FirmwareConfig:
    """Build options of a firmware."""

    telemetry_period: int = 10  # [ms]; 5 in older versions
    with_currents: bool = False  # it sends ``cur``
    with_imu: bool = True  # otherwise attitude and rates are 0, as in the current version
    homes: bool = True  # at the start; otherwise it holds its pose at once


class Firmware:
    """Simulated firmware of a robot, which moves ``body``.

    ``on_change`` is called at every change of mode with the mode, and at every target with "target".

    Attributes:
        mode: homing, holding, position, idle or error.
        now: time since the start [ms].
        gains: kp [A/rad], kd [A·s/rad] and current limit [A] in force.
    """

    def __init__(
        self, robot: Robot, body: RobotBody, config: FirmwareConfig, on_change: Callable[[str], None] = lambda _: None
    ):
        self._body, self._config, self._on_change = body, config, on_change
        self._wire, self._joints = robot.require_wire(), robot.num_joints
        self._reader = FrameReader(Command, self._joints)
        self.gains = (self._wire.kp, self._wire.kd, self._wire.max_current)
        self._sensors = body.sense()
        self._target = self._sensors.pos.copy()
        self._text: list[str] = ["LED on", "Homing" if config.homes else "Holding"]
        self.mode = HOMING if config.homes else HOLDING
        self.now = 0

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        for message in self._reader.feed(data):
            if isinstance(message, Command) and self.mode != ERROR:
                self._execute(message)

    def advance(self, milliseconds: int) -> bytes:
        """Simulate; returns the bytes sent meanwhile."""
        out, end, period = bytearray(), self.now + milliseconds, self._config.telemetry_period
        while self.now < end:
            out += "".join(f"{line}\r\n" for line in self._text).encode()
            self._text.clear()
            if self.mode == HOMING:
                self._home()
            every_millisecond = self.mode in (HOMING, ERROR)
            step = 1 if every_millisecond else min(end - self.now, period - self.now % period)
            self._body.advance(step, self._drive())
            self.now += step
            if self.mode == ERROR:
                self._text.append("ERROR")
            if self.now % period == 0:
                self._read_sensors()
                out += framed(self._telemetry(), self._joints)
        return bytes(out)

    def frames(self, milliseconds: int) -> Iterator[bytes]:
        """Simulate; yields the bytes sent in each telemetry period."""
        end, period = self.now + milliseconds, self._config.telemetry_period
        while self.now < end:
            yield self.advance(min(end - self.now, period - self.now % period))

    def _execute(self, command: Command) -> None:
        if command.pos is not None:  # other keys of that command are ignored
            if self.mode != HOMING:
                self._target = command.pos.copy()
                self._enter(POSITION)
                self._on_change("target")
            return
        new = command.kp, command.kd, command.max_current
        kp, kd, limit = (old if value is None else value for value, old in zip(new, self.gains, strict=True))
        self.gains = kp, kd, limit
        if command.idle:
            self._enter(IDLE)

    def _enter(self, mode: str) -> None:
        if mode != self.mode:
            self.mode = mode
            self._on_change(mode)

    def _home(self) -> None:
        """Targets move to the crouch pose at the homing speed; then the robot holds."""
        step, away = 1e-3 * HOMING_SPEED, self._target - self._wire.joint_signs * self._wire.crouch_pose
        self._target -= np.clip(away, -step, step)
        if np.abs(away).max() <= step:
            self._text.append("Homed")
            self._enter(HOLDING)

    def _drive(self) -> Drive:
        kp, kd, limit = self.gains
        if self.mode == HOMING:
            kp, kd, limit = self._wire.kp, self._wire.kd, HOMING_CURRENT
        on = np.full(self._joints, float(self.mode in (HOMING, HOLDING, POSITION)))
        return Drive(self._target, kp * on, kd * on, limit)

    def _read_sensors(self) -> None:
        self._sensors = self._body.sense()
        if np.abs(self._sensors.pos).max() > MAX_ANGLE or np.abs(self._sensors.current).max() > MAX_CURRENT:
            self._enter(ERROR)

    def _telemetry(self) -> Telemetry:
        sensors, config = self._sensors, self._config
        roll, pitch, yaw = sensors.attitude if config.with_imu else np.zeros(3)
        roll_rate, pitch_rate, yaw_rate = sensors.rates if config.with_imu else np.zeros(3)
        return Telemetry(
            ts=self.now, roll=float(roll), pitch=float(pitch), yaw=float(yaw), roll_rate=float(roll_rate),
            pitch_rate=float(pitch_rate), yaw_rate=float(yaw_rate), pos=sensors.pos, vel=sensors.vel,
            cur=sensors.current if config.with_currents else None, temp=sensors.temperature, bat=sensors.battery,
        )  # fmt: skip
