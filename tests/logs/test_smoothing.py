"""Smoothing removes noise, and leaves a log without noise as it is."""

import numpy as np
import pytest

from motorprior.logs.operations import smooth_on_grid
from motorprior.logs.smoothing import noise_of, smoothed, smoothing_of

DT = 0.002
ROWS = 1000
SEGMENTS = (slice(0, 450), slice(450, ROWS))
TIME = DT * np.arange(ROWS)[:, None]
RATES = np.array([7.0, 11.0, 16.0])
WAVE = 0.3 * np.sin(RATES * TIME)
SPEED = 0.3 * RATES * np.cos(RATES * TIME)
"""Angles [rad] and speeds [rad/s] of three motors, (ROWS, 3); one motion in two segments."""


def noisy(deviation: float, seed: int = 0) -> np.ndarray:
    return WAVE + deviation * np.random.default_rng(seed).standard_normal(WAVE.shape)


def settings_for(readings: np.ndarray) -> tuple[float, float]:
    settings = smoothing_of(readings, SEGMENTS, DT)
    assert settings is not None

    return settings


@pytest.mark.parametrize("deviation", [1e-4, 1e-3])
def test_positions_and_velocities_get_closer_to_the_truth(deviation: float):
    readings = noisy(deviation)
    position, velocity = smoothed(readings, SEGMENTS, DT, *settings_for(readings))

    assert position.shape == velocity.shape == readings.shape
    assert np.std(position - WAVE) < 0.6 * deviation

    differences = np.concatenate([np.gradient(readings[rows], DT, axis=0) for rows in SEGMENTS])

    assert np.std(velocity - SPEED) < 0.35 * np.std(differences - SPEED)
    assert np.std(velocity - SPEED) < 0.1 * np.std(SPEED)


def test_a_log_without_noise_is_left_as_it_is():
    assert smoothing_of(WAVE, SEGMENTS, DT) is None
    assert smoothing_of(noisy(1e-5), SEGMENTS, DT) is None
    assert smoothing_of(np.zeros((400, 2)), (slice(0, 400),), DT) is None


def test_the_steps_of_an_encoder_are_smoothed_as_noise():
    step = 2 * np.pi / 4096
    readings = step * np.round(WAVE / step)
    position, _ = smoothed(readings, SEGMENTS, DT, *settings_for(readings))

    assert np.std(position - WAVE) < 0.8 * np.std(readings - WAVE)

    # a rounding error is uniform: its standard deviation is step/√12
    deviation = step / np.sqrt(12)

    assert 0.5 * deviation < noise_of(readings[:, 0], SEGMENTS, DT)[0] < 2.0 * deviation


def test_smoothed_commands_move_a_motor_to_its_smoothed_angles(make_log):
    """The motor is a first-order lag whose angles are rounded; the readings are kept."""
    time = DT * np.arange(1200)
    ticks_per_radian = 4096 / (2 * np.pi)
    target = 0.3 * (np.sin(1.3 * time - 0.5) > 0.0)

    def lagged(command: np.ndarray) -> np.ndarray:
        angle = np.zeros_like(time)
        for row in range(1, len(time)):
            late = command[max(0, row - 8)]
            angle[row] = late + (angle[row - 1] - late) * np.exp(-DT / 0.03)
        return angle

    readings = np.round(lagged(target) * ticks_per_radian) / ticks_per_radian
    log = smooth_on_grid(
        make_log(
            rows=len(time),
            period=DT,
            time=time,
            position_target=np.stack([target] * 2, axis=1),
            joint_vel=None,
            joint_pos=np.stack([readings] * 2, axis=1),
        ),
        DT,
    )

    def error(command: np.ndarray) -> float:
        return float(np.mean((lagged(command) - log.joint_pos[:, 0]) ** 2))

    assert error(log.position_target[:, 0]) < 0.8 * error(target)
    assert (
        np.abs(log.readings[:, 0] - lagged(target)).max()
        < 0.6 / ticks_per_radian
        < np.abs(log.joint_pos[:, 0] - readings).max()
    )
