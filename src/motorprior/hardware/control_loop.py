"""Control steps at absolute times on the monotonic clock, and figures of how well they were kept."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import Pace
from motorprior.hardware.motions import Motion
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode
from motorprior.results import Result, Results
from motorprior.robots.wire import SafetyLimits

_AFTER_TELEMETRY = 0.0015
"""A step aims at this time [s] after the arrival of a measurement, so that it acts on a fresh one."""
_LARGEST_SHIFT = 2e-5
"""[s] by which one period may differ from the nominal one to get there: robot and host have their own clocks."""


@dataclass
class Timing:
    """Of every control step, seconds.

    Attributes:
        sent: when its command left.
        late: behind its time, when its command left.
        age: of the measurement it acted on, when its command left.
        stamp: the robot's time stamp of that measurement.
        skipped: steps that were left out because the one before took too long.
        broken_off: how late the step was that a fault ended instead of a command; None if there was none.
        ended: when the motion ended, on the clock of ``sent``; None while it goes on.
        fault: kind of the fault that ended it; empty if none did.
    """

    sent: array = field(default_factory=lambda: array("d"))
    late: array = field(default_factory=lambda: array("d"))
    age: array = field(default_factory=lambda: array("d"))
    stamp: array = field(default_factory=lambda: array("d"))
    skipped: int = 0
    broken_off: float | None = None
    ended: float | None = None
    fault: str = ""

    def add(self, sent: float, late: float, measurement: Measurement) -> None:
        """Count one more step."""
        self.sent.append(sent)
        self.late.append(late)
        self.age.append(sent - measurement.sampled)
        self.stamp.append(1e-3 * measurement.telemetry.ts)


def clock_results(runs: Sequence[Timing], period: float) -> Results:
    """Jitter of the period, share of missed deadlines, age of the telemetry, over one or more runs.

    period_jitter_ms: |time between two commands - period|. missed_share: steps that were skipped or whose command left
    more than half a period late. telemetry_age_ms: of the measurement acted on. No row for no run. A step that a
    fault ended counts in the first two as if its command had left when the fault was found: the worst step of a run
    must not be missing. What lies between two runs is no jitter.
    """
    runs = [run for run in runs if len(run.sent) >= 2]
    if not runs:
        return Results()
    broken_off = [run.broken_off for run in runs if run.broken_off is not None]
    jitter = np.concatenate([*(np.diff(run.sent) - period for run in runs), broken_off])
    late, age = np.concatenate([*(run.late for run in runs), broken_off]), np.concatenate([run.age for run in runs])
    skipped = sum(run.skipped for run in runs)
    missed = (int(np.count_nonzero(late > 0.5 * period)) + skipped) / (len(late) + skipped)
    return Results.of(
        [
            *quantiles_ms("period_jitter_ms", np.abs(jitter)),
            Result("missed_share", "1", missed),
            *quantiles_ms("telemetry_age_ms", age),
            Result("control_steps", "1", float(sum(len(run.sent) for run in runs))),
        ]
    )


def quantiles_ms(quantity: str, seconds: np.ndarray) -> Results:
    """Median, 99 % quantile and largest of times [s], in ms."""
    quantiles = {"p50": 50.0, "p99": 99.0, "max": 100.0}
    return Results.of(
        Result(quantity, "ms", 1e3 * float(np.percentile(seconds, q)), statistic=name) for name, q in quantiles.items()
    )


class ControlLoop:
    """Run motions on an armed robot.

    Attributes:
        timing: of the motion played last.

    Args:
        link: armed.
        limits: for the host's pace.
        period: control period [s].
        stop: asked before every step; True ends the motion.
    """

    def __init__(self, link: RobotLink, limits: SafetyLimits, period: float, stop: Callable[[], bool]):
        self._link, self._period, self._stop = link, period, stop
        self._pace = Pace(limits, period)
        self._deadline, self._paused = time.monotonic() + period, False
        self.timing = Timing()

    def play(
        self,
        motion: Motion,
        mode: Mode,
        after_step: Callable[[Measurement], None] = lambda _: None,
        timing: Timing | None = None,
    ) -> Measurement | None:
        """Play ``motion`` until it ends or ``stop`` returns True; returns the last measurement.

        Args:
            motion: gives the targets.
            mode: for the recording.
            after_step: called after the command has left, in the slack of the period; must be quick.
            timing: filled, also if a fault ends the motion.

        Raises:
            RobotFault: see `RobotLink.check`, `RobotLink.send` and `Pace.check`.
        """
        self.timing = timing or Timing()
        self._deadline = max(self._deadline, time.monotonic() + self._period)
        try:
            return self._play(motion, mode, after_step)
        except RobotFault as fault:
            self.timing.fault = fault.kind
            raise
        finally:
            self.timing.ended = time.monotonic()

    def _play(self, motion: Motion, mode: Mode, after_step: Callable[[Measurement], None]) -> Measurement | None:
        measurement = None
        while not self._stop():
            try:
                measurement = self._look()
                target = motion(measurement)
                if target is None:
                    return measurement
                sent = self._link.send(target, mode)
            except Exception:
                self.timing.broken_off = max(0.0, time.monotonic() - self._deadline)
                raise
            self.timing.add(sent, sent - self._deadline, measurement)
            after_step(measurement)
            self._next_deadline(measurement, sent)
        return measurement

    def _look(self) -> Measurement:
        """Wait for the deadline; the latest measurement then."""
        self._link.receive(self._deadline)
        if self._paused or time.monotonic() - self._deadline > self._period:
            self._link.after_pause()
            self._paused = False
        return self._link.check()

    def _next_deadline(self, measurement: Measurement, sent: float) -> None:
        """Move the deadline one period on, a little nearer to a fresh measurement; skip those that have passed."""
        due, now = self._deadline, time.monotonic()
        wanted = due - measurement.arrival - _AFTER_TELEMETRY
        wanted -= self._period * round(wanted / self._period)
        self._deadline += self._period - min(_LARGEST_SHIFT, max(-_LARGEST_SHIFT, wanted))
        behind = now - self._deadline
        self._pace.check(now - due if behind > 0.0 else sent - due)
        if behind > 0.0:
            skipped = math.ceil(behind / self._period)
            self._deadline += skipped * self._period
            self.timing.skipped += skipped
            self._paused = True
