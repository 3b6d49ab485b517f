"""``motorprior record``: excite the motors of a robot and record a log."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Annotated

import tyro

from motorprior.cli.console import TERMINAL
from motorprior.cli.robot_choice import RobotChoice
from motorprior.hardware.settings import RecordSettings, require_robot_extra
from motorprior.robots.load import load_robot


@dataclass(frozen=True)
class Record:
    """Excite the motors of a suspended or standing robot and record them."""

    choice: Annotated[RobotChoice, tyro.conf.arg(name="")] = field(default_factory=RobotChoice)
    """The robot; a virtual one is suspended unless --standing."""
    settings: Annotated[RecordSettings, tyro.conf.arg(name="")] = field(default_factory=RecordSettings)
    """The excitation."""


def run_record_command(config: Record) -> None:
    """Record, and print the path of the log.

    Raises:
        ConfigError: pyserial or msgpack is not installed.
        ConfigError, ArtifactError, RobotFault: see `hardware.commands.run_record`.
    """
    require_robot_extra()
    from motorprior.hardware.commands import run_record
    from motorprior.hardware.teleop import non_blocking

    show = non_blocking(TERMINAL.note, sys.stderr)
    settings, choice = config.settings, config.choice
    if choice.virtual and not settings.standing:
        choice = replace(choice, robot=replace(choice.robot, suspended=True))
    with choice.open() as port:
        log = run_record(load_robot(choice.kind), port, settings, show)
    show(f"{log}: next, motorprior logs check {log}")
