"""The operator at the robot: confirms arming, steers by keyboard or gamepad, and reads messages."""

import contextlib
import os
import select
import struct
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.robots.robot import Gait

Print = Callable[[str], None]
WALKING = (
    "Keys while it moves: w/s or up/down: faster, slower; a/d or left/right: turn; "
    "space: stand still; q: sit down; "
    "Ctrl-C: sit down; Ctrl-C twice: no current, the robot drops."
)
STANDING = "Ctrl-C: sit down; Ctrl-C twice: no current, the robot drops. Other keys have no effect."
SUSPENDED = "The legs move fast. Ctrl-C: no current, the legs drop. Other keys have no effect."

_NUM_STEPS = 10  # key presses from standing to the maximum speed or yaw rate
_ARROWS = {b"\x1b[A": b"w", b"\x1b[B": b"s", b"\x1b[D": b"a", b"\x1b[C": b"d"}
_GAMEPAD = Path("/dev/input/js0")
_EVENT = struct.Struct("<IhBB")  # Linux joystick API: time [ms], value, type, number
_AXIS = 2
_BUTTON = 1
# axes of the left stick; -32767 is forward, left
_VERTICAL = 1
_HORIZONTAL = 0
# a released stick does not rest at exactly 0
_MAX_DEFLECTION = 32767.0
_DEAD_ZONE = 0.06
# Relative reduction of the maximum speed in the sharpest turn: policies fell with both speed and
# yaw rate at their limits.
_SLOW_DOWN_IN_TURNS = 0.4
_AUTONOMOUS_SPEED = 0.3  # speed of a robot without an operator [m/s]


