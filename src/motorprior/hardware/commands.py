"""The commands deploy, record and doctor: checks of the settings, output files, and messages to the user.

The command line `motorprior` and, on the robot's own computer, `python -m motorprior.hardware` both call them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import RobotFault
from motorprior.hardware import deploy, teleop
from motorprior.hardware.control_loop import clock_results
from motorprior.hardware.doctor import Check, check_telemetry
from motorprior.hardware.excitations import excitation_targets, excite, joints_of
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.run_files import RunFiles
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import StopRequest, stop_on_signals
from motorprior.hardware.settings import DeploySettings, Excitation, RecordSettings
from motorprior.hardware.teleop import Print
from motorprior.locomotion.policy import Policy
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits

_LOG = "run.csv"
_FAST_TARGETS, _SLOW_TARGETS = 40.0, 8.0  # limits of the targets [rad/s], see `RecordSettings`


def run_deploy(robot: Robot, path: Path, port: str, settings: DeploySettings, show: Print) -> Results:
    """Walk with the policy at ``path``; returns the timing of the control loop.

    Raises:
        ArtifactError, ConfigError: a policy that does not fit, settings out of range, or a folder in use.
        RobotFault: a fault ended the walk early.
    """
    if settings.seconds is not None:
        require_number("seconds", settings.seconds, 0.0, 1e6, positive=True)
    policy = Policy.load(path)
    policy.check()
    policy.require_robot(robot)
    gait = robot.with_speed_range(policy.forward).require_legs()
    if settings.forward is not None:
        require_number("forward", settings.forward, *gait.forward)
    require_number("yaw_rate", settings.yaw_rate, -gait.yaw_rate, gait.yaw_rate)
    gains = deploy.gains_for(robot, policy, settings.kp, settings.kd, settings.max_current)
    gains.check(robot.require_wire().safety)
    if settings.dry_run:
        command = teleop.autonomous_speed(gait) if settings.forward is None else settings.forward, settings.yaw_rate
        with RobotLink(robot, SerialLink(robot, port)) as link, stop_on_signals() as stop:
            seconds, has_imu = settings.seconds or 5.0, not settings.without_imu
            steps = deploy.dry_run(link, policy, stop, seconds, show, command, has_imu)
        show(f"dry run: {steps} control steps, nothing was sent")
        return Results()
    teleop.require_terminal(settings.yes)
    randomization = policy.provenance.get("randomization")
    if isinstance(randomization, dict) and randomization.get("push") == 0.0:
        show("note: this policy was trained without pushes; the robot may fall when the host pauses")
    out = settings.out or _dated_folder("deploy")
    with _recorded_run(robot, port, out) as (link, stop, files):

        def confirm() -> None:
            teleop.confirm_arming(stop, settings.yes, teleop.WALKING, show)
            files.begin("deploy", port, settings, gains, policy=str(path), provenance=dict(policy.provenance))

        files.outcome = deploy.walk(
            link, policy, gains, stop,
            seconds=settings.seconds, need_imu=not settings.without_imu, confirm=confirm,
            teleop=lambda: teleop.teleop(gait, settings.forward, settings.yaw_rate), status=show, timing=files.timing,
        )  # fmt: skip
    show(f"stopped by {files.outcome}; {out / _LOG}")
    return clock_results([files.timing], policy.control_dt)


def run_record(robot: Robot, port: str, settings: RecordSettings, show: Print) -> Path:
    """Excite and record; returns the recording.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a folder in use.
        RobotFault: a fault ended it early; the recording is kept.
    """
    safety, settings = robot.require_wire().safety, _with_defaults(robot, settings)
    excitation, amplitude, speed = settings.excitation, settings.amplitude, settings.speed
    assert excitation is not None and amplitude is not None and speed is not None, "defaults"
    require_number("seconds", settings.seconds, 1.0, 3600.0)
    require_number("amplitude", amplitude, 0.0, 1.5, positive=True)
    require_number("speed", speed, 0.0, safety.target_speed, positive=True)
    require_seed(settings.seed)
    gains = Gains.of(robot.require_wire(), settings.kp, settings.kd, settings.max_current)
    gains.check(safety)
    joints = joints_of(robot, settings.joint)
    targets = excitation_targets(robot, excitation, joints, settings.seconds, amplitude, speed, settings.seed)
    teleop.require_terminal(settings.yes)
    out = settings.out or _dated_folder("record")
    limits = replace(safety, target_speed=speed)
    if not settings.standing:
        limits = replace(limits, max_tilt=float("inf"))  # it may hang tilted
    with _recorded_run(robot, port, out, limits) as (link, stop, files):

        def confirm() -> None:
            teleop.confirm_arming(stop, settings.yes, teleop.STANDING if settings.standing else teleop.SUSPENDED, show)
            files.begin("record", port, settings, gains)

        excite(
            link, targets, gains, stop,
            suspended=not settings.standing, need_imu=settings.standing and not settings.without_imu,
            confirm=confirm, status=show, timing=files.timing,
        )  # fmt: skip
        files.outcome = stop.reason or "time"
    return out / _LOG


@contextmanager
def _recorded_run(
    robot: Robot, port: str, out: Path, limits: SafetyLimits | None = None
) -> Iterator[tuple[RobotLink, StopRequest, RunFiles]]:
    """Open a link that records to ``out``; at the end the robot is idle and the files of the run are written."""
    recorder = Recorder(robot, out / _LOG)
    link = RobotLink(robot, SerialLink(robot, port), limits, recorder)
    files = RunFiles(out, link)
    with link, stop_on_signals() as stop, files.written_at_end():
        yield link, stop, files


def run_doctor(robot: Robot, port: str, seconds: float, idle: bool) -> list[Check]:
    """Check the telemetry of a robot; sends nothing, or only idle. Raises RobotFault if no telemetry comes."""
    require_number("seconds", seconds, 1.0, 3600.0)
    with RobotLink(robot, SerialLink(robot, port)) as link:
        if idle:
            check_telemetry(link, 0.3)  # an error for a device that is not a robot, before anything is sent
            link.relax()
        return check_telemetry(link, seconds)


def require_ok(checks: list[Check]) -> None:
    """Raise RobotFault if a check failed."""
    if failed := [check.name for check in checks if not check.ok]:
        raise RobotFault("doctor", f"failed: {', '.join(failed)}", remedy="see the remedies above")


def _with_defaults(robot: Robot, settings: RecordSettings) -> RecordSettings:
    """Excitation, amplitude and speed for a robot in the air or standing, where they are not given."""
    standing = settings.standing
    # Steps of a leg that carries weight would tip a standing robot.
    excitation: Excitation = settings.excitation or ("multisine" if standing else "varied")
    amplitude = settings.amplitude
    if amplitude is None:  # small on the ground: feet that push into it look blocked
        amplitude = 0.1 if standing else 0.4
    speed = settings.speed
    if speed is None:  # steps in the air must be fast, to reach a motor's torque limit
        fast = excitation in ("steps", "varied") and not standing
        speed = min(robot.require_wire().safety.target_speed, _FAST_TARGETS if fast else _SLOW_TARGETS)
    return replace(settings, excitation=excitation, amplitude=amplitude, speed=speed)


def _dated_folder(command: str) -> Path:
    return Path("runs") / command / datetime.now().strftime("%Y%m%d-%H%M%S")
