"""A virtual robot: a pseudo-terminal with firmware and a body behind it, in real time.

A host that opens `port` talks to it as to a Teensy on /dev/ttyACM0, with the same bytes over a real serial port
object.
"""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Sequence

from motorprior.hardware.real_time import real_time_priority
from motorprior.hardware.virtual.firmware import Body, Drive, Firmware, FirmwareConfig, Sensors
from motorprior.hardware.virtual.injected import LAG, CommandCutter, Fault, FaultySensors, NoisyLine
from motorprior.robots.robot import Robot

_READ_SIZE = 4096


class VirtualRobot:
    """One virtual robot. `run` moves it in real time, in a thread or a process of its own.

    Attributes:
        port: path of the pseudo-terminal to open.
        events: (time on the monotonic clock [s], mode or "target"), in order.
        firmware: its state.
        received: bytes from the host.
        started: when `run` began, on the monotonic clock [s].

    Args:
        robot: that it is one of; with a wire.
        body: motors and mechanics.
        config: of the firmware.
        faults: injected.
        to_host: the line that telemetry goes over.
        to_robot: the line that commands go over.
    """

    def __init__(
        self,
        robot: Robot,
        body: Body,
        config: FirmwareConfig,
        faults: Sequence[Fault] = (),
        to_host: NoisyLine | None = None,
        to_robot: NoisyLine | None = None,
    ):
        self._faults = list(faults)
        self._body = _FaultyBody(body, self._faults)
        sensors = FaultySensors(self._faults)
        self.events: list[tuple[float, str]] = []
        self._switch_on = lambda: Firmware(
            robot, self._body, config, self._note, lambda sensed: sensors(sensed, self._body.now)
        )
        self.firmware = self._switch_on()
        self._to_host, self._to_robot, self._cutter = to_host or NoisyLine(), to_robot or NoisyLine(), CommandCutter()
        self._period = config.telemetry_period
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.received = 0
        self.started = self._switched_on = 0.0
        self._stop = threading.Event()
        self._plugged = True

    def break_down(self, kind: str, joint: int = 0) -> float:
        """Inject a fault now; returns when [s], on the monotonic clock."""
        self._faults.append(Fault(kind, self._body.now, joint))
        return time.monotonic()

    def stop(self) -> None:
        """End `run`, from another thread or a signal handler."""
        self._stop.set()

    def run(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Move until `stop` is called or ``ended`` returns True."""
        try:
            with real_time_priority():
                self.started = self._switched_on = time.monotonic()
                while not self._stop.is_set() and not ended():
                    self._turn()
        finally:
            self._unplug()

    def _turn(self) -> None:
        """Wait for bytes or for the next telemetry, and bring the robot up to date."""
        if self._lasts("restart") > 0.0:
            self._restart()
        ahead = self._period - self.firmware.now % self._period  # in whole milliseconds: no remainder of a rounding
        wake = self._switched_on + 1e-3 * (self.firmware.now + ahead)
        wake = min(wake, self._to_host.due(), self._to_robot.due())
        readers = [self._master] if self._plugged and not self._lasts("deaf") else []
        ready, _, _ = select.select(readers, [], [], max(0.0, wake - time.monotonic()))
        data = self._read() if ready else b""
        now = time.monotonic()
        elapsed = int(1e3 * (now - self._switched_on)) - self.firmware.now
        for piece in self.firmware.frames(elapsed):
            self._to_host.put(piece, now + LAG * self._lasts("lagging"))
        for piece in self._cutter.cut(data):
            self._to_robot.put(piece, now)
        self.firmware.receive(self._to_robot.take(now))
        if self._lasts("unplugged"):
            self._unplug()
        out = self._to_host.take(now)
        if out and self._plugged and not self._lasts("mute"):
            self._write(out)

    def _restart(self) -> None:
        """Switch off and on: another firmware, its clock at 0."""
        self._faults[:] = [fault for fault in self._faults if fault.kind != "restart"]
        self.firmware, self._switched_on = self._switch_on(), time.monotonic()

    def _read(self) -> bytes:
        try:
            data = os.read(self._master, _READ_SIZE)
        except (BlockingIOError, OSError):
            return b""
        self.received += len(data)
        return data

    def _write(self, data: bytes) -> None:
        """A host that does not read loses what does not fit, as on a real port."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return

    def _lasts(self, kind: str) -> float:
        """For how long a fault has been there [s]; 0 if it has not begun."""
        return max((0.0, *(self._body.now - fault.at + 1e-3 for fault in self._faults if fault.kind == kind)))

    def _unplug(self) -> None:
        if self._plugged:
            self._plugged = False
            os.close(self._slave)
            os.close(self._master)

    def _note(self, what: str) -> None:
        self.events.append((time.monotonic(), what))


class _FaultyBody:
    """A body whose motors break."""

    def __init__(self, body: Body, faults: list[Fault]):
        self._body, self._faults = body, faults
        self._milliseconds = 0

    @property
    def now(self) -> float:
        """[s] since the start."""
        return 1e-3 * self._milliseconds

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """See `Body.advance`; a dead motor gets no current, a stalled one holds where it is with all it has."""
        broken = [fault for fault in self._faults if fault.at <= self.now and fault.kind in ("dead", "stalled")]
        if broken:
            kp, kd, blocked = drive.kp.copy(), drive.kd.copy(), []
            for fault in broken:
                kp[fault.joint] = kd[fault.joint] = 0.0
                if fault.kind == "stalled":
                    blocked.append(fault.joint)
            drive = Drive(drive.target, kp, kd, drive.max_current, tuple(blocked))
        self._body.advance(milliseconds, drive)
        self._milliseconds += milliseconds

    def sense(self) -> Sensors:
        """See `Body.sense`."""
        return self._body.sense()


def in_thread(robot: VirtualRobot) -> Callable[[], None]:
    """Start a virtual robot in a thread of this process; returns what ends it."""
    thread = threading.Thread(target=robot.run, name="virtual-robot", daemon=True)
    thread.start()

    def end() -> None:
        robot.stop()
        thread.join(timeout=60.0)

    return end
