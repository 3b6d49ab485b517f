"""The commands deploy, record and doctor: checks of the settings, output files, and messages to the user.

The command line `motorprior` and, on the robot's own computer, `python -m motorprior.hardware` both
call them.
"""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from motorprior.artifacts import write_json
from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.hardware import motions, teleop
from motorprior.hardware.control_loop import clock_figures
from motorprior.hardware.motions import excite, hardware_targets, joints_of
from motorprior.hardware.robot_link import Recorder, RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import (
    Session,
    check_telemetry,
    fault_of,
    require_ok,
    stop_on_signals,
)
from motorprior.hardware.settings import DeploySettings, RecordSettings, RunSettings
from motorprior.hardware.teleop import Print
from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import Robot, SafetyLimits

_LOG = "run.csv"
# limits of the targets [rad/s], see `RecordSettings`
_FAST_TARGETS = 40.0
_SLOW_TARGETS = 8.0
_DRY_RUN = 5.0  # [s]


def run_deploy(robot: Robot, path: Path, port: str, settings: DeploySettings, show: Print) -> None:
    """Walk with the policy at ``path``, and show the timing of the control loop; RobotFault if one ended it early."""
    if settings.seconds is not None:
        require_number("seconds", settings.seconds, 0.0, 1e6, positive=True)
    policy = Policy.load(path)
    policy.require_robot(robot)
    gait = robot.with_speed_range(policy.forward).require_gait()
    if settings.forward is not None:
        require_number("forward", settings.forward, *gait.forward)
    require_number("yaw_rate", settings.yaw_rate, -gait.yaw_rate, gait.yaw_rate)
    gains = motions.gains_for(robot, policy, settings.kp, settings.kd, settings.max_current)
    if settings.dry_run:
        command = (
            teleop.autonomous_speed(gait) if settings.forward is None else settings.forward,
            settings.yaw_rate,
        )
        with RobotLink(robot, SerialLink(robot, port)) as link, stop_on_signals() as stop:
            session = Session(link, gains, stop, not settings.without_imu, status=show)
            steps = motions.dry_run(session, policy, command, settings.seconds or _DRY_RUN)
        show(f"dry run: {steps} control steps, nothing was sent")
        return
    randomization = policy.provenance.get("randomization")
    if isinstance(randomization, dict) and randomization.get("push") == 0.0:
        show("this policy was trained without pushes; the robot may fall when the host pauses")
    origin = {"command": "deploy", "policy": str(path), "provenance": dict(policy.provenance)}
    with _session(robot, port, settings, gains, teleop.WALKING, show, origin) as (session, out):
        steering = teleop.teleop(gait, settings.forward, settings.yaw_rate)
        motions.walk(session, policy, steering, settings.seconds)
    show(f"stopped by {session.outcome}; {out / _LOG}")
    for name, value in clock_figures(session.timing, policy.control_dt).items():
        show(f"{name} {value:.4g}")


def run_record(robot: Robot, port: str, settings: RecordSettings, show: Print) -> Path:
    """Excite and record; returns the recording, which is kept if a RobotFault ended it early."""
    safety = robot.require_wire().safety
    standing = settings.standing
    # Steps of a leg that carries weight would tip a standing robot.
    excitation = settings.excitation or ("multisine" if standing else "varied")
    amplitude = settings.amplitude
    max_speed = settings.max_speed
    if amplitude is None:  # small on the ground: feet that push into it look blocked
        amplitude = 0.1 if standing else 0.4
    if max_speed is None:  # steps in the air must be fast, to reach a motor's torque limit
        fast = excitation in ("steps", "varied") and not standing
        max_speed = min(safety.target_speed, _FAST_TARGETS if fast else _SLOW_TARGETS)
    settings = replace(settings, excitation=excitation, amplitude=amplitude, max_speed=max_speed)
    require_number("seconds", settings.seconds, 1.0, 3600.0)
    require_number("amplitude", amplitude, 0.0, 1.5, positive=True)
    require_number("max_speed", max_speed, 0.0, safety.target_speed, positive=True)
    require_seed(settings.seed)
    gains = Gains.of(robot.require_wire(), settings.kp, settings.kd, settings.max_current)
    joints = joints_of(robot, settings.joint)
    targets = hardware_targets(
        robot, excitation, joints, settings.seconds, amplitude, max_speed, settings.seed
    )
    how_to_stop = teleop.STANDING if standing else teleop.SUSPENDED
    # A suspended robot may hang tilted.
    limits = replace(
        safety, target_speed=max_speed, max_tilt=safety.max_tilt if standing else math.inf
    )
    with _session(
        robot, port, settings, gains, how_to_stop, show, {"command": "record"}, limits
    ) as (session, out):
        session.need_imu = standing and session.need_imu
        excite(session, targets, suspended=not standing)
    show(f"recorded {out / _LOG}")
    return out / _LOG


