"""Acceptance of frames, and their age.

Without a checksum a damaged frame can look right, so a frame is accepted only if the robot could have moved there
since the last one. The robot's clock is tied to the host's by the quickest frames:

    host time of a frame = ts + second smallest of the last 5 to 10 s of (arrival - ts), not after its arrival

so the age of a measurement includes what it waited in buffers, less the shortest way that frames took. The smallest may
be that of a damaged stamp, which would make every frame of the next seconds look old. A stamp ahead of all others is
taken for damaged, unless those that follow agree with it: then all before had waited, in the buffer of a port that was
opened long before it was read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motorprior.hardware.protocol import Telemetry
from motorprior.robots.wire import SafetyLimits

_WINDOW = 5.0
_FURTHEST_ANGLE = 2.0 * math.pi  # the firmware's own bound of a joint angle
_SLACK = 0.05  # [rad] on top of speed times time: the time stamps are whole milliseconds
_EARLIEST = 0.03  # [s] by which a frame may come quicker than any before; a stamp further ahead is a damaged one
_AGREEING = 3  # stamps in a row that are right together
_SETTLING = 20  # frames until the quickest way is known
_RESTART = 2.0  # [s] of a clock that runs from 0 again


@dataclass(frozen=True)
class Measurement:
    """An accepted frame.

    Attributes:
        telemetry: the frame.
        arrival: when it came, on the host's monotonic clock [s].
        sampled: when it was measured, on the same clock [s].
    """

    telemetry: Telemetry
    arrival: float
    sampled: float


class ClockTie:
    """Offset between the robot's clock and the host's over a moving window, so that drift is followed."""

    def __init__(self) -> None:
        self._since = -math.inf
        self._current: list[float] = []
        self._previous: list[float] = []

    @property
    def offset(self) -> float:
        """Host's clock minus robot's [s]; infinite before the first frame."""
        smallest = sorted((*self._current, *self._previous))[:2]
        return smallest[-1] if smallest else math.inf

    def host_time(self, ts: float, arrival: float) -> float:
        """When something stamped ``ts`` [s] happened, on the clock of ``arrival`` [s]."""
        if arrival - self._since > _WINDOW:
            self._since, self._previous, self._current = arrival, self._current, []
        self._current = sorted((*self._current, arrival - ts))[:2]
        return min(arrival, ts + self.offset)


class TelemetryStream:
    """Sorts frames into accepted, repeated and impossible ones, and counts them."""

    def __init__(self, limits: SafetyLimits):
        self._limits, self._tie = limits, ClockTie()
        self._ahead: list[float] = []
        self.latest: Measurement | None = None
        self.accepted = self.repeated = self.impossible = self.impossible_in_a_row = 0

    def take(self, telemetry: Telemetry, arrival: float) -> Measurement | None:
        """The measurement, or None for a frame that is not accepted."""
        last = self.latest
        if last is not None and _is_old(telemetry, last.telemetry):
            self.repeated += 1
            return None
        if not self._is_possible(telemetry, arrival):
            self.impossible += 1
            self.impossible_in_a_row += 1
            return None
        self.accepted += 1
        self.impossible_in_a_row = 0
        sampled = self._tie.host_time(1e-3 * telemetry.ts, arrival)
        self.latest = Measurement(telemetry, arrival, sampled)
        return self.latest

    def _is_possible(self, new: Telemetry, arrival: float) -> bool:
        limits = self._limits
        if new.ts < 0 or np.abs(new.pos).max() > _FURTHEST_ANGLE or np.abs(new.vel).max() > 3.0 * limits.joint_speed:
            return False
        if max(map(abs, (new.roll, new.pitch, new.yaw))) > _FURTHEST_ANGLE:
            return False
        if max(map(abs, (new.roll_rate, new.pitch_rate, new.yaw_rate))) > limits.body_rate:
            return False
        return self.latest is None or self._could_follow(new, self.latest, arrival)

    def _could_follow(self, new: Telemetry, last: Measurement, arrival: float) -> bool:
        step = 1e-3 * (new.ts - last.telemetry.ts)
        if step < 0.0 or not self._is_in_time(arrival - 1e-3 * new.ts):
            return False
        moved = np.abs(new.pos - last.telemetry.pos).max()
        turned = max(abs(new.roll - last.telemetry.roll), abs(new.pitch - last.telemetry.pitch))
        return bool(
            moved <= self._limits.joint_speed * step + _SLACK and turned <= self._limits.body_rate * step + _SLACK
        )

    def _is_in_time(self, offset: float) -> bool:
        """Whether a stamp, by its host time minus robot time [s], is not from the future, or no other than the last."""
        if self.accepted <= _SETTLING or self._tie.offset - offset <= _EARLIEST:
            self._ahead = []
            return True
        agreeing = [each for each in self._ahead if abs(each - offset) <= _EARLIEST]
        self._ahead = [*agreeing, offset][-_AGREEING:]
        return len(self._ahead) == _AGREEING


def _is_old(new: Telemetry, last: Telemetry) -> bool:
    """A duplicate, or a frame that was overtaken. A clock that begins at 0 again is not old, but impossible."""
    return 0.0 <= 1e-3 * (last.ts - new.ts) < _RESTART
