"""Fault detection in telemetry, sent targets and the host's timing.

Each check is called once per measurement or control step and yields or raises a `RobotFault` when a limit of
`robots.wire.SafetyLimits` has been exceeded for the given time. Angles have the library's signs.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits


class _Debounce:
    """Whether a condition has been true for ``duration`` [s]: a single frame may be damaged."""

    def __init__(self, duration: float):
        self._duration, self._since = duration, math.inf

    def __call__(self, condition: bool, now: float) -> bool:
        self._since = min(self._since, now) if condition else math.inf
        return now - self._since >= self._duration - 1e-3  # time stamps are whole milliseconds


class Sensors:
    """Detects a fall, a frozen IMU, overcurrent, overheating and an empty battery.

    An IMU is frozen if it worked and now repeats its values or sends zeros, so that a fall would not be detected. It
    has worked once its values were not 0 for ``imu_time``: one damaged frame of a firmware without IMU does not count.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names, self._limits = robot.joint_names, limits
        times = limits.tilt_time, limits.imu_time, limits.current_time, limits.warning_time, limits.warning_time
        self._tilted, self._imu_works, self._overcurrent, self._hot, self._empty = map(_Debounce, times)
        self._imu_has_worked, self._last, self._since = False, tuple[float, ...](), 0.0

    def faults(self, telemetry: Telemetry, now: float) -> Iterator[RobotFault]:
        """The faults in a measurement at ``now`` [s] on the robot's clock."""
        limits = self._limits
        name, current = self._largest(None if telemetry.cur is None else np.abs(telemetry.cur))
        if self._overcurrent(current > limits.measured_current, now):
            yield RobotFault("current", f"{name} draws {current:.1f} A")
        name, temperature = self._largest(telemetry.temp)
        if self._hot(temperature > limits.temperature, now):
            problem, remedy = f"{name} is at {temperature:.0f} °C", "let the motors cool down"
            yield RobotFault("temperature", problem, safe_state="crouch", remedy=remedy)
        if self._empty(telemetry.bat is not None and telemetry.bat < limits.battery, now):
            yield RobotFault("battery", f"{telemetry.bat:.1f} V", safe_state="crouch", remedy="charge the battery")
        values = (*telemetry.attitude, *telemetry.rates)
        self._imu_has_worked = self._imu_works(telemetry.has_imu, now) or self._imu_has_worked
        if values != self._last or not self._imu_has_worked:
            self._last, self._since = values, now
        elif now - self._since >= limits.imu_time:
            problem = f"roll, pitch, yaw and their rates have been constant for {now - self._since:.2f} s"
            remedy = "look for a loose IMU, switch the robot off and on"
            yield RobotFault("frozen IMU", problem, safe_state="crouch", remedy=remedy)
        if self._tilted(max(abs(telemetry.roll), abs(telemetry.pitch)) > limits.max_tilt, now):
            yield RobotFault("fall", f"roll {telemetry.roll:+.2f} rad, pitch {telemetry.pitch:+.2f} rad")

    def _largest(self, values: np.ndarray | None) -> tuple[str, float]:
        """Joint and value of the largest of (joints,) values."""
        joint = 0 if values is None else int(np.argmax(values))
        return self._names[joint], -math.inf if values is None else float(values[joint])


class Tracking:
    """Detects a joint that does not follow its target.

    The reference is the response of a joint with the sent gains, a first-order lag of kd/kp:
    reference += (1 - exp(-dt / lag)) (target - reference).
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names, self._limits = robot.joint_names, limits
        self.begin(robot.require_wire().tracking_lag)

    def begin(self, lag: float) -> None:
        """Restart at the next measurement, with ``lag`` [s]: the motors had no current before."""
        self._lag = lag
        self._reference: np.ndarray | None = None
        self._last, self._restart, self._away = 0.0, -math.inf, np.zeros(len(self._names))
        self._window: list[tuple[float, np.ndarray, np.ndarray]] = []

    def restart_window(self, now: float) -> None:
        """Detect stuck joints only from ``now`` [s] on: the host paused, and no target moved meanwhile.

        At most once a second, so that many pauses cannot hide a stuck joint.
        """
        if now - self._restart >= 1.0:
            self._window, self._restart = [], now

    def faults(self, joint_pos: np.ndarray, target: np.ndarray, now: float) -> Iterator[RobotFault]:
        """The fault of a joint that is too far from the reference for too long, or does not move at all."""
        if self._reference is None:
            self._reference, self._last = joint_pos.copy(), now
        step, self._last = max(0.0, now - self._last), now
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

    def _stuck(self, joint_pos: np.ndarray, reference: np.ndarray, now: float) -> Iterator[RobotFault]:
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
            yield RobotFault("stuck", problem, remedy="look for a frozen encoder or a blocked joint")


class SlowHost:
    """Detects a host that is too slow for a control period [s]."""

    def __init__(self, limits: SafetyLimits, period: float):
        self._limits, self._period = limits, period
        self._late = deque([0.0] * 100, maxlen=100)

    def check(self, late: float) -> None:
        """Add the lateness [s] of a step: of its command, or of its end if that missed the next deadline.

        Raise if one step is far too late, too many steps are late, or the sum is too large.
        """
        limits = self._limits
        self._late.append(late if late > 0.5 * self._period else 0.0)
        num_late, total = len(self._late) - self._late.count(0.0), sum(self._late)
        if late > limits.tick_delay or num_late > limits.late_ticks or total > limits.stalled_time:
            problem = f"a control step was {1e3 * late:.0f} ms late, {num_late} of the last hundred were late, by "
            problem += f"{1e3 * total:.0f} ms in all"
            raise RobotFault("slow host", problem, safe_state="crouch", remedy="close other programs on this computer")
