"""The watchdog's own process: sends idle when the host is silent or dead, and does nothing else.

The firmware has no watchdog: a robot whose host dies holds its last target. So a second process inherits the open
port and the read end of a pipe. The host writes a byte per control step; when the pipe ends (the host is dead, the
kernel closed it) or nothing comes for `timeout` (it hangs), this process takes over the port. It uses the standard
library only, leaves the terminal's session and ignores its signals, so that what ends the host does not end it.

    python -I -S watchdog.py PORT_FD BEAT_FD REPORT_FD TIMEOUT IDLE_FRAME_HEX

Beats: any bytes; "q" ends it, and it sends nothing. Reports: "r" ready, "t" tripped.
"""

import contextlib
import ctypes
import os
import select
import signal
import sys
import termios
import time

_PRIORITY = 20
_NOW = 1
"""Flag of mlockall(2): the pages that are there; it allocates next to nothing later, and no limit can stop that."""
_BURST = 40
"""Idle frames at once: more bytes than the longest command, of which the dead host may have sent a part."""
_REPEAT = 0.02
_LINGER = 1.0
"""[s] between repetitions, and how long they go on after the host is dead."""


def main(arguments: list[str]) -> None:
    """Guard until the host releases this process or is gone."""
    port, beats, report = map(int, arguments[:3])
    timeout, idle = float(arguments[3]), bytes.fromhex(arguments[4])
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGPIPE):
        signal.signal(ignored, signal.SIG_IGN)
    with contextlib.suppress(OSError, AttributeError):  # needs a right, and a system that has it
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    with contextlib.suppress(OSError, AttributeError):  # the host's lock does not outlive the start of this program
        ctypes.CDLL(None).mlockall(_NOW)
    os.set_blocking(port, False)
    os.write(report, b"r")
    if guard(beats, timeout):
        with contextlib.suppress(OSError):  # the host is dead
            os.write(report, b"t")
        hold_idle(port, beats, idle)


def guard(beats: int, timeout: float) -> bool:
    """Wait until the host ends its beats: True if it died or hangs, False if it released this process."""
    first = True  # the host may take its time before its first command
    while True:
        ready, _, _ = select.select([beats], [], [], None if first else timeout)
        data = os.read(beats, 4096) if ready else b""
        if b"q" in data:
            return False
        if not data:
            return True
        first = False


def hold_idle(port: int, beats: int, idle: bytes) -> None:
    """Send idle until the host is gone for a while; a host that only hung may still be writing targets."""
    with contextlib.suppress(termios.error, OSError):
        termios.tcflush(port, termios.TCOFLUSH)  # what the host still had in the queue
    _write(port, _BURST * idle)
    gone = None
    while gone is None or time.monotonic() < gone + _LINGER:
        if gone is None:
            ready, _, _ = select.select([beats], [], [], _REPEAT)
            data = os.read(beats, 4096) if ready else b"."
            if b"q" in data:
                return
            if not data:
                gone = time.monotonic()
        else:
            time.sleep(_REPEAT)
        if not _write(port, idle):
            return


def _write(port: int, data: bytes) -> bool:
    """Write what the port takes; False if it is gone."""
    try:
        os.write(port, data)
    except BlockingIOError:
        pass
    except OSError:
        return False
    return True


if __name__ == "__main__":
    main(sys.argv[1:])
