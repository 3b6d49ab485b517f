"""How real motors compare, in a minute, from any logs of them: what a demo begins with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.fleet import Fleet, load_fleet
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.doctor.gap_segments import begin_at_gaps
from motorprior.logs.formats.registry import unit_assumption
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.resampling import drop_repeats, resample
from motorprior.pipeline.log_import.log_folder import LogFolder, read_log_folder
from motorprior.pipeline.log_import.raw_logs import with_loads_on_grid
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.quick_report.findings import Findings
from motorprior.pipeline.stage import description, is_finished, read_results, working, write_results
from motorprior.pipeline.validation.log_stretches import Split, long_segments, moving_joints, split, with_joints
from motorprior.report.real_motor_tables import as_tensors
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

TRACES = "traces.safetensors"
PERIOD = 0.002
"""Of the grid that models are fitted on [s]."""
MOTOR_SECONDS, RESPONSE_SECONDS, MOST_SECONDS = 144.0, 72.0, 48.0
"""Log to fit motors or responses to: of all joints together, and of each at most [s]; it takes most of the minute."""
JUDGED_SECONDS = 120.0
"""Log to judge by [s]."""


@dataclass(frozen=True)
class RealMotors:
    """Compare the motors of real logs with a PD, with a prior and with each other."""

    logs: Path
    """A log, or a folder of logs of the same joints, in any format of docs/logs.md."""
    out: Path
    """Folder for figures.json and the traces of the report."""
    columns: str | None = None
    """What columns of tables mean: a shipped map by name, or your .toml file."""
    suspended: bool = False
    """The robot has a free base and was suspended in the air with its body level."""
    fleet: str | None = None
    """Population to compare with; if not given, that of the robot, if it comes with one."""
    seed: int = 0
    """Of the fits and draws."""
    robot: str = DEFAULT_ROBOT
    """Robot that was recorded: a shipped one by name, or a .toml file; logs that name other joints are of none."""


Show: TypeAlias = Callable[[Results, list[str]], None]
"""Takes what was found, and a few sentences about it."""


def run_real_motors(config: RealMotors, progress: Progress = SILENT, show: Show = lambda found, lines: None) -> Results:
    """Compare, or read what this very comparison found.

    Args:
        config: settings.
        progress: where to report to.
        show: called with what was found, also if it is not new.

    Raises:
        LogError, ArtifactError, ConfigError: a log, column map, robot or fleet that cannot be used.
    """
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    robot, folder = load_robot(config.robot), read_logs_of(config)
    maps = [Path(config.columns)] if config.columns and config.columns.endswith(".toml") else []
    wanted = description("real_motors", asdict(config), [*folder.files, *maps, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            found = _findings(config, folder, robot, progress)
            write_results(config.out, found.results)
            arrays, names = as_tensors(found.traces)
            write_tensors(config.out / TRACES, arrays, {"lines": list(found.lines), "traces": names})
    results = read_results(config.out)
    show(results, read_tensors(config.out / TRACES)[1]["lines"])
    return results


def read_logs_of(config: RealMotors) -> LogFolder:
    """The logs; a column map's are of the joints that it names, unless a robot is given.

    Raises:
        LogError, ArtifactError: they cannot be read, are of different joints, or nothing moves in them.
            Or one of a fixed base states another posture.
        ConfigError: suspended, of a robot with a fixed base or of logs of which one states another posture.
    """
    robot = load_robot(config.robot)
    if config.suspended and robot.base == "fixed":
        raise ConfigError(
            f"suspended, but the base of {robot.name!r} is fixed", remedy="leave it out", argument="suspended"
        )
    unnamed = config.columns is not None and config.robot == DEFAULT_ROBOT
    found = read_log_folder(config.logs, None if unnamed else robot, config.columns)
    first = next(iter(found.logs.values())).joint_names
    for name, log in found.logs.items():
        if log.joint_names != first:
            problem = f"log {name} has joints {', '.join(log.joint_names)}; others {', '.join(first)}"
            raise LogError(problem, where=config.logs, remedy="give logs of the same joints")
    _require_held(config, found, robot)
    if not moving_joints(found.logs):
        problem = f"{', '.join(found.logs)}: no joint is excited"
        raise LogError(problem, where=config.logs, remedy="record with a moving command")
    return found


def _require_held(config: RealMotors, found: LogFolder, robot: Robot) -> None:
    """Refuse, before anything is written, logs whose stated posture is not that of a base which is said to be held."""
    if not config.suspended and (robot.base == "free" or not _is_of(found, robot)):
        return
    from motorprior.simulation.suspended_load import require_fixed_base  # here: it imports MuJoCo, which is slow

    for path, log in zip(found.paths, found.logs.values(), strict=True):
        require_fixed_base(log, robot, path, "suspended" if config.suspended else "")


def is_replayed(config: RealMotors, robot: str) -> bool:
    """Whether the logs are of this very robot, so that its simulation can be given their commands.

    Raises:
        LogError, ArtifactError, ConfigError: see `read_logs_of`.
    """
    return _is_of(read_logs_of(config), load_robot(robot)) and robot == config.robot and config.columns is None


def _is_of(folder: LogFolder, robot: Robot) -> bool:
    """Whether all logs are of this robot's joints."""
    return all(log.joint_names == robot.joint_names for log in folder.logs.values())


