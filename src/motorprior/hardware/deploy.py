"""Let a trained policy walk a robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.control_loop import ControlLoop, Timing
from motorprior.hardware.motions import Walker
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, StopRequest, first_look, look_and_confirm, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion.policy import Policy
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.robot import Robot

GAIN_TOLERANCE = 0.15
"""A policy's gains may differ from the robot's by this share: they come out of a fit."""
_STATUS_EVERY = 50
_WIND_DOWN = 1.0
"""Time to come to rest before crouching [s]: of 36 walks on the twin that were stopped at full speed, 11 tilted beyond
0.5 rad without it, none with it."""


class Pilot(Protocol):
    """A person who steers, with keyboard or gamepad."""

    def command(self) -> tuple[float, float] | None:
        """Speed [m/s] and yaw rate [rad/s], or None to stop."""
        ...


@dataclass(frozen=True)
class Run:
    """Outcome of a walk.

    Attributes:
        timing: of the walk.
        stopped_by: "time", "pilot", or the name of a signal.
    """

    timing: Timing
    stopped_by: str


def gains_for(
    robot: Robot,
    policy: Policy,
    kp: float | None = None,
    kd: float | None = None,
    max_current: float | None = None,
) -> Gains:
    """The gains to send for a policy.

    A policy states the gains of the motors it was trained on in N·m/rad, a wire its own in A/rad; the torque constant
    [N·m/A] is between them. The fleets were identified at the wire's, so where the two agree to 15 % these are sent.

    Args:
        robot: with a wire.
        policy: to be deployed.
        kp: sent instead [A/rad].
        kd: sent instead [A·s/rad].
        max_current: sent instead of the robot's own [A].

    Raises:
        ConfigError: the policy's gains are others and none were given.
    """
    wire = robot.require_wire()
    for name, unit, given, of_policy, of_robot, highest in (
        ("kp", "A/rad", kp, policy.kp, wire.kp, wire.safety.highest_kp),
        ("kd", "A·s/rad", kd, policy.kd, wire.kd, wire.safety.highest_kd),
    ):
        wanted = of_policy / wire.torque_constant
        if given is None and np.abs(wanted / of_robot - 1.0).max() > GAIN_TOLERANCE:
            mean = float(wanted.mean())
            raise ConfigError(
                f"the policy was trained with {name} = {mean:.1f} {unit} on its motors, the robot has {of_robot:g}",
                remedy=(f"give {name} {mean:.1f} if that is meant, or " if mean <= highest else "")
                + "train it with the robot's gains",
                argument=name,
            )
    return Gains.of(wire, kp, kd, max_current)


def check_policy(robot: Robot, policy: Policy) -> None:
    """Refuse a policy that this robot cannot run.

    Raises:
        ArtifactError: a damaged one.
        ConfigError: one for another robot, other joints or another control period.
    """
    policy.check()
    policy.require_robot(robot)
    policy.require_clock(robot.control_dt)


def walk(
    link: RobotLink,
    policy: Policy,
    gains: Gains,
    stop: StopRequest,
    *,
    command: tuple[float, float] = (0.0, 0.0),
    seconds: float | None = None,
    need_imu: bool = True,
    confirm: Callable[[], None] = lambda: None,
    pilot: Callable[[], AbstractContextManager[Pilot | None]] = nullcontext,
    status: Callable[[str], None] = lambda _: None,
    timing: Timing | None = None,
) -> Run:
    """Look at the robot, arm it, stand up, walk, sit down.

    Args:
        link: idle.
        policy: see `check_policy`.
        gains: to send.
        stop: ends the walk.
        command: speed [m/s] and yaw rate [rad/s] where nobody steers; a ``pilot`` has its own to begin with.
        seconds: ends it too [s].
        need_imu: refuse a robot whose IMU is not read.
        confirm: the arm step; raises if the user does not want to.
        pilot: opened when the robot walks, and asked at every control step.
        status: gets a line twice a second.
        timing: filled with the walk's, also if a fault ends it.

    Raises:
        RobotFault: why the walk ended early; the robot is idle.
    """
    walker = Walker(link.robot, policy, need_imu)
    walker.rates_at_rest = look_and_confirm(link, confirm, need_imu, walker.warm_up).rates
    timing, ended_by = timing or Timing(), ""

    def work(loop: ControlLoop) -> None:
        end = time.monotonic() + seconds if seconds is not None else float("inf")

        def motion(measurement: Measurement) -> np.ndarray | None:
            nonlocal ended_by
            wanted = steering.command() if steering is not None else command
            if wanted is None or time.monotonic() >= end:
                ended_by = "pilot" if wanted is None else "time"
                return None
            walker.forward, walker.yaw_rate = wanted
            return walker(measurement)

        with pilot() as steering:
            loop.play(motion, Mode.WALK, _status_line(link, walker, status), timing)

    run_armed(link, gains, stop, work, wind_down=lambda: walker.winding_down(_WIND_DOWN))
    return Run(timing, ended_by or stop.reason or "")


def rehearse(
    link: RobotLink,
    policy: Policy,
    stop: StopRequest,
    seconds: float,
    status: Callable[[str], None],
    command: tuple[float, float] = (0.0, 0.0),
    has_imu: bool = True,
) -> int:
    """Compute the targets of a policy for a command, and send nothing; returns the number of control steps.

    Args:
        link: idle.
        policy: see `check_policy`.
        stop: ends it.
        seconds: ends it too [s].
        status: gets a line twice a second.
        command: speed [m/s] and yaw rate [rad/s].
        has_imu: see `Walker`.

    Raises:
        RobotFault: targets that are not finite, or a robot that `first_look` or `RobotLink.check` refuses.
    """
    walker = Walker(link.robot, policy, has_imu)
    look = first_look(link, need_imu=False)
    walker.warm_up(look.measurement)
    walker.rates_at_rest = look.rates
    walker.forward, walker.yaw_rate = command
    show, steps = _status_line(link, walker, status), 0
    deadline = time.monotonic()
    end = deadline + seconds
    while deadline < end and not stop():
        deadline += policy.control_dt
        link.receive(deadline)
        measurement = link.check()
        target = walker(measurement)
        if not np.all(np.isfinite(target)):
            raise RobotFault("impossible command", f"the policy's targets are {target.tolist()}")
        show(measurement)
        steps += 1
    return steps


def _status_line(link: RobotLink, walker: Walker, status: Callable[[str], None]) -> Callable[[Measurement], None]:
    """A function that gives ``status`` a line every 50 control steps."""
    count, period = 0, link.robot.control_dt

    def show(measurement: Measurement) -> None:
        nonlocal count
        count += 1
        if count % _STATUS_EVERY:
            return
        telemetry, stream = measurement.telemetry, link.stream
        age = 1e3 * (time.monotonic() - measurement.sampled)
        battery = f", {telemetry.bat:.1f} V" if telemetry.bat is not None else ""
        status(
            f"{period * count:6.1f} s  roll {telemetry.roll:+.2f} pitch {telemetry.pitch:+.2f} rad  command "
            f"{walker.forward:+.2f} m/s {walker.yaw_rate:+.1f} rad/s  telemetry {age:.0f} ms old, damaged "
            f"{link.rejected + stream.impossible}{battery}"
        )

    return show
