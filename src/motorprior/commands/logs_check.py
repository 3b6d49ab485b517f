"""Check logs."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import LogReport
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import read_log
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


def check_logs(config: LogsCheck) -> Iterator[tuple[Path, MotorLog, LogReport]]:
    """Path, log and findings of one log after the other; errors as `read_log`."""
    robot = load_robot(config.robot or DEFAULT_ROBOT)
    robot_of_reader = robot if config.robot or config.columns is None else None
    for path in config.paths:
        log = read_log(path, robot_of_reader, config.columns)
        is_of_robot = config.robot is not None or log.joint_names == robot.joint_names
        yield path, log, check_log(log, robot if is_of_robot else None)
