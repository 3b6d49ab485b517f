"""Walk a robot with a trained policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.control_loop import ControlLoop, Timing
from motorprior.hardware.motions import PolicyMotion
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, StopRequest, check_and_confirm, check_before_arming, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.teleop import Teleop
from motorprior.locomotion.policy import Policy
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.robot import Robot

_GAIN_TOLERANCE = 0.15  # relative; a policy's gains come from a fit
_STATUS_PERIOD = 50  # control steps
# On the twin, 11 of 36 walks that crouched at once from full speed tilted beyond 0.5 rad; with it, none.
_STOPPING_TIME = 1.0  # [s]


def gains_for(
    robot: Robot,
    policy: Policy,
    kp: float | None = None,
    kd: float | None = None,
    max_current: float | None = None,
) -> Gains:
    """The gains to send for a policy.

    A policy's gains are in N·m/rad, a wire's in A/rad; the torque constant [N·m/A] converts them. Where the two agree
    to 15 % the wire's are sent, at which the fleets were identified.

    Args:
        robot: with a wire.
        policy: to be deployed.
        kp: sent instead [A/rad].
        kd: sent instead [A·s/rad].
        max_current: sent instead of the robot's own [A].

    Raises:
        ConfigError: the policy was trained with other gains, and none were given.
    """
    wire = robot.require_wire()
    for name, unit, given, of_policy, of_robot, highest in (
        ("kp", "A/rad", kp, policy.kp, wire.kp, wire.safety.max_kp),
        ("kd", "A·s/rad", kd, policy.kd, wire.kd, wire.safety.max_kd),
    ):
        wanted = of_policy / wire.torque_constant
        if given is None and np.abs(wanted / of_robot - 1.0).max() > _GAIN_TOLERANCE:
            mean = float(wanted.mean())
            raise ConfigError(
                f"the policy was trained with {name} = {mean:.1f} {unit} on its motors, the robot has {of_robot:g}",
                remedy=(f"give {name} {mean:.1f} if that is intended, or " if mean <= highest else "")
                + "train it with the robot's gains",
                argument=name,
            )
    return Gains.of(wire, kp, kd, max_current)


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
    teleop: Callable[[], AbstractContextManager[Teleop | None]] = nullcontext,
    status: Callable[[str], None] = lambda _: None,
    timing: Timing | None = None,
) -> str:
    """Check the robot, arm it, stand up, walk, crouch; returns what ended it: "time", "operator" or a signal's name.

    Args:
        link: idle.
        policy: for this robot.
        gains: to send.
        stop: ends the walk.
        command: speed [m/s] and yaw rate [rad/s] without ``teleop``.
        seconds: ends it too [s].
        need_imu: reject a robot whose IMU is not read.
        confirm: raises if the user does not confirm arming.
        teleop: opened when the robot walks, and read at every control step.
        status: gets a line twice a second.
        timing: filled, also if a fault ends the walk.

    Raises:
        RobotFault: what ended the walk early; the robot is idle.
    """
    motion = PolicyMotion(link.robot, policy, need_imu)
    motion.gyro_bias = check_and_confirm(link, confirm, need_imu, motion.warm_up).gyro_bias
    ended_by = ""

    def work(loop: ControlLoop) -> None:
        end = time.monotonic() + seconds if seconds is not None else float("inf")

        def steered(measurement: Measurement) -> np.ndarray | None:
            nonlocal ended_by
            wanted = operator.command() if operator is not None else command
            if wanted is None or time.monotonic() >= end:
                ended_by = "operator" if wanted is None else "time"
                return None
            motion.forward, motion.yaw_rate = wanted
            return motion(measurement)

        with teleop() as operator:
            loop.play(steered, Mode.WALK, _status_line(link, motion, status), timing)

    run_armed(link, gains, stop, work, stopping=lambda: motion.stopping(_STOPPING_TIME))
    return ended_by or stop.reason or ""


def dry_run(
    link: RobotLink,
    policy: Policy,
    stop: StopRequest,
    seconds: float,
    status: Callable[[str], None],
    command: tuple[float, float] = (0.0, 0.0),
    has_imu: bool = True,
) -> int:
    """Compute a policy's targets from the robot's telemetry, and send nothing; returns the number of control steps.

    Args:
        link: idle.
        policy: for this robot.
        stop: ends it.
        seconds: ends it too [s].
        status: gets a line twice a second.
        command: speed [m/s] and yaw rate [rad/s].
        has_imu: see `PolicyMotion`.

    Raises:
        RobotFault: targets that are not finite, or see `check_before_arming` and `RobotLink.check`.
    """
    motion = PolicyMotion(link.robot, policy, has_imu)
    state = check_before_arming(link, need_imu=False)
    motion.warm_up(state.measurement)
    motion.gyro_bias = state.gyro_bias
    motion.forward, motion.yaw_rate = command
    show, steps = _status_line(link, motion, status), 0
    deadline = time.monotonic()
    end = deadline + seconds
    while deadline < end and not stop():
        deadline += policy.control_dt
        link.receive(deadline)
        measurement = link.check()
        target = motion(measurement)
        if not np.all(np.isfinite(target)):
            raise RobotFault("impossible command", f"the policy's targets are {target.tolist()}")
        show(measurement)
        steps += 1
    return steps


def _status_line(link: RobotLink, motion: PolicyMotion, status: Callable[[str], None]) -> Callable[[Measurement], None]:
    """A function of the measurement that gives ``status`` a line every 50 control steps."""
    count, period = 0, link.robot.control_dt

    def show(measurement: Measurement) -> None:
        nonlocal count
        count += 1
        if count % _STATUS_PERIOD:
            return
        telemetry, stream = measurement.telemetry, link.stream
        age = 1e3 * (time.monotonic() - measurement.sampled)
        battery = f", {telemetry.bat:.1f} V" if telemetry.bat is not None else ""
        status(
            f"{period * count:6.1f} s  roll {telemetry.roll:+.2f} pitch {telemetry.pitch:+.2f} rad  command "
            f"{motion.forward:+.2f} m/s {motion.yaw_rate:+.1f} rad/s  telemetry {age:.0f} ms old, damaged "
            f"{link.rejected + stream.impossible}{battery}"
        )

    return show
