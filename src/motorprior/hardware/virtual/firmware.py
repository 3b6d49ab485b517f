"""The firmware's behaviour without a port: bytes in and bytes out, at times that the caller gives.

After Nate711/DJIPupperTests (MIT): it homes by itself, then holds; a target puts it into position mode with the gains
it knows; `idle` takes the current away; an angle beyond 2π or a current beyond 10 A ends in 0 A and "ERROR" every
millisecond until it is switched off. It has no watchdog. Assumptions: it takes no targets while homing; homing ends in
the crouch pose; `home` homes again; `zero` makes the present pose 0. Cartesian commands are read and ignored. Some
versions leave a command with `pos` without reading its other keys, so this one does too: a host must not rely on them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from motorprior.hardware.axes import to_wire
from motorprior.hardware.framing import command_reader, telemetry_frame
from motorprior.hardware.protocol import Command, Sizes, Telemetry
from motorprior.robots.robot import Robot

HOMING_CURRENT, HOMING_SPEED = 6.0, 1.5  # [A], [rad/s]
FURTHEST_ANGLE, LARGEST_CURRENT = 2.0 * np.pi, 10.0  # [rad], [A]
HOMING, HOLDING, POSITION, IDLE, ERROR = "homing", "holding", "position", "idle", "error"


@dataclass(frozen=True)
class Drive:
    """Input of the current loops: i = kp·(target - q) - kd·dq, within ±max_current.

    Attributes:
        target: (joints,) [rad].
        kp: (joints,) [A/rad]; 0 where a motor is off.
        kd: (joints,) [A·s/rad].
        max_current: [A].
        blocked: joints that something holds fast.
    """

    target: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    max_current: float
    blocked: tuple[int, ...] = ()


@dataclass(frozen=True)
class Sensors:
    """Measurements of a robot's sensors, joints in the robot's own signs.

    Attributes:
        pos: (joints,) [rad].
        vel: (joints,) [rad/s].
        current: (joints,) [A].
        attitude: roll, pitch, yaw [rad].
        rates: of roll, pitch, yaw about the body's axes [rad/s].
        temperature: (joints,) of the motors [°C], where it is measured.
        battery: [V], where it is measured.
    """

    pos: np.ndarray
    vel: np.ndarray
    current: np.ndarray
    attitude: np.ndarray
    rates: np.ndarray
    temperature: np.ndarray | None = None
    battery: float | None = None


class Body(Protocol):
    """Motors and mechanics of a robot, real time apart. Joints in the robot's own signs."""

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """Let time pass under a constant drive; the current law runs at 1 kHz or faster."""
        ...

    def sense(self) -> Sensors:
        """The state now."""
        ...


@dataclass(frozen=True)
class FirmwareConfig:
    """How a firmware is built.

    Attributes:
        telemetry_period: [ms]; 10, or 5 in older versions.
        with_currents: `cur` and the references are compiled in.
        with_imu: otherwise attitude and rates read 0, as in the present version.
        homes: home at the start; without, hold at once.
    """

    telemetry_period: int = 10
    with_currents: bool = False
    with_imu: bool = True
    homes: bool = True


