"""Acceptance of telemetry, and detection of faults of the robot and of the host.

Each check is called once per measurement or control step and yields or raises a `RobotFault` when a
limit of `robots.robot.SafetyLimits` has been exceeded for the given time. Angles have the library's
signs.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.robot import Robot, SafetyLimits

_TIME_STEP = 1e-3  # resolution of the robot's time stamps [s]
_NUM_STEPS = 100  # control steps over which a slow host is detected


class _Debounce:
    """Whether a signal has been true for ``duration`` [s]: a single frame may be damaged."""

    def __init__(self, duration: float):
        self._duration = duration
        self._true_since = math.inf  # [s]; infinite while the signal is false

    def __call__(self, signal: bool, now: float) -> bool:
        if not signal:
            self._true_since = math.inf
        elif now < self._true_since:
            self._true_since = now
        return now - self._true_since >= self._duration - _TIME_STEP


class SensorFaults:
    """Detects a fall, a frozen IMU and overcurrent.

    An IMU is frozen if it worked and now repeats its values or sends zeros, so that a fall would
    not be detected. It counts as having worked once its values have not been 0 for ``imu_time``: a
    single damaged frame of a firmware without IMU does not count.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names = robot.joint_names
        self._limits = limits
        self._tilted = _Debounce(limits.tilt_time)
        self._imu_works = _Debounce(limits.imu_time)
        self._overcurrent = _Debounce(limits.current_time)
        self._imu_has_worked = False
        self._imu_values: tuple[float, ...] = ()  # last attitude and rates
        self._imu_constant_since = 0.0  # time since which these values are constant [s]

    def faults(self, telemetry: Telemetry, now: float) -> Iterator[RobotFault]:
        """The faults in a measurement at ``now`` [s] on the robot's clock."""
        yield from self._current_faults(telemetry, now)
        yield from self._imu_faults(telemetry, now)

        tilt = max(abs(telemetry.roll), abs(telemetry.pitch))
        if self._tilted(tilt > self._limits.max_tilt, now):
            yield RobotFault(
                "fall", f"roll {telemetry.roll:+.2f} rad, pitch {telemetry.pitch:+.2f} rad"
            )

    def _current_faults(self, telemetry: Telemetry, now: float) -> Iterator[RobotFault]:
        currents = np.zeros(len(self._names)) if telemetry.cur is None else np.abs(telemetry.cur)
        joint = int(np.argmax(currents))
        is_too_high = bool(currents[joint] > self._limits.measured_current)
        if self._overcurrent(is_too_high, now):
            yield RobotFault("current", f"{self._names[joint]} draws {currents[joint]:.1f} A")

    def _imu_faults(self, telemetry: Telemetry, now: float) -> Iterator[RobotFault]:
        values = (*telemetry.attitude, *telemetry.rates)
        if self._imu_works(telemetry.has_imu, now):
            self._imu_has_worked = True

        if values != self._imu_values or not self._imu_has_worked:
            self._imu_values = values
            self._imu_constant_since = now
            return
        seconds = now - self._imu_constant_since
        if seconds >= self._limits.imu_time:
            yield RobotFault(
                "frozen IMU",
                f"roll, pitch, yaw and their rates have been constant for {seconds:.2f} s",
                safe_state="crouch",
                remedy="look for a loose IMU, switch the robot off and on",
            )


class TrackingLimits(Protocol):
    """Limits of `TrackingFaults`, see `robots.robot.SafetyLimits`."""

    @property
    def tracking_error(self) -> float: ...  # noqa: D102
    @property
    def tracking_time(self) -> float: ...  # noqa: D102
    @property
    def stuck_motion(self) -> float: ...  # noqa: D102
    @property
    def stuck_target(self) -> float: ...  # noqa: D102
    @property
    def stuck_time(self) -> float: ...  # noqa: D102


