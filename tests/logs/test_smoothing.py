"""Smoothing removes noise, and leaves a log without noise as it is."""

from dataclasses import replace

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


TICK = 2 * np.pi / 4096  # [rad]


def log_of(make_log, command: np.ndarray, period: float = DT):
    """A log of two motors whose angles follow ``command`` (rows,) [rad] late, in encoder ticks."""
    time = period * np.arange(len(command))
    angle = np.zeros_like(command)
    for row in range(1, len(command)):
        late = command[max(0, row - 8)]
        angle[row] = late + (angle[row - 1] - late) * np.exp(-period / 0.03)
    readings = TICK * np.round(angle / TICK)
    return make_log(
        rows=len(time),
        period=period,
        time=time,
        position_target=np.stack([command] * 2, axis=1),
        joint_vel=None,
        joint_pos=np.stack([readings] * 2, axis=1),
    )


@pytest.mark.parametrize("size", [0.02, 0.3])
@pytest.mark.parametrize("background", ["static", "ramp"])
def test_commanded_steps_keep_their_time_and_size(make_log, size: float, background: str):
    time = DT * np.arange(1200)
    speeds = {"static": 0.0, "ramp": 0.2}
    command = speeds[background] * time
    command += size * (np.sin(4.0 * time - 0.5) > 0.0)

    log = smooth_on_grid(log_of(make_log, command), DT)

    assert np.abs(log.position_target[:, 0] - command).max() < 1e-4


def two_row_changes() -> np.ndarray:
    rows = np.arange(1200)
    return 0.12 * (rows // 50 % 2) + 0.12 * ((rows - 1) // 50 % 2)


EVENTS = {
    "changes made in two rows": two_row_changes(),
    "a target per row": np.random.default_rng(0).uniform(-0.3, 0.3, 1200),
    "small steps": 0.005 * (np.arange(1200) // 50 % 2),
    "targets held for four rows": 0.3 * np.sin(0.02 * 4 * (np.arange(1200) // 4)),
}


@pytest.mark.parametrize("command", EVENTS.values(), ids=EVENTS)
def test_commands_keep_their_events(make_log, command: np.ndarray):
    log = smooth_on_grid(log_of(make_log, command), DT)

    assert np.abs(log.position_target[:, 0] - command).max() < 1e-9

    noisy_log = log_of(make_log, command)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(noisy_log.joint_pos.shape)
    log = smooth_on_grid(replace(noisy_log, joint_pos=noisy_log.joint_pos + noise), DT)

    assert np.abs(log.position_target[:, 0] - command).max() < 1e-9


@pytest.mark.parametrize("channel", ["velocity_target", "torque_feedforward"])
def test_steps_of_velocities_and_torques_keep_their_time_and_size(make_log, channel: str):
    time = DT * np.arange(1200)
    command = 5.0 * (np.sin(4.0 * time - 0.5) > 0.0) + np.sin(3.0 * time)
    recorded = log_of(make_log, 0.3 * np.sin(3.0 * time))
    mode = channel.partition("_")[0]
    commands = {channel: np.stack([command] * 2, axis=1), "position_target": recorded.joint_pos}

    log = smooth_on_grid(replace(recorded, command_mode=mode, **commands), DT)

    assert np.abs(getattr(log, channel)[:, 0] - command).max() < 0.02


def test_a_step_between_two_rows_of_the_grid_changes_the_row_of_its_period_only(make_log):
    period = 0.005
    command = np.zeros(400)
    command[203:] = 0.1  # at 0.406 s, in the period from 0.405 to 0.410 s

    log = smooth_on_grid(log_of(make_log, command), period)
    row = int(np.searchsorted(log.time, 0.406)) - 1

    np.testing.assert_allclose(log.position_target[:row, 0], 0.0, atol=1e-12)
    assert log.position_target[row, 0] == pytest.approx(0.08)
    np.testing.assert_allclose(log.position_target[row + 1 :, 0], 0.1, atol=1e-12)


def test_quantised_commands_are_smoothed(make_log):
    time = DT * np.arange(1200)
    smooth = 0.3 * np.sin(3.0 * time)
    quantised = TICK * np.round(smooth / TICK)

    log = smooth_on_grid(log_of(make_log, quantised), DT)

    error = log.position_target[:, 0] - smooth

    assert np.std(error) < 0.7 * np.std(quantised - smooth)


def test_readings_are_kept_beside_the_smoothed_angles(make_log):
    command = 0.3 * np.sin(3.0 * DT * np.arange(1200))
    recorded = log_of(make_log, command)

    log = smooth_on_grid(recorded, DT)

    np.testing.assert_allclose(log.readings, recorded.joint_pos, atol=1e-9)
    assert np.abs(log.joint_pos - recorded.joint_pos).max() > 0.2 * TICK
