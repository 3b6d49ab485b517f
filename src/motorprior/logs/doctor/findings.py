"""Findings of the log doctor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

IN_MAP = "in a column map (docs/your-motors.md)"


@dataclass(frozen=True)
class Finding:
    """One finding about a log."""

    severity: Literal["error", "warning", "info"]  # do not use the log as it is; inspect it; a fact
    check: str  # its name
    value: float  # what was measured, in the unit that the message names
    message: str  # with value and bound
    remedy: str = ""
    joint: str | None = None  # None for the whole log
    row: int = 0  # the first concerned


def grouped(findings: Sequence[Finding]) -> list[Finding]:
    """One finding for each kind: that of the largest value, with the other joints of the same kind in its message."""
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for each in findings:
        named = re.sub(rf"(?<!\w){re.escape(each.joint or chr(0))}(?!\w)", "J", each.message, count=1)
        words = re.sub(r"[-+]?[\d.]+(e[-+]\d+)?", "#", named)
        kinds.setdefault((each.severity, each.check, words if each.joint else each.message), []).append(each)
    found = []
    for same in kinds.values():
        worst = max(same, key=lambda each: abs(each.value))
        others = [f"{each.joint} {each.value:.3g}" for each in same if each is not worst]
        found.append(replace(worst, message=f"{worst.message}; likewise {', '.join(others)}") if others else worst)
    return found


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
