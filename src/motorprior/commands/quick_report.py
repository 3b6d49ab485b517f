"""Quick report of real logs: models of their motors, fitted in a minute and evaluated on held-out logs."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.evaluation.splits import excited_in_any, long_segments, split
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.doctor.signs import gravity_signs
from motorprior.logs.loads import load_source, require_posture, with_loads
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import drop_repeats, resample, smooth_on_grid
from motorprior.logs.prepare_log import PERIOD, cleaned
from motorprior.logs.read_log import LogFolder, read_log_folder, reader_of
from motorprior.progress import SILENT, Progress
from motorprior.results import Results, read_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working

# training log of all joints for motors, for responses, and maximum per joint [s]; the fit takes
# most of the minute
MOTOR_SECONDS = 144.0
RESPONSE_SECONDS = 72.0
MAX_SECONDS = 48.0
TEST_SECONDS = 120.0


@dataclass(frozen=True)
class QuickReport:
    """Fit models to the motors of real logs, and evaluate them on held-out logs."""

    logs: Path  # a log, or a folder of logs of the same joints, in any format of docs/logs.md
    out: Path  # folder for figures.json and traces.png
    columns: str | None = None  # column map of tables: a shipped one by name, or a .toml file
    # the robot has a free base and was suspended in the air with its body level
    suspended: bool = False
    seed: int = 0  # random seed of fits and samples
    # name or .toml file of the robot of the logs; not used for logs with other joints
    robot: str = DEFAULT_ROBOT


def run_quick_report(config: QuickReport, progress: Progress = SILENT) -> Results:
    """Fit and evaluate, or read the results of the finished stage; errors for an input that cannot be used."""
    robot = load_robot(config.robot)
    folder = read_logs_of(config)
    maps = [Path(config.columns)] if config.columns and config.columns.endswith(".toml") else []
    wanted = description("real_motors", asdict(config), [*folder.files, *maps, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            _write_report(config, folder, robot, progress)
    return read_results(config.out)


def read_logs_of(config: QuickReport) -> LogFolder:
    """The logs; those with a column map have the joints of the map unless a robot is given."""
    robot = load_robot(config.robot)
    if config.suspended and robot.base == "fixed":
        raise ConfigError(
            f"the base of {robot.name!r} is fixed", remedy="omit suspended", argument="suspended"
        )
    unnamed = config.columns is not None and config.robot == DEFAULT_ROBOT
    found = read_log_folder(config.logs, None if unnamed else robot, config.columns)
    first = next(iter(found.logs.values())).joint_names
    for path, (name, log) in zip(found.paths, found.logs.items(), strict=True):
        if log.joint_names != first:
            problem = (
                f"log {name} has joints {', '.join(log.joint_names)}; others {', '.join(first)}"
            )
            raise LogError(problem, where=config.logs, remedy="give logs of the same joints")
        if config.suspended or (robot.base == "fixed" and first == robot.joint_names):
            require_posture(log, robot, path)
    if not excited_in_any(found.logs):
        problem = f"{', '.join(found.logs)}: no joint is excited"
        raise LogError(problem, where=config.logs, remedy="record with a moving command")
    return found


def _write_report(config: QuickReport, folder: LogFolder, robot: Robot, progress: Progress) -> None:
    from motorprior.priors.quick_report import report_with_loads, report_without_loads
    from motorprior.report.sections import write_validation  # here: it imports matplotlib

    first = next(iter(folder.logs.values()))
    described = robot if first.joint_names == robot.joint_names else None
    whole, lines = _cleaned(config, folder)
    prepare, loads = loads_of(config, folder.logs, described)
    if described is not None:
        lines += [
            f"{name}: {each}"
            for name, log in whole.items()
            for each in gravity_signs(log, described)
        ]
    together = RESPONSE_SECONDS if prepare is None else MOTOR_SECONDS
    seconds = min(MAX_SECONDS, together / max(1, len(excited_in_any(whole))))
    logs = split(whole, seconds, TEST_SECONDS).map(prepare or _on_grid)
    joints = excited_in_any(logs.train)
    logs = logs.map(lambda log: log.with_joints(joints))
    if prepare is None:
        found = report_without_loads(logs, config.seed, progress)
    else:
        found = report_with_loads(logs, described, config.seed, config.out / "prior", progress)
    write_validation(config.out, found, [*lines, loads, logs.rule])


def _cleaned(config: QuickReport, folder: LogFolder) -> tuple[dict[str, MotorLog], list[str]]:
    """The logs with a new segment after each gap, and lines about what was omitted or assumed."""
    logs = {}
    lines = [f"left out {line}" for line in folder.unreadable]
    unsteady = None
    for path, (name, log) in zip(folder.paths, folder.logs.items(), strict=True):
        try:
            logs[name], notes = cleaned(log, name)
            texts = [note.text for note in notes]
        except LogError as error:
            unsteady = error
            texts = [f"{name}: left out {error}"]
        assumed = "" if config.columns else reader_of(path).assumption
        lines += [f"{name}: {assumed}"] * bool(assumed) + texts
    if unsteady and not logs:
        raise unsteady
    return logs, lines


def loads_of(
    config: QuickReport, logs: dict[str, MotorLog], robot: Robot | None
) -> tuple[Callable[[MotorLog], MotorLog] | None, str]:
    """A function that adds loads to a log and resamples it, or None if loads are unknown; and the reason."""
    sources = [load_source(log, robot, config.suspended, config.logs) for log in logs.values()]
    names = {source.name for source in sources}
    if names == {"log"}:
        return lambda log: resample(log, PERIOD), "loads: from the logs"
    if names == {"model"} and robot is not None:
        return lambda log: with_loads(smooth_on_grid(log, PERIOD), robot), str(sources[0])
    unknown = next((source for source in sources if source.name == "unknown"), sources[0])
    return None, f"{unknown}; only responses are fitted, not motors"


def _on_grid(log: MotorLog) -> MotorLog:
    """Without segments in which nothing moves, repeated rows and short segments."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        keep[part] = np.ptp(log.joint_pos[part], axis=0).any()
    kept = long_segments(drop_repeats(log.rows(keep) if keep.any() else log))
    return resample(log if kept is None else kept, PERIOD)
