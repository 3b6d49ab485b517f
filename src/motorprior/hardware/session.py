"""Checks of an idle robot, and the sequence from it to a moving one and back, of deployment and recording.

    check, confirm, arm, ramp to the nominal pose, [walk or excite], crouch, idle

Every run ends with the last two, or with idle alone if a fault leaves no time to crouch.
"""

import contextlib
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.control_loop import ControlLoop, Motion, Timing, ramp, real_time
from motorprior.hardware.health import Measurement, SensorFaults
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.robots.robot import Robot

_CHECK_DURATION = 0.5  # [s]
_MAX_MOTION = 0.1  # [rad] during the check; more means homing, or a user who moves the legs
_MAX_GYRO_BIAS = 0.1  # [rad/s]; 0.05 rad/s are common in a cheap gyroscope before calibration
_HOLD = 0.5  # [s] at the nominal pose
_RECHECK_AFTER = 0.1  # [s]; a longer confirmation or compilation is followed by a second check
# the policy, or its input, is not to be trusted
_UNTRUSTED = ("program error", "impossible command", "frozen IMU")


@contextmanager
def stop_on_signals() -> Iterator[list[str]]:
    """Names of the received signals Ctrl-C, SIGTERM, lost terminal (SIGHUP) and Ctrl-Z (SIGTSTP), which ask to stop.

    The second signal raises RobotFault, so that the robot is idle at once.
    """
    received: list[str] = []

    def on_signal(number: int, _: FrameType | None) -> None:
        received.append(signal.Signals(number).name)
        if len(received) == 2:  # further ones must not interrupt the way to idle
            raise RobotFault("stopped", f"a second signal, {received[1]}")

    # SIGTSTP would stop the host where it is, and the watchdog would drop the robot.
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def check_before_arming(link: RobotLink, need_imu: bool) -> tuple[Measurement, np.ndarray]:
    """Check telemetry for half a second; returns the last measurement and the (3,) gyroscope bias [rad/s].

    The bias is the mean of the rates about the body's axes, 0 if one is too large for a bias.
    Raises RobotFault for too few frames, an IMU that is not read, joints that move or are out of
    range, or another fault.
    """
    link.receive(time.monotonic() + 0.2 * _CHECK_DURATION)  # read buffered telemetry
    received = [link.check().telemetry]
    received += [each.telemetry for each in link.receive(time.monotonic() + 0.8 * _CHECK_DURATION)]
    measurement = link.check()
    robot = link.robot
    moved = np.abs(measurement.telemetry.pos - received[0].pos)
    moving = f"{robot.joint_names[int(np.argmax(moved))]} moved {moved.max():.2f} rad, although this host sent nothing"
    remedy = (
        "wait until homing has ended, hands off the robot, and end other programs that drive it"
    )
    checks = [frame_rate(robot, received), imu(received[-1]), *joint_ranges(robot, received[-1:])]
    checks.append(Check("moving", moving, bool(moved.max() <= _MAX_MOTION), remedy))
    require_ok([check for check in checks if need_imu or check.name != "IMU"])
    rates = np.mean([telemetry.rates for telemetry in received], axis=0)
    return measurement, rates if np.abs(rates).max() <= _MAX_GYRO_BIAS else np.zeros(3)


