"""What the policy's sensors make of the truth: late by a fraction of control steps, and noisy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.compiled import njit


class Sensors(NamedTuple):
    """Of one episode; for compiled code."""

    noise: np.ndarray
    """(observations, readings) to add to each observation; no rows if there is none"""
    delay: float
    """age of a reading [control steps]"""
    past: np.ndarray
    """(ring, readings) true readings; no rows if there is no delay; state"""


def perfect_sensors() -> Sensors:
    """Neither noise nor delay."""
    return Sensors(np.zeros((0, 0)), 0.0, np.zeros((0, 0)))


@njit(cache=True, nogil=True)
def sense(sensors: Sensors, count: int, observation: np.ndarray) -> None:
    """Turn the true observation number ``count`` of an episode, 0 after the reset, into the observed one.

    A delay between two control steps interpolates linearly between their readings; before the reset
    everything was as it was then.

    Args:
        sensors: of this episode.
        count: observations before this one.
        observation: its readings are overwritten; the phase of the gait is known exactly.
    """
    ring, count_of_readings = sensors.past.shape
    if ring > 0:
        sensors.past[count % ring] = observation[:count_of_readings]
        whole = int(sensors.delay)
        part = sensors.delay - whole
        newer, older = max(0, count - whole) % ring, max(0, count - whole - 1) % ring
        for i in range(count_of_readings):
            late = sensors.past[newer, i]
            observation[i] = late + part * (sensors.past[older, i] - late)
    if sensors.noise.shape[0] > 0:
        for i in range(sensors.noise.shape[1]):
            observation[i] += sensors.noise[count, i]
