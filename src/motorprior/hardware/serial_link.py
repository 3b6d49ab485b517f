"""The serial port as two streams of messages. No call blocks longer than its time limit."""

import contextlib
import errno
import os
import select
import termios
import time
from pathlib import Path

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.robots.robot import Robot

BAUD_RATE = 500_000  # 8N1; a USB port ignores it, a serial converter does not
_MAX_UNSENT = 2048  # maximum length of the send queue: about 20 commands [bytes]
_UNPLUGGED = "switch the robot's motors off by hand: without its host it holds its last target"


class SerialLink:
    """An open port, for example /dev/ttyACM0; raises RobotFault if it cannot be opened."""

    def __init__(self, robot: Robot, port: str | Path):
        import serial

        self.port = str(port)
        try:
            self._serial = serial.Serial(
                self.port, BAUD_RATE, timeout=0, write_timeout=0, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise _cannot_open(self.port, error) from error
        self._joints = robot.num_joints
        self.reader = FrameReader(Telemetry, self._joints)
        self.unsent = bytearray()  # what the port has not accepted yet

    def fileno(self) -> int:
        """File descriptor of the port, which the watchdog inherits."""
        return self._serial.fileno()

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        """Messages with their arrival times [s].

        Returns when bytes come, or at ``until`` [s] on the monotonic clock. Raises RobotFault if
        the port is gone.
        """
        try:
            timeout = max(0.0, until - time.monotonic())
            ready, _, _ = select.select([self.fileno()], [], [], timeout)
            if not ready:
                return []
            data = os.read(self.fileno(), 4096)
            if not data:
                raise OSError("end of file")
        except BlockingIOError:
            return []
        except (OSError, ValueError, TypeError) as error:
            # a TypeError: pyserial's fileno is None once it is closed
            raise self._gone(error) from error
        now = time.monotonic()
        return [(now, message) for message in self.reader.feed(data)]

    def send(self, command: Command) -> float:
        """Write a command; returns the time [s].

        Raises RobotFault if the port is gone or the robot stops reading.
        """
        self.unsent += framed(command, self._joints)
        try:
            sent = os.write(self.fileno(), self.unsent)
            del self.unsent[:sent]
        except BlockingIOError:
            pass
        except (OSError, ValueError, TypeError) as error:
            raise self._gone(error) from error
        if len(self.unsent) > _MAX_UNSENT:
            raise RobotFault(
                "unplugged", f"{self.port}: the robot accepts no more bytes", remedy=_UNPLUGGED
            )
        return time.monotonic()

    def discard_unsent(self) -> None:
        """Empty the send queue, here and in the kernel: the next command is more urgent."""
        self.unsent.clear()
        with contextlib.suppress(termios.error, ValueError, TypeError):
            termios.tcflush(self.fileno(), termios.TCOFLUSH)

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):
            self._serial.close()

    def _gone(self, error: Exception) -> RobotFault:
        return RobotFault("unplugged", f"{self.port} is gone ({error})", remedy=_UNPLUGGED)


def resolve_port(port: str | None) -> str:
    """The given port, or the only USB serial port; ConfigError if there are none or several."""
    ports = _usb_ports() if port is None else [port]
    if len(ports) == 1:
        return ports[0]
    if not ports:
        raise ConfigError(
            "no robot or adapter at USB",
            remedy="plug it in and switch it on, or give port, such as /dev/ttyACM0",
            argument="port",
        )
    raise ConfigError(
        f"several ports: {', '.join(ports)}", remedy="give one of them as port", argument="port"
    )


def _usb_ports() -> list[str]:
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports() if port.vid is not None)


def _cannot_open(port: str, error: Exception) -> RobotFault:
    number = getattr(error, "errno", None)
    cause = error.__context__
    if not number and isinstance(cause, termios.error):
        number = cause.args[0]

    return no_port(port, number, str(error))


def no_port(port: str, number: int | None, message: str) -> RobotFault:
    """The fault of a port that cannot be opened, with the remedy of its error number if known."""
    reason = os.strerror(number) if number else message
    ports = ", ".join(_usb_ports()) or "none"
    remedies = {
        errno.ENOTTY: "this is no serial port; give one such as /dev/ttyACM0",
        errno.EACCES: "add yourself to the group dialout (sudo usermod -aG dialout $USER) "
        "and log in again",
        errno.ENOENT: f"plug the robot in and switch it on; ports found: {ports}",
    }
    remedy = remedies.get(
        number or 0, "close every other program that uses the port, and check the baud rate"
    )
    return RobotFault("no port", f"cannot open {port} ({reason})", remedy=remedy)
