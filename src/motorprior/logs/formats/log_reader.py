"""The interface of a log reader."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ConfigError, LogError
from motorprior.files import require_file
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

FOLDER = "/"  # the ending of a folder's name
GIVE_COLUMNS = "with columns, the file of a column map (docs/your-motors.md)"


@dataclass(frozen=True)
class LogReader:
    """A log format.

    Attributes:
        name: of the format, for messages.
        endings: of its file names, each with its dot, or FOLDER.
        recognises: (path) whether a file with such an ending has this format; LogError if it cannot be read.
        read: (path, robot or None) the log; LogError if it is damaged.
        assumption: a sentence for the user about what is assumed because the format lacks it; empty if none.
    """

    name: str
    endings: tuple[str, ...]
    recognises: Callable[[Path], bool]
    read: Callable[[Path, Robot | None], MotorLog]
    assumption: str = ""

    def matches(self, path: Path) -> bool:
        """Whether a path has this format.

        Raises:
            LogError: it cannot be read.
        """
        name = path.name + FOLDER if path.is_dir() else path.name
        if not name.endswith(self.endings):
            return False
        if not path.is_dir():
            require_file(path, LogError)
        return self.recognises(path)


def require_robot(robot: Robot | None, path: Path) -> Robot:
    """The robot of a format that does not name its joints.

    Raises:
        ConfigError: none was given.
    """
    if robot is None:
        raise ConfigError("the log does not name its joints", where=path, remedy="give robot", argument="robot")
    return robot
