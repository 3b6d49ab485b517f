"""From a port to a moving robot and safely back: the sequence of deployment and recording.

    open, first look, arm, ramp to the nominal pose, [walk or excite], crouch, idle

Every way out leads through the last two, or through idle alone where a fault leaves no time to sit down.
"""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.health import is_imu_alive
from motorprior.hardware.motions import Motion, ramp
from motorprior.hardware.real_time import locked_memory, no_garbage_collection, real_time_priority
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.wire import Wire

_FIRST_LOOK = 0.5
"""Duration of the check before arming [s]."""
_FEWEST_FRAMES = 0.8
"""Least number of frames per control period of the robot's own clock, so that old frames from a buffer or a busy host
have no influence; the rest may get lost."""
_RANGE_SLACK = 0.1
"""Angle by which a joint may be beyond its limits before arming [rad], as the end stops are soft."""
_HOLD = 0.5
_STILL = 0.1
"""Largest motion of a joint during the check before arming [rad]; more comes from homing or from a hand."""
_LARGEST_BIAS = 0.1
"""Of a gyroscope at rest [rad/s]; 0.05 rad/s are common in a cheap one before it is calibrated."""
_NOT_TO_BE_TRUSTED = ("program error", "impossible command", "frozen IMU")
"""Faults after which the present motion, or its input, cannot be trusted to come to rest."""
_QUICK = 0.1
"""Longest time for confirmation and compilation [s] after which the check is not repeated."""


