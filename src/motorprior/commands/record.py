"""Excite and record the motors of a robot."""

from dataclasses import dataclass, replace

from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.hardware.settings import RecordSettings, require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Record(RecordSettings, RobotChoice):
    """Excite and record the motors of a robot."""


def run_record(config: Record, progress: Progress = SILENT) -> None:
    """Play an excitation and record it; errors as `hardware.runs.record`."""
    require_robot_extra()
    from motorprior.excitation.robot_targets import hardware_targets, joints_of
    from motorprior.hardware.runs import record  # here: it needs the extra robot

    robot = load_robot(DEFAULT_ROBOT)
    playback = config.playback(robot.require_wire().safety)
    targets = hardware_targets(
        robot,
        playback.excitation,
        joints_of(robot, config.joint),
        config.seconds,
        playback.amplitude,
        playback.max_speed,
        config.seed,
    )

    is_suspended = config.robot.suspended or not config.standing
    virtual_robot = replace(config.robot, suspended=is_suspended)
    with opened_port(robot, config, virtual_robot) as port:
        record(robot, port, config, targets, messages(progress))
