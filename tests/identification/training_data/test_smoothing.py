"""A log's readings are freed of their noise, as much of it as there is."""

import numpy as np
import pytest

from motorprior.identification.training_data.smoothing import LEAST_NOISE, noise_of, smoothed

DT, ROWS = 0.002, 1500
PARTS = (slice(0, 700), slice(700, ROWS))
TIME = DT * np.arange(ROWS)[:, None]
RATES = np.array([7.0, 11.0, 16.0])
WAVE, SPEED = 0.3 * np.sin(RATES * TIME), 0.3 * RATES * np.cos(RATES * TIME)
"""Of three motors; the segments are one motion here."""


def noisy(deviation: float, seed: int = 0) -> np.ndarray:
    return WAVE + deviation * np.random.default_rng(seed).standard_normal(WAVE.shape)


@pytest.mark.parametrize("deviation", [1e-4, 3e-4, 1e-3])
def test_positions_and_velocities_get_closer_to_the_truth(deviation: float):
    readings = noisy(deviation)
    found = smoothed(readings, PARTS, DT)
    assert found is not None
    position, velocity = found
    assert position.shape == velocity.shape == readings.shape
    assert np.std(position - WAVE) < 0.6 * deviation
    differences = np.concatenate([np.gradient(readings[part], DT, axis=0) for part in PARTS])
    assert np.std(velocity - SPEED) < 0.35 * np.std(differences - SPEED)
    assert np.std(velocity - SPEED) < 0.1 * np.std(SPEED)


@pytest.mark.parametrize("deviation", [1e-4, 3e-4, 1e-3])
def test_the_noise_of_a_reading_is_found(deviation: float):
    for motor in range(3):
        found = noise_of(noisy(deviation, 1)[:, motor], PARTS, DT)[0]
        assert 0.5 * deviation < found < 2.0 * deviation


def test_a_log_without_noise_is_left_as_it_is():
    assert smoothed(WAVE, PARTS, DT) is None
    assert smoothed(noisy(0.2 * LEAST_NOISE), PARTS, DT) is None
    assert smoothed(np.zeros((400, 2)), (slice(0, 400),), DT) is None


def test_the_steps_of_an_encoder_are_noise():
    step = 2 * np.pi / 4096
    readings = step * np.round(WAVE / step)
    found = smoothed(readings, PARTS, DT)
    assert found is not None and np.std(found[0] - WAVE) < 0.8 * np.std(readings - WAVE)
    assert 0.5 * step / np.sqrt(12) < noise_of(readings[:, 0], PARTS, DT)[0] < 2.0 * step / np.sqrt(12)


def test_rest_slow_motion_and_wide_steady_motion_tell_nothing_of_the_fast_one():
    """Ten seconds: four at rest, a chirp whose slow part comes first, steps of a gait before a wide steady move."""
    time, rng = DT * np.arange(5000), np.random.default_rng(3)
    rest = np.where(time < 4.0, 0.0, 0.3 * np.sin(19.0 * (time - 4.0)))
    chirp = 0.3 * np.sin(2.0 * np.pi * 0.2 * np.cumsum(np.exp(time / 10.0 * np.log(40.0))) * DT)
    gait = 0.15 * np.sin(2.0 * np.pi * 5.0 * time) * (time < 8.0) + 2.5 * np.clip((time - 8.2) / 1.6, 0.0, 1.0)
    for truth, fast in ((rest, time > 4.5), (chirp, time > 4.5), (gait, (time > 0.5) & (time < 7.5))):
        readings = truth + 5e-4 * rng.standard_normal(len(time))
        found = smoothed(readings[:, None], (slice(0, len(time)),), DT)
        assert found is not None and np.std(found[0][fast, 0] - truth[fast]) < 2.5e-4
