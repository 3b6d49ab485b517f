"""The robot of a command: at a port, or virtual."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field

from motorprior.commands.virtual_robot import VirtualRobotSettings, running_virtual_robot
from motorprior.exceptions import ConfigError
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class RobotChoice:
    """A robot at a port, or a virtual one."""

    port: str | None = None
    """Serial port, for example /dev/ttyACM0; the only one if not given."""
    kind: str = DEFAULT_ROBOT
    """Name of a shipped robot."""
    virtual: bool = False
    """Start a virtual robot and use it."""
    robot: VirtualRobotSettings = field(default_factory=VirtualRobotSettings)
    """The virtual robot."""

    @contextlib.contextmanager
    def open(self) -> Iterator[str]:
        """Its port, while this is open.

        Raises:
            ConfigError: both a port and a virtual robot; no port, or several.
            RobotFault: the virtual robot did not start.
        """
        if self.virtual and self.port is not None:
            raise ConfigError(f"--port {self.port} and --virtual", remedy="give one of them")
        if not self.virtual and self.robot != VirtualRobotSettings():
            raise ConfigError("settings of a virtual robot without --virtual", remedy="give --virtual, or omit them")
        if self.virtual:
            with running_virtual_robot(self.kind, self.robot) as port:
                yield port
        else:
            from motorprior.hardware.serial_link import resolve_port

            yield resolve_port(self.port)
