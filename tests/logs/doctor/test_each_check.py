"""Every check of the log doctor: one log that triggers it, at a row that is known, and one that does not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog

LIMITS = np.array([[-1.0, 1.0]] * 2)
CASES: list[tuple[str, str, int | None, Callable[[MotorLog], MotorLog]]] = []
"""Check, severity, first row or None for any, and what it does to a healthy log."""


@pytest.mark.parametrize(("check", "severity", "row", "change"), CASES)
def test_a_check_finds_what_was_done(
    rich_log: MotorLog, check: str, severity: str, row: int | None, change: Callable[[MotorLog], MotorLog]
):
    found = [finding for finding in check_log(change(rich_log), LIMITS).of(check) if finding.severity == severity]
    assert found, check_log(change(rich_log), LIMITS)
    assert row is None or found[0].row == row
    assert found[0].row is not None and found[0].message
    assert found[0].remedy or check in ("load_given", "stated")
    healthy = check_log(rich_log, LIMITS).of(check)
    assert not [finding for finding in healthy if finding.severity != "info"]
    assert [finding.message for finding in found] != [finding.message for finding in healthy]


def test_every_check_has_its_case(rich_log: MotorLog):
    known = {check for check, *_ in CASES}
    for _, _, _, change in CASES:
        assert {finding.check for finding in check_log(change(rich_log), LIMITS).findings} <= known


def sines(rates: tuple[float, ...], lag: float, sign: float = 1.0) -> MotorLog:
    time = 0.005 * np.arange(2000)
    way = lambda late: sum((0.2 * np.sin(2 * np.pi * rate * (time - late)) for rate in rates), start=0.0 * time)  # noqa: E731
    return MotorLog(
        time=time, position_target=way(0.0)[:, None], joint_pos=sign * way(lag)[:, None], joint_names=("knee",),
        robot="bench", motor="m", source="made",
    )  # fmt: skip


@pytest.mark.parametrize("rates", [(2.0,), (0.5,), (3.0,), (5.0,), (0.4, 1.3, 2.9)])
@pytest.mark.parametrize("lag", [0.0, 0.02, 0.085])
def test_the_lag_is_that_of_the_first_peak(rates: tuple[float, ...], lag: float):
    (finding,) = check_log(sines(rates, lag)).of("tracking")
    assert finding.severity == "info" and finding.value == pytest.approx(lag, abs=0.0025)


@pytest.mark.parametrize("rates", [(0.5,), (1.0,), (1.9,), (0.4, 1.3, 2.9), (3.0, 4.1)])
@pytest.mark.parametrize("lag", [0.0, 0.02, 0.085])
def test_a_joint_that_moves_against_its_command_is_an_error(rates: tuple[float, ...], lag: float):
    (finding,) = check_log(sines(rates, lag, -1.0)).of("tracking")
    assert finding.severity == "error" and "against" in finding.message and finding.value < -0.5


def test_one_fast_sine_cannot_tell_late_from_reversed():
    (finding,) = check_log(sines((4.0,), 0.05, -1.0)).of("tracking")
    assert finding.severity == "warning" and "or moves against it 50 ms later" in finding.message


def test_a_reversed_joint_is_found_though_part_of_the_log_says_nothing():
    reversed_, rest = sines((0.4, 1.3, 2.9), 0.05, -1.0), sines((0.4, 1.3, 2.9), 0.05)
    noise = np.random.default_rng(0).normal(size=rest.joint_pos.shape)
    whole = replace(
        rest, time=0.005 * np.arange(4000), segment=np.repeat([0, 1], 2000),
        position_target=np.concatenate([reversed_.position_target, rest.position_target]),
        joint_pos=np.concatenate([reversed_.joint_pos, 0.1 * noise]),
    )  # fmt: skip
    assert [finding.severity for finding in check_log(whole).of("tracking")] == ["error"]


@pytest.mark.parametrize(
    ("folder", "columns"), [("go2", "go2_identification"), ("so101", "so101_sage"), ("xl330", None)]
)
def test_the_real_logs_have_no_errors(shared_data: Path, folder: str, columns: str | None):
    paths = sorted(path for path in (shared_data / folder).glob("*.gz"))
    reports = [check_log(read_log(path, columns=columns)) for path in paths]
    assert reports
    for report in reports:
        assert report.usable, (report.source, report.errors)
        assert not [found for found in report.of("tracking") if found.value < -0.5]
        assert not any(report.of(check) for check in ("dead", "unsigned_torque", "torque_sign"))
    lags = [found.value for report in reports for found in report.of("tracking")]
    if folder == "go2":
        assert 0.055 < min(lags) <= max(lags) < 0.075
