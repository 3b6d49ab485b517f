"""Errors that a user can correct: the command line prints one line and exits with code 2."""

import re
from collections.abc import Sequence
from pathlib import Path
from reprlib import Repr
from typing import Any

_MAX_PART = 400  # letters of the problem, the place or the remedy
_REPR = Repr()  # a few entries of a container
_REPR.maxstring = 40
_REPR.maxother = 40
_REPR.maxlong = 40


def cut(text: str, max_letters: int) -> str:
    """The beginning of a text, as one printable line of at most ``max_letters``."""
    letters = [
        letter if letter.isprintable() else ascii(letter)[1:-1] for letter in " ".join(text.split())
    ]
    line = "".join(letters)
    return line if len(line) <= max_letters else line[: max_letters - 1] + "…"


def quoted(value: Any, max_letters: int = 40) -> str:
    """A value from a file, for a message: its ``repr``, cut; containers to a few entries."""
    text = f"{value:.10g}" if isinstance(value, float) else _REPR.repr(value)
    return cut(text, max_letters)


def listed(texts: Sequence[str], max_texts: int) -> str:
    """The first texts, separated by commas, and the number of the others."""
    more = f" and {len(texts) - max_texts} more" if len(texts) > max_texts else ""
    return ", ".join(texts[:max_texts]) + more


class MotorPriorError(Exception):
    """Bad input or an impossible request: problem, place and remedy.

    Args:
        problem: what is wrong, with the value and the bound that it violates.
        where: file (and row, key or joint).
        remedy: what the user can do.
        argument: dotted name of the invalid argument, as in ``problem``.
    """

    def __init__(
        self,
        problem: str,
        *,
        where: str | Path | None = None,
        remedy: str | None = None,
        argument: str | None = None,
    ):
        super().__init__(problem)
        self.problem = cut(problem, _MAX_PART)
        self.where = where
        self.argument = argument
        self.remedy = None if remedy is None else cut(remedy, _MAX_PART)

    def __str__(self) -> str:
        text = f"{self.problem} -> {self.remedy}" if self.remedy else self.problem
        if self.where is None:
            return text
        place = cut(str(self.where)[-_MAX_PART:], _MAX_PART)
        return f"{place}: {text}"

    def on_command_line(self) -> str:
        """The message with the argument as an option.

        ``task.max_speed`` becomes ``--task.max-speed``.
        """
        if self.argument is None:
            return str(self)
        place, problem, remedy = str(self).partition(self.problem)
        name = rf"(?<![\w.]){re.escape(self.argument)}(?!\w)"
        option = "--" + self.argument.replace("_", "-")
        return place + re.sub(name, option, problem + remedy, count=1)


class LogError(MotorPriorError):
    """A motor log that cannot be used."""


class ArtifactError(MotorPriorError):
    """A prior, policy, fleet or run folder that cannot be read or written."""


class ConfigError(MotorPriorError):
    """Invalid settings."""


class SimulationFault(MotorPriorError):
    """The physics engine reported NaN, a reset or a full buffer."""


class ProtocolError(MotorPriorError):
    """A message that the firmware would reject, or bytes that are not a message."""


class RobotFault(MotorPriorError):
    """A fault of the robot or of its telemetry; motion ends.

    Args:
        name: short name of the fault, as in the table of docs/hardware.md.
        problem: see `MotorPriorError`.
        safe_state: "idle" if motors must lose their current at once, "crouch" if there is time to
            sit down.
        more: ``remedy`` and ``argument`` of `MotorPriorError`.
    """

    def __init__(self, name: str, problem: str, *, safe_state: str = "idle", **more: str | None):
        super().__init__(problem, where=f"robot fault {name!r}", **more)
        self.args = (name, problem)  # pickle rebuilds the exception from these
        self.name = name
        self.safe_state = safe_state
