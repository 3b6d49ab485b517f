"""What the policy's sensors make of the truth: late by a fraction of control steps, and noisy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line


class Sensors(NamedTuple):
    """Of one episode; for compiled code."""

    noise: np.ndarray
    """(observations, readings) to add to each observation; no rows if there is none"""
    ages: np.ndarray
    """(observations,) age of the reading in each observation [control steps]"""
    past: np.ndarray
    """(rows, readings) true readings, a delay line; no rows if there is no delay; state"""


def perfect_sensors() -> Sensors:
    """Neither noise nor delay."""
    return Sensors(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


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
    rows, readings = sensors.past.shape
    if rows > 0:
        if count == 0:
            fill_line(sensors.past, 0, observation[:readings])
        newest = write_line(sensors.past, 0, count, observation[:readings])
        for i in range(readings):
            observation[i] = interpolated(sensors.past, 0, newest, sensors.ages[count], i)
    if sensors.noise.shape[0] > 0:
        for i in range(sensors.noise.shape[1]):
            observation[i] += sensors.noise[count, i]
