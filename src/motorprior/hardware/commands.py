"""What a person asks of a robot: deploy, record, doctor. Checks, the files they leave, and the words in between.

The command line `motorprior` and, on the robot's own computer, `python -m motorprior.hardware` both end here.
"""

from __future__ import annotations

import contextlib
import select
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TextIO

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware import deploy, record
from motorprior.hardware.control_loop import Timing, clock_figures
from motorprior.hardware.doctor import Diagnosis, examine
from motorprior.hardware.excitations import excitation_targets, joints_of
from motorprior.hardware.pilot import KEYS, pilot
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.robot import Robot
from motorprior.hardware.run_facts import RunFacts
from motorprior.hardware.serial_link import SerialLink, find_ports
from motorprior.hardware.session import Gains, StopRequest, stop_on_signals
from motorprior.hardware.settings import DeploySettings, RecordSettings
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2 import spec

LOG = "run.csv"
Say = Callable[[str], None]


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
            "no serial port that a robot could be on", remedy="plug it in and switch it on, or give --port"
        )
    raise ConfigError(f"several ports: {', '.join(found)}", remedy="say which one with --port")


def run_deploy(path: Path, port: str, settings: DeploySettings, say: Say) -> dict[str, float]:
    """Walk; returns the figures of the run's timing.

    Raises:
        ArtifactError, ConfigError: a policy that does not fit, settings out of range, or a folder in use.
        RobotFault: why the walk ended early.
    """
    _require("seconds", settings.seconds, 0.0, 1e6)
    _require("throttle", settings.throttle, 0.0, 1.0, or_equal=True)
    policy = Policy.load(path)
    deploy.check_policy(policy)
    gains = replace(deploy.gains_for(policy, settings.kp, settings.kd), max_current=settings.max_current)
    _require_gains(gains)
    if settings.dry_run:
        with Robot(SerialLink(port)) as robot, stop_on_signals() as stop:
            steps = deploy.rehearse(robot, policy, stop, settings.seconds or 5.0, say)
        say(f"dry run: {steps} control steps, nothing was sent")
        return {}
    _require_somebody(settings.yes)
    out = settings.out or _dated("deploy")
    facts, timing = RunFacts(out), Timing()
    robot = Robot(SerialLink(port), recorder=Recorder(out / LOG))
    with robot, stop_on_signals() as stop, facts.kept(robot, timing, policy.control_dt):

        def confirm() -> None:
            ask_to_arm(stop, settings.yes, say)
            more = {"policy": str(path), "provenance": dict(policy.provenance)}
            facts.begin("deploy", port, settings, gains, robot, more)

        run = deploy.walk(
            robot, policy, gains, stop,
            seconds=settings.seconds, need_imu=not settings.without_imu, confirm=confirm,
            pilot=lambda: pilot(settings.throttle), status=say, timing=timing,
        )  # fmt: skip
        facts.outcome = run.stopped_by
    say(f"stopped by {run.stopped_by or 'nobody'}; {out / LOG}")
    return clock_figures([timing], policy.control_dt)


def run_record(port: str, settings: RecordSettings, say: Say) -> Path:
    """Excite and record; returns the log.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a folder in use.
        RobotFault: why it ended early; the recording is kept.
    """
    _require("seconds", settings.seconds, 1.0, 3600.0, or_equal=True)
    _require("amplitude", settings.amplitude, 0.0, 1.5)
    _require("speed", settings.speed, 0.0, spec.SAFETY.target_speed)
    if settings.seed < 0:
        raise ConfigError(f"--seed {settings.seed} is below 0", remedy="give 0 or more")
    gains = Gains(settings.kp, settings.kd, settings.max_current)
    _require_gains(gains)
    joints = joints_of(settings.joint)
    targets = excitation_targets(
        settings.excitation,
        joints,
        settings.seconds,
        _amplitude(settings),
        settings.speed,
        spec.CONTROL_DT,
        settings.seed,
    )
    _require_somebody(settings.yes)
    out = settings.out or _dated("record")
    limits = replace(spec.SAFETY, target_speed=settings.speed)
    if not settings.standing:
        limits = replace(limits, max_tilt=float("inf"))  # it may hang askew
    facts, timing = RunFacts(out), Timing()
    robot = Robot(SerialLink(port), limits, Recorder(out / LOG))
    with robot, stop_on_signals() as stop, facts.kept(robot, timing, spec.CONTROL_DT):

        def confirm() -> None:
            ask_to_arm(stop, settings.yes, say)
            facts.begin("record", port, settings, gains, robot)

        record.excite(
            robot, targets, settings.speed, gains, stop,
            hung=not settings.standing, need_imu=settings.standing and not settings.without_imu,
            confirm=confirm, status=say, timing=timing,
        )  # fmt: skip
        facts.outcome = stop.reason or "time"
    return out / LOG


