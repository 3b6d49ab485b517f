"""Checks of an idle robot, and the sequence of a run, from idle to moving and back.

    check, confirm, arm, ramp to the nominal pose, [walk or excite], crouch, idle

Every run ends with crouch and idle, or with idle alone if a fault leaves no time to crouch.
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
_FIRST_FRAME = 2.0  # [s] a robot that was just switched on or plugged in has for its first frame
_MAX_MOTION = 0.1  # [rad] during the check; more means homing, or a user who moves the legs
_MAX_GYRO_BIAS = 0.1  # [rad/s]; 0.05 rad/s are common in a cheap gyroscope before calibration
_HOLD = 0.5  # [s] at the nominal pose
_RECHECK_AFTER = 0.1  # [s]; a longer confirmation or compilation is followed by a second check
# faults after which the policy does not slow the robot down: it, or its input, may be wrong
_UNTRUSTED = ("program error", "impossible command", "frozen IMU")


@contextmanager
def stop_on_signals() -> Iterator[list[str]]:
    """Collect the signals that ask to stop; the context is the list of their names so far.

    The signals are SIGINT (Ctrl-C), SIGTERM, SIGHUP (a lost terminal) and SIGTSTP (Ctrl-Z). The
    second signal raises RobotFault, so that the robot is idle at once.
    """
    received: list[str] = []

    def on_signal(number: int, _: FrameType | None) -> None:
        received.append(signal.Signals(number).name)
        if len(received) == 2:  # further signals must not interrupt the way to idle
            raise RobotFault("stopped", f"a second signal, {received[1]}")

    # SIGTSTP would stop the host where it is, and the watchdog would drop the robot.
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
    earlier_handlers = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in earlier_handlers.items():
            signal.signal(number, handler)


def check_before_arming(link: RobotLink, need_imu: bool) -> tuple[Measurement, np.ndarray]:
    """Check telemetry for half a second.

    Returns the last measurement and the (3,) gyroscope bias [rad/s]. The bias is the mean of the
    measured rates about the body's axes, or (0, 0, 0) if a mean is too large for a bias. Raises
    RobotFault for too few frames, an IMU that is not read, joints that move or are out of range, or
    another fault.
    """
    give_up = time.monotonic() + _FIRST_FRAME
    while link.stream.latest is None and time.monotonic() < give_up:
        link.receive(time.monotonic() + 0.01)
    link.receive(time.monotonic() + 0.2 * _CHECK_DURATION)  # read buffered telemetry
    telemetry = [link.check().telemetry]
    received = link.receive(time.monotonic() + 0.8 * _CHECK_DURATION)
    telemetry += [measurement.telemetry for measurement in received]
    measurement = link.check()

    robot = link.robot
    motion = np.abs(measurement.telemetry.pos - telemetry[0].pos)
    checks = [frame_rate(robot, telemetry)]
    if need_imu:
        checks.append(imu(telemetry[-1]))
    checks += joint_ranges(robot, telemetry[-1:])
    checks.append(_is_static(robot, motion))
    require_ok(checks)

    gyro_bias = np.mean([frame.rates for frame in telemetry], axis=0)
    if np.abs(gyro_bias).max() > _MAX_GYRO_BIAS:
        gyro_bias = np.zeros(3)
    return measurement, gyro_bias


@dataclass
class Session:
    """A run of a robot, from idle to idle."""

    link: RobotLink
    gains: Gains  # gains to send
    # names of the signals received so far; the run ends at the first signal
    stop_signals: Sequence[str] = ()
    need_imu: bool = True  # reject a robot whose IMU is not read
    confirm: Callable[[], None] = lambda: None  # raises if the user does not confirm arming
    status: Callable[[str], None] = lambda _: None  # shows a line of status to the user
    # timing of the motion between ramp and crouch; complete also if a fault ends the motion
    timing: Timing = field(default_factory=Timing)
    # reason for the end, if not an error: "time", "operator" or the name of a signal
    outcome: str = ""
    # makes the motion that slows the robot down before the crouch; None if the robot does not walk,
    # or after a fault in _UNTRUSTED
    _slow_down: Callable[[], Motion] | None = None

    def check(self, prepare: Callable[[Measurement], None] = lambda _: None) -> np.ndarray:
        """Check, prepare and confirm; if that took long, check again.

        Returns the (3,) gyroscope bias [rad/s].
        """
        measurement, gyro_bias = check_before_arming(self.link, self.need_imu)
        checked = time.monotonic()
        prepare(measurement)
        self.confirm()
        if time.monotonic() - checked > _RECHECK_AFTER:
            _, gyro_bias = check_before_arming(self.link, self.need_imu)
        return gyro_bias

    def run(
        self,
        work: Callable[[ControlLoop], None],
        crouch: bool = True,
        slow_down: Callable[[], Motion] | None = None,
    ) -> None:
        """Arm, ramp to the nominal pose, ``work``, slow down, crouch and idle.

        ``slow_down`` makes the motion that slows the robot down before it crouches. The robot also
        crouches after a fault that leaves time for it. Give ``crouch=False`` for a suspended robot.
        An error is raised once the robot is idle.
        """
        link = self.link
        with real_time():
            try:
                link.arm(self.gains)
                loop = ControlLoop(link, link.limits, self.stop_signals)
                self._ramp(loop, link.robot.nominal_pose, Mode.RAMP, _HOLD)
                if not self.stop_signals:
                    link.gate.slow = False
                    self._slow_down = slow_down
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

        if not self.outcome:
            self.outcome = self.stop_signals[0] if self.stop_signals else "time"

    def _ramp(self, loop: ControlLoop, pose: np.ndarray, mode: Mode, hold: float = 0.0) -> None:
        """Move the armed robot slowly to a (joints,) ``pose`` [rad], held for ``hold`` [s]."""
        link = self.link
        link.gate.slow = True
        target_in_force = link.gate.target
        start = pose if target_in_force is None else target_in_force
        motion = ramp(start, pose, link.limits.slow_speed, link.robot.control_dt, hold)
        loop.run_motion(motion, mode)

    def _crouch(self, fault: RobotFault | None = None) -> None:
        """Slow down, then crouch.

        If ``fault`` occurred during a crouch, the new crouch begins at the present targets.
        """
        link = self.link
        if fault is not None:
            link.gate.latch_fault(fault)
            link.ignore(fault.name)
            if fault.name in _UNTRUSTED:
                self._slow_down = None
        link.gate.allow_crouch()
        # the ground may block a foot while the body descends; to continue is safer than to fall
        link.ignore("stuck")
        # a late crouch is better than none: no lateness of the host ends it
        never = float("inf")
        limits_of_crouch = replace(
            link.limits, tick_delay=never, late_ticks=100, stalled_time=never
        )
        # without the signals that stopped the previous motion: they must not stop the crouch
        loop = ControlLoop(link, limits_of_crouch, stop_signals=())
        if self._slow_down is not None:
            loop.run_motion(self._slow_down(), Mode.WALK)
        self._slow_down = None
        self._ramp(loop, link.robot.require_wire().crouch_pose, Mode.CROUCH)


def fault_of(error: Exception) -> RobotFault:
    """The robot fault for an error.

    After an error of the program, or of the recording, the robot can still crouch.
    """
    if isinstance(error, RobotFault):
        return error
    name = "recording" if isinstance(error, ArtifactError) else "program error"
    return RobotFault(name, str(error), safe_state="crouch")


# Minimum number of frames per control period; the others may be lost. Time is measured on the
# robot's clock, so that buffered frames and a busy host have no influence.
_MIN_FRAMES = 0.8
_MAX_DAMAGED = 0.01  # maximum share of damaged frames
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
    """Receive telemetry for ``seconds`` [s] and check it; raises RobotFault if no frame comes."""
    measurements = link.receive(time.monotonic() + seconds)
    if not measurements:
        problem = f"{len(link.text)} lines of text" if link.text else "no frame"
        raise RobotFault(
            "stale telemetry", problem, remedy="check power, cable and the firmware's version"
        )
    # before the other checks: meanwhile the age of the last frame would grow
    age = _age(link, measurements)
    telemetry = [measurement.telemetry for measurement in measurements]
    return [
        frame_rate(link.robot, telemetry),
        _damaged_frames(link),
        age,
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


def _age(link: RobotLink, measurements: Sequence[Measurement]) -> Check:
    """Delay of the measurements, and their maximum age until the next one or now."""
    delays = [measurement.arrival - measurement.sampled for measurement in measurements]
    next_arrivals = [measurement.arrival for measurement in measurements[1:]]
    next_arrivals.append(time.monotonic())
    max_age = max(
        next_arrival - measurement.sampled
        for measurement, next_arrival in zip(measurements, next_arrivals, strict=True)
    )
    return Check(
        "telemetry",
        f"{1e3 * np.median(delays):.1f} ms delay, {1e3 * max_age:.0f} ms maximum age",
        max_age < link.limits.telemetry_age,
        "close other programs, use another cable or port",
    )


def _damaged_frames(link: RobotLink) -> Check:
    damaged = link.port.reader.rejected + link.stream.impossible
    return Check(
        "damaged frames",
        f"{damaged}, {link.stream.repeated} repeated",
        damaged <= _MAX_DAMAGED * link.stream.accepted + 1,
        "use another cable or port",
    )


def _is_static(robot: Robot, motion: np.ndarray) -> Check:
    """Whether no joint has moved; ``motion`` is (joints,) [rad]."""
    joint = int(np.argmax(motion))
    return Check(
        "moving",
        f"{robot.joint_names[joint]} moved {motion.max():.2f} rad, although this host sent nothing",
        bool(motion.max() <= _MAX_MOTION),
        "wait until homing has ended, hands off the robot, and end other programs that drive it",
    )


def frame_rate(robot: Robot, telemetry: Sequence[Telemetry]) -> Check:
    """Whether telemetry has enough frames for the control period."""
    seconds = 1e-3 * (telemetry[-1].ts - telemetry[0].ts)
    required_rate = 1.0 / robot.control_dt
    min_frames = max(2.0, _MIN_FRAMES * required_rate * seconds)
    return Check(
        "frames",
        f"{len(telemetry)} in {seconds:.2f} s",
        len(telemetry) - 1 >= min_frames,
        f"the policy needs {required_rate:.0f} per second: use another cable or port; "
        "PRINT_DELAY in the firmware's main.cpp is their period",
    )


def imu(telemetry: Telemetry) -> Check:
    """Whether the firmware reads the IMU."""
    return Check(
        "IMU",
        f"roll {telemetry.roll:+.3f} rad, pitch {telemetry.pitch:+.3f} rad",
        telemetry.has_imu,
        "flash a firmware that reads the IMU: without it a fall cannot be detected; "
        "or give --without-imu and stay within reach of the robot",
    )


def joint_ranges(robot: Robot, telemetry: Sequence[Telemetry]) -> list[Check]:
    """Whether the joints are within their limits."""
    checks = []
    joint_pos = np.array([frame.pos for frame in telemetry])
    for joint, angles in zip(robot.joints, joint_pos.T, strict=True):
        low = angles.min()
        high = angles.max()
        is_inside = joint.lower - _RANGE_SLACK <= low and high <= joint.upper + _RANGE_SLACK
        checks.append(
            Check(
                f"joint {joint.name}",
                f"{angles[-1]:+.3f} rad, was {low:+.3f} to {high:+.3f}; "
                f"limits {joint.lower:+.2f} to {joint.upper:+.2f}",
                bool(is_inside),
                "switch the robot on with its legs free so that it finds its end stops",
            )
        )
    return checks


def _sensors(link: RobotLink, telemetry: Sequence[Telemetry]) -> list[Check]:
    """The faults that would end a motion, and the last readings."""
    sensors = SensorFaults(link.robot, link.limits)
    faults: dict[str, RobotFault] = {}
    for frame in telemetry:
        for fault in sensors.faults(frame, 1e-3 * frame.ts):
            faults[fault.name] = fault

    currents = telemetry[-1].cur
    readings = {
        "current": "not sent" if currents is None else f"up to {np.abs(currents).max():.2f} A",
        "frozen IMU": "no",
    }
    checks = []
    for name, reading in readings.items():
        fault = faults.get(name)
        if fault is None:
            checks.append(Check(name, reading, True))
        else:
            remedy = fault.remedy or "look for a blocked joint"
            checks.append(Check(name, fault.problem, False, remedy))
    return checks
