"""``motorprior logs``: bring raw logs in, and look for what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import table
from motorprior.exceptions import LogError
from motorprior.logs.checks import check_log
from motorprior.pipeline.raw_logs import LogsImport, read_any, require_paths
from motorprior.robots.pupper_v2 import spec


@dataclass(frozen=True)
class LogsCheck:
    """Log doctor: repeats, gaps, clock, units, range, tracking."""

    paths: tyro.conf.Positional[tuple[Path, ...]]
    """Motor logs (.parquet), recordings of a robot (.csv) or raw Pupper v2 logs (.csv, .csv.gz, .txt)."""


@dataclass(frozen=True)
class LogsImportCommand(LogsImport):
    """Convert recordings of a robot and raw Pupper v2 logs to motor logs."""

    paths: tyro.conf.Positional[tuple[Path, ...]]


def run_logs_check(config: LogsCheck) -> None:
    """Print every finding.

    Raises:
        LogError: after all logs are checked, if one of them is not usable.
    """
    require_paths(config.paths)
    unusable = []
    for path in config.paths:
        log = read_any(path)
        report = check_log(log, spec.JOINT_LIMITS if log.joint_names == spec.JOINT_NAMES else None)
        rows = [[found.severity, found.check, found.message, found.remedy] for found in report.findings]
        title = f"{path}: {log.num_rows} rows, {log.num_joints} joints, {log.duration:.1f} s"
        table(title, ["severity", "check", "finding", "remedy"], rows)
        if not report.usable:
            unusable.append(str(path))
    if unusable:
        raise LogError(f"{len(unusable)} of {len(config.paths)} logs are not usable", where=", ".join(unusable))
