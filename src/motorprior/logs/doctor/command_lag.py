"""How late an angle follows its command, and whether it follows or opposes it: both read off their correlation.

r(k) = corr(joint_pos(t), position_target(t - k·period)), k = -earliest … longest, over the same t for every k.

The lag is that of the first peak of r: a sine repeats, so that later peaks are as high and mean nothing. An earlier
peak counts where it is nearly as high as the highest and r falls clearly between the two; ripple on one broad hill is
no peak.

An angle leads its command where r rises from k = 0 to negative k without a break, to where it is clearly higher.
No servo does, so that the two have different clocks.

An angle opposes its command where, among lags that a servo can have, r goes further below zero than above it. One pure
sine cannot tell a reversed joint from one that is late by more than half a period: that is reported as undecided.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_LAG = 0.25
"""Longest lag of a command that a servo plausibly has [s]."""
SEARCHED_LAG = 0.5
SEARCHED_LEAD = 0.25
"""[s]"""
LEAST_LEAD = 0.015
"""A shorter one may be that of a grid [s]."""
CLEARLY = 0.2
"""Of what is missing to a correlation of 1 at lag 0, at most this share is missing at the lead."""
NEARLY = 0.95
"""An earlier peak is at least this share of the highest."""
VALLEY = 0.1
"""By how much r falls between two peaks that are not the same hill."""
MARGIN = 0.1
"""By how much one sign must outweigh the other."""
MIN_CORRELATION = 0.5


@dataclass(frozen=True)
class Following:
    """How one angle follows its command.

    Attributes:
        lead: by which the angle moves before its command [s], 0 if it does not.
        lag: of the first positive peak [s].
        correlation: there.
        opposed_lag: of the first negative peak [s].
        opposed_correlation: there.
    """

    lead: float
    lag: float
    correlation: float
    opposed_lag: float
    opposed_correlation: float

    @property
    def opposes(self) -> bool:
        """The angle moves against its command."""
        beyond = -self.opposed_correlation - (self.correlation if self.lag < MAX_LAG else 0.0)
        return self._can_oppose and beyond > MARGIN

    @property
    def follows(self) -> bool:
        """The angle moves as its command does."""
        return self.correlation >= MIN_CORRELATION and not self.opposes

    @property
    def servo_lag(self) -> float:
        """The lag, as far as a servo may have it, of an angle that follows [s]; else 0."""
        return min(self.lag, MAX_LAG) if self.follows else 0.0

    @property
    def undecided(self) -> bool:
        """A command of one frequency: late by more than half a period, or reversed and less late."""
        return self._can_oppose and not self.opposes and self.opposed_lag < self.lag < MAX_LAG

    @property
    def _can_oppose(self) -> bool:
        return self.opposed_correlation < -MIN_CORRELATION and self.opposed_lag < MAX_LAG


def following(command: np.ndarray, angle: np.ndarray, period: float) -> Following:
    """Compare two series (T,) [rad] on one grid of ``period`` [s]."""
    longest = min(int(SEARCHED_LAG / period), len(command) // 2)
    earliest = min(max(1, int(SEARCHED_LEAD / period)), len(command) // 4)
    rows = len(angle) - longest - earliest  # the same for every shift
    later = angle[longest : longest + rows]
    begins = range(longest + earliest, -1, -1)
    r = np.array([_correlation(command[begin : begin + rows], later) for begin in begins])
    lead, r = _lead(r[: earliest + 1][::-1], period), r[earliest - 1 :]
    lag, opposed = _first_peak(r), _first_peak(-r)
    return Following(lead, lag * period, float(r[lag + 1]), opposed * period, float(r[opposed + 1]))


def _lead(r: np.ndarray, period: float) -> float:
    """[s] up to which r, at shifts 0, -1, …, rises without a break; 0 where that is next to nothing."""
    rising = np.diff(r) > 0.0
    best = len(r) - 1 if rising.all() else int(np.argmin(rising))
    clear = r[best] >= MIN_CORRELATION and 1.0 - r[best] <= CLEARLY * (1.0 - r[0])
    return best * period if clear and best * period >= LEAST_LEAD else 0.0


def _first_peak(r: np.ndarray) -> int:
    """Shift of the first peak; r[0] is that of shift -1, which only tells whether shift 0 is one."""
    best = 1 + int(np.argmax(r[1:]))
    for here in range(1, best):
        high = r[here] >= NEARLY * r[best]
        if high and r[here] >= max(r[here - 1], r[here + 1]) and r[here : best + 1].min() < r[here] - VALLEY:
            return here - 1
    return best - 1


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    return float(np.dot(a, b)) / scale if scale > 0.0 else 0.0