@dataclass
class Session:
    """A run of a robot, from idle to idle."""

    link: RobotLink
    gains: Gains  # gains to send
    stop: Sequence[str] = ()  # names of signals; ends the run once there is one
    need_imu: bool = True  # reject a robot whose IMU is not read
    confirm: Callable[[], None] = lambda: None  # raises if the user does not confirm arming
    status: Callable[[str], None] = lambda _: None  # gets a line to show now and then
    # of the motion between ramp and crouch, also if a fault ends it
    timing: Timing = field(default_factory=Timing)
    # reason for the end, if not an error: "time", "operator" or the name of a signal
    outcome: str = ""
    # a motion that slows down; None if nothing moves or it is untrusted
    _stopping: Callable[[], Motion] | None = None

    def check(self, prepare: Callable[[Measurement], None] = lambda _: None) -> np.ndarray:
        """Check, prepare and confirm; if that took long, check again. Returns the (3,) gyroscope bias [rad/s]."""
        measurement, gyro_bias = check_before_arming(self.link, self.need_imu)
        before = time.monotonic()
        prepare(measurement)
        self.confirm()
        is_old = time.monotonic() - before > _RECHECK_AFTER
        return check_before_arming(self.link, self.need_imu)[1] if is_old else gyro_bias

    def run(
        self,
        work: Callable[[ControlLoop], None],
        crouch: bool = True,
        stopping: Callable[[], Motion] | None = None,
    ) -> None:
        """Arm, ramp to the nominal pose, ``work``, slow down with ``stopping``, crouch and idle, also after a fault.

        A suspended robot does not ``crouch``. An error is raised once the robot is idle.
        """
        link = self.link
        with real_time():
            try:
                link.arm(self.gains)
                loop = ControlLoop(link, link.limits, self.stop)
                self._ramp(loop, link.robot.nominal_pose, Mode.RAMP, _HOLD)
                if not self.stop:
                    link.gate.slow = False
                    self._stopping = stopping
                    work(loop)
                if crouch:
                    self._crouch()
            except Exception as error:
                fault = fault_of(error)
                if crouch and fault.safe_state == "crouch":
                    # a second fault: idle follows anyway
                    with contextlib.suppress(MotorPriorError):
                        self._crouch(fault)
                raise
            finally:
                link.idle()
        self.outcome = self.outcome or "".join(self.stop[:1]) or "time"

    def _ramp(self, loop: ControlLoop, pose: np.ndarray, mode: Mode, hold: float = 0.0) -> None:
        """Move the armed robot slowly to a (joints,) ``pose`` [rad], and stay there for ``hold`` [s]."""
        gate = self.link.gate
        gate.slow = True
        start = pose if gate.target is None else gate.target
        loop.run_motion(
            ramp(start, pose, self.link.limits.slow_speed, self.link.robot.control_dt, hold), mode
        )

    def _crouch(self, fault: RobotFault | None = None) -> None:
        """Slow down, then crouch; after a fault in the descent it continues from there."""
        link = self.link
        if fault is not None:
            link.gate.latch(fault)
            link.ignore(fault.kind)
            if fault.kind in _UNTRUSTED:
                self._stopping = None
        link.gate.allow_crouch()
        # the ground may block a foot while the body descends; to continue is safer than to fall
        link.ignore("stuck")
        never = float("inf")  # a late crouch is better than none
        lenient = replace(link.limits, tick_delay=never, late_ticks=100, stalled_time=never)
        # a stop of the previous motion must not stop this one
        loop = ControlLoop(link, lenient, ())
        if self._stopping is not None:
            loop.run_motion(self._stopping(), Mode.WALK)
        self._stopping = None
        self._ramp(loop, link.robot.require_wire().crouch_pose, Mode.CROUCH)


def fault_of(error: Exception) -> RobotFault:
    """The robot fault for an error; after an error of the program the robot can still crouch."""
    if isinstance(error, RobotFault):
        return error
    kind = "recording" if isinstance(error, ArtifactError) else "program error"
    return RobotFault(kind, str(error), safe_state="crouch")


# Per control period of the robot's clock: buffered frames and a busy host have no influence. The
# rest may be lost.
_MIN_FRAMES = 0.8
_RANGE_SLACK = 0.1  # [rad] beyond the joint limits: the end stops are soft


@dataclass(frozen=True)
class Check:
    """A measured value, and what to do if it is not ``ok``."""

    name: str
    finding: str
    ok: bool
    remedy: str = ""


def require_ok(checks: Sequence[Check]) -> None:
    """Raise RobotFault for the first check that failed."""
    for check in checks:
        if not check.ok:
            raise RobotFault(check.name, check.finding, remedy=check.remedy)


