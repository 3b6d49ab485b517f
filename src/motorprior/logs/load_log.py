"""Read a recording in any format and prepare it for identification."""

from pathlib import Path

from motorprior.logs.column_map import ColumnMap
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.prepare_log import DEFAULT_SETTINGS, LogSettings, prepare_log
from motorprior.logs.read_log import read_recording
from motorprior.progress import PYTHON_WARNINGS, Progress
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot


def load_log(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    robot: Robot | str | Path | None = None,
    suspended: bool = False,
    settings: LogSettings = DEFAULT_SETTINGS,
    allow_errors: bool = False,
    progress: Progress = PYTHON_WARNINGS,
) -> MotorLog:
    """Read a recording in any format and prepare it for `fit_prior` and `adapt`.

    `read_recording` reads the file, `prepare_log` does the rest.

    Args:
        path: the file, or the folder for formats that are folders.
        columns: a column map, the name of a shipped one, or its file (docs/your-motors.md).
        robot: the recorded robot, its name or its .toml file. Its model gives the loads, and its
            description the joints of formats that do not name them.
        suspended: the robot was suspended in the air, level unless the log has its orientation; a
            robot with a fixed base needs no such statement. `loads.load_source` states which loads
            the log gets.
        settings: the grid, and what the recording lacks.
        allow_errors: whether to load a recording in which `check_log` finds errors, such as another
            unit or sign; they are then reported as warnings.
        progress: where to report to; by default warnings are Python warnings.

    Raises:
        ConfigError: a setting out of its range, or one that contradicts the log.
        LogError: the log cannot be read, lacks what loads need, or has a value out of its bounds;
            or it has errors that are not allowed.
        ArtifactError: a bad column map or robot.
    """
    described = None if robot is None else as_robot(robot)
    settings.check()
    recording = read_recording(Path(path), described, columns, settings.period, suspended)
    return prepare_log(recording, described, suspended, settings, progress, allow_errors)