class StopRequest:
    """Set by Ctrl-C, Ctrl-Z, SIGTERM, or a lost terminal; the second one drops the robot at once."""

    def __init__(self) -> None:
        self.reason: str | None = None
        self._dropped = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.reason is not None

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """Handler of a signal.

        Raises:
            RobotFault: the second time, idle at once. Further ones must not hinder that, and do nothing.
        """
        if self.reason is None:
            self.reason = signal.Signals(number).name
        elif not self._dropped:
            self._dropped = True
            raise RobotFault("stopped", f"a second signal, {signal.Signals(number).name}")


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """SIGINT, SIGTERM, SIGHUP and SIGTSTP end the motion cleanly while this is open.

    Ctrl-Z (SIGTSTP) would stop the host where it is, and the watchdog would drop the robot.
    """
    request = StopRequest()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
    before = {number: signal.signal(number, request.on_signal) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class Gains:
    """Gains and current limit to send.

    Attributes:
        kp: [A/rad].
        kd: [A·s/rad].
        max_current: [A].
    """

    kp: float
    kd: float
    max_current: float

    @classmethod
    def of(
        cls, wire: Wire, kp: float | None = None, kd: float | None = None, max_current: float | None = None
    ) -> Gains:
        """The given gains, with the robot's own in place of None."""
        return cls(
            wire.kp if kp is None else kp,
            wire.kd if kd is None else kd,
            wire.max_current if max_current is None else max_current,
        )


@dataclass(frozen=True, eq=False)
class Look:
    """What was seen of a robot at rest.

    Attributes:
        measurement: the last one.
        rates: (3,) mean rates about the body's x, y and z axes: what the gyroscope is off by [rad/s]; 0 if one of them
            is more than _LARGEST_BIAS, which is no error but a motion.
    """

    measurement: Measurement
    rates: np.ndarray


def first_look(link: RobotLink, need_imu: bool) -> Look:
    """Check telemetry for half a second and refuse a robot that must not be armed.

    Raises:
        RobotFault: too few frames, an IMU that is not read, joints that move or are out of range, a tilted body, or a
            fault.
    """
    link.receive(time.monotonic() + 0.2 * _FIRST_LOOK)  # what waited in buffers comes first
    first, before = link.check().telemetry, link.stream.accepted
    rates, robot = _mean_rates(link, 0.8 * _FIRST_LOOK), link.robot
    measurement = link.check()
    telemetry, frames = measurement.telemetry, link.stream.accepted - before
    seconds, fewest = 1e-3 * (telemetry.ts - first.ts), _FEWEST_FRAMES / robot.control_dt
    if frames < max(2.0, fewest * seconds):
        raise RobotFault(
            "stale telemetry",
            f"{frames} frames in {seconds:.2f} s, {fewest:.0f} per second are the least",
            remedy="see `motorprior doctor`; PRINT_DELAY in the firmware's main.cpp is their period",
        )
    if need_imu and not is_imu_alive(telemetry):
        raise RobotFault(
            "no IMU",
            "roll, pitch and their rates are all 0: the firmware does not read it, so a fall cannot be detected",
            remedy="flash a firmware that reads the IMU, or give without_imu and stay within reach of the robot",
            argument="without_imu",
        )
    outside = (telemetry.pos < robot.lower - _RANGE_SLACK) | (telemetry.pos > robot.upper + _RANGE_SLACK)
    if outside.any():
        worst = int(np.argmax(outside))
        raise RobotFault(
            "joint range",
            f"{robot.joint_names[worst]} is at {telemetry.pos[worst]:+.2f} rad, its range is "
            f"{robot.lower[worst]:+.2f} to {robot.upper[worst]:+.2f}",
            remedy="switch the robot on with its legs free so that it finds its end stops",
        )
    moved = np.abs(telemetry.pos - first.pos)
    if moved.max() > _STILL:
        raise RobotFault(
            "moving",
            f"{robot.joint_names[int(np.argmax(moved))]} moved {moved.max():.2f} rad, and this host sent nothing",
            remedy="wait until the robot has homed or lies still, hands off, and end other programs that drive it",
        )
    if max(abs(telemetry.roll), abs(telemetry.pitch)) > link.limits.max_tilt:
        raise RobotFault("fall", "the robot lies on its side", remedy="put it on its feet")
    return Look(measurement, rates if np.abs(rates).max() <= _LARGEST_BIAS else np.zeros(3))


def _mean_rates(link: RobotLink, seconds: float) -> np.ndarray:
    """(3,) mean of the rates in the frames of the next ``seconds`` [rad/s]."""
    end, seen = time.monotonic() + seconds, []
    while (now := time.monotonic()) < end:
        link.receive(min(end, now + link.robot.control_dt))
        telemetry = link.check().telemetry
        seen.append((telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate))
    return np.mean(seen, axis=0)


def look_and_confirm(
    link: RobotLink,
    confirm: Callable[[], None],
    need_imu: bool,
    prepare: Callable[[Measurement], None] = lambda _: None,
) -> Look:
    """Look, prepare, and the arm step; a robot that waited for these is looked at once more. Returns the last look.

    Raises:
        RobotFault: ``confirm`` refused, or see `first_look`.
    """
    seen = first_look(link, need_imu)
    before = time.monotonic()
    prepare(seen.measurement)
    confirm()
    return first_look(link, need_imu) if time.monotonic() - before > _QUICK else seen


def run_armed(
    link: RobotLink,
    gains: Gains,
    stop: StopRequest,
    work: Callable[[ControlLoop], None],
    *,
    crouch: bool = True,
    wind_down: Callable[[], Motion] | None = None,
) -> None:
    """Arm, ramp to the nominal pose, ``work``, then wind down, crouch and idle, whatever happens.

    Args:
        link: idle, looked at.
        gains: to send.
        stop: ends any motion.
        work: plays motions on the loop it gets.
        crouch: sit down at the end; a hung robot need not.
        wind_down: a motion that brings what ``work`` did to rest, before the crouch: a robot that walks at half a metre
            per second and crouches at once falls over its feet one time in three.

    Raises:
        RobotFault: the fault that ended the run; the robot is idle.
    """
    way_down = _WayDown(link)
    with locked_memory(), no_garbage_collection(), real_time_priority():
        try:
            link.arm(gains.kp, gains.kd, gains.max_current)
            loop = ControlLoop(link, link.limits, link.robot.control_dt, stop)
            link.gate.slow = True
            loop.play(_to_nominal(link), Mode.RAMP)
            if not stop():
                link.gate.slow, way_down.wind_down = False, wind_down
                work(loop)
            if crouch:
                way_down.take()
        except Exception as error:
            fault = error if isinstance(error, RobotFault) else fault_of(error)
            if crouch and fault.safe_state == "crouch":
                way_down.take_after(fault)
            raise
        finally:
            link.idle()


def fault_of(error: Exception) -> RobotFault:
    """The robot fault that a program's error amounts to; after one the robot can still come to rest."""
    kind = "recording" if isinstance(error, ArtifactError) else "program error"
    return RobotFault(kind, str(error), safe_state="crouch")


def _to_nominal(link: RobotLink) -> Motion:
    target, robot = link.gate.target, link.robot
    assert target is not None, "armed"
    return ramp(target, robot.nominal_pose, link.limits.slow_speed, robot.control_dt, _HOLD)


class _WayDown:
    """Come to rest, crouch. After a fault on the way the rest of it follows: a robot that sits down walks no more.

    Attributes:
        wind_down: a motion that comes to rest; None where nothing moves any more, or the motion cannot be trusted.
    """

    def __init__(self, link: RobotLink):
        self._link = link
        self.wind_down: Callable[[], Motion] | None = None

    def take(self) -> None:
        """Sit down, on a clock of its own: what ended the motion must not end this."""
        link, robot = self._link, self._link.robot
        link.gate.let_down()
        link.forgive("stuck")  # the ground holds a foot fast while the body comes down; going on is safer than falling
        never = float("inf")
        # A late crouch is better than none.
        patient = replace(link.limits, tick_delay=never, late_ticks=100, stalled_time=never)
        loop = ControlLoop(link, patient, robot.control_dt, lambda: False)
        if self.wind_down is not None:
            loop.play(self.wind_down(), Mode.WALK)
        self.wind_down = None
        link.gate.slow = True
        target, crouch = link.gate.target, robot.require_wire().crouch_pose
        assert target is not None, "armed"
        loop.play(ramp(target, crouch, link.limits.slow_speed, robot.control_dt), Mode.CROUCH)

    def take_after(self, fault: RobotFault) -> None:
        """Sit down after a fault; a second fault on the way leaves idle, which follows anyway."""
        with contextlib.suppress(MotorPriorError):
            self._link.gate.shut(fault)
            self._link.forgive(fault.kind)
            if fault.kind in _NOT_TO_BE_TRUSTED:
                self.wind_down = None
            self.take()
