"""From an idle robot to a moving one and back: the sequence of deployment and recording.

    check, confirm, arm, ramp to the nominal pose, [walk or excite], crouch, idle

Every run ends with the last two, or with idle alone if a fault leaves no time to crouch.
"""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.control_loop import ControlLoop, Motion, Timing, ramp
from motorprior.hardware.doctor import Check, frame_rate, imu, joint_ranges, require_ok
from motorprior.hardware.real_time import real_time
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.readers.robot_run import Mode

_CHECK_DURATION = 0.5  # [s]
_MAX_MOTION = 0.1  # [rad] during the check; more means homing, or a user who moves the legs
_MAX_GYRO_BIAS = 0.1  # [rad/s]; 0.05 rad/s are common in a cheap gyroscope before calibration
_HOLD = 0.5  # [s] at the nominal pose
_RECHECK_AFTER = 0.1  # [s]; a longer confirmation or compilation is followed by a second check
_UNTRUSTED = ("program error", "impossible command", "frozen IMU")  # the policy, or its input, is not to be trusted


class StopRequest:
    """Set by Ctrl-C, Ctrl-Z, SIGTERM or a lost terminal; the second signal makes the robot idle at once."""

    def __init__(self) -> None:
        self.reason: str | None = None
        self._dropped = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.reason is not None

    def on_signal(self, number: int, _: FrameType | None) -> None:
        """Handle a signal; the second one raises RobotFault."""
        if self.reason is None:
            self.reason = signal.Signals(number).name
        elif not self._dropped:  # further signals must not interrupt the way to idle
            self._dropped = True
            raise RobotFault("stopped", f"a second signal, {signal.Signals(number).name}")


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """SIGINT, SIGTERM, SIGHUP and SIGTSTP end the motion cleanly within this context."""
    # Ctrl-Z (SIGTSTP) would stop the host where it is, and the watchdog would drop the robot.
    request, numbers = StopRequest(), (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
    before = {number: signal.signal(number, request.on_signal) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def check_before_arming(link: RobotLink, need_imu: bool) -> tuple[Measurement, np.ndarray]:
    """Check telemetry for half a second; returns the last measurement and the (3,) gyroscope bias [rad/s].

    The bias is the mean of the rates about the body's axes, 0 if one is too large for a bias.

    Raises:
        RobotFault: too few frames, an IMU that is not read, joints that move or are out of range, or a fault.
    """
    link.receive(time.monotonic() + 0.2 * _CHECK_DURATION)  # read buffered telemetry
    received, before, robot = [link.check().telemetry], link.stream.accepted, link.robot
    end = time.monotonic() + 0.8 * _CHECK_DURATION
    while (now := time.monotonic()) < end:
        link.receive(min(end, now + robot.control_dt))
        received.append(link.check().telemetry)
    measurement = link.check()
    moved = np.abs(measurement.telemetry.pos - received[0].pos)
    moving = f"{robot.joint_names[int(np.argmax(moved))]} moved {moved.max():.2f} rad, although this host sent nothing"
    remedy = "wait until homing has ended, hands off the robot, and end other programs that drive it"
    require_ok(
        [
            frame_rate(robot, link.stream.accepted - before, received),
            *([imu(received[-1])] if need_imu else []),
            *joint_ranges(robot, received[-1:]),
            Check("moving", moving, bool(moved.max() <= _MAX_MOTION), remedy),
        ]
    )
    rates = np.mean([telemetry.rates for telemetry in received[1:]], axis=0)
    return measurement, rates if np.abs(rates).max() <= _MAX_GYRO_BIAS else np.zeros(3)


@dataclass
class Session:
    """A run of a robot, from idle to idle.

    Attributes:
        link: to the robot.
        gains: to send.
        stop: ends the run when it is set.
        need_imu: reject a robot whose IMU is not read.
        confirm: raises if the user does not confirm arming.
        status: gets a line to show now and then.
        timing: of the motion between ramp and crouch, also if a fault ends it.
        outcome: reason for the end, if not an error: "time", "operator" or the name of a signal.
    """

    link: RobotLink
    gains: Gains
    stop: StopRequest = field(default_factory=StopRequest)
    need_imu: bool = True
    confirm: Callable[[], None] = lambda: None
    status: Callable[[str], None] = lambda _: None
    timing: Timing = field(default_factory=Timing)
    outcome: str = ""
    _stopping: Callable[[], Motion] | None = None  # a motion that slows down; None if nothing moves or it is untrusted

    def check(self, prepare: Callable[[Measurement], None] = lambda _: None) -> np.ndarray:
        """Check, prepare and confirm; if that took long, check again. Returns the (3,) gyroscope bias [rad/s]."""
        measurement, gyro_bias = check_before_arming(self.link, self.need_imu)
        before = time.monotonic()
        prepare(measurement)
        self.confirm()
        is_old = time.monotonic() - before > _RECHECK_AFTER
        return check_before_arming(self.link, self.need_imu)[1] if is_old else gyro_bias

    def run(
        self, work: Callable[[ControlLoop], None], crouch: bool = True, stopping: Callable[[], Motion] | None = None
    ) -> None:
        """Arm, ramp to the nominal pose, ``work``, then slow down, crouch and idle, also after a fault.

        A suspended robot does not ``crouch``. ``stopping`` is a motion that slows ``work`` down before the crouch. An
        error is raised once the robot is idle.
        """
        link = self.link
        with real_time():
            try:
                link.arm(self.gains)
                loop = ControlLoop(link, link.limits, self.stop)
                self._ramp(loop, link.robot.nominal_pose, Mode.RAMP, _HOLD)
                if not self.stop():
                    link.gate.slow, self._stopping = False, stopping
                    work(loop)
                if crouch:
                    self._descend()
            except Exception as error:
                fault = fault_of(error)
                if crouch and fault.safe_state == "crouch":
                    with contextlib.suppress(MotorPriorError):  # a second fault: idle follows anyway
                        self._descend(fault)
                raise
            finally:
                link.idle()
        self.outcome = self.outcome or self.stop.reason or "time"

    def _ramp(self, loop: ControlLoop, pose: np.ndarray, mode: Mode, hold: float = 0.0) -> None:
        """Move the armed robot slowly to a (joints,) ``pose`` [rad], and stay there for ``hold`` [s]."""
        gate = self.link.gate
        assert gate.target is not None, "armed"
        gate.slow = True
        loop.play(ramp(gate.target, pose, self.link.limits.slow_speed, self.link.robot.control_dt, hold), mode)

    def _descend(self, fault: RobotFault | None = None) -> None:
        """Slow down, then crouch; after a fault in the descent it continues from there."""
        link = self.link
        if fault is not None:
            link.gate.latch(fault)
            link.ignore(fault.kind)
            if fault.kind in _UNTRUSTED:
                self._stopping = None
        link.gate.allow_crouch()
        link.ignore("stuck")  # the ground may block a foot while the body descends; to continue is safer than to fall
        never = float("inf")  # a late crouch is better than none
        lenient = replace(link.limits, tick_delay=never, late_ticks=100, stalled_time=never)
        loop = ControlLoop(link, lenient, lambda: False)  # a stop of the previous motion must not stop this one
        if self._stopping is not None:
            loop.play(self._stopping(), Mode.WALK)
        self._stopping = None
        self._ramp(loop, link.robot.require_wire().crouch_pose, Mode.CROUCH)


def fault_of(error: Exception) -> RobotFault:
    """The robot fault for an error; after an error of the program the robot can still crouch."""
    if isinstance(error, RobotFault):
        return error
    kind = "recording" if isinstance(error, ArtifactError) else "program error"
    return RobotFault(kind, str(error), safe_state="crouch")
