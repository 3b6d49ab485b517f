"""``motorprior deploy``, ``record`` and ``doctor``: a robot at a port, or a virtual one."""

import sys
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from motorprior.cli.show import TERMINAL
from motorprior.commands.virtual_robot import VirtualRobotSettings, running_virtual_robot
from motorprior.exceptions import ConfigError
from motorprior.hardware.settings import DeploySettings, RecordSettings, require_robot_extra
from motorprior.hardware.teleop import non_blocking
from motorprior.locomotion.policy import Policy
from motorprior.robots.load import load_robot
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


def run(config: Deploy | Record | Doctor) -> None:
    """See `run_deploy`, `run_record` and `run_doctor` of `hardware.commands`."""
    require_robot_extra()
    from motorprior.hardware import commands, serial_link

    if config.virtual and config.port is not None:
        raise ConfigError(f"--port {config.port} and --virtual", remedy="give one of them")
    robot = load_robot(DEFAULT_ROBOT)
    body = config.robot
    if isinstance(config, Deploy):
        Policy.load(config.policy)  # an error comes before a virtual robot is started
    if isinstance(config, Record):
        body = replace(body, suspended=body.suspended or not config.standing)
    with running_virtual_robot(robot.name, body) if config.virtual else nullcontext() as virtual:
        port = virtual or serial_link.resolve_port(config.port)
        if isinstance(config, Deploy):
            commands.run_deploy(robot, config.policy, port, config, PRINT)
        elif isinstance(config, Record):
            commands.run_record(robot, port, config, PRINT)
        else:
            commands.run_doctor(robot, port, config.seconds, config.idle, PRINT)