def run_doctor(port: str, seconds: float, idle: bool) -> list[Diagnosis]:
    """Listen and judge; sends nothing, or idle and nothing else.

    Raises:
        ConfigError: less than a second.
        RobotFault: nothing came, or the port is gone.
    """
    _require("seconds", seconds, 1.0, 3600.0, or_equal=True)
    with Robot(SerialLink(port)) as robot:
        if idle:
            robot.relax()
        return examine(robot, seconds)


def require_well(found: list[Diagnosis]) -> None:
    """Refuse what a doctor found.

    Raises:
        RobotFault: something is not as it should be.
    """
    bad = [one.check for one in found if not one.well]
    if bad:
        raise RobotFault("doctor", f"{', '.join(bad)}: not as it should be", remedy="see the remedies above")


def ask_to_arm(stop: StopRequest, yes: bool, say: Say) -> None:
    """Wait until somebody types ``arm``.

    Raises:
        RobotFault: something else was typed, or a signal came.
    """
    if yes:
        return
    say(f"Stand clear, one hand at the power switch. Keys while it moves: {KEYS}; Ctrl-C sits down, twice drops it.")
    say("Type arm and press Enter:")
    while not stop():
        if select.select([sys.stdin], [], [], 0.1)[0]:
            if sys.stdin.readline().strip() == "arm":
                return
            break
    raise RobotFault("not armed", "nobody typed arm; nothing was sent", remedy="run the command again when ready")


def careful(say: Say, file: TextIO) -> Say:
    """The same words, unless the terminal or pipe behind ``file`` is gone or full: no reason to stop, or to wait.

    A control loop that waits for a terminal (Ctrl-S, a pager) would be idled by the watchdog.
    """

    def speak(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            if _takes_more(file):
                say(text)

    return speak


def _takes_more(file: TextIO) -> bool:
    try:
        number = file.fileno()
    except (OSError, ValueError):  # a notebook's, or a test's: no terminal, never full
        return True
    return bool(select.select([], [number], [], 0.0)[1])


def _amplitude(settings: RecordSettings) -> float:
    """What the ground lets pass is less than what the air does: feet that are pushed into it look blocked."""
    if settings.amplitude is not None:
        return settings.amplitude
    return 0.1 if settings.standing else 0.4


def _require_somebody(yes: bool) -> None:
    if not yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise ConfigError("nobody is at the terminal to arm the robot", remedy="give --yes if that is meant")


def _require(name: str, value: float | None, low: float, high: float, or_equal: bool = False) -> None:
    if value is None or low < value <= high or (or_equal and value == low):
        return
    bound = "at least" if or_equal else "more than"
    raise ConfigError(f"--{name} {value:g} is out of range", remedy=f"give {bound} {low:g} and at most {high:g}")


def _require_gains(gains: Gains) -> None:
    limits = spec.SAFETY
    _require("kp", gains.kp, 0.0, limits.highest_kp)
    _require("kd", gains.kd, 0.0, limits.highest_kd)
    _require("max-current", gains.max_current, 0.0, limits.max_current)


def _dated(command: str) -> Path:
    return Path("runs") / command / datetime.now().strftime("%Y%m%d-%H%M%S")
