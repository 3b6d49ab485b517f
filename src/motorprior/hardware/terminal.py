"""Dialogue at a terminal: confirmation before arming, and messages that never make a moving robot wait."""

from __future__ import annotations

import contextlib
import select
import sys
import termios
from collections.abc import Callable
from typing import TextIO

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.pilot import KEYS

Say = Callable[[str], None]
WALKING = f"Keys while it moves: {KEYS}; Ctrl-C sits down, twice drops it."
STANDING = "Ctrl-C sits down, twice drops it; no key does anything."
HUNG = (
    "Legs kick, unless the excitation is a gentle one. Ctrl-C takes the current away at once and the legs drop; "
    "no key does anything."
)


def require_terminal(yes: bool) -> None:
    """Refuse to wait for a confirmation that no terminal can give.

    Raises:
        ConfigError: no terminal, and no ``yes``.
    """
    if not yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise ConfigError("no terminal to confirm at", remedy="give yes to arm without confirmation", argument="yes")


def ask_to_arm(stop: Callable[[], bool], yes: bool, how_to_stop: str, say: Say) -> None:
    """Wait until ``arm`` is typed. What was typed before the question does not count.

    Raises:
        RobotFault: something else was typed, or a signal came.
    """
    if yes:
        return
    with contextlib.suppress(termios.error):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    say(f"Stand clear, one hand at the power switch. {how_to_stop}")
    say("Type arm and press Enter:")
    while not stop():
        if select.select([sys.stdin], [], [], 0.1)[0]:
            if sys.stdin.readline().strip() == "arm":
                return
            break
    raise RobotFault("not armed", "arm was not typed; nothing was sent", remedy="run the command again when ready")


def careful(say: Say, file: TextIO) -> Say:
    """``say``, but silent while the terminal or pipe behind ``file`` is gone or full: no reason to stop, or to wait.

    A control loop that waits for a terminal (Ctrl-S, a pager) would be idled by the watchdog.
    """

    def print_line(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            if _takes_more(file):
                say(text)

    return print_line


def _takes_more(file: TextIO) -> bool:
    try:
        number = file.fileno()
    except (OSError, ValueError):  # a notebook's, or a test's: no terminal, never full
        return True
    return bool(select.select([], [number], [], 0.0)[1])
