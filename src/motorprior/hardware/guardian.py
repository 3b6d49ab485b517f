"""The host's side of the watchdog: starts the process, sends it beats, and reads when it has taken over."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import sys
from pathlib import Path

from motorprior.exceptions import RobotFault
from motorprior.hardware.framing import IDLE_FRAME

_START = 10.0
"""Longest start of the watchdog's interpreter [s]."""
_SOON = 0.005
"""Longest wait for a killed watchdog process [s]."""
_PIPE = 4096
"""Capacity of the pipe [bytes], one page."""
_BEAT = 40 * b"."
"""Bytes of one beat. Unread beats fill the pipe in about a second, which reveals a watchdog that sleeps; it takes up to
16 s where pages are larger or the pipe cannot be made smaller."""


class Guardian:
    """A running watchdog process.

    Args:
        port: open file of the serial port, which the process inherits.
        timeout: longest silence [s].

    Raises:
        RobotFault: it did not start.
    """

    def __init__(self, port: int, timeout: float):
        beat_end, self._beats = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._beats, fcntl.F_SETPIPE_SZ, _PIPE)
        self._reports, report_end = os.pipe()
        script = str(Path(__file__).with_name("watchdog.py"))
        numbers = [str(port), str(beat_end), str(report_end), str(timeout)]
        arguments = [sys.executable, "-I", "-S", script, *numbers, IDLE_FRAME.hex()]
        try:
            self._process = subprocess.Popen(
                arguments, pass_fds=(port, beat_end, report_end), start_new_session=True, stdin=subprocess.DEVNULL
            )
        finally:
            os.close(beat_end)
            os.close(report_end)
        os.set_blocking(self._beats, False)
        ready, _, _ = select.select([self._reports], [], [], _START)
        if not ready or os.read(self._reports, 1) != b"r":
            self.release()
            raise RobotFault("watchdog", "the watchdog process did not start", remedy="see what it printed above")

    @property
    def pid(self) -> int:
        """Process number."""
        return self._process.pid

    def beat(self) -> None:
        """Send beats: the host is alive.

        Raises:
            RobotFault: the watchdog has taken over the port, is dead, or has not read a beat for a second.
        """
        try:
            os.write(self._beats, _BEAT)
        except (BrokenPipeError, BlockingIOError):
            raise _dead() from None
        ready, _, _ = select.select([self._reports], [], [], 0.0)
        if ready:
            if os.read(self._reports, 1) != b"t":
                raise _dead()
            raise RobotFault("watchdog", "the host was silent for too long and the watchdog sent idle")

    def release(self) -> None:
        """End the watchdog process; the robot must be idle by now."""
        with contextlib.suppress(OSError):
            os.write(self._beats, b"q")
        self.abandon()

    def abandon(self) -> None:
        """Close the pipe and no more: as after the death of the host, the watchdog sends idle for a second."""
        os.close(self._beats)
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:  # it sleeps, and must not wake up beside the next host
            self._process.kill()
            self._process.wait()
        os.close(self._reports)

    def kill(self) -> None:
        """End it at once, dead or asleep, without waiting: the robot still moves."""
        self._process.kill()
        os.close(self._beats)
        os.close(self._reports)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=_SOON)


def _dead() -> RobotFault:
    return RobotFault(
        "watchdog",
        "the watchdog process is dead or asleep",
        safe_state="crouch",
        remedy="look into the system's log for why",
    )