def _findings(config: RealMotors, folder: LogFolder, robot: Robot, progress: Progress) -> Findings:
    known_robot, logs = _is_of(folder, robot), folder.logs
    fleet = fleet_of(config, robot, known_robot)
    whole, lines = _without_gaps(config, folder)
    found = Findings(lines)
    loads, why = _loads(config, logs, robot if known_robot else None)
    if loads is None and known_robot and fleet is not None and fleet.robot == robot.name:
        from motorprior.pipeline.quick_report.by_replay import report_by_replay

        found += report_by_replay(
            logs, robot, fleet, "suspended" if config.suspended else "auto", config.seed, progress
        )
    parts = _moving(split(whole, _seconds(whole, loads is None), JUDGED_SECONDS).map(loads or _on_grid))
    found += Findings((why, parts.told))
    if loads is None:
        from motorprior.pipeline.quick_report.without_loads import report_without_loads

        return found + report_without_loads(parts, config.seed, config.out, progress)
    from motorprior.pipeline.quick_report.with_loads import report_with_loads

    described = robot if known_robot else None
    return found + report_with_loads(parts, described, fleet, config.seed, config.out / "prior", progress)


def _without_gaps(config: RealMotors, folder: LogFolder) -> tuple[dict[str, MotorLog], tuple[str, ...]]:
    """The logs, segments begun after their gaps, and what was left out, taken for granted, and found of gaps.

    Raises:
        LogError: every log has gaps all over.
    """
    logs, lines = {}, [f"left out {line}" for line in folder.left_out]
    for path, (name, log) in zip(folder.paths, folder.logs.items(), strict=True):
        try:
            logs[name], told = begin_at_gaps(log)
        except LogError as error:
            if len(folder.logs) == 1:
                raise
            told = f"left out {error}"
        lines += [f"{name}: {line}" for line in (unit_assumption(path, config.columns), told) if line]
    if not logs:
        raise LogError("every log has gaps all over", where=config.logs, remedy="give logs of a steady clock")
    return logs, tuple(lines)


def fleet_of(config: RealMotors, robot: Robot, known_robot: bool) -> Fleet | None:
    """The one asked for, or that of the very robot; an arm has nothing to do with the motors of another robot."""
    if config.fleet is not None:
        return load_fleet(config.fleet)
    return load_fleet(robot.default_fleet) if known_robot and robot.fleets else None


def _seconds(logs: dict[str, MotorLog], responses: bool) -> float:
    """Of log to fit to [s]."""
    together = RESPONSE_SECONDS if responses else MOTOR_SECONDS
    return min(MOST_SECONDS, together / max(1, len(moving_joints(logs))))


def _moving(parts: Split) -> Split:
    """Only joints that moved in what is known."""
    joints = moving_joints(parts.known)
    return parts.map(lambda log: with_joints(log, joints))


def _loads(
    config: RealMotors, logs: dict[str, MotorLog], robot: Robot | None
) -> tuple[Callable[[MotorLog], MotorLog] | None, str]:
    """What puts loads into a log and the log on the grid, or None; and a line about it."""
    if all(log.load_inertia is not None and log.external_torque is not None for log in logs.values()):
        return lambda log: resample(log, PERIOD), "loads: the logs state them"
    if robot is None:
        return None, (
            "loads: unknown, since no description of these joints was given (robot): no PD or prior can be simulated, "
            "only responses that need no load"
        )
    stated = {None if code is None else POSTURES[code] for log in logs.values() for code in _codes(log)}
    if robot.base == "fixed" or config.suspended or stated == {"suspended"}:
        return lambda log: with_loads_on_grid(log, robot, PERIOD), f"loads: rigid body of {robot.name}, its base held"
    others = " and ".join(sorted(name for name in stated if name not in (None, "suspended")))
    why = f"was {others}, as logs state" if others else "may have stood on its feet (set suspended if it was suspended)"
    return None, f"loads: unknown, since {robot.name} {why}: no motor can be fitted, only responses that need no load"


def _codes(log: MotorLog) -> list[int | None]:
    """Of the postures that a log states; None where it states none."""
    return [None] if log.posture is None else np.unique(log.posture).tolist()


def _on_grid(log: MotorLog) -> MotorLog:
    kept = long_segments(drop_repeats(_where_it_moves(log)))
    return resample(log if kept is None else kept, PERIOD)


def _where_it_moves(log: MotorLog) -> MotorLog:
    """Segments in which some measured angle changes: of the others nothing is left without repeats."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        keep[part] = np.ptp(log.joint_pos[part], axis=0).any()
    return log.rows(keep) if keep.any() else log
