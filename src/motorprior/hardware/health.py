"""Faults of a robot, found in accepted telemetry and the targets that were sent. One small class per kind.

Each check is called once per measurement and raises `RobotFault` when its bound (`robots.wire.SafetyLimits`) is broken
for the stated time. Angles are those of the library, not of the wire.
"""

from __future__ import annotations

import math

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.telemetry_stream import Measurement, TelemetryStream
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits

_ONCE_IN = 1.0
"""Least time [s] between two pauses of the host after which joints get time to move again."""


class _Lasting:
    """Whether a condition has held for ``duration`` [s]: a single damaged frame proves nothing."""

    def __init__(self, duration: float):
        self._duration, self._since = duration, math.inf

    def __call__(self, is_so: bool, now: float) -> bool:
        self._since = min(self._since, now) if is_so else math.inf
        return now - self._since >= self._duration - 1e-3  # stamps are whole milliseconds


class Tilt:
    """The body leans further than any walking body does."""

    def __init__(self, limits: SafetyLimits):
        self._limits, self._leans = limits, _Lasting(limits.tilt_time)

    def check(self, telemetry: Telemetry, now: float) -> None:
        """Raise once roll or pitch has been beyond ``max_tilt`` for ``tilt_time``."""
        if self._leans(max(abs(telemetry.roll), abs(telemetry.pitch)) > self._limits.max_tilt, now):
            raise RobotFault("fall", f"roll {telemetry.roll:+.2f} rad, pitch {telemetry.pitch:+.2f} rad")


class FrozenImu:
    """An IMU that worked before repeats its values, or sends zeros, so that a fall would not be detected.

    `is_imu_alive` finds an IMU that never was alive. To have been alive takes ``imu_time``: one damaged
    frame of a firmware that reads no IMU does not count.
    """

    def __init__(self, limits: SafetyLimits):
        self._limits, self._lives = limits, _Lasting(limits.imu_time)
        self._was_alive = False
        self._last: tuple[float, ...] = ()
        self._since = 0.0

    def check(self, telemetry: Telemetry, now: float) -> None:
        """Raise once all six values have been the same for ``imu_time``."""
        values = (telemetry.roll, telemetry.pitch, telemetry.yaw)
        values += (telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate)
        self._was_alive = self._lives(is_imu_alive(telemetry), now) or self._was_alive
        if values != self._last or not self._was_alive:
            self._last, self._since = values, now
        elif now - self._since >= self._limits.imu_time:
            raise RobotFault(
                "frozen IMU",
                f"roll, pitch, yaw and their rates have been the same for {now - self._since:.2f} s",
                safe_state="crouch",
                remedy="look for a loose IMU, switch the robot off and on",
            )