class TimingLimits(Protocol):
    """Limits of `SlowHost`, see `robots.robot.SafetyLimits`."""

    @property
    def tick_delay(self) -> float: ...  # noqa: D102
    @property
    def late_ticks(self) -> int: ...  # noqa: D102
    @property
    def stalled_time(self) -> float: ...  # noqa: D102


class TrackingFaults:
    """Detects a joint that does not follow its target.

    A joint is compared with its lagged target, the response of a joint with the sent gains:
    lagged_target += (1 - exp(-dt / lag)) (target - lagged_target), where lag = kd / kp.
    """

    def __init__(self, joint_names: Sequence[str], limits: TrackingLimits, lag: float):
        self._names = joint_names
        self._limits = limits
        self.begin(lag)

    def begin(self, lag: float) -> None:
        """Restart: the lagged target begins at the joint positions of the next measurement.

        Call it for motors that had no current until now. ``lag`` is kd / kp of the new gains [s].
        """
        self._lag = lag
        self._lagged_target: np.ndarray | None = None
        self._last = 0.0  # time of the last measurement [s]
        self._window_start = -math.inf  # time from which stuck joints are detected [s]
        # time since each joint was near its lagged target [s]
        self._seconds_away = np.zeros(len(self._names))
        # (time, positions, lagged targets) of the last measurements
        self._window: list[tuple[float, np.ndarray, np.ndarray]] = []

    def restart_window(self, now: float) -> None:
        """After a pause of the host, detect stuck joints from ``now`` [s] on.

        A call within a second of the last restart has no effect, so that frequent pauses hide no
        stuck joint.
        """
        if now - self._window_start >= 1.0:
            self._window = []
            self._window_start = now

    def faults(self, joint_pos: np.ndarray, target: np.ndarray, now: float) -> Iterator[RobotFault]:
        """Faults of joints that are too far from their lagged targets, or do not move."""
        if self._lagged_target is None:
            self._lagged_target = joint_pos.copy()
            self._last = now

        step = max(0.0, now - self._last)
        self._last = now
        self._lagged_target += (1.0 - math.exp(-step / self._lag)) * (target - self._lagged_target)

        error = np.abs(joint_pos - self._lagged_target)
        is_away = error > self._limits.tracking_error
        self._seconds_away = np.where(is_away, self._seconds_away + step, 0.0)
        joint = int(np.argmax(self._seconds_away))
        seconds = self._seconds_away[joint]
        if seconds >= self._limits.tracking_time:
            yield RobotFault(
                "tracking",
                f"{self._names[joint]} is {error[joint]:.2f} rad from its lagged target, "
                f"for {seconds:.2f} s",
                remedy="look for a motor without power, a loose cable or an obstacle",
            )

        if now >= self._window_start:
            yield from self._stuck(joint_pos, self._lagged_target, now)

    def _stuck(
        self, joint_pos: np.ndarray, lagged_target: np.ndarray, now: float
    ) -> Iterator[RobotFault]:
        """The fault of a joint that is static while its lagged target moves."""
        limits = self._limits
        duration = limits.stuck_time - _TIME_STEP
        window = self._window
        window.append((now, joint_pos.copy(), lagged_target.copy()))
        if now - window[0][0] < duration:
            return
        while now - window[1][0] >= duration:
            del window[0]

        _, _, first_target = window[0]
        motion = np.ptp([angles for _, angles, _ in window], axis=0)
        target_motion = np.abs(lagged_target - first_target)
        is_stuck = (motion < limits.stuck_motion) & (target_motion > limits.stuck_target)
        if is_stuck.any():
            joint = int(np.argmax(is_stuck))
            yield RobotFault(
                "stuck",
                f"{self._names[joint]} moved less than {limits.stuck_motion} rad while its lagged "
                f"target moved {target_motion[joint]:.2f} rad",
                remedy="look for a frozen encoder or a blocked joint",
            )


