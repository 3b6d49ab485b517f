"""Acceptance and age of telemetry, and fault detection in telemetry, sent targets and the host's timing.

Each check is called once per measurement or control step and yields or raises a `RobotFault` when a
limit of `robots.robot.SafetyLimits` has been exceeded for the given time. Angles have the library's
signs.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.robot import Robot, SafetyLimits


class _Debounce:
    """Whether a condition has been true for ``duration`` [s]: a single frame may be damaged."""

    def __init__(self, duration: float):
        self._duration = duration
        self._since = math.inf

    def __call__(self, condition: bool, now: float) -> bool:
        self._since = min(self._since, now) if condition else math.inf
        return now - self._since >= self._duration - 1e-3  # time stamps are whole milliseconds


class SensorFaults:
    """Detects a fall, a frozen IMU and overcurrent.

    An IMU is frozen if it worked and now repeats its values or sends zeros, so that a fall would
    not be detected. It has worked once its values were not 0 for ``imu_time``: one damaged frame of
    a firmware without IMU does not count.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names = robot.joint_names
        self._limits = limits
        times = limits.tilt_time, limits.imu_time, limits.current_time
        self._tilted, self._imu_works, self._overcurrent = map(_Debounce, times)
        self._imu_has_worked = False
        self._last = tuple[float, ...]()
        self._since = 0.0

    def faults(self, telemetry: Telemetry, now: float) -> Iterator[RobotFault]:
        """The faults in a measurement at ``now`` [s] on the robot's clock."""
        limits = self._limits
        currents = np.zeros(len(self._names)) if telemetry.cur is None else np.abs(telemetry.cur)
        joint = int(np.argmax(currents))
        if self._overcurrent(bool(currents[joint] > limits.measured_current), now):
            yield RobotFault("current", f"{self._names[joint]} draws {currents[joint]:.1f} A")
        values = (*telemetry.attitude, *telemetry.rates)
        self._imu_has_worked = self._imu_works(telemetry.has_imu, now) or self._imu_has_worked
        if values != self._last or not self._imu_has_worked:
            self._last = values
            self._since = now
        elif now - self._since >= limits.imu_time:
            problem = (
                f"roll, pitch, yaw and their rates have been constant for {now - self._since:.2f} s"
            )
            remedy = "look for a loose IMU, switch the robot off and on"
            yield RobotFault("frozen IMU", problem, safe_state="crouch", remedy=remedy)
        if self._tilted(max(abs(telemetry.roll), abs(telemetry.pitch)) > limits.max_tilt, now):
            yield RobotFault(
                "fall", f"roll {telemetry.roll:+.2f} rad, pitch {telemetry.pitch:+.2f} rad"
            )


