"""Lag and sign of an angle against its command, and end stops, in chirps, sines and real logs."""

from collections.abc import Callable

import numpy as np
import pytest
from motor_logs import log_of, of_check

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog

Change = Callable[[np.ndarray], np.ndarray]
TIME = 0.01 * np.arange(2400)
STEP = 0.0015
"""Resolution of the encoder [rad]."""


def log_of_angle(command: np.ndarray, angle: np.ndarray, period: float = 0.01) -> MotorLog:
    """A log of one joint whose angle is rounded by its encoder."""
    return log_of(period * np.arange(len(angle)), command, STEP * np.rint(angle / STEP))


def chirp(late: float = 0.0) -> np.ndarray:
    """A chirp of 0.3 rad from 0.1 to 3 Hz, ``late`` [s] behind the command."""
    time = TIME - late
    return 0.3 * np.sin(2 * np.pi * (0.1 + 0.06 * time) * time)


def stopped(share: float) -> Change:
    """End stops on both sides, at this share of the motion."""

    def clip(angle: np.ndarray) -> np.ndarray:
        low = angle.min(axis=0)
        high = angle.max(axis=0)
        middle = 0.5 * (low + high)
        reach = 0.5 * share * (high - low)

        return np.clip(angle, middle - reach, middle + reach)

    return clip


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_end_stops_show_though_a_chirp_is_far_behind_its_command(share: float):
    log = log_of_angle(chirp(), stopped(share)(chirp(0.1)))

    findings = of_check(check_log(log), "saturation")
    stops = [log.joint_pos[finding.row, 0] for finding in findings]

    assert stops == pytest.approx([0.3 * share, -0.3 * share], abs=2 * STEP)


def held_back(command: np.ndarray, band: float) -> np.ndarray:
    """Angle of a joint with friction: it follows its command only beyond ``band`` [rad]."""
    angle = np.zeros_like(command)
    for row in range(1, len(command)):
        angle[row] = np.clip(angle[row - 1], command[row] - band, command[row] + band)
    return angle


def sagging() -> tuple[np.ndarray, np.ndarray]:
    """Command and angle of ramps between held positions; a weight bends the servo by a third."""
    command = np.clip(0.9 * np.abs((TIME / 2.0) % 2.0 - 1.0) - 0.3, 0.0, 0.3)
    angle = np.zeros_like(command)
    for row in range(1, len(command)):
        angle[row] = angle[row - 1] + 0.1 * (command[row - 1] * 2.0 / 3.0 - angle[row - 1])

    return command, angle


def test_reversals_dead_bands_and_weights_are_no_end_stop():
    slow = 0.3 * np.sin(2 * np.pi * 0.4 * TIME)
    dead_bands = [(slow, held_back(slow, 0.08)), (chirp(), held_back(chirp(0.05), 0.08))]
    for ramp_time in (1.5, 2.0):  # [s]: the lag that the correlation of a triangle shows is long
        triangle = 0.5 * np.abs((TIME / ramp_time) % 2.0 - 1.0) - 0.25
        dead_bands += [(triangle, held_back(triangle, band)) for band in (0.06, 0.1)]

    for command, angle in [(chirp(), chirp(0.1)), *dead_bands, sagging()]:
        log = log_of_angle(command, angle)
        assert not of_check(check_log(log), "saturation")


def sines(rates: tuple[float, ...], lag: float, sign: float = 1.0) -> MotorLog:
    """A sum of sines of 0.2 rad at these rates [Hz], followed ``lag`` [s] later."""
    times = 0.005 * np.arange(2000) - np.array([[0.0], [lag]])
    waves = [0.2 * np.sin(2 * np.pi * rate * times) for rate in rates]
    command, angle = sum(waves, start=0.0 * times)

    return log_of_angle(command, sign * angle, 0.005)


@pytest.mark.parametrize("rates", [(1.9,), (0.4, 1.3, 2.9)])
@pytest.mark.parametrize("lag", [0.0, 0.085])
def test_lag_and_sign_are_taken_from_the_first_peak_of_the_correlation(
    rates: tuple[float, ...], lag: float
):
    (finding,) = of_check(check_log(sines(rates, lag)), "tracking")

    assert finding.severity == "info"
    assert finding.value == pytest.approx(lag, abs=0.0025)

    (finding,) = of_check(check_log(sines(rates, lag, -1.0)), "tracking")

    assert finding.severity == "error"
    assert finding.value < -0.5


def test_the_lag_of_one_fast_sine_is_ambiguous():
    (finding,) = of_check(check_log(sines((4.0,), 0.05, -1.0)), "tracking")

    assert finding.severity == "warning"
    assert "50 ms" in finding.message
