"""Excite and record the motors of a robot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from motorprior.bounds import require_number
from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.exceptions import ConfigError
from motorprior.excitation.recording import MotionSettings
from motorprior.hardware.settings import RunSettings, require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.servos import MotionPart
from motorprior.robots.shipped import DEFAULT_ROBOT

if TYPE_CHECKING:
    from motorprior.commands.servo_bus import OpenBus
    from motorprior.excitation.servo_motion import MotionRange
    from motorprior.hardware.servo_run import RecordedRobot

_SERVO_AMPLITUDE = 0.5  # default of robots on a servo bus [rad]
_SERVO_SPEED = 12.0  # default limit of targets on a servo bus [rad/s]
# Options without effect on servos, on robots without servos, and on any robot. The gains of servos
# are in their registers.
_NOT_OF_SERVOS = ("excitation", "joint", "standing", "kp", "kd", "max_current", "without_imu")
_OF_SERVOS = ("baud_rate", "profile", "free_space", "plan")
_OF_ONE_MOTOR = ("bar", "id")


@dataclass(frozen=True)
class Record(MotionSettings, RunSettings, RobotChoice):
    """Excite and record the motors of a robot, or of one servo with a pendulum."""

    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot with a table [servos]
    (docs/hardware.md)."""
    motor: str | None = None
    """One servo without robot, such as STS3215 or XL330-M288; needs --bar."""
    bar: str | None = None
    """Pendulum on the servo of --motor: length and mass at its end, "0.1m,0.5kg". It must hang down
    when the recording begins."""
    id: int = 1
    """Id of the servo of --motor on its bus."""
    baud_rate: int | None = None
    """Baud rate of a servo bus [bit/s]; if not given, the usual ones of the servos are tried."""
    profile: Literal["keep", "off"] = "keep"
    """Acceleration limit of servos during the recording: as found, or switched off. It is restored
    afterwards."""
    free_space: float | None = None
    """Free space around the base of a robot on a servo bus [m]: no link goes further away from it.
    If not given, all that the robot can reach is free."""
    plan: bool = False
    """Move nothing: check the motion for collisions in the model of a robot on a servo bus, and
    write a film of it."""


def run_record(config: Record, progress: Progress = SILENT) -> None:
    """Play an excitation and record it; errors as `hardware.runs.record` or `record_servos`."""
    if config.motor is not None:
        _require_unused(
            config, ("robot", "free_space", "plan", *_NOT_OF_SERVOS), "of one servo, --motor"
        )
        _record_motor(config, progress)
        return
    _require_unused(config, _OF_ONE_MOTOR, "without --motor")
    robot = load_robot(config.robot)
    if robot.servos is not None:
        _require_unused(config, _NOT_OF_SERVOS, f"of the servos of {robot.name}")
        _record_servos(config, robot, progress)
        return
    _require_unused(config, _OF_SERVOS, f"of {robot.name}, which has no servos")
    _record_robot(config, robot, progress)


def _require_unused(config: Record, names: Sequence[str], recording: str) -> None:
    """Raise ConfigError for an option that has no effect on this recording."""
    defaults = {field.name: field.default for field in fields(Record)}
    for name in names:
        if getattr(config, name) == defaults[name]:
            continue
        remedy = "leave it out"
        if name in ("kp", "kd"):
            remedy = "leave it out, and set the gains in the registers of the servos"
        problem = f"{name} has no effect on a recording {recording}"
        raise ConfigError(problem, remedy=remedy, argument=name)


def _record_robot(config: Record, robot: Robot, progress: Progress) -> None:
    """Record a robot with a protocol of its own."""
    require_robot_extra()
    from motorprior.excitation.robot_targets import recorded_motion
    from motorprior.hardware.runs import record  # here: it needs the extra robot

    motion = recorded_motion(robot, config)
    run_settings = replace(
        config,
        excitation=motion.excitation,
        amplitude=motion.amplitude,
        max_speed=motion.max_speed,
    )

    is_suspended = config.virtual_robot.suspended or not config.standing
    virtual_robot = replace(config.virtual_robot, suspended=is_suspended)
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


def _record_servos(config: Record, robot: Robot, progress: Progress) -> None:
    """Record a robot on a servo bus, or show the plan."""
    from motorprior.commands.servo_bus import opened_bus, recorded_robot

    recorded = recorded_robot(robot)
    if config.plan:
        _show_plan(config, recorded, robot, progress)
        return
    out = _new_folder(config, len(recorded.joint_names))
    with opened_bus(recorded.chain, config, config.baud_rate, robot) as opened:
        _record(config, out, recorded, robot, opened, progress)


