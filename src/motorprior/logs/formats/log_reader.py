"""What a reader of log files says about itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ConfigError, LogError
from motorprior.files import require_file
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

FOLDER = "/"
"""The ending of a folder's name."""
SAY_COLUMNS = "with columns, a map.toml that says what its names mean (docs/your-motors.md)"
"""What to do about a table of no known format."""


@dataclass(frozen=True)
class LogReader:
    """A file format that becomes a `MotorLog`; its own file makes one.

    Attributes:
        name: of the format, for messages.
        endings: of the names of its files, each with its dot, or FOLDER.
        recognises: (path) whether a file with such an ending is one; a LogError if it cannot be read.
        read: (path, robot) its log; a LogError if it is damaged. The robot is None where none was given.
        taken_for_granted: a sentence for the user about what such files do not say; empty if there is nothing.
    """

    name: str
    endings: tuple[str, ...]
    recognises: Callable[[Path], bool]
    read: Callable[[Path, Robot | None], MotorLog]
    taken_for_granted: str = ""

    def takes(self, path: Path) -> bool:
        """Whether a path is in this format.

        Raises:
            LogError: it cannot be read.
        """
        name = path.name + FOLDER if path.is_dir() else path.name
        if not name.endswith(self.endings):
            return False
        if not path.is_dir():
            require_file(path, LogError)
        return self.recognises(path)


def require_given(robot: Robot | None, path: Path) -> Robot:
    """The robot, which a file that does not name its joints is nothing without.

    Raises:
        ConfigError: none was given.
    """
    if robot is None:
        raise ConfigError("it does not say of which robot it is", where=path, remedy="give robot", argument="robot")
    return robot
