"""The profile of a servo on commands."""

import numpy as np
import pytest

import motorprior as mp
from motorprior.exceptions import ConfigError


@pytest.mark.parametrize("distance", [-0.5, 0.3])
@pytest.mark.parametrize("acceleration", [20.0, 39.0])
def test_a_step_takes_the_time_of_full_acceleration_and_braking(
    distance: float, acceleration: float
):
    dt = 0.002
    profile = mp.CommandProfile(np.zeros(1), dt, acceleration=acceleration)
    references = np.array([profile.step(np.array([distance]))[0] for _ in range(500)])
    arrived = dt * np.argmax(np.abs(references - distance) < 1e-3)

    # up to the last millimetre of braking, and steps of dt
    assert arrived == pytest.approx(2.0 * np.sqrt(abs(distance) / acceleration), abs=0.02)
    assert np.abs(references).max() <= abs(distance) + 1e-4
    assert np.abs(np.diff(references, n=2)).max() <= 1.01 * acceleration * dt**2


def test_the_speed_is_limited():
    profile = mp.CommandProfile(np.zeros(2), 0.01, speed=2.0)
    references = np.array([profile.step(np.array([1.0, -1.0])) for _ in range(40)])

    assert np.abs(np.diff(references, axis=0)).max() == pytest.approx(0.02)


def test_without_limits_the_reference_is_the_target():
    profile = mp.CommandProfile(np.zeros(1), 0.01)

    assert profile.step(np.array([0.4]))[0] == pytest.approx(0.4, abs=2e-3)


def test_a_negative_limit_is_refused():
    with pytest.raises(ConfigError, match="acceleration"):
        mp.CommandProfile(np.zeros(1), 0.01, acceleration=-1.0)
