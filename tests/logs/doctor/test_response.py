"""Lag and sign of an angle against its command."""

import numpy as np
import pytest

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog


def sines(rates: tuple[float, ...], lag: float, sign: float = 1.0) -> MotorLog:
    time = 0.005 * np.arange(2000)
    way = lambda late: sum((0.2 * np.sin(2 * np.pi * rate * (time - late)) for rate in rates), start=0.0 * time)  # noqa: E731
    return MotorLog(
        time=time, position_target=way(0.0)[:, None], joint_pos=sign * way(lag)[:, None], joint_names=("knee",),
        robot="bench", motor="m", source="made",
    )  # fmt: skip


@pytest.mark.parametrize("rates", [(2.0,), (5.0,), (0.4, 1.3, 2.9)])
@pytest.mark.parametrize("lag", [0.0, 0.085])
def test_the_lag_is_that_of_the_first_peak(rates: tuple[float, ...], lag: float):
    (finding,) = check_log(sines(rates, lag)).of("tracking")
    assert finding.severity == "info" and finding.value == pytest.approx(lag, abs=0.0025)


@pytest.mark.parametrize("rates", [(0.5,), (1.9,), (3.0, 4.1)])
@pytest.mark.parametrize("lag", [0.0, 0.085])
def test_a_joint_that_moves_against_its_command_is_an_error(rates: tuple[float, ...], lag: float):
    (finding,) = check_log(sines(rates, lag, -1.0)).of("tracking")
    assert finding.severity == "error" and "against" in finding.message and finding.value < -0.5


def test_the_lag_of_one_fast_sine_is_ambiguous():
    (finding,) = check_log(sines((4.0,), 0.05, -1.0)).of("tracking")
    assert finding.severity == "warning" and "or moves against its command 50 ms later" in finding.message
