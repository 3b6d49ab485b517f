"""Errors a user can act on. The command line prints them in one line and exits with code 2."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LONGEST_WHERE, LONGEST_PROBLEM, LONGEST_REMEDY = 280, 400, 300
"""Bytes of the parts of a message; with what stands between them less than 1 kB."""


def cut(text: str, most: int) -> str:
    """One line of at most ``most`` bytes, for people: of a longer one the beginning."""
    data = _printable(" ".join(text[: 2 * most].split()))
    return data.decode() if len(data) <= most else data[: most - 3].decode(errors="ignore") + "…"


def _printable(text: str) -> bytes:
    """Control characters, and bytes of a file's name that are no text, are spelled out."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text).encode()


def shown(value: Any, most: int = 40) -> str:
    """A value from outside in a message: a text or a number as Python writes it, of all else its type alone.

    A small file can describe containers, and numbers, that would take hours to write out.
    """
    if isinstance(value, int) and value.bit_length() > 8 * most:
        return f"a whole number of {value.bit_length()} bits"
    known = value is None or isinstance(value, str | bytes | int | float)
    return cut(repr(value[:most] if isinstance(value, str | bytes) else value), most) if known else type(value).__name__


def spelled(value: Any, most: int = 40) -> str:
    """A value of a small file in a message: as Python writes it, containers and all, or what `shown` says of it."""
    try:
        return cut(repr(value), most)
    except (ValueError, RecursionError):  # a whole number of thousands of digits
        return shown(value, most)


def listed(parts: Sequence[str], most: int) -> str:
    """The first ``most`` of them, between commas, and how many more there are."""
    more = f" and {len(parts) - most} more" if len(parts) > most else ""
    return ", ".join(parts[:most]) + more


class MotorPriorError(Exception):
    """Bad input or an impossible request: says what, where, and what to do about it.

    Args:
        problem: what is wrong, with the offending value and the bound it broke.
        where: file (and row, key or joint) it was found in.
        remedy: what the user can do.
        argument: dotted name of the argument that is to blame, as the message writes it.
    """

    def __init__(
        self,
        problem: str,
        *,
        where: str | Path | None = None,
        remedy: str | None = None,
        argument: str | None = None,
    ):
        self.problem, self.where, self.argument = cut(problem, LONGEST_PROBLEM), where, argument
        self.remedy = None if remedy is None else cut(remedy, LONGEST_REMEDY)
        super().__init__(self._text())

    def __reduce__(self) -> tuple[Any, ...]:
        """Between processes it is sent whole, whatever its class asks for."""
        return _sent, (type(self), self.args, vars(self))

    def _text(self, option: bool = False) -> str:
        text = f"{self.problem} -> {self.remedy}" if self.remedy else self.problem
        if option and self.argument is not None:
            written = "--" + self.argument.replace("_", "-")
            text = re.sub(rf"(?<![\w.]){re.escape(self.argument)}(?!\w)", written, text, count=1)
        if self.where is None:
            return text
        where = _printable(str(self.where)[-LONGEST_WHERE:])
        return f"{where[-LONGEST_WHERE:].decode(errors='ignore')}: {text}"

    def on_command_line(self) -> str:
        """The message for who typed a command: the argument ``task.max_speed`` is the option ``--task.max-speed``."""
        return self._text(option=True)


def _sent(kind: type[MotorPriorError], args: tuple[Any, ...], attributes: dict[str, Any]) -> MotorPriorError:
    """The error that another process sent."""
    error = kind.__new__(kind)
    error.args = args
    vars(error).update(attributes)
    return error


class LogError(MotorPriorError):
    """A motor log that cannot be trusted."""


class ArtifactError(MotorPriorError):
    """A prior, policy, fleet or run folder that cannot be read or written."""


class ConfigError(MotorPriorError):
    """Settings that do not fit together."""


class SimulationFault(MotorPriorError):
    """The physics engine reported NaN, a reset or a full buffer."""


class ProtocolError(MotorPriorError):
    """A message that the firmware would refuse, or bytes that are no message."""


class RobotFault(MotorPriorError):
    """The robot, or what the host can see of it, is not as it must be: motion ends.

    Args:
        kind: short name of the fault, as in the table of docs/hardware.md.
        problem: see `MotorPriorError`.
        safe_state: "idle" where motors must lose their current at once, "crouch" where there is time to sit down.
        remedy: see `MotorPriorError`.
        argument: see `MotorPriorError`.
    """

    def __init__(
        self,
        kind: str,
        problem: str,
        *,
        safe_state: str = "idle",
        remedy: str | None = None,
        argument: str | None = None,
    ):
        self.kind, self.safe_state = kind, safe_state
        super().__init__(problem, where=f"robot fault {kind!r}", remedy=remedy, argument=argument)
