"""Angles, speeds and rates that are in another unit are errors; sound ones of fast, far and noisy joints are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.motor_log import MotorLog

DEGREES = 180.0 / np.pi
MakeLog = Callable[..., MotorLog]


def units(log: MotorLog, limits: np.ndarray | None = None) -> list[tuple[str, str | None]]:
    return [(finding.severity, finding.joint) for finding in check_log(log, limits).of("units")]


def scaled(log: MotorLog, by: float) -> MotorLog:
    return replace(log, joint_pos=by * log.joint_pos, position_target=by * log.position_target, joint_vel=None)


@pytest.mark.parametrize(
    ("size", "severity"), [(2.9, None), (3.3, "warning"), (7.0, "warning"), (26.0, "error"), (101.0, "error")]
)
def test_angles_that_are_too_large_are_named(make_log: MakeLog, size: float, severity: str | None):
    log = make_log(joint_vel=None, time=0.1 * np.arange(200))
    log.joint_pos[:, 1] = size * np.sin(0.5 * log.time)
    assert units(log) == ([] if severity is None else [(severity, "right")])


def test_a_joint_may_turn_as_far_as_its_limits_say(make_log: MakeLog):
    log = make_log(joint_vel=None, time=0.1 * np.arange(200))
    log.joint_pos[:, 0] = 26.0 * np.sin(0.5 * log.time)
    unknown, endless = np.full((2, 2), np.nan), np.array([[-np.inf, np.inf]] * 2)
    assert units(log, endless) == [], "a wheel turns on and on"
    assert units(log) == units(log, unknown) == [("error", "left")]
    assert units(log, np.array([[-30.0, 30.0], [-1.0, 1.0]])) == []
    assert units(log, np.array([[-3.0, 3.0], [-1.0, 1.0]])) == [("error", "left")]


def test_a_joint_that_is_too_fast_is_in_another_unit(make_log: MakeLog):
    log = scaled(make_log(rows=400), DEGREES)  # 17 rad, at up to 108 rad/s
    left, right = check_log(log).errors
    assert left.value == pytest.approx(0.3 * DEGREES * 2 * np.pi, rel=0.01) and "rad/s" in left.message
    assert 'angle = "deg"' in left.remedy and right.joint == "right"
    assert not check_log(scaled(make_log(rows=400), 0.9 * DEGREES)).errors


def test_a_wrong_row_is_no_speed(make_log: MakeLog):
    log = make_log(rows=400)
    assert log.joint_vel is not None
    log.joint_vel[[3, 50, 99, 200, 300], 0] = 1e3
    log.joint_pos[100:380:40, 1] = -np.pi
    assert not check_log(log).of("units")
    log.joint_vel[301, 0] = 1e3
    assert units(log) == [("error", "left")]
    long = make_log(rows=9000)
    assert long.joint_vel is not None
    long.joint_vel[:9, 0] = 1e3
    assert not check_log(long).of("units")
    long.joint_vel[9, 0] = 1e3
    assert units(long) == [("error", "left")]


@pytest.mark.parametrize(("pairs", "fine"), [(5, True), (6, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_more_than_a_handful_of_fast_steps_is_a_unit(make_log: MakeLog, pairs: int, fine: bool, sign: float):
    log = make_log(rows=400, joint_vel=None)
    steps = np.zeros(400)
    steps[200 : 201 + pairs] = sign * 1.2  # 120 rad/s
    log.joint_pos[:, 0] += np.cumsum(steps)
    assert [each for each in units(log) if each[0] == "error"] == ([] if fine else [("error", "left")])


def test_too_large_an_angle_is_said_once(make_log: MakeLog):
    assert units(scaled(make_log(), 100.0)) == [("error", "left"), ("error", "right")] * 2


def test_the_steps_of_an_encoder_that_is_polled_fast_are_no_speed(make_log: MakeLog):
    step = 2 * np.pi / 1024
    log = make_log(rows=10_000, period=1e-4, joint_vel=None)
    log = replace(log, joint_pos=step * np.rint(log.joint_pos / step))
    assert np.abs(np.diff(log.joint_pos, axis=0)).max() / 1e-4 > 50.0
    assert not check_log(log).errors


@pytest.mark.parametrize(
    ("rate", "fine"), [(0.1, False), (4.8, False), (4.98, True), (2e4, True), (2.01e4, True), (1e5, False)]
)
def test_a_rate_that_no_log_has_is_an_error(make_log: MakeLog, rate: float, fine: bool):
    found: Finding = check_log(make_log(period=1.0 / rate)).of("rate")[0]
    assert (found.severity == "info") == fine and found.value == pytest.approx(rate)
    assert fine or 'time = "s", "ms"' in found.remedy


def test_angles_are_told_in_degrees(make_log: MakeLog):
    (found,) = check_log(make_log(joint_pos=np.radians(np.linspace([-10.0, 5.0], [20.0, 95.5], 200)))).of("angles")
    assert found.severity == "info" and "left -10..20, right 5..95.5" in found.message


def test_joints_without_limits_are_named(make_log: MakeLog):
    (found,) = check_log(make_log(), np.array([[-1.0, 1.0], [np.nan, np.nan]])).of("limits")
    assert found.severity == "info" and "no limits for right: 1 of 2" in found.message
