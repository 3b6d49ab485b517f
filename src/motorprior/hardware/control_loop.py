"""Control steps at absolute times on the monotonic clock, and figures of how well they were kept."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from motorprior.hardware.health import Pace
from motorprior.hardware.motions import Motion
from motorprior.hardware.robot import Robot
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.robot_run import Mode
from motorprior.robots.pupper_v2.spec import SafetyLimits

_AFTER_TELEMETRY = 0.0015
"""A step aims at this time [s] after the arrival of a measurement, so that it acts on a fresh one."""
_LARGEST_SHIFT = 2e-5
"""[s] by which one period may differ from the nominal one to get there: robot and host have their own clocks."""


@dataclass
class Timing:
    """Of every control step, seconds.

    Attributes:
        sent: when its command left.
        delay: of its beginning behind its time.
        age: of the measurement it acted on, when its command left.
        stamp: the robot's time stamp of that measurement.
        skipped: steps that were left out because the one before took too long.
    """

    sent: array = field(default_factory=lambda: array("d"))
    delay: array = field(default_factory=lambda: array("d"))
    age: array = field(default_factory=lambda: array("d"))
    stamp: array = field(default_factory=lambda: array("d"))
    skipped: int = 0

    def add(self, sent: float, delay: float, measurement: Measurement) -> None:
        """One more step."""
        self.sent.append(sent)
        self.delay.append(delay)
        self.age.append(sent - measurement.sampled)
        self.stamp.append(1e-3 * measurement.telemetry.ts)

    def figures(self, period: float) -> dict[str, float]:
        """Jitter of the period, share of missed deadlines, age of the telemetry.

        period_jitter_ms/Q: quantile Q of |time between two commands - period|. missed_share: steps that were skipped or
        whose command left more than half a period late. telemetry_age_ms/Q: of the measurement acted on.
        """
        if len(self.sent) < 2:
            return {}
        jitter = 1e3 * np.abs(np.diff(self.sent) - period)
        age, delay = 1e3 * np.asarray(self.age), np.asarray(self.delay)
        late = int(np.count_nonzero(delay > 0.5 * period)) + self.skipped
        quantiles = {"p50": 50.0, "p99": 99.0, "max": 100.0}
        return {
            **{f"period_jitter_ms/{name}": float(np.percentile(jitter, q)) for name, q in quantiles.items()},
            "missed_share": late / (len(self.sent) + self.skipped),
            **{f"telemetry_age_ms/{name}": float(np.percentile(age, q)) for name, q in quantiles.items()},
            "control_steps": float(len(self.sent)),
        }


class ControlLoop:
    """Plays motions on an armed robot.

    Attributes:
        timing: of the motion played last.

    Args:
        robot: armed.
        limits: for the host's pace.
        period: control period [s].
        stop: asked before every step; True ends the motion.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits, period: float, stop: Callable[[], bool]):
        self._robot, self._period, self._stop = robot, period, stop
        self._pace = Pace(limits, period)
        self._deadline = time.monotonic() + period
        self.timing = Timing()

    def play(
        self,
        motion: Motion,
        mode: Mode,
        after_step: Callable[[Measurement], None] = lambda _: None,
        timing: Timing | None = None,
    ) -> Measurement | None:
        """Play ``motion`` until it ends or ``stop`` says so; returns the last measurement.

        Args:
            motion: gives the targets.
            mode: for the recording.
            after_step: called after the command has left, in the slack of the period; must be quick.
            timing: filled, also if a fault ends the motion.

        Raises:
            RobotFault: see `Robot.check`, `Robot.send` and `Pace.check`.
        """
        measurement, self.timing = None, timing or Timing()
        self._deadline = max(self._deadline, time.monotonic() + self._period)
        while not self._stop():
            self._robot.listen(self._deadline)
            delay = time.monotonic() - self._deadline
            self._pace.check(delay)
            measurement = self._robot.check()
            target = motion(measurement)
            if target is None:
                return measurement
            sent = self._robot.send(target, mode)
            self.timing.add(sent, delay, measurement)
            after_step(measurement)
            self._next_deadline(measurement)
        return measurement

    def _next_deadline(self, measurement: Measurement) -> None:
        """One period on, a little nearer to a fresh measurement; deadlines that have passed are skipped."""
        wanted = self._deadline - measurement.arrival - _AFTER_TELEMETRY
        wanted -= self._period * round(wanted / self._period)
        self._deadline += self._period - min(_LARGEST_SHIFT, max(-_LARGEST_SHIFT, wanted))
        behind = time.monotonic() - self._deadline
        if behind > 0.0:
            self._pace.check(behind + self._period)  # this step took so long that the next one is left out
            skipped = math.ceil(behind / self._period)
            self._deadline += skipped * self._period
            self.timing.skipped += skipped
