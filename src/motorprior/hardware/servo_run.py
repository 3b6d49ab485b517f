"""A recording of servos on a bus, with its files and messages.

    scan, confirm, arm, first motion, ramp to the start, [part, ramp] …, ramp to rest, release

The robot is released where it rested by itself before the recording. A fault that leaves no time
to return there lowers the torque limit, so that the robot sinks, and then switches the torque off.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import write_json
from motorprior.bounds import require_number
from motorprior.exceptions import ArtifactError, ConfigError, RobotFault
from motorprior.hardware.buses.bus import Clock, MonotonicClock, NoAnswer, ServoBus, ServoInfo
from motorprior.hardware.control_loop import real_time
from motorprior.hardware.servo_link import (
    ChainJoints,
    ServoLimits,
    ServoLink,
    differences,
    require_one_model,
    require_ready,
    scanned,
)
from motorprior.hardware.servo_recorder import ServoRecorder
from motorprior.hardware.session import fault_of, stop_on_signals
from motorprior.hardware.teleop import Print, confirm_arming, require_confirmation
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.logs.readers.servo_recording import ENDING, VERSION
from motorprior.robots.servos import MotionPart, ServoChain

RECORDING = f"run{ENDING}"
_HOW_TO_STOP = "Ctrl-C returns to the present pose and switches the torque off; twice: off at once"
_SLOW_BUS = 100.0  # [Hz]
_READ_PERIOD = 0.02  # of a diagnosis [s]
_MIN_RAMP = 0.3  # [s]
_SETTLING = 0.3  # time in which a first motion must have followed [s]
# makes the parts of a recording from the control period [s] and the joints' limits [rad]
Plan = Callable[[float, np.ndarray, np.ndarray], Sequence[MotionPart]]


@dataclass(frozen=True, kw_only=True)
class RecordedRobot:
    """What a recording states about the robot that is not in its servos."""

    name: str
    motor: str
    joint_names: tuple[str, ...]
    joint_classes: tuple[str, ...]
    lower: np.ndarray  # (n,) [rad]
    upper: np.ndarray  # (n,) [rad]
    chain: ServoChain
    posture: str  # "fixed" or "suspended"
    encoder: str = "joint"
    # length [m], mass and bar_mass [kg] of the pendulum on a motor without robot; else empty
    pendulum: dict[str, float] | None = None


@dataclass(frozen=True, kw_only=True)
class ServoSettings:
    """Settings of a recording of servos."""

    out: Path
    yes: bool = False  # arm without asking
    max_rate: float = 250.0  # of control steps [Hz]
    profile: str = "keep"  # the profile's acceleration during the recording: "keep" or "off"
    limits: ServoLimits = field(default_factory=ServoLimits)


def record_servos(
    robot: RecordedRobot,
    bus: ServoBus,
    clock: Clock,
    plan: Plan,
    settings: ServoSettings,
    show: Print,
    watch: str | None = None,
) -> Path:
    """Scan, confirm, play the plan and record; returns the recording.

    Args:
        robot: the recorded robot.
        bus: the open bus.
        clock: the time of the bus.
        plan: makes the parts.
        settings: see `ServoSettings`.
        show: prints messages.
        watch: name of the port for the watchdog process; None for a bus in simulated time.

    Raises:
        ConfigError: a setting out of range, or servos of several models.
        RobotFault: a fault ended the recording early; its file is kept.
        ArtifactError: the recording exists, or the disk is full.
    """
    if settings.profile not in ("keep", "off"):
        raise ConfigError(
            f"profile {settings.profile!r} is unknown",
            remedy="give keep or off",
            argument="profile",
        )
    require_confirmation(settings.yes)
    infos = scanned(bus, robot.chain)
    require_one_model(infos)
    for line in scan_report(infos):
        show(line)

    joints = ChainJoints(
        robot.joint_names, robot.lower, robot.upper, robot.chain, bus.counts
    ).within(infos)
    recorder = ServoRecorder(settings.out / RECORDING, header(robot, bus, infos, settings))
    link = ServoLink(bus, joints, infos, clock, settings.limits, recorder, watch)
    try:
        with stop_on_signals() as stop:
            run = _Run(link, settings, stop, show)
            run.go(plan)
    finally:
        link.release()
        recorder.close()
    early = f" until {stop[0]}" if stop else ""
    show(f"recorded {recorder.path}{early}: {recorder.rows} readings, {link.lost} lost")
    return recorder.path


def diagnose_servos(
    robot: RecordedRobot, bus: ServoBus, clock: Clock, seconds: float, idle: bool, show: Print
) -> None:
    """Show what the servos state, and how their joints move by hand during ``seconds`` [s].

    Writes nothing; with ``idle`` it switches torque and bus watchdog off first. Raises RobotFault
    if a servo does not answer or reports a condition.
    """
    require_number("seconds", seconds, 1.0, 3600.0)
    if idle:
        bus.ids = robot.chain.ids
        bus.set_torque(False)
        bus.set_bus_watchdog(np.zeros(len(bus.ids)))
    infos = bus.scan(robot.chain.ids)
    for line in scan_report(infos):
        show(line)
    require_ready(infos, robot.chain)

    bus.ids = robot.chain.ids
    joints = ChainJoints(robot.joint_names, robot.lower, robot.upper, robot.chain, bus.counts)
    angles = []
    end = clock.clock() + seconds
    while clock.clock() < end:
        with contextlib.suppress(NoAnswer):
            angles.append(joints.pos(bus.read().counts))
        clock.wait_until(clock.clock() + _READ_PERIOD)
    if not angles:
        raise RobotFault(
            "silence", f"no complete answer in {seconds:g} s", remedy="check the cable"
        )
    for index, name in enumerate(joints.names):
        column = np.array(angles)[:, index]
        show(
            f"{name}: {column[-1]:+.3f} rad, was {column.min():+.3f} to {column.max():+.3f}; "
            f"limits {joints.lower[index]:+.2f} to {joints.upper[index]:+.2f}"
        )


@dataclass
class _Run:
    """A recording from scan to release."""

    link: ServoLink
    settings: ServoSettings
    stop: Sequence[str]  # names of the signals received so far; the run ends at the first
    show: Print
    # poses of the way back to rest [rad]: the way between rest and the first pose of the motion is
    # the only one that leads out of it
    way_back: list[np.ndarray] = field(default_factory=list)

    def go(self, plan: Plan) -> None:
        link = self.link
        link.measure_rate(self.settings.max_rate)
        self.show(
            f"bus: {link.rate_of_bus:.0f} readings of all servos per second; "
            f"recording at {1.0 / link.period:.0f} Hz"
        )
        if link.rate_of_bus < _SLOW_BUS:
            self.show(
                "the bus is slow: set the latency timer of an FTDI converter to 1 ms "
                "(docs/hardware.md), or raise the servos' baud rate"
            )
        parts = plan(link.period, link.joints.lower, link.joints.upper)
        seconds = link.period * sum(len(part.targets) for part in parts)
        self.show(f"{len(parts)} parts, {seconds:.0f} s")
        confirm_arming(self.stop, self.settings.yes, _HOW_TO_STOP, self.show)

        rest = np.clip(link.pos, link.joints.lower, link.joints.upper)
        self.way_back = [rest]
        in_time = real_time() if isinstance(link.clock, MonotonicClock) else nullcontext()
        outcome = "time"
        message = ""
        try:
            with in_time:
                self._play(parts, rest)
        except Exception as error:
            fault = fault_of(error)
            outcome = fault.name
            message = str(error)
            self._end_after(fault)
            raise
        finally:
            link.release()
            if self.stop and outcome == "time":
                outcome = self.stop[0]
            ending = {"outcome": outcome, "message": message, "lost": link.lost}
            with contextlib.suppress(ArtifactError):
                write_json(self.settings.out / "run.json", ending)

    def _play(self, parts: Sequence[MotionPart], rest: np.ndarray) -> None:
        link = self.link
        if self.settings.profile == "off":
            link.set_profile([0.0] * len(link.infos))
        link.arm()
        self._first_motions(rest)
        link.allow_full_torque()
        self.way_back = [parts[0].targets[0], rest]
        for number, part in enumerate(parts):
            if self.stop:
                self.show(f"stopped by {self.stop[0]}; back to rest")
                break
            self.show(f"{number + 1} of {len(parts)}: {part.name}")
            self._ramp(part.targets[0], Mode.RAMP)
            for target in part.targets:
                if self.stop:
                    break
                link.step(target, Mode.EXCITE, number, link.limits.target_speed)
        self._return_to_rest()

    def _return_to_rest(self) -> None:
        for pose in self.way_back:
            self._ramp(pose, Mode.CROUCH)

    def _first_motions(self, rest: np.ndarray) -> None:
        """Move each joint a little with little torque; raises RobotFault if one does not follow."""
        link = self.link
        limits = link.limits
        joints = link.joints
        # away from the nearer limit
        room = np.where(joints.upper - rest > rest - joints.lower, 1.0, -1.0)
        for joint, name in enumerate(joints.names):
            if self.stop:
                return
            goal = rest.copy()
            goal[joint] += limits.first_motion * room[joint]
            before = link.pos[joint]
            self._ramp(goal, Mode.RAMP, hold=_SETTLING)
            moved = (link.pos[joint] - before) * room[joint]
            if moved < (1.0 - limits.first_error) * limits.first_motion and not self.stop:
                raise RobotFault(
                    "first motion",
                    f"{name} moved {moved:+.3f} rad for a target {limits.first_motion:g} rad away",
                    remedy="check that it is free, its sign in [servos], and its torque limit",
                )
            self._ramp(rest, Mode.RAMP)

    def _ramp(self, goal: np.ndarray, mode: Mode, hold: float = 0.0) -> None:
        """Move slowly to a pose [rad], on a cosine in time, and hold it for ``hold`` [s]."""
        link = self.link
        start = link.target.copy()
        goal = np.clip(goal, link.joints.lower, link.joints.upper)
        distance = float(np.abs(goal - start).max())
        speed = link.limits.slow_speed
        steps = math.ceil(max(_MIN_RAMP, 0.5 * math.pi * distance / speed) / link.period)
        for step in range(1, steps + round(hold / link.period) + 1):
            if self.stop and mode is not Mode.CROUCH:
                return
            share = 0.5 - 0.5 * math.cos(math.pi * min(1.0, step / steps))
            # the ramp keeps to its speed itself; the gate only stops jumps
            link.step(start + share * (goal - start), mode, -1, 2.0 * speed)

    def _end_after(self, fault: RobotFault) -> None:
        """Return to rest, or sink, after a fault; the torque is switched off afterwards."""
        if fault.safe_state == "crouch":
            try:
                self._return_to_rest()
                return
            except Exception:  # the first fault is reported
                pass
        if fault.name != "stopped":  # a second signal: off at once
            self.link.sink()


def scan_report(infos: Sequence[ServoInfo]) -> list[str]:
    """Lines about the servos found, and what differs between them."""
    lines = []
    for info in infos:
        p, i, d = info.gains
        speed = f"{info.profile_speed:.3g} rad/s" if info.profile_speed else "off"
        acceleration = "off"
        if info.profile_acceleration:
            acceleration = f"{info.profile_acceleration:.3g} rad/s²"
        low, high = info.position_limits
        lines.append(
            f"servo {info.id}: {info.model}, firmware {info.firmware}, {info.voltage:.1f} V, "
            f"{info.temperature:.0f} °C, P {p} I {i} D {d}, profile speed {speed}, "
            f"acceleration {acceleration}, torque limit {100 * info.torque_limit:.0f} %, "
            f"counts {low} to {high}, offset {info.offset}"
        )
    return lines + differences(infos)


def header(
    robot: RecordedRobot, bus: ServoBus, infos: Sequence[ServoInfo], settings: ServoSettings
) -> dict[str, Any]:
    """The first line of a recording: everything that is known."""
    chain = robot.chain
    servos = []
    for index, info in enumerate(infos):
        servos.append(
            {"joint": robot.joint_names[index], "sign": chain.signs[index],
             "zero_count": chain.zeros[index], **asdict(info)}
        )  # fmt: skip
    content: dict[str, Any] = {
        "version": VERSION,
        "robot": robot.name,
        "motor": robot.motor,
        "posture": robot.posture,
        "encoder": robot.encoder,
        "joint_names": list(robot.joint_names),
        "joint_classes": list(robot.joint_classes),
        "p_gains": [info.gains[0] for info in infos],
        "firmware": firmware(infos, settings),
        "units": {"load": bus.load_unit, "current": bus.current_unit},
        "servos": servos,
        "settings": {"profile": settings.profile, "max_rate": settings.max_rate},
    }
    if robot.pendulum is not None:
        content["pendulum"] = robot.pendulum
    return content


def firmware(infos: Sequence[ServoInfo], settings: ServoSettings) -> dict[str, float]:
    """Registers of `logs.motor_log.FIRMWARE` that are equal for all servos."""
    registers = {"output_encoder": 1.0}  # motors of the registry measure their output shaft
    for name in ("profile_speed", "profile_acceleration", "dead_zone"):
        values = {getattr(info, name) for info in infos}
        if name == "profile_acceleration" and settings.profile == "off":
            values = {0.0}
        if len(values) == 1:
            registers[name] = values.pop()
    return registers
