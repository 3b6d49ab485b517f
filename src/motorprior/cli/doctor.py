"""``motorprior doctor``: checks of a robot before it moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from motorprior.cli.console import table
from motorprior.cli.robot_choice import RobotChoice
from motorprior.hardware.settings import require_robot_extra
from motorprior.robots.load import load_robot


@dataclass(frozen=True)
class Doctor:
    """Check a robot's telemetry: frames, age, IMU, joints, currents, battery. Sends nothing, unless --idle."""

    choice: Annotated[RobotChoice, tyro.conf.arg(name="")] = field(default_factory=RobotChoice)
    """The robot."""
    seconds: float = 3.0
    """Duration of the check [s]."""
    idle: bool = False
    """Remove the current from the motors first, so that legs move by hand; a standing robot sinks."""


def run_doctor_command(config: Doctor) -> None:
    """Print every finding.

    Raises:
        ConfigError: pyserial or msgpack is not installed.
        RobotFault: after the table, if a check failed.
    """
    require_robot_extra()
    from motorprior.hardware.commands import require_ok, run_doctor

    with config.choice.open() as port:
        checks = run_doctor(load_robot(config.choice.kind), port, config.seconds, config.idle)
    rows = [["ok" if one.ok else "BAD", one.name, one.finding, "" if one.ok else one.remedy] for one in checks]
    table(f"{port}, {config.seconds:g} s", ["", "check", "finding", "remedy"], rows)
    require_ok(checks)