class SlowHost:
    """Detects a host that is too slow for a control period [s]."""

    def __init__(self, limits: TimingLimits, period: float):
        self._limits = limits
        self._period = period
        # lateness of the last control steps [s]; 0 for up to half a period
        self._lateness = deque([0.0] * _NUM_STEPS, maxlen=_NUM_STEPS)

    def check(self, late: float) -> None:
        """Add the lateness [s] of a command, or of a step that missed the next deadline.

        Raises RobotFault if one step, too many steps or their sum are too late.
        """
        limits = self._limits
        self._lateness.append(late if late > 0.5 * self._period else 0.0)
        num_late = len(self._lateness) - self._lateness.count(0.0)
        total = sum(self._lateness)
        is_too_slow = (
            late > limits.tick_delay or num_late > limits.late_ticks or total > limits.stalled_time
        )
        if is_too_slow:
            raise RobotFault(
                "slow host",
                f"a control step was {1e3 * late:.0f} ms late, {num_late} of the last "
                f"{_NUM_STEPS} were late, by {1e3 * total:.0f} ms in all",
                safe_state="crouch",
                remedy="close other programs on this computer",
            )


_WINDOW = 5.0  # [s]
_MAX_ANGLE = 2.0 * math.pi  # the firmware's own bound on joint angles
# allowed motion in addition to speed times time [rad], because time stamps are whole milliseconds
_SLACK = 0.05
# A frame can be transmitted faster than all earlier frames by at most this time [s]. A time stamp
# that is further ahead of the earlier ones is damaged.
_MAX_LEAD = 0.03
_NUM_AGREEING = 3  # number of agreeing time stamps in a row that are accepted although ahead
_WARM_UP = 20  # number of frames after which the shortest transmission time counts as measured
# A time stamp that goes back by this time [s] or more comes from a robot that was switched on
# again: its clock restarted at 0.
_MIN_CLOCK_RESET = 2.0


@dataclass(frozen=True)
class Measurement:
    """An accepted frame."""

    telemetry: Telemetry
    arrival: float  # time of arrival on the host's monotonic clock [s]
    sampled: float  # time of measurement on the same clock [s]


