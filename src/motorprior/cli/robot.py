"""``motorprior deploy``, ``record`` and ``doctor``: a robot at a port, or a virtual one."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType

import tyro

from motorprior.cli.console import TERMINAL
from motorprior.commands.virtual_robot import VirtualRobotSettings, running_virtual_robot
from motorprior.exceptions import ConfigError
from motorprior.hardware.settings import DeploySettings, RecordSettings, require_robot_extra
from motorprior.hardware.teleop import non_blocking
from motorprior.locomotion.policy import Policy
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

PRINT = non_blocking(TERMINAL.note, sys.stderr)


@dataclass(frozen=True)
class RobotChoice:
    """A robot at a port, or a virtual one.

    Attributes:
        port: serial port, for example /dev/ttyACM0; the only one if not given.
        virtual: start a virtual robot and use it; in record it is suspended unless --standing.
        robot: the virtual robot.
    """

    port: str | None = None
    virtual: bool = False
    robot: VirtualRobotSettings = field(default_factory=VirtualRobotSettings)


@dataclass(frozen=True)
class Deploy(DeploySettings, RobotChoice):
    """Run a policy on a robot."""

    policy: tyro.conf.Positional[Path] = field(kw_only=True)
    """Policy that `motorprior walk` wrote."""


@dataclass(frozen=True)
class Record(RecordSettings, RobotChoice):
    """Excite and record the motors of a robot."""


@dataclass(frozen=True)
class Doctor(RobotChoice):
    """Check a robot's telemetry; sends nothing without --idle."""

    seconds: float = 3.0
    """Duration of the check [s]."""
    idle: bool = False
    """Remove the current from the motors first, so that legs move by hand; a standing robot sinks."""


@contextmanager
def _opened(choice: RobotChoice) -> Iterator[tuple[ModuleType, Robot, str]]:
    """`hardware.commands`, the robot and its port, while this is open."""
    require_robot_extra()
    from motorprior.hardware import commands, serial_link

    if choice.virtual and choice.port is not None:
        raise ConfigError(f"--port {choice.port} and --virtual", remedy="give one of them")
    robot = load_robot(DEFAULT_ROBOT)
    if choice.virtual:
        with running_virtual_robot(robot.name, choice.robot) as port:
            yield commands, robot, port
    else:
        yield commands, robot, serial_link.resolve_port(choice.port)


def deploy(config: Deploy) -> None:
    """See `hardware.commands.run_deploy`."""
    Policy.load(config.policy)  # an error comes before a virtual robot is started
    with _opened(config) as (commands, robot, port):
        commands.run_deploy(robot, config.policy, port, config, PRINT)


def record(config: Record) -> None:
    """See `hardware.commands.run_record`."""
    choice = replace(config, robot=replace(config.robot, suspended=config.robot.suspended or not config.standing))
    with _opened(choice) as (commands, robot, port):
        commands.run_record(robot, port, config, PRINT)


def doctor(config: Doctor) -> None:
    """See `hardware.commands.run_doctor`."""
    with _opened(config) as (commands, robot, port):
        commands.run_doctor(robot, port, config.seconds, config.idle, PRINT)
