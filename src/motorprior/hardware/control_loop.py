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
# Deadlines are moved towards this time after the arrival of a measurement [s], so that a step acts
# on a fresh measurement.
_AFTER_TELEMETRY = 0.0015
# maximum difference of a period from the nominal one [s], to follow the drift of the robot's clock
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
    """Timing of every control step of a motion."""

    sent: list[float] = field(default_factory=list)  # time at which the command was sent [s]
    late: list[float] = field(default_factory=list)  # delay of the command after its deadline [s]
    # age of the measurement of the step at the time at which the command was sent [s]
    age: list[float] = field(default_factory=list)
    skipped: int = 0  # number of steps skipped because the previous step took too long


def clock_figures(run: Timing, period: float) -> dict[str, float]:
    """Jitter of the period, share of missed deadlines and age of the telemetry.

    period_jitter_ms is |time between two commands - period|. missed_share is the share of steps
    that were skipped or whose command was more than half a period late. telemetry_age_ms is the age
    of the measurement of a step when its command was sent. The result is empty for less than two
    steps.
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
    """Plays motions on an armed robot.

    A motion ends before the next step once ``stop_signals``, the names of received signals, is no
    longer empty. Raises RobotFault if the host is too slow.
    """

    def __init__(self, link: RobotLink, limits: SafetyLimits, stop_signals: Sequence[str]):
        self._link = link
        self._period = link.robot.control_dt
        self._stop_signals = stop_signals
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
        """Play ``motion`` until it ends or a signal to stop is received.

        ``after_step`` runs in the rest of the period, and must be fast. ``timing`` gets every step
        at once, so that it is complete also if a fault ends the motion. Raises the faults of
        `RobotLink` and `SlowHost`.
        """
        timing = timing or Timing()
        self._deadline = max(self._deadline, time.monotonic() + self._period)
        while not self._stop_signals:
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
        """Wait for the deadline; returns the latest measurement at this time."""
        self._link.receive(self._deadline)
        if self._paused or time.monotonic() - self._deadline > self._period:
            self._link.resume_after_pause()
            self._paused = False
        return self._link.check()

    def _next_deadline(self, measurement: Measurement, sent: float, timing: Timing) -> None:
        """Move the deadline by one period, less up to _MAX_SHIFT, towards _AFTER_TELEMETRY.

        Deadlines that have passed already are skipped.
        """
        due = self._deadline
        now = time.monotonic()

        # distance of the deadline from _AFTER_TELEMETRY after the nearest arrival
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
