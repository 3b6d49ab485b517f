"""Check a robot's telemetry."""

from dataclasses import dataclass

from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.hardware.settings import require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Doctor(RobotChoice):
    """Check a robot's telemetry, or the servos on its bus; writes nothing without --idle."""

    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot with a table [servos]."""
    motor: str | None = None
    """One servo without robot, such as STS3215 or XL330-M288; angles are from the middle of its
    turn."""
    id: int = 1
    """Id of the servo of --motor on its bus."""
    baud_rate: int | None = None
    """Baud rate of a servo bus [bit/s]; if not given, the usual ones of the servos are tried."""
    seconds: float = 3.0
    """Duration of the check [s]."""
    idle: bool = False
    """Remove the current from the motors first, so that legs move by hand; a standing robot
    sinks."""


def run_doctor(config: Doctor, progress: Progress = SILENT) -> None:
    """Print every finding; errors as `hardware.runs.diagnose` or `diagnose_servos`."""
    if config.motor is not None:
        _check_motor(config, config.motor, progress)
        return
    robot = load_robot(config.robot)
    if robot.servos is not None:
        _check_servos(config, robot, progress)
        return
    require_robot_extra()
    from motorprior.hardware.runs import diagnose  # here: it needs the extra robot

    with opened_port(robot, config) as port:
        diagnose(robot, port, config.seconds, config.idle, messages(progress))


def _check_servos(config: Doctor, robot: Robot, progress: Progress) -> None:
    from motorprior.commands.servo_bus import opened_bus, recorded_robot
    from motorprior.hardware.servo_run import diagnose_servos

    recorded = recorded_robot(robot)
    with opened_bus(recorded.chain, config, config.baud_rate, robot) as opened:
        show = messages(progress)
        diagnose_servos(recorded, opened.bus, opened.clock, config.seconds, config.idle, show)


def _check_motor(config: Doctor, model: str, progress: Progress) -> None:
    from motorprior.commands.servo_bus import Bar, chain_of_one, opened_bus, recorded_motor
    from motorprior.hardware.servo_run import diagnose_servos

    chain = chain_of_one(model, config.id)
    bar = Bar(0.1, 0.1)  # of a virtual motor
    recorded = recorded_motor(model, config.id, bar, chain.zeros[0])
    with opened_bus(chain, config, config.baud_rate, None, bar) as opened:
        show = messages(progress)
        diagnose_servos(recorded, opened.bus, opened.clock, config.seconds, config.idle, show)
