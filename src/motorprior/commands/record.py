"""Excite and record the motors of a robot."""

from dataclasses import dataclass, replace

from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.excitation.recording import MotionSettings
from motorprior.hardware.settings import RunSettings, require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Record(MotionSettings, RunSettings, RobotChoice):
    """Excite and record the motors of a robot."""


def run_record(config: Record, progress: Progress = SILENT) -> None:
    """Play an excitation and record it; errors as `hardware.runs.record`."""
    require_robot_extra()
    from motorprior.excitation.robot_targets import recorded_motion
    from motorprior.hardware.runs import record  # here: it needs the extra robot

    robot = load_robot(DEFAULT_ROBOT)
    motion = recorded_motion(robot, config)
    run_settings = replace(
        config,
        excitation=motion.excitation,
        amplitude=motion.amplitude,
        max_speed=motion.max_speed,
    )

    is_suspended = config.robot.suspended or not config.standing
    virtual_robot = replace(config.robot, suspended=is_suspended)
    with opened_port(robot, config, virtual_robot) as port:
        record(
            robot,
            port,
            run_settings,
            motion.targets,
            messages(progress),
            max_speed=motion.max_speed,
            standing=config.standing,
        )
