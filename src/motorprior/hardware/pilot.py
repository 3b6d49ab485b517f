"""Steering by a keyboard in a terminal, or by a gamepad where there is one.

It sets the throttle, the share of the trained intensity of the gait, and nothing else: policies are trained to walk
straight on, not to turn.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

GAMEPAD = Path("/dev/input/js0")
KEYS = "w or up: faster, s or down: slower, space: step in place, q: sit down"
_STEP = 0.1
_EVENT = struct.Struct("<IhBB")  # Linux joystick API: time [ms], value, type, number
_AXIS, _BUTTON, _AT_START = 2, 1, 0x80
_STICK = 1
"""Number of the left stick's vertical axis, -32767 is forward."""


class Pilot:
    """Reads keys and stick without waiting.

    Args:
        keyboard: open file of a terminal in cbreak mode, or None.
        gamepad: open joystick device, or None.
        throttle: to begin with, 0..1.
    """

    def __init__(self, keyboard: int | None, gamepad: int | None, throttle: float):
        self._keyboard, self._gamepad, self._throttle = keyboard, gamepad, throttle

    def throttle(self) -> float | None:
        """0..1; None to stop: q, a button of the gamepad, or a terminal or gamepad that is gone."""
        for file, obey in ((self._keyboard, self._type), (self._gamepad, self._push)):
            if file is None or not select.select([file], [], [], 0.0)[0]:
                continue
            try:
                data = os.read(file, 256)
            except OSError:
                return None
            if not data or not obey(data):
                return None
        return self._throttle

    def _type(self, data: bytes) -> bool:
        """Obey keys; False to stop."""
        keys = data.replace(b"\x1b[A", b"w").replace(b"\x1b[B", b"s")
        for key in keys.decode("ascii", errors="ignore"):
            change = {"w": _STEP, "s": -_STEP, " ": -1.0}.get(key, 0.0)
            self._throttle = min(1.0, max(0.0, round(self._throttle + change, 3)))
        return b"q" not in keys

    def _push(self, data: bytes) -> bool:
        """Obey the stick; False on a button."""
        for _, value, kind, number in _EVENT.iter_unpack(data[: len(data) // _EVENT.size * _EVENT.size]):
            if kind == _BUTTON and value:
                return False
            if kind & ~_AT_START == _AXIS and number == _STICK and not kind & _AT_START:
                self._throttle = max(0.0, -value / 32767.0)
        return True


@contextlib.contextmanager
def pilot(throttle: float) -> Iterator[Pilot]:
    """A pilot with what there is; the terminal is put back afterwards."""
    with contextlib.ExitStack() as stack:
        keyboard = gamepad = None
        if sys.stdin is not None and sys.stdin.isatty() and _in_foreground(sys.stdin.fileno()):
            keyboard = sys.stdin.fileno()
            before = termios.tcgetattr(keyboard)
            stack.callback(_put_back, keyboard, before)
            tty.setcbreak(keyboard)
        with contextlib.suppress(OSError):
            gamepad = os.open(GAMEPAD, os.O_RDONLY | os.O_NONBLOCK)
            stack.callback(os.close, gamepad)
        yield Pilot(keyboard, gamepad, throttle)


def _in_foreground(terminal: int) -> bool:
    """Whether this process may touch a terminal; from the background, touching its own would stop it."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not its own
        return True


def _put_back(terminal: int, before: list) -> None:
    with contextlib.suppress(termios.error, OSError):  # the terminal may be gone
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
