"""Faults of a robot, injected into a simulated one."""

from dataclasses import replace

import numpy as np

from motorprior.hardware.protocol import Command, Telemetry
from motorprior.hardware.virtual_robot import IDLE, MAX_CURRENT, Firmware
from motorprior.robots.robot import MotorCommand, Robot, SensorReadings
from motorprior.simulation.simulated_robot import SimulatedRobot
from simulated_port import SimulatedPort


class FaultyPort(SimulatedPort):
    """A simulated robot with faults.

    ``events`` are (time [s], IDLE or "command"), one per command that was sent.
    """

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

    def inject(self, fault: str, joint: int = 0) -> None:
        """Inject a fault of `FaultyBody`, or of the line: telemetry_stops, telemetry_late, restart.

        At a restart, the clock of the robot begins at 0.
        """
        self.faults[fault] = self.now, joint

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
            messages = [(at, earlier(message, ahead)) for at, message in messages]

        if "telemetry_late" in self.faults:  # later and later: buffers fill up
            delay = 0.5 * (self.now - self.faults["telemetry_late"][0])
            self._late += [(at + delay, message) for at, message in messages]
            messages = [(self.now, message) for at, message in self._late if at <= self.now]
            self._late = [(at, message) for at, message in self._late if at > self.now]
        return messages


def earlier(message: Telemetry | str, milliseconds: float) -> Telemetry | str:
    """The message with an earlier time stamp; lines of text have none."""
    if isinstance(message, Telemetry):
        return replace(message, ts=message.ts - milliseconds)
    return message


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
        for fault, (_, joint) in self._port.faults.items():
            if fault == "dead":
                kp[joint] = 0.0
                kd[joint] = 0.0
            elif fault == "stalled":
                held_pos = float(self._body.sense().pos[joint])
                target[joint] = self._frozen.setdefault(fault, held_pos)
                kp[joint] *= 10.0

        self._body.advance(milliseconds, MotorCommand(target, kp, kd, command.max_current))

    def sense(self) -> SensorReadings:
        sensors = self._body.sense()
        pos = sensors.pos
        vel = sensors.vel
        current = sensors.current
        attitude = sensors.attitude
        changes: dict[str, np.ndarray] = {}

        for fault, (_, joint) in self._port.faults.items():
            if fault == "frozen":
                pos[joint] = self._frozen.setdefault(fault, float(pos[joint]))
                vel[joint] = 0.0
            elif fault == "jumping":
                pos[joint] += 0.8 * (1 if round(100.0 * self._port.now) % 2 else -1)
            elif fault == "hot_current":
                current[joint] = 9.5  # [A]
            elif fault == "surge":
                current[joint] = 1.2 * MAX_CURRENT
            elif fault == "tilted":
                attitude[0] = 1.0  # [rad]
            elif fault in ("imu_repeats", "imu_zeros"):
                repeated = 0.01 if fault == "imu_repeats" else 0.0
                changes = {"attitude": np.full(3, repeated), "rates": np.zeros(3)}

        return replace(sensors, **changes)
