"""``motorprior logs``: import raw logs, and check logs for faults."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import table
from motorprior.commands.logs_import import LogsImport, require_paths
from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.read_log import read_log
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class LogsCheck:
    """Check logs (log doctor): clock, units, limits, jumps, excitation, tracking, saturation, load, gravity."""

    paths: tyro.conf.Positional[tuple[Path, ...]]
    """Motor logs (.parquet), recordings of a robot (.csv) or raw logs in any format that `logs import` reads."""
    columns: str | None = None
    """Column map of a table: a shipped map by name, or your .toml file (docs/your-motors.md)."""
    robot: str | None = None
    """Robot: a shipped one by name, or your .toml file. Default for logs without joint names: the shipped robot."""


@dataclass(frozen=True)
class LogsImportCommand(LogsImport):
    """Convert recordings of a robot and raw logs to motor logs."""

    paths: tyro.conf.Positional[tuple[Path, ...]]


def run_logs_check(config: LogsCheck) -> None:
    """Print every finding.

    Raises:
        LogError: after all logs are checked, if one has errors.
    """
    require_paths(config.paths)
    robot, unusable = load_robot(config.robot or DEFAULT_ROBOT), []
    given = robot if config.robot or config.columns is None else None
    for path in config.paths:
        log = read_log(path, given, config.columns)
        report = check_log(log, robot if config.robot or log.joint_names == robot.joint_names else None)
        rows = [[found.severity, found.check, str(found.row), found.message, found.remedy] for found in report.findings]
        title = f"{path}: {log.num_rows} rows, {log.num_joints} joints, {log.duration:.1f} s"
        table(title, ["severity", "check", "row", "finding", "remedy"], rows)
        if not report.usable:
            unusable.append(str(path))
    if unusable:
        raise LogError(f"{len(unusable)} of {len(config.paths)} logs are not usable", where=", ".join(unusable))
