"""The command logs check: the findings of each log are printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.logs_check import LogsCheck, check_logs
from motorprior.exceptions import LogError
from motorprior.logs.doctor.findings import grouped
from motorprior.progress import Progress


def run(config: LogsCheck, progress: Progress) -> None:
    """Print every finding; raises LogError after all logs are checked, if one has errors."""
    unusable = []
    for path, log, report in check_logs(config):
        rows = [
            [finding.severity, finding.check, str(finding.row), finding.message, finding.remedy]
            for finding in grouped(report.findings)
        ]
        title = f"{path}: {log.num_rows} rows, {log.num_joints} joints, {log.duration:.1f} s"
        print_table(title, ["severity", "check", "row", "finding", "remedy"], rows)
        if not report.usable:
            unusable.append(str(path))

    if unusable:
        raise LogError(
            f"{len(unusable)} of {len(config.paths)} logs are not usable", where=", ".join(unusable)
        )
