"""The port of a robot, real or virtual, for the commands deploy, record and doctor."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec

from motorprior.commands.virtual_robot import VirtualRobotSettings, running_virtual_robot
from motorprior.exceptions import ConfigError
from motorprior.hardware.teleop import non_blocking
from motorprior.progress import Progress
from motorprior.robots.robot import Robot


@dataclass(frozen=True)
class RobotChoice:
    """A robot at a port, or a virtual one."""

    port: str | None = None
    """Serial port, for example /dev/ttyACM0. If not given, the only serial port of this
    computer."""
    virtual: bool = False
    """Start a virtual robot and use it; needs the full installation. For `record` the virtual robot
    is suspended, except with --standing."""
    virtual_robot: VirtualRobotSettings = field(default_factory=VirtualRobotSettings)
    """The virtual robot."""


@contextmanager
def opened_port(
    robot: Robot, choice: RobotChoice, virtual_robot: VirtualRobotSettings | None = None
) -> Iterator[str]:
    """Name of the robot's port; a virtual robot runs within this context.

    ``virtual_robot`` replaces the settings in ``choice``. Raises ConfigError if the port does not
    exist, if both port and virtual robot are given, or without a simulator.
    """
    from motorprior.hardware.serial_link import resolve_port  # here: it needs the extra robot

    if choice.virtual and choice.port is not None:
        raise ConfigError(f"--port {choice.port} and --virtual", remedy="give one of them")
    if choice.virtual:
        if find_spec("mujoco") is None:
            raise ConfigError(
                "--virtual needs a simulator, which is not installed",
                remedy="pip install mujoco",
            )
        with running_virtual_robot(robot.name, virtual_robot or choice.virtual_robot) as port:
            yield port
    else:
        yield resolve_port(choice.port)


def messages(progress: Progress) -> Callable[[str], None]:
    """Print messages, but none while the terminal cannot take them: the robot does not wait."""
    return non_blocking(progress.note, sys.stderr)
