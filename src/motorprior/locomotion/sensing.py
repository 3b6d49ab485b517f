"""Sensor model of the policy's observations: tilt relative to gravity, delay, noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line
from motorprior.rotations import roll_pitch_below


class SensorErrors(NamedTuple):
    """Sensor errors of one episode, for compiled code."""

    noise: np.ndarray  # (observations, readings) added to each observation; no rows without noise
    ages: np.ndarray  # (observations,) age of the reading in each observation [control steps]
    past: np.ndarray  # (rows, readings) true readings, a delay line; no rows without delay; state
    up: np.ndarray  # (3,) unit vector against gravity, in the world; on a slope not the normal of the ground


def perfect_sensors() -> SensorErrors:
    """Neither noise nor delay, on level ground."""
    return SensorErrors(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.array([0.0, 0.0, 1.0]))


@njit(cache=True, nogil=True)
def apply_sensor_errors(sensors: SensorErrors, count: int, base_quat: np.ndarray, observation: np.ndarray) -> None:
    """Replace the true readings of an observation by the measured ones.

    Roll and pitch relative to the ground become those relative to gravity. A delay between two control steps
    interpolates linearly between their readings; readings before the reset are those of the reset.

    Args:
        sensors: of this episode.
        count: observations since the reset before this one.
        base_quat: (4,) rotation_base_to_world.
        observation: its readings are overwritten.
    """
    if sensors.up[2] < 1.0:
        observation[0], observation[1] = roll_pitch_below(sensors.up, base_quat)
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
