"""What the log doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

IN_MAP = "in a column map (docs/your-motors.md)"
"""Where a table's remedy is stated. Some formats take no map, so such a remedy names another way, too."""

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One observation about a log.

    Attributes:
        severity: ``error``: do not use the log as it is; ``warning``: look at it; ``info``: good to know.
        check: name of the check.
        value: what was measured; its unit stands in the message.
        bound: what it was compared with, or None.
        message: value, unit and bound in words.
        remedy: what to do, empty where nothing needs doing.
        joint: name of the joint, or None for the whole log.
        row: first row concerned (from 0), or None.
    """

    severity: Severity
    check: str
    value: float
    bound: float | None
    message: str
    remedy: str = ""
    joint: str | None = None
    row: int | None = None


@dataclass(frozen=True)
class LogReport:
    """Every finding about one log, errors first.

    Attributes:
        source: the log's source.
        num_rows: rows.
        num_joints: joints.
        duration: recorded time [s].
        findings: errors, warnings, infos.
    """

    source: str
    num_rows: int
    num_joints: int
    duration: float
    findings: tuple[Finding, ...]

    def of(self, check: str) -> tuple[Finding, ...]:
        """The findings of one check."""
        return tuple(finding for finding in self.findings if finding.check == check)

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that forbid using the log as it is."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def usable(self) -> bool:
        """No errors."""
        return not self.errors
