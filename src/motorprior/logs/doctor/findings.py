"""Findings of the log doctor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

IN_MAP = "in a column map (docs/your-motors.md)"


@dataclass(frozen=True)
class Finding:
    """One finding about a log.

    Attributes:
        severity: ``error``: do not use the log as it is; ``warning``: inspect it; ``info``: a fact.
        check: name of the check.
        value: what was measured, in the unit that the message names.
        message: the finding with value and bound.
        remedy: what to do, or empty.
        joint: name of the joint, or None for the whole log.
        row: first row concerned, counted from 0.
    """

    severity: Literal["error", "warning", "info"]
    check: str
    value: float
    message: str
    remedy: str = ""
    joint: str | None = None
    row: int = 0


@dataclass(frozen=True)
class LogReport:
    """All findings about one log, errors first."""

    findings: tuple[Finding, ...]

    def of(self, check: str) -> tuple[Finding, ...]:
        """Findings of one check."""
        return tuple(finding for finding in self.findings if finding.check == check)

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that forbid using the log as it is."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def usable(self) -> bool:
        """Whether the log has no errors."""
        return not self.errors
