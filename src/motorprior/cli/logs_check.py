"""The command logs check: the findings of each log are printed."""

from dataclasses import dataclass
from pathlib import Path

from motorprior.cli.terminal import print_table
from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.read_log import read_log
from motorprior.progress import Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class LogsCheck:
    """Check logs: clock, units, limits, jumps, excitation, tracking, saturation, gravity."""

    paths: tuple[Path, ...]
    """Motor logs (.parquet), recordings of a robot (.csv) or raw logs in any format that `logs
    import` reads."""
    columns: str | None = None
    """Column map of a table: a shipped map by name, or your .toml file (docs/your-motors.md)."""
    robot: str | None = None
    """Robot: a shipped one by name, or your .toml file. Default for logs without joint names: the
    shipped robot."""


def run(config: LogsCheck, progress: Progress) -> None:
    """Print every finding; raises LogError after all logs are checked, if one has errors."""
    robot = load_robot(config.robot or DEFAULT_ROBOT)
    robot_of_reader = robot if config.robot or config.columns is None else None

    unusable = []
    for path in config.paths:
        log = read_log(path, robot_of_reader, config.columns)
        is_of_robot = config.robot is not None or log.joint_names == robot.joint_names
        report = check_log(log, robot if is_of_robot else None)

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