def _record_motor(config: Record, progress: Progress) -> None:
    """Record one servo that swings a pendulum; it hangs down now."""
    from motorprior.commands.servo_bus import Bar, chain_of_one, opened_bus, recorded_motor
    from motorprior.hardware.servo_link import scanned

    assert config.motor is not None
    if config.bar is None:
        raise ConfigError(
            "no bar for the motor", remedy='give its load, such as "0.1m,0.5kg"', argument="bar"
        )
    bar = Bar.parsed(config.bar)
    out = _new_folder(config, joints=1)
    chain = chain_of_one(config.motor, config.id)
    with opened_bus(chain, config, config.baud_rate, None, bar) as opened:
        scanned(opened.bus, chain)
        zero = round(float(opened.bus.read().counts[0]))
        recorded = recorded_motor(config.motor, config.id, bar, zero)
        _record(config, out, recorded, None, opened, progress)


def _new_folder(config: Record, joints: int) -> Path:
    """Folder of a recording; what needs no bus to be refused is refused here.

    Raises ConfigError for too short a time, and ArtifactError for a recording that exists.
    """
    from motorprior.excitation.servo_motion import require_time
    from motorprior.hardware.servo_recorder import require_new
    from motorprior.hardware.servo_run import RECORDING

    require_time(joints, config.seconds)
    date = datetime.now().strftime("%Y%m%d-%H%M%S")
    out = config.out or Path("runs") / "record" / date
    require_new(out / RECORDING)
    return out


def _record(
    config: Record,
    out: Path,
    recorded: "RecordedRobot",
    robot: Robot | None,
    opened: "OpenBus",
    progress: Progress,
) -> None:
    from motorprior.hardware.servo_link import ServoLimits
    from motorprior.hardware.servo_run import ServoSettings, record_servos

    settings = ServoSettings(
        out=out,
        yes=config.yes,
        profile=config.profile,
        limits=ServoLimits(target_speed=config.max_speed or _SERVO_SPEED),
    )
    show = messages(progress)
    plan = _plan(config, recorded, robot, show)
    record_servos(recorded, opened.bus, opened.clock, plan, settings, show, opened.watch)


def _plan(
    config: Record, recorded: "RecordedRobot", robot: Robot | None, show: Callable[[str], None]
) -> Callable[[float, np.ndarray, np.ndarray], list[MotionPart]]:
    """The function that makes the parts, see `hardware.servo_run.Plan`."""
    from motorprior.excitation.servo_motion import motion_range, servo_parts

    if config.free_space is not None:
        require_number("free_space", config.free_space, 0.0, 100.0, positive=True)
    names = recorded.joint_names
    nominal = None if robot is None else robot.nominal_pose
    has_model = robot is not None and find_spec("mujoco") is not None
    if config.free_space is not None and not has_model:
        raise ConfigError(
            "free_space cannot be checked: MuJoCo is not installed",
            remedy="pip install mujoco, or omit it",
            argument="free_space",
        )
    if robot is not None and not has_model:
        show(
            "MuJoCo is not installed: collisions are not checked, and joints move about the "
            "nominal pose only"
        )

    def parts(period: float, lower: np.ndarray, upper: np.ndarray) -> list[MotionPart]:
        motion = motion_range(names, lower, upper, nominal, config.amplitude or _SERVO_AMPLITUDE)
        loaded = None
        if robot is not None and has_model:
            loaded = _loaded(config, robot, motion)
        made = servo_parts(
            names, motion, loaded, period=period, seconds=config.seconds, seed=config.seed
        )
        if robot is not None and has_model:
            _check(config, robot, made, period, show)
        return made

    return parts


def _loaded(config: Record, robot: Robot, motion: "MotionRange") -> np.ndarray:
    """Poses in which gravity loads the joints."""
    from motorprior.simulation.loaded_poses import loaded_poses

    return loaded_poses(
        robot, motion.lowest, motion.highest, motion.center, motion.reach, config.free_space
    )


def _check(
    config: Record,
    robot: Robot,
    parts: Sequence[MotionPart],
    period: float,
    show: Callable[[str], None],
) -> None:
    """Check the parts for collisions in the robot's model."""
    from motorprior.simulation.motion_check import require_free_motion

    check = require_free_motion(robot, parts, period, config.free_space)
    show(
        f"no collision of {len(check.pairs)} pairs of links, or links and table, in the model; "
        f"keep {check.radius:.2f} m around the base free"
    )


def _show_plan(config: Record, recorded: "RecordedRobot", robot: Robot, progress: Progress) -> None:
    """Check the motion at the robot's own control period; show a table and write a film of it."""
    from motorprior.report.motion_film import write_motion_film
    from motorprior.report.motion_table import motion_table

    period = robot.control_dt
    parts = _plan(config, recorded, robot, progress.note)(period, robot.lower, robot.upper)
    for line in motion_table(robot, parts, period).splitlines():
        progress.note(line)
    seconds = period * sum(len(part.targets) for part in parts)
    out = config.out or Path("runs") / "record" / "plan"
    path = write_motion_film(out, robot, parts, period, progress)
    progress.note(f"{len(parts)} parts, {seconds:.0f} s; film {path}")