@contextmanager
def _session(
    robot: Robot,
    port: str,
    settings: RunSettings,
    gains: Gains,
    how_to_stop: str,
    show: Print,
    origin: dict[str, Any],
    limits: SafetyLimits | None = None,
) -> Iterator[tuple[Session, Path]]:
    """A session that the operator confirms, and the folder of its files.

    run.json contains ``origin``, settings, gains and limits (an infinite one is null). It is
    written when the robot is armed, and again when it is idle, with the outcome: "time",
    "operator", the name of a signal, or the kind of a fault and its message.
    """
    if not settings.yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise ConfigError(
            "no terminal to confirm at",
            remedy="give yes to arm without confirmation",
            argument="yes",
        )
    command = origin["command"]
    out = settings.out or Path("runs") / command / datetime.now().strftime("%Y%m%d-%H%M%S")
    recorder = Recorder(robot, out / _LOG)
    begun = dict[str, Any]()
    with (
        RobotLink(robot, SerialLink(robot, port), limits, recorder) as link,
        stop_on_signals() as stop,
    ):

        def confirm() -> None:
            teleop.confirm_arming(stop, settings.yes, how_to_stop, show)
            begun.update(
                port=port,
                robot=robot.name,
                started=datetime.now().astimezone().isoformat(timespec="seconds"),
                settings={
                    name: str(v) if isinstance(v, Path) else v
                    for name, v in asdict(settings).items()
                },
                gains=asdict(gains),
                safety={
                    name: v if math.isfinite(v) else None for name, v in asdict(link.limits).items()
                },
                **origin,
            )
            write_json(out / "run.json", begun)

        def end(outcome: str, message: str | None) -> None:
            if begun:
                stream = link.stream
                frames = {
                    name: getattr(stream, name) for name in ("accepted", "repeated", "impossible")
                }
                ending = {
                    "ended": datetime.now().astimezone().isoformat(timespec="seconds"),
                    "outcome": outcome,
                    "message": message,
                    "position_clips": link.gate.position_clips,
                    "slew_clips": link.gate.slew_clips,
                    "commands": link.sent,
                    "frames": frames | {"damaged": link.port.reader.rejected},
                }
                write_json(out / "run.json", begun | ending)
                write_json(out / "figures.json", clock_figures(session.timing, robot.control_dt))

        session = Session(link, gains, stop, not settings.without_imu, confirm, show)
        try:
            yield session, out
        except BaseException as error:
            kind = fault_of(error).kind if isinstance(error, Exception) else type(error).__name__
            with suppress(ArtifactError):  # the error that ended the run is more important
                end(kind, str(error))
            raise
        end(session.outcome, None)


def run_doctor(robot: Robot, port: str, seconds: float, idle: bool, show: Print) -> None:
    """Check the telemetry of a robot and show every finding; sends nothing, or only idle. RobotFault if one failed."""
    require_number("seconds", seconds, 1.0, 3600.0)
    with RobotLink(robot, SerialLink(robot, port)) as link:
        if idle:
            check_telemetry(link, 0.3)  # nothing is sent to a device that is no robot
            link.send_idle()
        checks = check_telemetry(link, seconds)
    for check in checks:
        show(
            f"{'ok ' if check.ok else 'BAD'} {check.name}: {check.finding}{'' if check.ok else f' -> {check.remedy}'}"
        )
    require_ok(checks)
