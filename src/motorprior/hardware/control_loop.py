"""Motions, and the control loop that plays them: steps at absolute times on the monotonic clock.

It measures its timing, and protects itself from other processes.
"""

import ctypes
import gc
import math
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from motorprior.hardware.health import Measurement, SlowHost
from motorprior.hardware.robot_link import RobotLink
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.robots.robot import SafetyLimits

# Function of the latest measurement: the (joints,) position targets [rad] of this control step, or
# None at the end.
Motion = Callable[[Measurement], np.ndarray | None]
# Called after each command of a motion, with the number of steps and the measurement used
AfterStep = Callable[[int, Measurement], None]

_MIN_RAMP = 0.5  # [s]
# A step aims at this time [s] after the arrival of a measurement, so that it acts on a fresh one.
# Robot and host have their own clocks, so each period may differ from the nominal one by _MAX_SHIFT
# [s].
_AFTER_TELEMETRY = 0.0015
_MAX_SHIFT = 2e-5


def ramp(
    start: np.ndarray, goal: np.ndarray, speed: float, control_dt: float, hold: float = 0.0
) -> Motion:
    """Move all joints together from (joints,) ``start`` to ``goal`` [rad], and hold it.

    target = start + (goal - start)·(1 - cos(π t / T)) / 2, T such that no target exceeds ``speed``
    [rad/s]. The goal is held for ``hold`` [s].
    """
    distance = float(np.abs(goal - start).max())
    duration = max(_MIN_RAMP, 0.5 * math.pi * distance / speed)
    moving_steps = math.ceil(duration / control_dt)
    holding_steps = round(hold / control_dt)

    def targets() -> Iterator[np.ndarray]:
        for step in range(1, moving_steps + holding_steps + 1):
            share = 0.5 - 0.5 * math.cos(math.pi * min(1.0, step / moving_steps))
            yield start + share * (goal - start)

    remaining_targets = targets()
    return lambda _: next(remaining_targets, None)


@dataclass
class Timing:
    """Timing of every control step, in seconds."""

    sent: list[float] = field(default_factory=list)  # when the command was sent
    late: list[float] = field(default_factory=list)  # time after the deadline
    # age of the measurement used, when the command was sent
    age: list[float] = field(default_factory=list)
    skipped: int = 0  # steps skipped because the previous one took too long


def clock_figures(run: Timing, period: float) -> dict[str, float]:
    """Jitter of the period, share of missed deadlines and age of the telemetry.

    period_jitter_ms: |time between two commands - period|. missed_share: steps that were skipped,
    or whose command was more than half a period late. telemetry_age_ms: age of the measurement
    used. Empty for less than two steps.
    """
    if len(run.sent) < 2:
        return {}
    jitter = np.abs(np.diff(run.sent) - period)
    figures: dict[str, float] = {}
    for name, seconds in (("period_jitter_ms", jitter), ("telemetry_age_ms", run.age)):
        for quantile, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0)):
            figures[f"{name}/{quantile}"] = 1e3 * float(np.percentile(seconds, percent))

    late = np.array(run.late)
    missed = int(np.count_nonzero(late > 0.5 * period)) + run.skipped
    figures["missed_share"] = missed / (len(late) + run.skipped)
    figures["control_steps"] = float(len(run.sent))
    return figures


class ControlLoop:
    """Plays motions on an armed robot, until ``stop`` holds a signal before a step.

    Raises RobotFault if the host is too slow.
    """

    def __init__(self, link: RobotLink, limits: SafetyLimits, stop: Sequence[str]):
        self._link = link
        self._period = link.robot.control_dt
        self._stop = stop
        self._slow_host = SlowHost(limits, self._period)
        self._deadline = time.monotonic() + self._period
        self._paused = False

    def run_motion(
        self,
        motion: Motion,
        mode: Mode,
        after_step: AfterStep = lambda *_: None,
        timing: Timing | None = None,
    ) -> None:
        """Play ``motion`` until it ends or ``stop`` holds a signal.

        ``after_step`` runs in the rest of the period, and must be fast. ``timing`` is filled also
        if a fault ends the motion. Raises the faults of `RobotLink` and `SlowHost`.
        """
        timing = timing or Timing()
        self._deadline = max(self._deadline, time.monotonic() + self._period)
        while not self._stop:
            measurement = self._next_measurement()
            target = motion(measurement)
            if target is None:
                return
            sent = self._link.send(target, mode)
            timing.sent.append(sent)
            timing.late.append(sent - self._deadline)
            timing.age.append(sent - measurement.sampled)
            after_step(len(timing.sent), measurement)
            self._next_deadline(measurement, sent, timing)

    def _next_measurement(self) -> Measurement:
        """Wait for the deadline; returns the latest measurement then."""
        self._link.receive(self._deadline)
        if self._paused or time.monotonic() - self._deadline > self._period:
            self._link.resume_after_pause()
            self._paused = False
        return self._link.check()

    def _next_deadline(self, measurement: Measurement, sent: float, timing: Timing) -> None:
        """Move the deadline by one period, slightly towards fresh measurements.

        Deadlines that have passed are skipped.
        """
        due = self._deadline
        now = time.monotonic()

        shift = due - measurement.arrival - _AFTER_TELEMETRY
        shift -= self._period * round(shift / self._period)
        self._deadline += self._period - min(_MAX_SHIFT, max(-_MAX_SHIFT, shift))

        behind = now - self._deadline
        has_missed_deadline = behind > 0.0
        self._slow_host.check(now - due if has_missed_deadline else sent - due)
        if has_missed_deadline:
            skipped = math.ceil(behind / self._period)
            self._deadline += skipped * self._period
            timing.skipped += skipped
            self._paused = True


# the watchdog's priority is higher
_SCHED_FIFO = 1
_PRIORITY = 10
# flags of mlockall(2)
_MCL_CURRENT = 1
_MCL_FUTURE = 2
_MCL_ONFAULT = 4


@contextmanager
def real_time() -> Iterator[None]:
    """Real-time priority, locked memory and no garbage collection within this context."""
    earlier_scheduler = _set_scheduler(_SCHED_FIFO, _PRIORITY)
    # With a limit of locked memory, a later allocation would fail in the middle of a motion.
    unlimited = (
        sys.platform == "linux"
        and resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    )
    libc = ctypes.CDLL(None) if unlimited else None
    if libc is not None:
        libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if libc is not None:
            libc.munlockall()
        if earlier_scheduler is not None:
            _set_scheduler(*earlier_scheduler)


def _set_scheduler(policy: int, priority: int) -> tuple[int, int] | None:
    """Set scheduling policy and priority of this thread; returns the earlier ones.

    Returns None, without effect, if it is not permitted.
    """
    try:
        earlier_policy = os.sched_getscheduler(0)
        earlier_priority = os.sched_getparam(0).sched_priority
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError):  # not permitted, or not Linux
        return None
    return earlier_policy, earlier_priority
