"""Findings of the log doctor."""

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
    message: str  # states value and bound
    remedy: str = ""
    joint: str | None = None  # None for the whole log
    row: int = 0  # the first concerned

    def __str__(self) -> str:
        return f"{self.message} -> {self.remedy}" if self.remedy else self.message


def grouped(findings: Sequence[Finding]) -> list[Finding]:
    """One finding for each kind and remedy: that of the largest value, with the other joints in its message."""
    kinds: dict[tuple[str, ...], list[Finding]] = {}
    for each in findings:
        kind = each.message.partition(each.joint)[0] + each.remedy if each.joint else each.message
        kinds.setdefault((each.severity, each.check, kind), []).append(each)
    found = []
    for same in kinds.values():
        worst = max(same, key=lambda each: abs(each.value))
        others = [f"{each.joint} {each.value:.3g}" for each in same if each is not worst]
        found.append(
            replace(worst, message=f"{worst.message}; likewise {', '.join(others)}")
            if others
            else worst
        )
    return found


@dataclass(frozen=True, repr=False)
class LogReport:
    """All findings about one log, errors first."""

    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return f"{len(self.errors)} errors in {len(self.findings)} findings"

    def __str__(self) -> str:
        lines = [
            f"{each.severity}: {each.check}, row {each.row}: {each}"
            for each in grouped(self.findings)
        ]
        return "\n".join([repr(self), *lines])

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that forbid using the log as it is."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def usable(self) -> bool:
        """Whether the log has no errors."""
        return not self.errors
