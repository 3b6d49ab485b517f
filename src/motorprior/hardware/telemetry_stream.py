"""Acceptance and age of telemetry frames.

Without a checksum a damaged frame can decode, so a frame is accepted only if the robot could have moved there since the
last one. The fastest frames synchronise the robot's clock with the host's:

    host time of a frame = ts + second smallest of the last 5 to 10 s of (arrival - ts), at most its arrival

so a measurement's age includes its time in buffers, without the shortest transmission time. The second smallest,
because the smallest may come from a damaged time stamp, which would make all frames of the next seconds look old.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import Telemetry
from motorprior.robots.wire import SafetyLimits

_WINDOW = 5.0  # [s]
_MAX_ANGLE = 2.0 * math.pi  # the firmware's own bound on joint angles
_SLACK = 0.05  # [rad] in addition to speed times time: time stamps are whole milliseconds
_MAX_LEAD = 0.03  # [s] by which a frame may be faster than all before; a time stamp further ahead is damaged
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
    """Accepts telemetry frames, and counts accepted, repeated and impossible ones."""

    def __init__(self, limits: SafetyLimits):
        self._limits, self._since = limits, -math.inf
        # The two smallest host's minus robot's time [s] of this window and of the one before, which follow drift.
        self._current, self._previous, self._ahead = list[float](), list[float](), list[float]()
        self.latest: Measurement | None = None
        self.accepted = self.repeated = self.impossible = self.impossible_in_a_row = 0

    def accept(self, telemetry: Telemetry, arrival: float) -> Measurement | None:
        """The measurement; None for a frame that is repeated or impossible."""
        # A clock that starts again at 0 is impossible, not a duplicate or an overtaken frame.
        if self.latest is not None and 0.0 <= 1e-3 * (self.latest.telemetry.ts - telemetry.ts) < _RESTART:
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
            raise RobotFault("stale telemetry", "none yet", remedy="switch the robot on, see `motorprior doctor`")
        age, limit = now - self.latest.sampled, self._limits.telemetry_age
        if age > limit:
            raise RobotFault("stale telemetry", f"the last measurement is {age:.2f} s old, {limit} s is the limit")
        return self.latest

    @property
    def _offset(self) -> float:
        """Host's time minus robot's [s]; infinite before the first frame."""
        smallest = sorted((*self._current, *self._previous))[:2]
        return smallest[-1] if smallest else math.inf

    def _host_time(self, ts: float, arrival: float) -> float:
        """The time stamp ``ts`` [s] on the host's clock, on which the frame arrived at ``arrival`` [s]."""
        if arrival - self._since > _WINDOW:
            self._since, self._previous, self._current = arrival, self._current, []
        self._current = sorted((*self._current, arrival - ts))[:2]
        return min(arrival, ts + self._offset)

    def _is_possible(self, new: Telemetry, arrival: float) -> bool:
        limits = self._limits
        if new.ts < 0 or np.abs(new.pos).max() > _MAX_ANGLE or np.abs(new.vel).max() > 3.0 * limits.joint_speed:
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
        return bool(moved <= limits.joint_speed * step + _SLACK and turned <= limits.body_rate * step + _SLACK)

    def _is_in_time(self, offset: float) -> bool:
        """Whether a time stamp, given as arrival - ts [s], is not too far ahead of all earlier ones.

        If several in a row agree, the earlier frames had waited in the buffer of a port that was opened long before.
        """
        if self.accepted <= _WARM_UP or self._offset - offset <= _MAX_LEAD:
            self._ahead = []
            return True
        agreeing = [each for each in self._ahead if abs(each - offset) <= _MAX_LEAD]
        self._ahead = [*agreeing, offset][-_NUM_AGREEING:]
        return len(self._ahead) == _NUM_AGREEING
