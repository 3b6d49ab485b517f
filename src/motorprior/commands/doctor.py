"""Check a robot's telemetry."""

from dataclasses import dataclass

from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.hardware.settings import require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Doctor(RobotChoice):
    """Check a robot's telemetry; sends nothing without --idle."""

    seconds: float = 3.0
    """Duration of the check [s]."""
    idle: bool = False
    """Remove the current from the motors first, so that legs move by hand; a standing robot
    sinks."""


def run_doctor(config: Doctor, progress: Progress = SILENT) -> None:
    """Print every finding; errors as `hardware.runs.diagnose`."""
    require_robot_extra()
    from motorprior.hardware.runs import diagnose  # here: it needs the extra robot

    robot = load_robot(DEFAULT_ROBOT)
    with opened_port(robot, config) as port:
        diagnose(robot, port, config.seconds, config.idle, messages(progress))
