"""Faults of a robot, injected into a simulated one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from motorprior.hardware.protocol import Command, Telemetry
from motorprior.hardware.virtual_robot import IDLE, MAX_CURRENT, Firmware, FirmwareConfig, RobotBody
from motorprior.robots.robot import Robot
from motorprior.robots.wire import MotorCommand, SensorReadings
from motorprior.simulation.simulated_robot import SimulatedRobot
from simulated_port import SimulatedPort


class ObservedFirmware(Firmware):
    """Calls ``on_change`` with the new mode at every change of mode, and with "target" at every target."""

    def __init__(self, robot: Robot, body: RobotBody, config: FirmwareConfig, on_change: Callable[[str], object]):
        super().__init__(robot, body, config)
        self._on_change, self.received = on_change, 0

    def receive(self, data: bytes) -> None:
        self.received += len(data)
        super().receive(data)

    def execute(self, command: Command) -> None:
        before = self.mode
        super().execute(command)
        self._report_change(before)
        if command.pos is not None:
            self._on_change("target")

    def advance(self, milliseconds: int) -> bytes:
        before, sent = self.mode, super().advance(milliseconds)
        self._report_change(before)
        return sent

    def _report_change(self, before: str) -> None:
        if self.mode != before:
            self._on_change(self.mode)


class FaultyPort(SimulatedPort):
    """A simulated robot with faults; ``events`` are (time [s], mode or "target")."""

    def __init__(
        self, robot: Robot, currents: bool = False, suspended: bool = False, period: int = 10, corrupt: float = 0.0
    ):
        self.events: list[tuple[float, str]] = []
        self._signs = robot.require_wire().joint_signs
        self.pose_at_idle = np.full(robot.num_joints, np.nan)
        self._pause, self._late = 0.0, list[tuple[float, Telemetry | str]]()
        self.faults: dict[str, tuple[float, int]] = {}
        super().__init__(robot, 0, currents=currents, suspended=suspended, period=period, corrupt=corrupt)
        config = FirmwareConfig(period, with_currents=currents)
        self.firmware = ObservedFirmware(robot, FaultyBody(self.body, self), config, self.on_change)

    def inject(self, kind: str, joint: int = 0) -> None:
        """Inject a fault, see `FaultyBody`; or telemetry_stops, telemetry_late, restart (its clock)."""
        self.faults[kind] = self.now, joint

    def pause_host(self, seconds: float) -> None:
        """Pause the host before its next command."""
        self._pause = seconds

    def on_change(self, what: str) -> None:
        self.events.append((self.now, what))
        if what == IDLE:
            self.pose_at_idle = self._signs * self.body.sense().pos

    def send(self, command: Command) -> float:
        if command.pos is not None:
            self.now += self._pause
            self._pause = 0.0
        return super().send(command)

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        messages = super().wait(until)
        if "telemetry_stops" in self.faults and self.now >= self.faults["telemetry_stops"][0]:
            return []
        if "restart" in self.faults:
            ahead = 1e3 * self.faults["restart"][0]
            messages = [(at, replace(m, ts=m.ts - ahead) if isinstance(m, Telemetry) else m) for at, m in messages]
        if "telemetry_late" in self.faults:  # later and later: buffers fill up
            delay = 0.5 * (self.now - self.faults["telemetry_late"][0])
            self._late += [(at + delay, message) for at, message in messages]
            messages = [(self.now, message) for at, message in self._late if at <= self.now]
            self._late = [(at, message) for at, message in self._late if at > self.now]
        return messages


class FaultyBody:
    """A body whose motors and sensors break."""

    def __init__(self, body: SimulatedRobot, port: FaultyPort):
        self._body, self._port = body, port
        self._frozen: dict[str, float] = {}

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        target, kp, kd = command.target.copy(), command.kp.copy(), command.kd.copy()
        for kind, (_, joint) in self._port.faults.items():
            if kind == "dead":
                kp[joint] = kd[joint] = 0.0
            elif kind == "stalled":
                target[joint] = self._frozen.setdefault(kind, float(self._body.sense().pos[joint]))
                kp[joint] *= 10.0
        self._body.advance(milliseconds, MotorCommand(target, kp, kd, command.max_current))

    def sense(self) -> SensorReadings:
        sensors = self._body.sense()
        pos, vel, current, attitude = (sensors.pos, sensors.vel, sensors.current, sensors.attitude)
        changes: dict[str, np.ndarray] = {}
        for kind, (_, joint) in self._port.faults.items():
            if kind == "frozen":
                pos[joint], vel[joint] = self._frozen.setdefault(kind, float(pos[joint])), 0.0
            elif kind == "jumping":
                pos[joint] += 0.8 * (1 if round(100.0 * self._port.now) % 2 else -1)
            elif kind == "hot_current":
                current[joint] = 9.5
            elif kind == "surge":
                current[joint] = 1.2 * MAX_CURRENT
            elif kind == "tilted":
                attitude[0] = 1.0
            elif kind in ("imu_repeats", "imu_zeros"):
                changes = {"attitude": np.full(3, 0.01 if kind == "imu_repeats" else 0.0), "rates": np.zeros(3)}
        return replace(sensors, **changes)
