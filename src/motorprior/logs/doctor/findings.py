"""Findings of the log doctor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from motorprior.texts import ShownInNotebooks

IN_MAP = "in a column map (docs/your-motors.md)"


@dataclass(frozen=True)
class Finding:
    """One finding about a log."""

    # error: the log must not be used as it is; warning: inspect the log; info: a fact
    severity: Literal["error", "warning", "info"]
    check: str  # name of the check
    value: float  # measured value, in the unit that the message names
    message: str  # what was found, with value and bound
    remedy: str = ""
    joint: str | None = None  # None if the finding is about the whole log
    row: int = 0  # the first row with the finding
    is_sign_error: bool = False  # the angle clearly moves against its command

    def __str__(self) -> str:
        return f"{self.message} -> {self.remedy}" if self.remedy else self.message


def grouped(findings: Sequence[Finding]) -> list[Finding]:
    """One finding per problem and remedy: the finding with the largest value.

    Its message also names the other joints with this problem, and their values.
    """
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for finding in findings:
        key = (finding.severity, finding.check, _problem_without_joint(finding))
        groups.setdefault(key, []).append(finding)
    return [_largest_with_other_joints(group) for group in groups.values()]


def _problem_without_joint(finding: Finding) -> str:
    """Beginning of the message before the joint's name, and the remedy."""
    if finding.joint is None:
        return finding.message
    return finding.message.partition(finding.joint)[0] + finding.remedy


def _largest_with_other_joints(group: list[Finding]) -> Finding:
    largest = max(group, key=lambda finding: abs(finding.value))
    joints = [f"{finding.joint} {finding.value:.3g}" for finding in group if finding is not largest]
    if not joints:
        return largest
    return replace(largest, message=f"{largest.message}; also {', '.join(joints)}")


@dataclass(frozen=True, repr=False)
class LogReport(ShownInNotebooks):
    """All findings about one log, errors first."""

    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return f"{len(self.errors)} errors in {len(self.findings)} findings"

    def __str__(self) -> str:
        lines = [
            f"{finding.severity}: {finding.check}, row {finding.row}: {finding}"
            for finding in grouped(self.findings)
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
