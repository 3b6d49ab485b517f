"""Runs of a robot, with their files and messages: a walk, a recording, a check of the telemetry.

The commands deploy, record and doctor call them.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import write_json
from motorprior.bounds import require_number
from motorprior.exceptions import ArtifactError
from motorprior.hardware import motions, teleop
from motorprior.hardware.control_loop import clock_figures
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
from motorprior.hardware.settings import DeploySettings, RunSettings
from motorprior.hardware.teleop import Print
from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import Gait, Robot, SafetyLimits

_RECORDING = "run.csv"
_DRY_RUN = 5.0  # default duration of a dry run [s]
# duration of a check before idle is sent, since the device may not be a robot [s]
_FIRST_CHECK = 0.3


def deploy(robot: Robot, path: Path, port: str, settings: DeploySettings, show: Print) -> None:
    """Walk with the policy at ``path``, and show the timing of the control loop.

    Raises ConfigError for a setting out of range, and RobotFault if a fault ended the walk early.
    """
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
        _dry_run(robot, policy, gait, port, settings, gains, show)
        return

    randomization = policy.provenance.get("randomization")
    if isinstance(randomization, dict) and randomization.get("push") == 0.0:
        show("this policy was trained without pushes; the robot may fall when the host pauses")
    origin = {"command": "deploy", "policy": str(path), "provenance": dict(policy.provenance)}
    with _session(robot, port, settings, gains, teleop.WALKING, show, origin) as (session, out):
        steering = teleop.teleop(gait, settings.forward, settings.yaw_rate)
        motions.walk(session, policy, steering, settings.seconds)

    show(f"stopped by {session.outcome}; {out / _RECORDING}")
    for name, value in clock_figures(session.timing, policy.control_dt).items():
        show(f"{name} {value:.4g}")


def _dry_run(
    robot: Robot,
    policy: Policy,
    gait: Gait,
    port: str,
    settings: DeploySettings,
    gains: Gains,
    show: Print,
) -> None:
    """Compute a walk from the telemetry of an idle robot, and send nothing."""
    forward = settings.forward
    if forward is None:
        forward = teleop.autonomous_speed(gait)
    command = (forward, settings.yaw_rate)
    seconds = settings.seconds or _DRY_RUN

    with RobotLink(robot, SerialLink(robot, port)) as link, stop_on_signals() as stop:
        session = Session(link, gains, stop, not settings.without_imu, status=show)
        steps = motions.dry_run(session, policy, command, seconds)
    show(f"dry run: {steps} control steps, nothing was sent")


def record(
    robot: Robot,
    port: str,
    settings: RunSettings,
    targets: np.ndarray,
    show: Print,
    *,
    max_speed: float,
    standing: bool = False,
) -> Path:
    """Play targets and record; returns the recording.

    Args:
        robot: the robot at the port.
        port: name of the serial port.
        settings: stored with the recording.
        targets: (steps, joints) [rad].
        show: prints messages.
        max_speed: limit of the targets' speed [rad/s].
        standing: whether the robot stands on the ground; otherwise it is suspended.

    Raises:
        ConfigError: a setting out of range.
        RobotFault: a fault ended the recording early; its file is kept.
    """
    wire = robot.require_wire()
    gains = Gains.of(wire, settings.kp, settings.kd, settings.max_current)
    how_to_stop = teleop.STANDING if standing else teleop.SUSPENDED
    limits = replace(
        wire.safety,
        target_speed=max_speed,
        # a suspended robot may hang tilted
        max_tilt=wire.safety.max_tilt if standing else math.inf,
    )

    origin = {"command": "record"}
    with _session(robot, port, settings, gains, how_to_stop, show, origin, limits) as (
        session,
        out,
    ):
        session.need_imu = standing and session.need_imu
        motions.excite(session, targets, suspended=not standing)
    show(f"recorded {out / _RECORDING}")
    return out / _RECORDING


def diagnose(robot: Robot, port: str, seconds: float, idle: bool, show: Print) -> None:
    """Check the telemetry of a robot for ``seconds`` [s] and show every finding.

    Sends nothing; with ``idle`` it removes the current of the motors first. Raises RobotFault if a
    check failed.
    """
    require_number("seconds", seconds, 1.0, 3600.0)
    with RobotLink(robot, SerialLink(robot, port)) as link:
        if idle:
            check_telemetry(link, _FIRST_CHECK)
            link.send_idle()
        checks = check_telemetry(link, seconds)
    for check in checks:
        if check.ok:
            show(f"ok  {check.name}: {check.finding}")
        else:
            show(f"BAD {check.name}: {check.finding} -> {check.remedy}")
    require_ok(checks)


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

    run.json is written when the robot is armed, and again when it is idle, see `_RunFile`.
    """
    teleop.require_confirmation(settings.yes)
    date = datetime.now().strftime("%Y%m%d-%H%M%S")
    out = settings.out or Path("runs") / origin["command"] / date
    recorder = Recorder(robot, out / _RECORDING)

    with (
        RobotLink(robot, SerialLink(robot, port), limits, recorder) as link,
        stop_on_signals() as stop,
    ):
        run_file = _RunFile(out, link, port, settings, gains, origin)

        def confirm() -> None:
            teleop.confirm_arming(stop, settings.yes, how_to_stop, show)
            run_file.begin()

        session = Session(link, gains, stop, not settings.without_imu, confirm, show)
        try:
            yield session, out
        except BaseException as error:
            outcome = type(error).__name__
            if isinstance(error, Exception):
                outcome = fault_of(error).name
            with suppress(ArtifactError):  # the error that ended the run is more important
                run_file.end(session, outcome, str(error))
            raise
        run_file.end(session, session.outcome, None)


@dataclass
class _RunFile:
    """run.json: ``origin``, settings, gains and limits (an infinite one is null), and the outcome.

    The outcome is "time", "operator", the name of a signal, or the name of a fault with its
    message.
    """

    out: Path
    link: RobotLink
    port: str
    settings: RunSettings
    gains: Gains
    origin: dict[str, Any]

    def __post_init__(self) -> None:
        self._beginning: dict[str, Any] = {}

    def begin(self) -> None:
        """Write what is known when the operator has confirmed."""
        settings = {
            name: str(value) if isinstance(value, Path) else value
            for name, value in asdict(self.settings).items()
        }
        limits = {
            name: value if math.isfinite(value) else None
            for name, value in asdict(self.link.limits).items()
        }
        self._beginning = {
            "port": self.port,
            "robot": self.link.robot.name,
            "started": _now(),
            "settings": settings,
            "gains": asdict(self.gains),
            "safety": limits,
            **self.origin,
        }
        write_json(self.out / "run.json", self._beginning)

    def end(self, session: Session, outcome: str, message: str | None) -> None:
        """Add the outcome, and write figures.json; nothing if the run did not begin."""
        if not self._beginning:
            return
        link = self.link
        frames = {
            "accepted": link.stream.accepted,
            "repeated": link.stream.repeated,
            "impossible": link.stream.impossible,
            "damaged": link.port.reader.rejected,
        }
        ending = {
            "ended": _now(),
            "outcome": outcome,
            "message": message,
            "position_clips": link.gate.position_clips,
            "slew_clips": link.gate.slew_clips,
            "commands": link.sent,
            "frames": frames,
        }
        write_json(self.out / "run.json", self._beginning | ending)
        figures = clock_figures(session.timing, link.robot.control_dt)
        write_json(self.out / "figures.json", figures)


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