class TrackingFaults:
    """Detects a joint that does not follow its target.

    The reference is the response of a joint with the sent gains, a first-order lag of kd/kp:
    reference += (1 - exp(-dt / lag)) (target - reference).
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names = robot.joint_names
        self._limits = limits
        self.begin(robot.require_wire().kd / robot.require_wire().kp)

    def begin(self, lag: float) -> None:
        """Restart at the next measurement, with ``lag`` [s]: the motors had no current before."""
        self._lag = lag
        self._reference: np.ndarray | None = None
        self._last, self._restart, self._away = 0.0, -math.inf, np.zeros(len(self._names))
        self._window: list[tuple[float, np.ndarray, np.ndarray]] = []

    def restart_window(self, now: float) -> None:
        """After a pause of the host, detect stuck joints from ``now`` [s] on; once a second, so as to hide none."""
        if now - self._restart >= 1.0:
            self._window = []
            self._restart = now

    def faults(self, joint_pos: np.ndarray, target: np.ndarray, now: float) -> Iterator[RobotFault]:
        """The fault of a joint that is too far from the reference for too long, or does not move at all."""
        if self._reference is None:
            self._reference = joint_pos.copy()
            self._last = now
        step = max(0.0, now - self._last)
        self._last = now
        self._reference += (1.0 - math.exp(-step / self._lag)) * (target - self._reference)
        error = np.abs(joint_pos - self._reference)
        self._away = np.where(error > self._limits.tracking_error, self._away + step, 0.0)
        worst = int(np.argmax(self._away))
        if self._away[worst] >= self._limits.tracking_time:
            problem = f"{self._names[worst]} is {error[worst]:.2f} rad from its lagged target, for "
            remedy = "look for a motor without power, a loose cable or an obstacle"
            yield RobotFault("tracking", f"{problem}{self._away[worst]:.2f} s", remedy=remedy)
        if now >= self._restart:
            yield from self._stuck(joint_pos, self._reference, now)

    def _stuck(
        self, joint_pos: np.ndarray, reference: np.ndarray, now: float
    ) -> Iterator[RobotFault]:
        limits = self._limits
        self._window.append((now, joint_pos.copy(), reference.copy()))
        if now - self._window[0][0] < limits.stuck_time - 1e-3:
            return
        while now - self._window[1][0] >= limits.stuck_time - 1e-3:
            del self._window[0]
        moved = np.ptp([angles for _, angles, _ in self._window], axis=0)
        expected = np.abs(reference - self._window[0][2])
        stuck = (moved < limits.stuck_motion) & (expected > limits.stuck_target)
        if stuck.any():
            joint = int(np.argmax(stuck))
            problem = f"{self._names[joint]} moved less than {limits.stuck_motion} rad while its lagged target "
            problem += f"moved {expected[joint]:.2f} rad"
            yield RobotFault(
                "stuck", problem, remedy="look for a frozen encoder or a blocked joint"
            )


class SlowHost:
    """Detects a host that is too slow for a control period [s]."""

    def __init__(self, limits: SafetyLimits, period: float):
        self._limits = limits
        self._period = period
        self._late = deque([0.0] * 100, maxlen=100)

    def check(self, late: float) -> None:
        """Add the lateness [s] of a command, or of a step that missed the next deadline; raise if it is too much."""
        limits = self._limits
        self._late.append(late if late > 0.5 * self._period else 0.0)
        num_late = len(self._late) - self._late.count(0.0)
        total = sum(self._late)
        if late > limits.tick_delay or num_late > limits.late_ticks or total > limits.stalled_time:
            problem = f"a control step was {1e3 * late:.0f} ms late, {num_late} of the last hundred were late, by "
            problem += f"{1e3 * total:.0f} ms in all"
            raise RobotFault(
                "slow host",
                problem,
                safe_state="crouch",
                remedy="close other programs on this computer",
            )


_WINDOW = 5.0  # [s]
_MAX_ANGLE = 2.0 * math.pi  # the firmware's own bound on joint angles
_SLACK = 0.05  # [rad] in addition to speed times time: time stamps are whole milliseconds
# [s] by which a frame may be faster than all before; a time stamp further ahead is damaged
_MAX_LEAD = 0.03
_NUM_AGREEING = 3  # so many leading time stamps in a row are accepted if they agree
_WARM_UP = 20  # frames until the shortest transmission time is measured
_RESTART = 2.0  # [s] by which a clock that starts again at 0 goes back


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

        host time of a frame = ts + second smallest of the last 5 to 10 s of (arrival - ts), at most
        its arrival

    so a measurement's age includes its time in buffers, without the shortest transmission time. The
    second smallest, because the smallest may come from a damaged time stamp, which would make all
    frames of the next seconds look old.
    """

    def __init__(self, limits: SafetyLimits):
        self._limits = limits
        self._since = -math.inf
        # The two smallest host's minus robot's time [s] of this window and of the one before, which
        # follow drift.
        self._current = list[float]()
        self._previous = list[float]()
        self._ahead = list[float]()
        self.latest: Measurement | None = None
        self.accepted = self.repeated = self.impossible = self.impossible_in_a_row = 0

    def accept(self, telemetry: Telemetry, arrival: float) -> Measurement | None:
        """The measurement; None for a frame that is repeated or impossible."""
        # A clock that starts again at 0 is impossible, not a duplicate or an overtaken frame.
        if (
            self.latest is not None
            and 0.0 <= 1e-3 * (self.latest.telemetry.ts - telemetry.ts) < _RESTART
        ):
            self.repeated += 1
            return None
        if not self._is_possible(telemetry, arrival):
            self.impossible += 1
            self.impossible_in_a_row += 1
            return None
        self.accepted += 1
        self.impossible_in_a_row = 0
        self.latest = Measurement(telemetry, arrival, self._host_time(1e-3 * telemetry.ts, arrival))
        return self.latest

    def fresh(self, now: float) -> Measurement:
        """The latest measurement; RobotFault if there is none, if it is old, or after several impossible frames."""
        if self.impossible_in_a_row >= self._limits.implausible_frames:
            problem = f"{self.impossible_in_a_row} physically impossible frames in a row"
            remedy = "look for a slipping encoder, a loose cable or a restart of the robot"
            raise RobotFault("implausible telemetry", problem, remedy=remedy)
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
        """Host's time minus robot's [s]; infinite before the first frame."""
        smallest = sorted((*self._current, *self._previous))[:2]
        return smallest[-1] if smallest else math.inf

    def _host_time(self, ts: float, arrival: float) -> float:
        """The time stamp ``ts`` [s] on the host's clock, on which the frame arrived at ``arrival`` [s]."""
        if arrival - self._since > _WINDOW:
            self._since = arrival
            self._previous = self._current
            self._current = []
        self._current = sorted((*self._current, arrival - ts))[:2]
        return min(arrival, ts + self._offset)

    def _is_possible(self, new: Telemetry, arrival: float) -> bool:
        limits = self._limits
        if (
            new.ts < 0
            or np.abs(new.pos).max() > _MAX_ANGLE
            or np.abs(new.vel).max() > 3.0 * limits.joint_speed
        ):
            return False
        if max(map(abs, new.attitude)) > _MAX_ANGLE or max(map(abs, new.rates)) > limits.body_rate:
            return False
        if self.latest is None:
            return True
        last = self.latest.telemetry
        step = 1e-3 * (new.ts - last.ts)
        if step < 0.0 or not self._is_in_time(arrival - 1e-3 * new.ts):
            return False
        moved = np.abs(new.pos - last.pos).max()
        turned = max(abs(new.roll - last.roll), abs(new.pitch - last.pitch))
        return bool(
            moved <= limits.joint_speed * step + _SLACK
            and turned <= limits.body_rate * step + _SLACK
        )

    def _is_in_time(self, offset: float) -> bool:
        """Whether a time stamp, given as arrival - ts [s], is not too far ahead of all earlier ones.

        If several in a row agree, the earlier frames had waited in the buffer of a port that was
        opened long before.
        """
        if self.accepted <= _WARM_UP or self._offset - offset <= _MAX_LEAD:
            self._ahead = []
            return True
        agreeing = [each for each in self._ahead if abs(each - offset) <= _MAX_LEAD]
        self._ahead = [*agreeing, offset][-_NUM_AGREEING:]
        return len(self._ahead) == _NUM_AGREEING
