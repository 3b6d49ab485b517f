"""The host's side of the watchdog: starts its process, sends heartbeats, and reads its reports."""

import contextlib
import fcntl
import os
import select
import subprocess
import sys
from pathlib import Path

from motorprior.exceptions import RobotFault

_MAX_START = 10.0  # maximum time in which the interpreter of the process starts [s]
# Unread heartbeats of 40 bytes fill a pipe of one page in about a second, which reveals a stopped
# watchdog process. It takes up to 16 s where pages are larger or the pipe cannot be made smaller.
_HEARTBEAT = 40 * b"."
_PIPE_SIZE = 4096


class Watchdog:
    """A running watchdog process, see `watchdog_process`; raises RobotFault if it does not start.

    It inherits ``port``, the open file of the serial port. ``timeout`` is the maximum time between
    heartbeats [s]. ``idle_frame`` are the bytes that remove the current from the motors and, on a
    servo bus, restore the registers.
    """

    def __init__(self, port: int, timeout: float, idle_frame: bytes):
        heartbeat_end, self._heartbeats = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._heartbeats, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
        self._reports, report_end = os.pipe()
        script = Path(__file__).with_name("watchdog_process.py")
        arguments = [port, heartbeat_end, report_end, timeout, idle_frame.hex()]
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(script), *map(str, arguments)],
                pass_fds=(port, heartbeat_end, report_end),
                start_new_session=True,
                stdin=subprocess.DEVNULL,
            )
        finally:
            os.close(heartbeat_end)
            os.close(report_end)

        os.set_blocking(self._heartbeats, False)
        ready, _, _ = select.select([self._reports], [], [], _MAX_START)
        if not ready or os.read(self._reports, 1) != b"r":
            self.end(idle_sent=True)
            raise RobotFault(
                "watchdog", "the watchdog process did not start", remedy="see its output above"
            )

    def beat(self) -> None:
        """Send a heartbeat.

        Raises RobotFault if the watchdog has tripped, is dead, or has not read for a second.
        """
        try:
            os.write(self._heartbeats, _HEARTBEAT)
        except (BrokenPipeError, BlockingIOError):
            raise _dead() from None
        ready, _, _ = select.select([self._reports], [], [], 0.0)
        if ready:
            if os.read(self._reports, 1) != b"t":
                raise _dead()
            raise RobotFault(
                "watchdog", "the host was silent for too long and the watchdog sent idle"
            )

    def end(self, idle_sent: bool, patience: float = 2.0) -> None:
        """End the process, by force after ``patience`` [s].

        Without ``idle_sent`` the process first sends idle for a second.
        """
        if idle_sent:
            with contextlib.suppress(OSError):
                os.write(self._heartbeats, b"q")
        os.close(self._heartbeats)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        self._process.kill()  # a stopped process must not wake up while the next host runs
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        os.close(self._reports)


def _dead() -> RobotFault:
    return RobotFault(
        "watchdog",
        "the watchdog process is dead or stopped",
        safe_state="crouch",
        remedy="look into the system's log for the reason",
    )