class Tracking:
    """A joint is not where its target has been leading it.

    reference += (1 - exp(-dt / lag)) (target - reference), lag = kd / kp of the gains that were sent: what a joint
    with these gains does.

    Args:
        robot: with a wire; until `begin`, the lag is that of its own gains.
        limits: bounds.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names, self._limits = robot.joint_names, limits
        self.begin(robot.require_wire().tracking_lag)

    def begin(self, lag: float) -> None:
        """Restart from the next measurement, with ``lag`` [s]: the motors had no current until now."""
        self._lag = lag
        self._reference: np.ndarray | None = None
        self._last, self._moves_since, self._away = 0.0, -math.inf, np.zeros(len(self._names))
        self._windows: list[tuple[float, np.ndarray, np.ndarray]] = []

    def begin_again(self, now: float) -> None:
        """Look for stuck joints from ``now`` [s] on: the host stood still, and joints rested that would have moved.

        At most once in `_ONCE_IN`, so that no number of pauses hides a joint that is stuck.
        """
        if now - self._moves_since >= _ONCE_IN:
            self._windows, self._moves_since = [], now

    def check(self, joint_pos: np.ndarray, target: np.ndarray, now: float) -> None:
        """Raise for a joint that is too far away for too long, or that does not move although it is led."""
        if self._reference is None:
            self._reference, self._last = joint_pos.copy(), now
        step, self._last = max(0.0, now - self._last), now
        self._reference += (1.0 - math.exp(-step / self._lag)) * (target - self._reference)
        error = np.abs(joint_pos - self._reference)
        self._away = np.where(error > self._limits.tracking_error, self._away + step, 0.0)
        worst = int(np.argmax(self._away))
        if self._away[worst] >= self._limits.tracking_time:
            raise RobotFault(
                "tracking",
                f"{self._names[worst]} is {error[worst]:.2f} rad from where its target led it, for "
                f"{self._away[worst]:.2f} s",
                remedy="look for a motor without power, a loose cable or an obstacle",
            )
        self._check_stuck(joint_pos, now)

    def _check_stuck(self, joint_pos: np.ndarray, now: float) -> None:
        assert self._reference is not None
        if now < self._moves_since:
            return
        self._windows.append((now, joint_pos.copy(), self._reference.copy()))
        if now - self._windows[0][0] < self._limits.stuck_time - 1e-3:
            return
        while now - self._windows[1][0] >= self._limits.stuck_time - 1e-3:
            del self._windows[0]
        moved = np.ptp([angles for _, angles, _ in self._windows], axis=0)
        led = np.abs(self._windows[-1][2] - self._windows[0][2])
        stuck = (moved < self._limits.stuck_motion) & (led > self._limits.stuck_target)
        if stuck.any():
            joint = int(np.argmax(stuck))
            raise RobotFault(
                "stuck",
                f"{self._names[joint]} moved less than {self._limits.stuck_motion} rad while its target led it "
                f"{led[joint]:.2f} rad",
                remedy="look for a frozen encoder or a blocked joint",
            )


class Extras:
    """Currents, temperatures and battery, where the robot sends them."""

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._names, self._limits = robot.joint_names, limits
        self._current = _Lasting(limits.current_time)
        self._temperature, self._battery = _Lasting(limits.warning_time), _Lasting(limits.warning_time)

    def check(self, telemetry: Telemetry, now: float) -> None:
        """Raise once a current has been too high for ``current_time``, or another value bad for ``warning_time``."""
        limits, current, temperature = self._limits, telemetry.cur, telemetry.temp
        if self._current(current is not None and np.abs(current).max() > limits.measured_current, now):
            assert current is not None
            worst = int(np.argmax(np.abs(current)))
            raise RobotFault("current", f"{self._names[worst]} draws {current[worst]:.1f} A")
        if self._temperature(temperature is not None and temperature.max() > limits.temperature, now):
            assert temperature is not None
            worst = int(np.argmax(temperature))
            raise RobotFault(
                "temperature",
                f"{self._names[worst]} is at {temperature[worst]:.0f} °C",
                safe_state="crouch",
                remedy="let the motors cool down",
            )
        if self._battery(telemetry.bat is not None and telemetry.bat < limits.battery, now):
            raise RobotFault("battery", f"{telemetry.bat:.1f} V", safe_state="crouch", remedy="charge the battery")


def check_stream(stream: TelemetryStream, limits: SafetyLimits, now: float) -> Measurement:
    """The latest measurement, if it may be acted on.

    Raises:
        RobotFault: none yet, an old one, or a row of impossible ones.
    """
    if stream.impossible_in_a_row >= limits.implausible_frames:
        raise RobotFault(
            "implausible telemetry",
            f"{stream.impossible_in_a_row} frames in a row that no robot can be in",
            remedy="look for a slipping encoder, a loose cable or a restart of the robot",
        )
    if stream.latest is None:
        raise RobotFault("stale telemetry", "nothing came yet", remedy="switch the robot on, see `motorprior doctor`")
    age = now - stream.latest.sampled
    if age > limits.telemetry_age:
        raise RobotFault(
            "stale telemetry", f"the last measurement is {age:.2f} s old, {limits.telemetry_age} s is the limit"
        )
    return stream.latest


def is_imu_alive(telemetry: Telemetry) -> bool:
    """False where every value is exactly 0, as the current firmware sends."""
    return any((telemetry.roll, telemetry.pitch, telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate))


class Pace:
    """Whether the host keeps up with its own clock.

    Args:
        limits: bounds.
        period: control period [s].
    """

    def __init__(self, limits: SafetyLimits, period: float):
        self._limits, self._period, self._late = limits, period, [0.0] * 100
        self._count = 0

    def check(self, late: float) -> None:
        """Count one control step that was done, or whose command left, ``late`` [s] after its time.

        Raises:
            RobotFault: one step far too late, too many late ones, or too much lateness in all; the robot sits down.
        """
        limits, steps = self._limits, self._late
        steps[self._count % len(steps)] = late if late > 0.5 * self._period else 0.0
        self._count += 1
        many, together = len(steps) - steps.count(0.0), sum(steps)
        if late > limits.tick_delay or many > limits.late_ticks or together > limits.stalled_time:
            raise RobotFault(
                "slow host",
                f"a control step came {1e3 * late:.0f} ms late, {many} of the last hundred were late, by "
                f"{1e3 * together:.0f} ms in all",
                safe_state="crouch",
                remedy="close other programs on this computer",
            )
