"""The interface of a log format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.logs.mapped_log import Columns
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

FOLDER = "/"  # the ending of a folder's name
GIVE_COLUMNS = "with columns, the file of a column map (docs/your-motors.md)"


@dataclass(frozen=True)
class LogReader:
    """A log format; the READER of a module in `logs.readers`.

    Attributes:
        name: of the format, for messages.
        endings: of its file names, each with its dot, or FOLDER.
        recognises: (path) whether a path with such an ending has this format.
        read: (path, robot or None) the log; None if the format needs a column map.
        columns: reads named columns for a column map; None if it needs none.
        unmapped: (path) text about the content, for the error if a format that needs a map is read without.
        on_grid: (path, robot, period [s]) the log on a grid, for a format that knows more than its rows.
        assumption: a sentence for the user about what is assumed because the format lacks it; empty if none.
    """

    name: str
    endings: tuple[str, ...]
    recognises: Callable[[Path], bool] = lambda path: True
    read: Callable[[Path, Robot | None], MotorLog] | None = None
    columns: Columns | None = None
    unmapped: Callable[[Path], str] = lambda path: ""
    on_grid: Callable[[Path, Robot | None, float], MotorLog] | None = None
    assumption: str = ""

    def matches(self, path: Path) -> bool:
        """Whether an existing path has this format; raises `LogError` if it cannot be read."""
        name = path.name + FOLDER if path.is_dir() else path.name
        return name.endswith(self.endings) and self.recognises(path)


def require_robot(robot: Robot | None, path: Path) -> Robot:
    """The robot of a format that does not name its joints.

    Raises:
        ConfigError: none was given.
    """
    if robot is None:
        raise ConfigError("the log does not name its joints", where=path, remedy="give robot", argument="robot")
    return robot
