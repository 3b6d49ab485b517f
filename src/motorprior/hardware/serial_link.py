"""The serial port as two streams of messages. No call blocks beyond the time that it is given."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import time
from pathlib import Path

from motorprior.exceptions import RobotFault
from motorprior.hardware.framing import command_frame, telemetry_reader
from motorprior.hardware.protocol import Command, Sizes, Telemetry
from motorprior.robots.robot import Robot

BAUD_RATE = 500_000  # 8N1; on a USB port the number means nothing, on a converter it does
_READ_SIZE = 4096
_BACKLOG = 2048
"""Bytes [B] that may wait for the robot to take them: about 20 commands."""


class SerialLink:
    """One open port.

    Attributes:
        rejected: frames that were damaged.

    Args:
        robot: whose messages travel over it.
        port: path of the device, for example /dev/ttyACM0.

    Raises:
        RobotFault: no such port, no permission, or another program has it.
    """

    def __init__(self, robot: Robot, port: str | Path):
        import serial

        self.port = str(port)
        try:
            self._serial = serial.Serial(self.port, BAUD_RATE, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise RobotFault("no port", f"cannot open {self.port} ({_reason(error)})", remedy=_remedy(error)) from error
        self._sizes = Sizes.of(robot)
        self._reader = telemetry_reader(self._sizes)
        self._unsent = bytearray()

    @property
    def rejected(self) -> int:
        """Starts of frames that were none."""
        return self._reader.rejected

    @property
    def unsent(self) -> int:
        """Bytes that the port has not taken yet."""
        return len(self._unsent)

    def fileno(self) -> int:
        """The open file, for the watchdog to inherit."""
        return self._serial.fileno()

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        """Sleep until ``until`` on the monotonic clock or until bytes come; what they complete, with their time [s].

        Raises:
            RobotFault: the port is gone.
        """
        try:
            ready, _, _ = select.select([self.fileno()], [], [], max(0.0, until - time.monotonic()))
            data = os.read(self.fileno(), _READ_SIZE) if ready else None
        except BlockingIOError:
            return []
        except (OSError, ValueError, TypeError) as error:  # pyserial's fileno is None once it is closed
            raise self._gone(error) from error
        if data is None:
            return []
        if not data:
            raise self._gone("end of file")
        now = time.monotonic()
        return [(now, message) for message in self._reader.feed(data)]

    def send(self, command: Command) -> float:
        """Write a command; returns the time at which it was handed over [s].

        Raises:
            RobotFault: the port is gone, or the robot takes nothing any more.
            ProtocolError: a command that the firmware would refuse.
        """
        self._unsent += command_frame(command, self._sizes)
        try:
            sent = os.write(self.fileno(), self._unsent)
            del self._unsent[:sent]
        except BlockingIOError:
            pass
        except (OSError, ValueError, TypeError) as error:
            raise self._gone(error) from error
        if len(self._unsent) > _BACKLOG:
            raise RobotFault("unplugged", f"{self.port}: the robot takes no more bytes", remedy=_UNPLUGGED)
        return time.monotonic()

    def forget_unsent(self) -> None:
        """Drop what waits to be sent, here and in the kernel: what follows is more urgent."""
        self._unsent.clear()
        with contextlib.suppress(termios.error, ValueError, TypeError):
            termios.tcflush(self.fileno(), termios.TCOFLUSH)

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError):
            self._serial.close()

    def _gone(self, error: object) -> RobotFault:
        return RobotFault("unplugged", f"{self.port} is gone ({error})", remedy=_UNPLUGGED)


_UNPLUGGED = "switch the robot's motors off by hand: without its host it holds its last target"


def find_ports() -> list[str]:
    """Serial ports that a robot could be on, USB devices of the kind that a Teensy is first."""
    from serial.tools import list_ports

    found = [port for port in list_ports.comports() if port.vid is not None]
    teensy = 0x16C0  # vendor number of PJRC's boards
    return [port.device for port in sorted(found, key=lambda port: (port.vid != teensy, port.device))]


def _number(error: Exception) -> int | None:
    """The errno of an error, or of the one of termios behind it."""
    if isinstance(error, OSError) and error.errno:
        return error.errno
    behind = error.__context__
    return behind.args[0] if isinstance(behind, termios.error) else None


def _reason(error: Exception) -> str:
    number = _number(error)
    return os.strerror(number) if number is not None else str(error)


def _remedy(error: Exception) -> str:
    number = _number(error)
    if number == errno.ENOTTY:
        return "that is no serial port; give one such as /dev/ttyACM0"
    if number == errno.EACCES:
        return "add yourself to the group dialout (sudo usermod -aG dialout $USER) and log in again"
    if number == errno.ENOENT:
        found = find_ports()
        return f"use one of {', '.join(found)}" if found else "plug the robot in and switch it on; no port is there"
    return "close every other program that uses the port"
