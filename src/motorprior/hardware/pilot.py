"""Steering by a keyboard in a terminal, or by a gamepad where there is one: speed and yaw rate."""

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

from motorprior.robots.robot import Gait

GAMEPAD = Path("/dev/input/js0")
KEYS = "w/s or up/down: faster, slower; a/d or left/right: turn; space: stand still; q: sit down"
_STEPS = 10
"""Key presses from standing to the fastest speed or turn."""
_EVENT = struct.Struct("<IhBB")  # Linux joystick API: time [ms], value, type, number
_AXIS, _BUTTON = 2, 1
_DEAD = 0.06
"""Share of a stick's way that means nothing: a released stick does not rest at exactly 0."""
_STICK, _TURN_STICK, _FULL = 1, 0, 32767.0
"""Numbers of the left stick's axes, vertical (-32767 is forward) and horizontal (-32767 is left)."""
SLOWER_IN_TURNS = 0.4
"""Share of the fastest speed that the sharpest turn takes: told both at once, policies of earlier trainings fell
(docs/training-appendix.md)."""
ALONE = 0.3
"""Speed of a robot that nobody steers [m/s], if it can walk so fast."""
_ARROWS = {b"\x1b[A": b"w", b"\x1b[B": b"s", b"\x1b[D": b"a", b"\x1b[C": b"d"}


class Pilot:
    """Reads keys and stick without waiting.

    Args:
        keyboard: open file of a terminal in cbreak mode, or None.
        gamepad: open joystick device, or None.
        gait: bounds of speed and yaw rate.
        command: speed [m/s] and yaw rate [rad/s] to begin with.
    """

    def __init__(self, keyboard: int | None, gamepad: int | None, gait: Gait, command: tuple[float, float]):
        self._keyboard, self._gamepad, self._gait = keyboard, gamepad, gait
        self._forward, self._yaw_rate = command

    def command(self) -> tuple[float, float] | None:
        """Speed [m/s], slower in turns, and yaw rate [rad/s]; None to stop.

        It stops at q, at a button of the gamepad, and where one of both is gone.
        """
        for file, obey in ((self._keyboard, self._type), (self._gamepad, self._push)):
            if file is None or not select.select([file], [], [], 0.0)[0]:
                continue
            try:
                data = os.read(file, 256)
            except OSError:
                return None
            if not data or not obey(data):
                return None
        return min(self._forward, self._fastest_in_this_turn()), self._yaw_rate

    def _fastest_in_this_turn(self) -> float:
        """[m/s]; between the fastest straight on and SLOWER_IN_TURNS of it less in the sharpest turn."""
        sharp = abs(self._yaw_rate) / self._gait.yaw_rate if self._yaw_rate else 0.0
        return round((1.0 - SLOWER_IN_TURNS * sharp) * self._gait.forward[1], 4)

    def _type(self, data: bytes) -> bool:
        """Obey keys; False to stop."""
        for arrow, letter in _ARROWS.items():
            data = data.replace(arrow, letter)
        for key in data.decode("ascii", errors="ignore"):
            speed, turn = {"w": (1, 0), "s": (-1, 0), "a": (0, 1), "d": (0, -1)}.get(key, (0, 0))
            if key == " ":
                self._forward = self._yaw_rate = 0.0
            self._set(
                self._forward + speed * self._gait.forward[1] / _STEPS,
                self._yaw_rate + turn * self._gait.yaw_rate / _STEPS,
            )
        return b"q" not in data.lower()

    def _push(self, data: bytes) -> bool:
        """Obey the stick; False on a button."""
        for _, value, kind, number in _EVENT.iter_unpack(data[: len(data) // _EVENT.size * _EVENT.size]):
            if kind == _BUTTON and value:
                return False
            if kind != _AXIS:
                continue
            share = -value / _FULL if abs(value) > _DEAD * _FULL else 0.0
            if number == _STICK:
                slowest, fastest = self._gait.forward
                self._set(share * (fastest if share > 0.0 else -slowest), self._yaw_rate)
            elif number == _TURN_STICK:
                self._set(self._forward, share * self._gait.yaw_rate)
        return True

    def _set(self, forward: float, yaw_rate: float) -> None:
        (slowest, fastest), turn = self._gait.forward, self._gait.yaw_rate
        self._forward = round(min(fastest, max(slowest, forward)), 4)
        self._yaw_rate = round(min(turn, max(-turn, yaw_rate)), 4)


def walks_alone(gait: Gait) -> float:
    """Speed of a robot that nobody steers [m/s]."""
    return min(ALONE, gait.forward[1])


@contextlib.contextmanager
def pilot(gait: Gait, forward: float | None, yaw_rate: float) -> Iterator[Pilot]:
    """A pilot with what there is, see `Pilot`; the terminal is put back afterwards.

    Without ``forward`` [m/s] it begins at a stand, or as `walks_alone` where there is neither a terminal nor a gamepad.
    """
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
        if forward is None:
            forward = walks_alone(gait) if keyboard is None and gamepad is None else 0.0
        yield Pilot(keyboard, gamepad, gait, (forward, yaw_rate))


def _in_foreground(terminal: int) -> bool:
    """Whether this process may touch a terminal; from the background, touching its own would stop it."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # not its own
        return True


def _put_back(terminal: int, before: list) -> None:
    with contextlib.suppress(termios.error, OSError):  # the terminal may be gone
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
