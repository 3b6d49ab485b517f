"""Findings of the log doctor."""

from motorprior.logs.doctor.findings import Finding, LogReport


def of_check(report: LogReport, check: str) -> list[Finding]:
    """Findings of one check."""
    return [finding for finding in report.findings if finding.check == check]