class TelemetryStream:
    """Accepts telemetry frames, and counts accepted, repeated and impossible ones.

    Without a checksum a damaged frame can decode, so a frame is accepted only if the robot could
    have moved there since the last one. The fastest frames synchronise the robot's clock with the
    host's:

        host time of a frame = min(arrival, ts + offset)

    where the offset is the second smallest (arrival - ts) of the last 5 to 10 s. The smallest is
    not used, because it may come from a damaged time stamp, which would make all frames of the next
    seconds look old. A measurement's age is thus its time in buffers and on the wire, less the
    shortest time on the wire.
    """

    def __init__(self, limits: SafetyLimits):
        self._limits = limits
        # The two smallest offsets (arrival - ts) [s] in the present window and in the previous one.
        # Older offsets are forgotten, since the clocks drift.
        self._window_start = -math.inf
        self._smallest: list[float] = []
        self._smallest_before: list[float] = []
        # offsets (arrival - ts) of the last frames whose time stamps are too far ahead [s]
        self._offsets_ahead: list[float] = []
        self.latest: Measurement | None = None
        # numbers of frames
        self.accepted = 0
        self.repeated = 0
        self.impossible = 0
        self.impossible_in_a_row = 0

    def accept(self, telemetry: Telemetry, arrival: float) -> Measurement | None:
        """The measurement; None for a frame that is repeated or impossible."""
        if self._is_repeated(telemetry):
            self.repeated += 1
            return None
        if not self._is_possible(telemetry, arrival):
            self.impossible += 1
            self.impossible_in_a_row += 1
            return None

        self.accepted += 1
        self.impossible_in_a_row = 0
        sampled = self._host_time(1e-3 * telemetry.ts, arrival)
        self.latest = Measurement(telemetry, arrival, sampled)
        return self.latest

    def fresh(self, now: float) -> Measurement:
        """The latest measurement.

        Raises RobotFault if there is none, if it is old, or after several impossible frames.
        """
        if self.impossible_in_a_row >= self._limits.implausible_frames:
            raise RobotFault(
                "implausible telemetry",
                f"{self.impossible_in_a_row} physically impossible frames in a row",
                remedy="look for a slipping encoder, a loose cable or a restart of the robot",
            )
        if self.latest is None:
            raise RobotFault(
                "stale telemetry", "none yet", remedy="switch the robot on, see `motorprior doctor`"
            )

        age = now - self.latest.sampled
        limit = self._limits.telemetry_age
        if age > limit:
            raise RobotFault(
                "stale telemetry",
                f"the last measurement is {age:.2f} s old, {limit} s is the limit",
            )
        return self.latest

    @property
    def _offset(self) -> float:
        """Host's time minus robot's [s]: the second smallest of the last two windows.

        After a single frame it is the offset of this frame; before the first frame it is infinite.
        """
        offsets = sorted((*self._smallest, *self._smallest_before))
        if not offsets:
            return math.inf
        return offsets[min(1, len(offsets) - 1)]

    def _host_time(self, ts: float, arrival: float) -> float:
        """The time stamp ``ts`` [s] on the host's clock [s], on which ``arrival`` is given."""
        if arrival - self._window_start > _WINDOW:
            self._window_start = arrival
            self._smallest_before = self._smallest
            self._smallest = []
        offsets = sorted((*self._smallest, arrival - ts))
        self._smallest = offsets[:2]
        return min(arrival, ts + self._offset)

    def _is_repeated(self, telemetry: Telemetry) -> bool:
        """Whether a frame is not newer than the latest, although the clock has not been reset."""
        if self.latest is None:
            return False
        seconds_back = 1e-3 * (self.latest.telemetry.ts - telemetry.ts)
        return 0.0 <= seconds_back < _MIN_CLOCK_RESET

    def _is_possible(self, telemetry: Telemetry, arrival: float) -> bool:
        """Whether the values are in range, and reachable from the last accepted frame."""
        if not self._is_in_range(telemetry):
            return False
        if self.latest is None:
            return True

        last = self.latest.telemetry
        step = 1e-3 * (telemetry.ts - last.ts)
        if step < 0.0 or not self._is_in_time(arrival - 1e-3 * telemetry.ts):
            return False
        motion = np.abs(telemetry.pos - last.pos).max()
        rotation = max(abs(telemetry.roll - last.roll), abs(telemetry.pitch - last.pitch))
        return bool(
            motion <= self._limits.joint_speed * step + _SLACK
            and rotation <= self._limits.body_rate * step + _SLACK
        )

    def _is_in_range(self, telemetry: Telemetry) -> bool:
        limits = self._limits
        return not (
            telemetry.ts < 0
            or np.abs(telemetry.pos).max() > _MAX_ANGLE
            or np.abs(telemetry.vel).max() > 3.0 * limits.joint_speed
            or max(map(abs, telemetry.attitude)) > _MAX_ANGLE
            or max(map(abs, telemetry.rates)) > limits.body_rate
        )

    def _is_in_time(self, offset: float) -> bool:
        """Whether a time stamp is not too far ahead of all earlier ones.

        ``offset`` is arrival - ts [s]. If _NUM_AGREEING time stamps in a row are ahead by the same
        time, they are right: the frames before them had waited in the buffer of the port, which
        this host opened long before it read them.
        """
        if self.accepted <= _WARM_UP or self._offset - offset <= _MAX_LEAD:
            self._offsets_ahead = []
            return True

        agreeing = [ahead for ahead in self._offsets_ahead if abs(ahead - offset) <= _MAX_LEAD]
        agreeing.append(offset)
        self._offsets_ahead = agreeing[-_NUM_AGREEING:]
        return len(self._offsets_ahead) == _NUM_AGREEING
