"""Faults of a robot, injected into a simulated one."""

from dataclasses import replace

import numpy as np

from motorprior.hardware.protocol import Command, Telemetry
from motorprior.hardware.virtual_robot import IDLE, MAX_CURRENT, Firmware
from motorprior.robots.robot import MotorCommand, Robot, SensorReadings
from motorprior.simulation.simulated_robot import SimulatedRobot
from simulated_port import SimulatedPort


class FaultyPort(SimulatedPort):
    """A simulated robot with faults; ``events`` are (time [s], IDLE or "command"), one per command that was sent."""

    def __init__(
        self,
        robot: Robot,
        currents: bool = False,
        suspended: bool = False,
        period: int = 10,
        corrupt: float = 0.0,
    ):
        self.events: list[tuple[float, str]] = []
        self._signs = robot.require_wire().joint_signs
        self.pose_at_idle = np.full(robot.num_joints, np.nan)
        self._pause = 0.0
        self._late = list[tuple[float, Telemetry | str]]()
        self.faults: dict[str, tuple[float, int]] = {}
        super().__init__(robot, 0, suspended=suspended, period=period, corrupt=corrupt)
        self.firmware = Firmware(robot, FaultyBody(self.body, self), period, currents)

    def inject(self, kind: str, joint: int = 0) -> None:
        """Inject a fault, see `FaultyBody`; or telemetry_stops, telemetry_late, restart (its clock)."""
        self.faults[kind] = self.now, joint

    def pause_host(self, seconds: float) -> None:
        """Pause the host before its next command."""
        self._pause = seconds

    def send(self, command: Command) -> float:
        if command.pos is not None:
            self.now += self._pause
            self._pause = 0.0
        if command.idle and self.events and self.events[-1][1] != IDLE:
            self.pose_at_idle = self._signs * self.body.sense().pos
        self.events.append((self.now, IDLE if command.idle else "command"))
        return super().send(command)

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        messages = super().wait(until)
        if "telemetry_stops" in self.faults and self.now >= self.faults["telemetry_stops"][0]:
            return []
        if "restart" in self.faults:
            ahead = 1e3 * self.faults["restart"][0]
            messages = [
                (at, replace(m, ts=m.ts - ahead) if isinstance(m, Telemetry) else m)
                for at, m in messages
            ]
        if "telemetry_late" in self.faults:  # later and later: buffers fill up
            delay = 0.5 * (self.now - self.faults["telemetry_late"][0])
            self._late += [(at + delay, message) for at, message in messages]
            messages = [(self.now, message) for at, message in self._late if at <= self.now]
            self._late = [(at, message) for at, message in self._late if at > self.now]
        return messages


class FaultyBody:
    """A body whose motors and sensors break."""

    def __init__(self, body: SimulatedRobot, port: FaultyPort):
        self._body = body
        self._port = port
        self._frozen: dict[str, float] = {}

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        target = command.target.copy()
        kp = command.kp.copy()
        kd = command.kd.copy()
        for kind, (_, joint) in self._port.faults.items():
            if kind == "dead":
                kp[joint] = kd[joint] = 0.0
            elif kind == "stalled":
                target[joint] = self._frozen.setdefault(kind, float(self._body.sense().pos[joint]))
                kp[joint] *= 10.0
        self._body.advance(milliseconds, MotorCommand(target, kp, kd, command.max_current))

    def sense(self) -> SensorReadings:
        sensors = self._body.sense()
        pos = sensors.pos
        vel = sensors.vel
        current = sensors.current
        attitude = sensors.attitude
        changes: dict[str, np.ndarray] = {}
        for kind, (_, joint) in self._port.faults.items():
            if kind == "frozen":
                pos[joint] = self._frozen.setdefault(kind, float(pos[joint]))
                vel[joint] = 0.0
            elif kind == "jumping":
                pos[joint] += 0.8 * (1 if round(100.0 * self._port.now) % 2 else -1)
            elif kind == "hot_current":
                current[joint] = 9.5
            elif kind == "surge":
                current[joint] = 1.2 * MAX_CURRENT
            elif kind == "tilted":
                attitude[0] = 1.0
            elif kind in ("imu_repeats", "imu_zeros"):
                changes = {
                    "attitude": np.full(3, 0.01 if kind == "imu_repeats" else 0.0),
                    "rates": np.zeros(3),
                }
        return replace(sensors, **changes)
