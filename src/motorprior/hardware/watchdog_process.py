"""The watchdog process: sends idle when the host is silent or dead.

Most firmware has no watchdog: a robot whose host dies holds its last target. So a second process
inherits the open port and the read end of a pipe. The host writes a heartbeat per control step;
when the pipe ends (the host died) or stays empty for ``timeout`` (it hangs), this process takes
over the port. It uses only the standard library, and has a session of its own and ignores signals,
so that a signal that ends the host does not end it.

    python -I -S watchdog_process.py PORT_FD HEARTBEAT_FD REPORT_FD TIMEOUT IDLE_FRAME_HEX

Heartbeats: any bytes; "q" ends the process, and it sends nothing. Reports: "r" ready, "t" tripped.
"""

import contextlib
import ctypes
import os
import select
import signal
import sys
import termios
import time

_PRIORITY = 20  # SCHED_FIFO priority, above the control loop's
# flag of mlockall(2): lock the present pages; this process allocates almost nothing later
_MCL_CURRENT = 1
# Number of idle frames at once: more bytes than the longest command, which the dead host may have
# sent in part.
_BURST = 40
_REPEAT = 0.02  # time between idle frames [s]
_LINGER = 1.0  # time in which idle frames are sent after the host's death [s]


def main(arguments: list[str]) -> None:
    """Run until the host releases this process or dies."""
    port, heartbeats, report = map(int, arguments[:3])
    timeout = float(arguments[3])
    idle_frame = bytes.fromhex(arguments[4])

    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGPIPE):
        signal.signal(ignored, signal.SIG_IGN)
    with contextlib.suppress(OSError, AttributeError):  # not permitted, or not Linux
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    # the host's lock does not extend to this process
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).mlockall(_MCL_CURRENT)

    os.set_blocking(port, False)
    os.write(report, b"r")
    if wait_for_silence(heartbeats, timeout):
        with contextlib.suppress(OSError):  # the host is dead
            os.write(report, b"t")
        repeat_idle(port, heartbeats, idle_frame)


def wait_for_silence(heartbeats: int, timeout: float) -> bool:
    """Wait; returns True when the host died or hangs, False when it released this process."""
    limit = None  # before the first heartbeat
    while True:
        ready, _, _ = select.select([heartbeats], [], [], limit)
        data = os.read(heartbeats, 4096) if ready else b""
        if b"q" in data:
            return False
        if not data:
            return True
        limit = timeout


def repeat_idle(port: int, heartbeats: int, idle_frame: bytes) -> None:
    """Send idle until the host has been dead for a second.

    A host that hangs may resume and write targets.
    """
    with contextlib.suppress(termios.error, OSError):
        termios.tcflush(port, termios.TCOFLUSH)  # the host's last commands
    _write(port, _BURST * idle_frame)

    pipes = [heartbeats]
    end = float("inf")
    while time.monotonic() < end:
        ready, _, _ = select.select(pipes, [], [], _REPEAT)
        data = os.read(heartbeats, 4096) if ready else b"."
        if b"q" in data:
            return
        if not data:  # the host is dead
            pipes = []
            end = time.monotonic() + _LINGER
        if not _write(port, idle_frame):
            return


def _write(port: int, data: bytes) -> bool:
    """Write what the port accepts; False if it is gone."""
    try:
        with contextlib.suppress(BlockingIOError):
            os.write(port, data)
    except OSError:
        return False
    return True


if __name__ == "__main__":
    main(sys.argv[1:])
