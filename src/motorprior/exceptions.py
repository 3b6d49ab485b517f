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
