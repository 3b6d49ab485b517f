"""Quick report of real logs: models fitted in a minute and evaluated on held-out rows."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from motorprior.evaluation.splits import evenly_spread
from motorprior.exceptions import LogError
from motorprior.logs.loads import LoadSource, load_source
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.prepare_log import LOADS_TOPIC, PERIOD, LogSettings, prepare_log
from motorprior.logs.read_log import LogFolder, read_log_folder, read_recording
from motorprior.priors.quick_report import report_on_motors, report_on_responses
from motorprior.progress import SILENT, Note, Progress
from motorprior.results import Results, read_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working


@dataclass(frozen=True)
class QuickReport:
    """Fit models to the motors of real logs, and evaluate them on held-out rows."""

    logs: Path  # a log, or a folder of logs of the same joints, in any format of docs/logs.md
    out: Path  # folder for figures.json and traces.png
    columns: str | None = None  # column map of tables: a shipped one by name, or a .toml file
    # the robot was suspended in the air with its body level; a fixed base needs no such statement
    suspended: bool = False
    seed: int = 0  # random seed of fits and samples
    # name or .toml file of the robot of the logs; not used for logs with other joints
    robot: str = DEFAULT_ROBOT


def run_quick_report(config: QuickReport, progress: Progress = SILENT) -> Results:
    """Fit and evaluate, or read the results of the finished stage.

    Raises errors for an input that cannot be used.
    """
    robot = load_robot(config.robot)
    folder = read_logs_of(config)
    maps = [Path(config.columns)] if config.columns and config.columns.endswith(".toml") else []
    stage = description("real_motors", asdict(config), [*folder.files, *maps, *robot.files])
    if not is_finished(config.out, stage):
        with working(config.out, stage):
            _write_report(config, folder, robot, progress)
    return read_results(config.out)


def read_logs_of(config: QuickReport) -> LogFolder:
    """The logs; those with a column map have the joints of the map unless a robot is given."""
    folder = read_log_folder(config.logs, _robot_of_reader(config), config.columns)
    first_joints = next(iter(folder.logs.values())).joint_names
    for name, log in folder.logs.items():
        if log.joint_names != first_joints:
            joints = ", ".join(log.joint_names)
            problem = f"log {name} has joints {joints}; others {', '.join(first_joints)}"
            raise LogError(problem, where=config.logs, remedy="give logs of the same joints")
    return folder


def logs_are_of(robot: Robot, config: QuickReport) -> bool:
    """Whether the logs are of the robot's joints; raises errors as `read_logs_of`."""
    return _robot_of(read_logs_of(config), robot) is not None


def _robot_of_reader(config: QuickReport) -> Robot | None:
    """The robot that gives the joints of a log; None if the column map gives them."""
    if config.columns is not None and config.robot == DEFAULT_ROBOT:
        return None
    return load_robot(config.robot)


def loads_of(config: QuickReport, folder: LogFolder) -> LoadSource:
    """Where the loads of all logs come from; unknown if they are unknown for one log."""
    robot = _robot_of(folder, load_robot(config.robot))
    logs = zip(folder.paths, folder.logs.values(), strict=True)
    sources = [load_source(log, robot, config.suspended, path) for path, log in logs]
    for source in sources:
        if source.name == "unknown":
            return source
    if len({source.name for source in sources}) > 1:
        return LoadSource("unknown", "unknown, only some of the logs contain them")
    return sources[0]


def _robot_of(folder: LogFolder, robot: Robot) -> Robot | None:
    """The robot if the logs are of its joints, else None."""
    first = next(iter(folder.logs.values()))
    return robot if first.joint_names == robot.joint_names else None


def _write_report(config: QuickReport, folder: LogFolder, robot: Robot, progress: Progress) -> None:
    from motorprior.report.sections import write_validation  # here: it imports matplotlib

    recorded_robot = _robot_of(folder, robot)
    source = loads_of(config, folder)
    logs, lines = _prepared(config, folder, recorded_robot, source)
    if source.name == "unknown":
        lines.append(f"{source}; only responses are fitted, not motors")
        validation, rule = report_on_responses(logs, config.seed, progress)
    else:
        lines.append(str(source))
        out = config.out / "prior"
        validation, rule = report_on_motors(logs, recorded_robot, config.seed, out, progress)
    write_validation(config.out, validation, [*lines, rule])


def _prepared(
    config: QuickReport, folder: LogFolder, robot: Robot | None, source: LoadSource
) -> tuple[dict[str, MotorLog], list[str]]:
    """The logs that can be used, prepared as by `load_log`, and lines about what was omitted.

    Without known loads they keep their rows: fits of responses resample rows of their split.
    """
    lines = [f"left out {line}" for line in folder.unreadable]
    used = evenly_spread(list(folder.logs))
    if len(used) < len(folder.logs):
        lines.append(f"{len(used)} of {len(folder.logs)} logs are used")

    period = None if source.name == "unknown" else PERIOD
    settings = LogSettings(period=period)
    robot_of_reader = _robot_of_reader(config)

    logs = {}
    unusable = None
    for path, name in zip(folder.paths, folder.logs, strict=True):
        if name not in used:
            continue
        notes: list[Note] = []
        collecting = Progress(notes.append)
        try:
            recording = read_recording(
                path, robot_of_reader, config.columns, period, config.suspended
            )
            named_recording = replace(recording, path=Path(name))
            logs[name] = prepare_log(named_recording, robot, config.suspended, settings, collecting)
        except LogError as error:
            unusable = error
            lines.append(f"{name}: left out {error}")
        # the source of the loads is stated once, not for every log
        lines += [note.text for note in notes if note.topic != LOADS_TOPIC]
    if unusable is not None and not logs:
        raise unusable
    return logs, lines
