"""A virtual robot: a pseudo-terminal with firmware and a body behind it, in real time.

A host that opens ``port`` communicates as with a Teensy on /dev/ttyACM0, over the same kind of serial port.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable

from motorprior.hardware.virtual.firmware import Firmware, FirmwareConfig, RobotBody
from motorprior.robots.robot import Robot


class VirtualRobot:
    """A virtual robot. `run` moves it in real time, in a thread or a process of its own.

    Attributes:
        port: path of the pseudo-terminal to open.
        events: (time on the monotonic clock [s], mode or "target"), in order.
        received: number of bytes from the host.
    """

    def __init__(self, robot: Robot, body: RobotBody, config: FirmwareConfig):
        self.events: list[tuple[float, str]] = []
        self.firmware = Firmware(robot, body, config, lambda what: self.events.append((time.monotonic(), what)))
        self._period = config.telemetry_period
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.received, self._started = 0, 0.0
        self._stop = threading.Event()

    def stop(self) -> None:
        """End `run`, from another thread or a signal handler."""
        self._stop.set()

    def run(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Move until `stop` is called or ``ended`` returns True; then unplug."""
        try:
            self._started = time.monotonic()
            while not self._stop.is_set() and not ended():
                self._step()
        finally:
            os.close(self._slave)
            os.close(self._master)

    def _step(self) -> None:
        """Wait for bytes or the next telemetry, and advance the robot to the present."""
        next_frame = self.firmware.now + self._period - self.firmware.now % self._period  # [ms]
        timeout = max(0.0, self._started + 1e-3 * next_frame - time.monotonic())
        ready, _, _ = select.select([self._master], [], [], timeout)
        data = self._read() if ready else b""
        out = self.firmware.advance(int(1e3 * (time.monotonic() - self._started)) - self.firmware.now)
        self.firmware.receive(data)
        if out:
            with contextlib.suppress(BlockingIOError):  # as on a real port, a host that does not read loses frames
                os.write(self._master, out)

    def _read(self) -> bytes:
        try:
            data = os.read(self._master, 4096)
        except OSError:
            return b""
        self.received += len(data)
        return data
