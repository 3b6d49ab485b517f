"""Errors a user can act on. The command line prints them in one line and exits with code 2."""

from __future__ import annotations

from pathlib import Path


class MotorPriorError(Exception):
    """Bad input or an impossible request: says what, where, and what to do about it.

    Args:
        problem: what is wrong, with the offending value and the bound it broke.
        where: file (and row, key or joint) it was found in.
        remedy: what the user can do.
    """

    def __init__(self, problem: str, *, where: str | Path | None = None, remedy: str | None = None):
        self.problem, self.where, self.remedy = problem, where, remedy
        text = f"{where}: {problem}" if where is not None else problem
        super().__init__(f"{text} -> {remedy}" if remedy else text)


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
    """

    def __init__(self, kind: str, problem: str, *, safe_state: str = "idle", remedy: str | None = None):
        self.kind, self.safe_state = kind, safe_state
        super().__init__(problem, where=f"robot fault {kind!r}", remedy=remedy)