class Teleop:
    """Reads keyboard and gamepad, if there are any, without waiting.

    Both are open files: a terminal in cbreak mode and a joystick device. ``command`` is the initial
    speed [m/s] and yaw rate [rad/s]; ``gait`` limits both.
    """

    def __init__(
        self, keyboard: int | None, gamepad: int | None, gait: Gait, command: tuple[float, float]
    ):
        self._keyboard = keyboard
        self._gamepad = gamepad
        self._gait = gait
        self._forward, self._yaw_rate = command

    def command(self) -> tuple[float, float] | None:
        """Speed [m/s], reduced in turns, and yaw rate [rad/s].

        Returns None at q, at a gamepad button, or if keyboard or gamepad is lost.
        """
        for file, handle in ((self._keyboard, self._on_keys), (self._gamepad, self._on_events)):
            if file is None or not select.select([file], [], [], 0.0)[0]:
                continue
            try:
                data = os.read(file, 256)
            except OSError:
                return None
            if not data or not handle(data):
                return None

        turn = abs(self._yaw_rate) / self._gait.yaw_rate if self._yaw_rate else 0.0
        max_speed = round((1.0 - _SLOW_DOWN_IN_TURNS * turn) * self._gait.forward[1], 4)
        return min(self._forward, max_speed), self._yaw_rate

    def _on_keys(self, data: bytes) -> bool:
        """Change the command by key presses; returns False to stop."""
        for arrow, letter in _ARROWS.items():
            data = data.replace(arrow, letter)
        for key in data.decode("ascii", errors="ignore"):
            if key == " ":
                self._set(0.0, 0.0)
                continue
            forward_steps = (key == "w") - (key == "s")
            turn_steps = (key == "a") - (key == "d")
            self._set(
                self._forward + forward_steps * self._gait.forward[1] / _NUM_STEPS,
                self._yaw_rate + turn_steps * self._gait.yaw_rate / _NUM_STEPS,
            )
        return b"q" not in data.lower()

    def _on_events(self, data: bytes) -> bool:
        """Change the command by events of the gamepad; returns False to stop."""
        whole_events = data[: len(data) // _EVENT.size * _EVENT.size]
        for _, value, event_type, number in _EVENT.iter_unpack(whole_events):
            if event_type == _BUTTON and value:
                return False
            if event_type != _AXIS:
                continue
            deflection = 0.0
            if abs(value) > _DEAD_ZONE * _MAX_DEFLECTION:
                deflection = -value / _MAX_DEFLECTION
            if number == _VERTICAL:
                backward, forward = self._gait.forward
                max_speed = forward if deflection > 0.0 else -backward
                self._set(deflection * max_speed, self._yaw_rate)
            elif number == _HORIZONTAL:
                self._set(self._forward, deflection * self._gait.yaw_rate)
        return True

    def _set(self, forward: float, yaw_rate: float) -> None:
        """Set the command, within the limits of the gait."""
        slowest, fastest = self._gait.forward
        max_yaw_rate = self._gait.yaw_rate
        self._forward = round(min(fastest, max(slowest, forward)), 4)
        self._yaw_rate = round(min(max_yaw_rate, max(-max_yaw_rate, yaw_rate)), 4)


def autonomous_speed(gait: Gait) -> float:
    """Speed of a robot without an operator [m/s]."""
    return min(_AUTONOMOUS_SPEED, gait.forward[1])


@contextlib.contextmanager
def teleop(gait: Gait, forward: float | None, yaw_rate: float) -> Iterator[Teleop]:
    """Steering by the terminal's keyboard and the gamepad, if there are any.

    Without ``forward`` [m/s] the robot stands at first; without keyboard and gamepad it walks at
    `autonomous_speed`. The terminal is restored afterwards.
    """
    with contextlib.ExitStack() as stack:
        keyboard = None
        gamepad = None
        if sys.stdin is not None and sys.stdin.isatty() and _in_foreground(sys.stdin.fileno()):
            keyboard = sys.stdin.fileno()
            stack.callback(_restore, keyboard, termios.tcgetattr(keyboard))
            tty.setcbreak(keyboard)
        with contextlib.suppress(OSError):
            gamepad = os.open(_GAMEPAD, os.O_RDONLY | os.O_NONBLOCK)
            stack.callback(os.close, gamepad)
        if forward is None:
            forward = autonomous_speed(gait) if keyboard is None and gamepad is None else 0.0
        yield Teleop(keyboard, gamepad, gait, (forward, yaw_rate))


def require_confirmation(yes: bool) -> None:
    """Raise ConfigError unless ``yes``, or a terminal at which arming can be confirmed."""
    if not yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise ConfigError(
            "no terminal to confirm at",
            remedy="give yes to arm without confirmation",
            argument="yes",
        )


def confirm_arming(stop: Sequence[str], yes: bool, how_to_stop: str, show: Print) -> None:
    """Wait until ``arm`` is typed, unless ``yes``.

    Raises RobotFault if something else is typed, or a signal comes.
    """
    if yes:
        return
    with contextlib.suppress(termios.error):
        # input from before the question does not count
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    show(f"Stand clear, one hand at the power switch. {how_to_stop}")
    show("Type arm and press Enter:")
    while not stop:
        if select.select([sys.stdin], [], [], 0.1)[0]:
            if sys.stdin.readline().strip() == "arm":
                return
            break
    raise RobotFault(
        "not armed",
        "arm was not typed; nothing was sent",
        remedy="run the command again when ready",
    )


def non_blocking(show: Print, file: TextIO) -> Print:
    """``show``, but silent while the terminal or pipe behind ``file`` is gone or full.

    A print that waits would trip the watchdog.
    """
    try:
        number = file.fileno()
    except (OSError, ValueError):  # a notebook's: no terminal, never full
        return show

    def print_line(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            if select.select([], [number], [], 0.0)[1]:
                show(text)

    return print_line


def _in_foreground(terminal: int) -> bool:
    """Whether this process may change a terminal: the system stops a background process."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not its own terminal
        return True


def _restore(terminal: int, attributes: list) -> None:
    with contextlib.suppress(termios.error, OSError):  # the terminal may be gone
        termios.tcsetattr(terminal, termios.TCSADRAIN, attributes)