class Firmware:
    """A robot at the other end of the wire.

    Attributes:
        mode: one of the modes above.
        now: time since the start [ms].

    Args:
        robot: with a wire.
        body: what it moves.
        config: how it is built.
        on_change: called at every change of mode with the mode, and at every target with "target".
        sensed: what becomes of the sensors before the firmware reads them; a place for injected faults.
    """

    def __init__(
        self,
        robot: Robot,
        body: Body,
        config: FirmwareConfig,
        on_change: Callable[[str], None] = lambda _: None,
        sensed: Callable[[Sensors], Sensors] = lambda sensors: sensors,
    ):
        self._body, self._config, self._on_change, self._sense = body, config, on_change, sensed
        self._wire, self._sizes = robot.require_wire(), Sizes.of(robot)
        self._reader = command_reader(self._sizes)
        self._zero = np.zeros(robot.num_joints)
        self._gains = (self._wire.kp, self._wire.kd, self._wire.max_current)
        self._active = np.ones(robot.num_joints)
        self._sensors = sensed(body.sense())
        self._target = self._sensors.pos.copy()
        self._text: list[str] = ["LED on", "Homing" if config.homes else "Holding"]
        self.mode = HOMING if config.homes else HOLDING
        self.now = 0

    @property
    def gains(self) -> tuple[float, float, float]:
        """Gains and current limit in force: kp [A/rad], kd [A·s/rad], max_current [A]."""
        return self._gains

    def receive(self, data: bytes) -> None:
        """Bytes from the host, read as they come."""
        for message in self._reader.feed(data):
            if isinstance(message, Command):
                self._obey(message)

    def advance(self, milliseconds: int) -> bytes:
        """Let time pass; returns the bytes sent meanwhile."""
        out, end, period = bytearray(), self.now + milliseconds, self._config.telemetry_period
        while self.now < end:
            out += "".join(f"{line}\r\n" for line in self._text).encode()
            self._text.clear()
            if self.mode == HOMING:
                self._home()
            every_millisecond = self.mode in (HOMING, ERROR)
            piece = 1 if every_millisecond else min(end - self.now, period - self.now % period)
            self._body.advance(piece, self._drive())
            self.now += piece
            if self.mode == ERROR:
                self._text.append("ERROR")
            if self.now % period == 0:
                self._look()
                out += telemetry_frame(self._telemetry(), self._sizes)
        return bytes(out)

    def frames(self, milliseconds: int) -> Iterator[bytes]:
        """Advance the time; yields the bytes sent in each telemetry period, so that noise acts on each separately."""
        end, period = self.now + milliseconds, self._config.telemetry_period
        while self.now < end:
            yield self.advance(min(end - self.now, period - self.now % period))

    def _obey(self, command: Command) -> None:
        if self.mode == ERROR:
            return
        if command.pos is not None:  # and nothing else of that command
            if self.mode != HOMING:
                self._target = command.pos.copy()
                self._enter(POSITION)
                self._on_change("target")
            return
        self._set_law(command)
        if command.zero:
            self._target += self._zero - self._sensors.pos  # it stays where it is
            self._zero = self._sensors.pos.copy()
        if command.home:
            self._target = self._sensors.pos - self._zero
            self._enter(HOMING)
        if command.idle:
            self._enter(IDLE)

    def _set_law(self, command: Command) -> None:
        kp, kd, limit = self._gains
        self._gains = (
            kp if command.kp is None else command.kp,
            kd if command.kd is None else command.kd,
            limit if command.max_current is None else command.max_current,
        )
        if command.activations is not None:
            self._active = (command.activations > 0.5).astype(float)

    def _enter(self, mode: str) -> None:
        if mode != self.mode:
            self.mode = mode
            self._on_change(mode)

    def _home(self) -> None:
        """Targets move to the homed pose at the homing speed; then the robot holds."""
        step, away = 1e-3 * HOMING_SPEED, self._target - to_wire(self._wire, self._wire.crouch_pose)
        self._target -= np.clip(away, -step, step)
        if np.abs(away).max() <= step:
            self._text.append("Homed")
            self._enter(HOLDING)

    def _drive(self) -> Drive:
        kp, kd, limit = self._gains
        if self.mode == HOMING:
            kp, kd, limit = self._wire.kp, self._wire.kd, HOMING_CURRENT
        on = self._active if self.mode in (HOMING, HOLDING, POSITION) else np.zeros_like(self._active)
        return Drive(self._target + self._zero, kp * on, kd * on, limit)

    def _look(self) -> None:
        """Read the sensors; beyond its bounds the firmware gives up."""
        self._sensors = self._sense(self._body.sense())
        too_far = np.abs(self._sensors.pos - self._zero).max() > FURTHEST_ANGLE
        if too_far or np.abs(self._sensors.current).max() > LARGEST_CURRENT:
            self._enter(ERROR)

    def _telemetry(self) -> Telemetry:
        sensors, config = self._sensors, self._config
        imu = config.with_imu
        roll, pitch, yaw = sensors.attitude if imu else np.zeros(3)
        roll_rate, pitch_rate, yaw_rate = sensors.rates if imu else np.zeros(3)
        telemetry = Telemetry(
            ts=self.now, roll=float(roll), pitch=float(pitch), yaw=float(yaw), roll_rate=float(roll_rate),
            pitch_rate=float(pitch_rate), yaw_rate=float(yaw_rate), pos=sensors.pos - self._zero, vel=sensors.vel,
            temp=sensors.temperature, bat=sensors.battery,
        )  # fmt: skip
        if not config.with_currents:
            return telemetry
        nothing = np.zeros_like(self._active)
        return replace(
            telemetry, cur=sensors.current, pref=self._target, vref=nothing, cref=sensors.current, lcur=sensors.current
        )
