"""A virtual robot at a port whose clock moves only when the host waits: hours of a life in minutes, repeatable.

The host's own code runs, the firmware and the twin. The operating system (the port, priorities, the watchdog process)
and its delays are left out; `hardware.py` measures them in real time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from unittest import mock

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.fleet import load_fleet
from motorprior.hardware import commands, robot_link, run_facts, session
from motorprior.hardware.framing import command_frame, telemetry_reader
from motorprior.hardware.protocol import Command, Sizes, Telemetry
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.virtual.firmware import Firmware, FirmwareConfig
from motorprior.hardware.virtual.injected import CommandCutter, NoisyLine
from motorprior.pipeline.virtual.twin_body import TwinBody, draw_motors
from motorprior.robots.robot import Robot

WAY = 1e-4
"""From the robot to the host, and back [s]."""
_ROUNDING = 1e-6
"""Of times [ms]."""


class SimulatedPort(SerialLink):
    """What `SerialLink` is to a host, and the robot behind it.

    Attributes:
        now: the time on both ends [s].
        body: of the robot.
        firmware: of the robot.

    Args:
        robot: that it is one of; its motors are of the first of its fleets.
        number: of the virtual robot, that is, of its motors.
        life: seed of its sensors' noise and of the line's.
        hung: it hangs in the air.
        rate: telemetry frames per second.
        drop: share of frames that are lost, both ways.
        corrupt: share of frames that are damaged, both ways.
        wear: of its motors, from those of the fleet; none if not given.
    """

    def __init__(  # pyright: ignore[reportMissingSuperCall]  # there is no device to open
        self,
        robot: Robot,
        number: int,
        life: int = 0,
        *,
        hung: bool = False,
        rate: int = 100,
        drop: float = 0.0,
        corrupt: float = 0.0,
        wear: Callable[[MotorParameters, int], MotorParameters] | None = None,
    ):
        self.port, self.now = f"simulated robot {number}", 0.0
        self._sizes, fleet = Sizes.of(robot), load_fleet(robot.fleets[0][0])
        motors = draw_motors(robot, fleet, number)
        self.body = TwinBody(robot, motors if wear is None else wear(motors, number), hung, life)
        self._period = 1000 // rate
        self.firmware = Firmware(robot, self.body, FirmwareConfig(self._period, homes=False))
        self._to_host, self._to_robot = (
            NoisyLine(drop, corrupt, delay=delay, rng=np.random.default_rng([number, life, way]))
            for way, delay in enumerate((0.0, WAY))
        )
        self._cutter, self._reader = CommandCutter(), telemetry_reader(self._sizes)

    @property
    def unsent(self) -> int:
        """The robot takes every byte at once."""
        return 0

    def fileno(self) -> int:
        """No file: for a guardian that is none."""
        return -1

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        """See `SerialLink.wait`."""
        next_frame = 1e-3 * (self.firmware.now + self._period - self.firmware.now % self._period) + WAY
        self.now = max(self.now, min(until, next_frame))
        self._live()
        return [(self.now, message) for message in self._reader.feed(self._to_host.take(self.now))]

    def send(self, command: Command) -> float:
        """See `SerialLink.send`."""
        self._live()
        for piece in self._cutter.cut(command_frame(command, self._sizes)):
            self._to_robot.put(piece, self.now)
        return self.now

    def forget_unsent(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Nothing to give back."""

    def sleep(self, seconds: float) -> None:
        """`time.sleep` on this clock."""
        self.now += seconds

    def _live(self) -> None:
        """Bring the robot up to date; it reads what came before the beginning of each of its milliseconds."""
        end = int(1e3 * (self.now - WAY) + _ROUNDING)
        while (due := 1e3 * self._to_robot.due() - _ROUNDING) <= end:
            self._live_until(math.ceil(due))
            self.firmware.receive(self._to_robot.take(1e-3 * (self.firmware.now + _ROUNDING)))
        self._live_until(end)

    def _live_until(self, milliseconds: int) -> None:
        for piece in self.firmware.frames(milliseconds - self.firmware.now):
            self._to_host.put(piece, self.now)


class _Nobody:
    """In place of a process that lives in real time: the watchdog, the timer of the machine."""

    def beat(self) -> None:
        """Nobody listens."""

    def release(self) -> None:
        """Nobody ends."""

    def stop(self) -> None:
        """Nobody reports."""

    abandon = kill = release


@contextmanager
def on_its_clock(port: SimulatedPort) -> Iterator[None]:
    """The host's clock is the port's while this is open, and nothing that lives in real time is started.

    The commands `deploy` and `record` find it at any port.
    """
    with (
        mock.patch.object(commands, "SerialLink", lambda *_: port),
        mock.patch.object(time, "monotonic", lambda: port.now),
        mock.patch.object(time, "sleep", port.sleep),
        mock.patch.object(robot_link, "Guardian", lambda *_: _Nobody()),
        mock.patch.object(run_facts, "BareTimers", _Nobody),
        mock.patch.object(session, "real_time_priority", nullcontext),
        mock.patch.object(session, "locked_memory", nullcontext),
    ):
        yield
