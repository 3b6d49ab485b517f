"""The commands deploy, record and doctor: checks, the files they leave, and messages to the user.

The command line `motorprior` and, on the robot's own computer, `python -m motorprior.hardware` both end here.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware import deploy, excitation_run
from motorprior.hardware.control_loop import Timing, clock_results
from motorprior.hardware.doctor import Diagnosis, examine
from motorprior.hardware.excitations import excitation_targets, joints_of
from motorprior.hardware.pilot import pilot, walks_alone
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.run_facts import RunFacts
from motorprior.hardware.serial_link import SerialLink, find_ports
from motorprior.hardware.session import Gains, stop_on_signals
from motorprior.hardware.settings import DeploySettings, Excitation, RecordSettings
from motorprior.hardware.terminal import HUNG, STANDING, WALKING, Say, ask_to_arm, require_terminal
from motorprior.locomotion.policy import Policy
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits

LOG = "run.csv"
_FAST, _CAREFUL = 40.0, 8.0
"""Fastest targets [rad/s], see `RecordSettings`."""
_NEVER_PUSHED = (
    "note: this policy was trained without pushes, and a pause of this computer may throw it over: measure how long a "
    "pause it survives, and give that as longest_pause ('A machine that stands still' in docs/hardware.md)"
)
_SHORTEST_PAUSE = 0.02
"""The shortest one that was measured [s]; nearly every computer pauses for less now and then."""
_RECOGNISED = 0.3
"""Time in which telemetry must prove that the device is a robot [s]."""


def the_port(port: str | None) -> str:
    """The port that was given, or the only one there is.

    Raises:
        ConfigError: none, or more than one.
    """
    if port is not None:
        return port
    found = find_ports()
    if len(found) == 1:
        return found[0]
    if not found:
        raise ConfigError(
            "no serial port that a robot could be on", remedy="plug it in and switch it on, or give its name"
        )
    raise ConfigError(f"several ports: {', '.join(found)}", remedy="give one of them as port", argument="port")


def run_deploy(robot: Robot, path: Path, port: str, settings: DeploySettings, say: Say) -> Results:
    """Walk; returns how well its clock was kept.

    Raises:
        ArtifactError, ConfigError: a policy that does not fit, settings out of range, or a folder in use.
        RobotFault: why the walk ended early.
    """
    _require("seconds", settings.seconds, 0.0, 1e6)
    policy = Policy.load(path)
    deploy.check_policy(robot, policy)
    gait = policy.commanded(robot).require_legs()
    if settings.forward is not None:
        _require("forward", settings.forward, *gait.forward, or_equal=True)
    _require("yaw_rate", settings.yaw_rate, -gait.yaw_rate, gait.yaw_rate, or_equal=True)
    command = walks_alone(gait) if settings.forward is None else settings.forward, settings.yaw_rate
    gains = deploy.gains_for(robot, policy, settings.kp, settings.kd, settings.max_current)
    _require_gains(gains, robot.require_wire().safety)
    limits = _with_pause(robot.require_wire().safety, settings.longest_pause)
    if settings.dry_run:
        with RobotLink(robot, SerialLink(robot, port)) as link, stop_on_signals() as stop:
            seconds, has_imu = settings.seconds or 5.0, not settings.without_imu
            steps = deploy.rehearse(link, policy, stop, seconds, say, command, has_imu)
        say(f"dry run: {steps} control steps, nothing was sent")
        return Results()
    require_terminal(settings.yes)
    if settings.longest_pause is None and never_pushed(policy):
        say(_NEVER_PUSHED)
    out = settings.out or _dated("deploy")
    facts, timing = RunFacts(out), Timing()
    link = RobotLink(robot, SerialLink(robot, port), limits, Recorder(robot, out / LOG))
    with link, stop_on_signals() as stop, facts.kept(link, timing, policy.control_dt):

        def confirm() -> None:
            ask_to_arm(stop, settings.yes, WALKING, say)
            more = {"policy": str(path), "provenance": dict(policy.provenance)}
            facts.begin("deploy", port, settings, gains, link, more)

        run = deploy.walk(
            link, policy, gains, stop,
            command=command, seconds=settings.seconds, need_imu=not settings.without_imu, confirm=confirm,
            pilot=lambda: pilot(gait, settings.forward, settings.yaw_rate), status=say, timing=timing,
        )  # fmt: skip
        facts.outcome = run.stopped_by
    say(f"stopped by {run.stopped_by}; {out / LOG}")
    return clock_results([timing], policy.control_dt)


def never_pushed(policy: Policy) -> bool:
    """Whether a policy says that nothing pushed its robots in training."""
    randomization = policy.provenance.get("randomization")
    return isinstance(randomization, dict) and randomization.get("push") == 0.0


def run_record(robot: Robot, port: str, settings: RecordSettings, say: Say) -> Path:
    """Excite and record; returns the log.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a folder in use.
        RobotFault: why it ended early; the recording is kept.
    """
    wire = robot.require_wire()
    _require("seconds", settings.seconds, 1.0, 3600.0, or_equal=True)
    _require("amplitude", settings.amplitude, 0.0, 1.5)
    excitation, amplitude = _excitation(settings), _amplitude(settings)
    speed = _speed(settings, wire.safety.target_speed)
    _require("speed", speed, 0.0, wire.safety.target_speed)
    if settings.seed < 0:
        raise ConfigError(f"seed {settings.seed} is below 0", remedy="give 0 or more", argument="seed")
    gains = Gains.of(wire, settings.kp, settings.kd, settings.max_current)
    _require_gains(gains, wire.safety)
    joints = joints_of(robot, settings.joint)
    targets = excitation_targets(robot, excitation, joints, settings.seconds, amplitude, speed, settings.seed)
    require_terminal(settings.yes)
    out = settings.out or _dated("record")
    used = replace(settings, excitation=excitation, amplitude=amplitude, speed=speed)
    limits = replace(wire.safety, target_speed=speed)
    if not settings.standing:
        limits = replace(limits, max_tilt=float("inf"))  # it may hang askew
    facts, timing = RunFacts(out), Timing()
    link = RobotLink(robot, SerialLink(robot, port), limits, Recorder(robot, out / LOG))
    with link, stop_on_signals() as stop, facts.kept(link, timing, robot.control_dt):

        def confirm() -> None:
            ask_to_arm(stop, settings.yes, STANDING if settings.standing else HUNG, say)
            facts.begin("record", port, used, gains, link)

        excitation_run.excite(
            link, targets, gains, stop,
            hung=not settings.standing, need_imu=settings.standing and not settings.without_imu,
            confirm=confirm, status=say, timing=timing,
        )  # fmt: skip
        facts.outcome = stop.reason or "time"
    return out / LOG


def run_doctor(robot: Robot, port: str, seconds: float, idle: bool) -> list[Diagnosis]:
    """Check the telemetry of a robot; sends nothing, or only idle.

    Raises:
        ConfigError: less than a second.
        RobotFault: nothing came, or the port is gone.
    """
    _require("seconds", seconds, 1.0, 3600.0, or_equal=True)
    with RobotLink(robot, SerialLink(robot, port)) as link:
        if idle:
            examine(link, _RECOGNISED)  # an unknown device at the port gets no bytes
            link.relax()
        return examine(link, seconds)


def require_well(found: list[Diagnosis]) -> None:
    """Refuse a robot with a finding that is not as it should be.

    Raises:
        RobotFault: something is not as it should be.
    """
    bad = [one.check for one in found if not one.well]
    if bad:
        raise RobotFault("doctor", f"{', '.join(bad)}: not as it should be", remedy="see the remedies above")


def _amplitude(settings: RecordSettings) -> float:
    """The largest amplitude [rad]; a smaller one on the ground, where feet that are pushed into it look blocked."""
    if settings.amplitude is not None:
        return settings.amplitude
    return 0.1 if settings.standing else 0.4


def _excitation(settings: RecordSettings) -> Excitation:
    """Steps of a leg that carries would tip a standing robot."""
    if settings.excitation is not None:
        return settings.excitation
    return "multisine" if settings.standing else "varied"


def _speed(settings: RecordSettings, most: float) -> float:
    """The fastest target [rad/s], no faster than the robot's ``most`` unless asked for.

    In the air steps must be fast, to bring a motor to its limit of torque.
    """
    if settings.speed is not None:
        return settings.speed
    fast = _excitation(settings) in ("steps", "varied") and not settings.standing
    return min(most, _FAST if fast else _CAREFUL)


def _require(name: str, value: float | None, low: float, high: float, or_equal: bool = False) -> None:
    if value is None or low < value <= high or (or_equal and value == low):
        return
    bound = "at least" if or_equal else "more than"
    raise ConfigError(
        f"{name} {value:g} is out of range", remedy=f"give {bound} {low:g} and at most {high:g}", argument=name
    )


def _require_gains(gains: Gains, limits: SafetyLimits) -> None:
    _require("kp", gains.kp, 0.0, limits.highest_kp)
    _require("kd", gains.kd, 0.0, limits.highest_kd)
    _require("max_current", gains.max_current, 0.0, limits.max_current)


def _with_pause(limits: SafetyLimits, longest: float | None) -> SafetyLimits:
    """Limits with a shorter pause to ride out [s].

    The watchdog waits as long as before, so that after a pause between the two the host is there to sit down.
    """
    if longest is None:
        return limits
    _require("longest_pause", longest, _SHORTEST_PAUSE, limits.tick_delay, or_equal=True)
    return replace(limits, tick_delay=longest)


def _dated(command: str) -> Path:
    return Path("runs") / command / datetime.now().strftime("%Y%m%d-%H%M%S")