def check_telemetry(link: RobotLink, seconds: float) -> list[Check]:
    """Receive telemetry for some seconds and check it; raises RobotFault if no frame comes."""
    received = link.receive(time.monotonic() + seconds)
    if not received:
        found = f"{len(link.text)} lines of text" if link.text else "no frame"
        raise RobotFault(
            "stale telemetry", found, remedy="check power, cable and the firmware's version"
        )
    damaged = link.port.reader.rejected + link.stream.impossible
    stream = link.stream
    delays = [each.arrival - each.sampled for each in received]
    # the last frame may be old by now
    arrivals = [*(each.arrival for each in received[1:]), time.monotonic()]
    max_age = max(after - each.sampled for each, after in zip(received, arrivals, strict=True))
    telemetry = [each.telemetry for each in received]
    return [
        frame_rate(link.robot, telemetry),
        Check(
            "damaged frames",
            f"{damaged}, {stream.repeated} repeated",
            damaged <= 0.01 * stream.accepted + 1,
            "use another cable or port",
        ),
        Check(
            "telemetry",
            f"{1e3 * np.median(delays):.1f} ms delay, {1e3 * max_age:.0f} ms maximum age",
            max_age < link.limits.telemetry_age,
            "close other programs, use another cable or port",
        ),
        imu(telemetry[-1]),
        *joint_ranges(link.robot, telemetry),
        *_sensors(link, telemetry),
        Check(
            "text",
            link.text[-1] if link.text else "none",
            not any("ERROR" in line for line in link.text),
            "switch the robot off and on with its legs free",
        ),
    ]


def frame_rate(robot: Robot, telemetry: Sequence[Telemetry]) -> Check:
    """Whether the frames are enough for the control period."""
    seconds = 1e-3 * (telemetry[-1].ts - telemetry[0].ts)
    needed = 1.0 / robot.control_dt
    remedy = f"the policy needs {needed:.0f} per second: use another cable or port; PRINT_DELAY in the firmware's "
    enough = len(telemetry) - 1 >= max(2.0, _MIN_FRAMES * needed * seconds)
    return Check(
        "frames",
        f"{len(telemetry)} in {seconds:.2f} s",
        enough,
        remedy + "main.cpp is their period",
    )


def imu(telemetry: Telemetry) -> Check:
    """Whether the firmware reads the IMU."""
    finding = f"roll {telemetry.roll:+.3f} rad, pitch {telemetry.pitch:+.3f} rad"
    remedy = "flash a firmware that reads the IMU: without it a fall cannot be detected; or give --without-imu and "
    return Check("IMU", finding, telemetry.has_imu, remedy + "stay within reach of the robot")


def joint_ranges(robot: Robot, telemetry: Sequence[Telemetry]) -> list[Check]:
    """Whether the joints are within their limits."""
    checks = []
    remedy = "switch the robot on with its legs free so that it finds its end stops"
    for joint, angles in zip(robot.joints, np.array([one.pos for one in telemetry]).T, strict=True):
        low = angles.min()
        high = angles.max()
        inside = joint.lower - _RANGE_SLACK <= low and high <= joint.upper + _RANGE_SLACK
        finding = (
            f"{angles[-1]:+.3f} rad, was {low:+.3f} to {high:+.3f}; limits {joint.lower:+.2f} to "
        )
        checks.append(
            Check(f"joint {joint.name}", f"{finding}{joint.upper:+.2f}", bool(inside), remedy)
        )
    return checks


def _sensors(link: RobotLink, telemetry: Sequence[Telemetry]) -> list[Check]:
    """The faults that would end a motion, and the last readings."""
    sensors = SensorFaults(link.robot, link.limits)
    last = telemetry[-1]
    faults = {
        fault.kind: fault for one in telemetry for fault in sensors.faults(one, 1e-3 * one.ts)
    }
    current = "not sent" if last.cur is None else f"up to {np.abs(last.cur).max():.2f} A"
    return [
        Check(kind, faults[kind].problem, False, faults[kind].remedy or "look for a blocked joint")
        if kind in faults
        else Check(kind, reading, True)
        for kind, reading in (("current", current), ("frozen IMU", "no"))
    ]
