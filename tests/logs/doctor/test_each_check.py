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


def case(check: str, severity: str = "warning", row: int | None = 0):
    def keep(change: Callable[[MotorLog], MotorLog]) -> Callable[[MotorLog], MotorLog]:
        CASES.append((check, severity, row, change))
        return change

    return keep


def edited(log: MotorLog, channel: str, edit: Callable[[np.ndarray], object]) -> MotorLog:
    values = getattr(log, channel).copy()
    edit(values)
    return replace(log, **{channel: values})


def column(rows: slice, value: float | np.ndarray) -> Callable[[np.ndarray], None]:
    def edit(values: np.ndarray) -> None:
        values[rows, 0] = value

    return edit


@case("jitter", row=2)
def late_every_other_row(log: MotorLog) -> MotorLog:
    return replace(log, time=log.time + 0.004 * (np.arange(log.num_rows) % 2))


@case("jitter", row=None)
def in_bursts(log: MotorLog) -> MotorLog:
    rows = np.arange(log.num_rows)
    return replace(log, time=log.time[rows // 10 * 10] + 1e-4 * (rows % 10))


@case("gaps", row=700)
def a_pause(log: MotorLog) -> MotorLog:
    return replace(log, time=log.time + 0.2 * (np.arange(log.num_rows) >= 700))


@case("repeats", row=1)
@case("true_rate", "info", row=1)
def polled_twice(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", lambda angle: np.copyto(angle[1::2], angle[::2].copy()))


@case("stale", row=1)
def joints_in_turn(log: MotorLog) -> MotorLog:
    pos = log.joint_pos.copy()
    pos[1::2, 0], pos[2::2, 1] = pos[:-1:2, 0], pos[1:-1:2, 1]
    return replace(log, joint_pos=pos)


@case("units", row=500)
def beyond_one_turn(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(500, 501), 7.0))


@case("units", "error", row=500)
def a_damaged_number(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(500, 501), 1e6))


@case("units", "error", row=400)
def a_damaged_velocity(log: MotorLog) -> MotorLog:
    return edited(log, "joint_vel", column(slice(400, 401), -1e9))


@case("units", "error", row=500)
def four_turns(log: MotorLog) -> MotorLog:
    return edited(log, "position_target", column(slice(500, 501), 26.0))


@case("units", "error", row=None)
def degrees(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", lambda angle: np.multiply(angle, 180.0 / np.pi, out=angle))


@case("units", "error", row=None)
def velocity_in_degrees(log: MotorLog) -> MotorLog:
    return edited(log, "joint_vel", lambda speed: np.multiply(speed, 180.0 / np.pi, out=speed))


@case("angles", "info")
def turned_round(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", lambda angle: np.negative(angle, out=angle))


@case("rate", "error")
def milliseconds(log: MotorLog) -> MotorLog:
    return replace(log, time=1e3 * log.time)


@case("rate", "error")
def seconds_as_milliseconds(log: MotorLog) -> MotorLog:
    return replace(log, time=1e-3 * log.time)


@case("jumps", "error", row=410)
def a_failed_read(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(410, 413), -np.pi))


@case("jumps", "error", row=None)
def an_encoder_that_wraps(log: MotorLog) -> MotorLog:
    return replace(log, **{name: getattr(log, name) % (2 * np.pi) for name in ("position_target", "joint_pos")})


@case("limits", row=300)
def beyond_its_limit(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(300, 301), 1.2))


@case("constant")
def no_reading(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(None), 0.1))


@case("excitation", "error")
def nothing_commanded(log: MotorLog) -> MotorLog:
    return replace(log, position_target=np.zeros_like(log.position_target))


@case("excitation")
def another_unit(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", lambda angle: np.multiply(angle, 10.0, out=angle))


@case("dead", row=599)
def an_angle_dies(log: MotorLog) -> MotorLog:
    return edited(log, "joint_pos", column(slice(600, 850), log.joint_pos[599, 0]))


@case("dead", row=599)
def a_velocity_dies(log: MotorLog) -> MotorLog:
    assert log.joint_vel is not None
    return edited(log, "joint_vel", column(slice(600, 850), log.joint_vel[599, 0]))


@case("saturation", row=None)
def an_end_stop(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=np.minimum(log.joint_pos, 0.15))


@case("saturation", row=None)
def two_end_stops(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=np.clip(log.joint_pos, -0.15, 0.15))


@case("saturation", row=None)
def a_torque_limit(log: MotorLog) -> MotorLog:
    return edited(log, "joint_torque", lambda torque: np.clip(torque, -0.05, 0.05, out=torque))


@case("saturation", row=100)
def a_speed_limit(log: MotorLog) -> MotorLog:
    """A step of 1 rad at 0.5 rad/s."""
    way = np.clip(0.5 * (log.time - log.time[100]), 0.0, 1.0)[:, None] * np.ones(2)
    target = np.where(log.time[:, None] >= log.time[100], 1.0, 0.0) * np.ones(2)
    speed = 0.5 * ((log.time >= log.time[100]) & (way[:, 0] < 1.0))[:, None] * np.ones(2)
    return replace(log, position_target=target, joint_pos=way, joint_vel=speed)


@case("quantisation", row=None)
def a_coarse_encoder(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=0.05 * np.rint(log.joint_pos / 0.05))


@case("tracking", "error")
def reversed_command(log: MotorLog) -> MotorLog:
    return edited(log, "position_target", lambda target: np.negative(target, out=target))


@case("tracking")
def other_command(log: MotorLog) -> MotorLog:
    noise = np.random.default_rng(0).normal(size=log.position_target.shape)
    return replace(log, position_target=noise)


@case("tracking")
def very_late(log: MotorLog) -> MotorLog:
    return replace(log, position_target=np.roll(log.position_target, -30, axis=0)).rows(slice(0, 1100))


@case("tracking")
def before_its_command(log: MotorLog) -> MotorLog:
    late = lambda channel: np.roll(channel, 20, axis=0)  # noqa: E731
    return replace(log, position_target=late(log.position_target)).rows(slice(20, None))


@case("tracking")
def too_short(log: MotorLog) -> MotorLog:
    return replace(log, segment=np.arange(log.num_rows) // 15)


@case("offset")
def another_zero(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=log.joint_pos + 0.5 * np.pi)


@case("proportion")
def half_the_ticks_per_turn(log: MotorLog) -> MotorLog:
    slow = lambda by: 0.2 * np.sin(2 * np.pi * 0.2 * (log.time[:, None] - by)) * np.ones(2)  # noqa: E731
    return replace(log, position_target=slow(0.0), joint_pos=2.0 * slow(0.03))


@case("copied", "error", row=1)
def a_command_recorded_twice(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=log.position_target.copy())


@case("torques", "info")
def milli_newton_meters(log: MotorLog) -> MotorLog:
    return edited(log, "joint_torque", lambda torque: np.multiply(torque, 1e3, out=torque))


@case("jumps", "error", row=None)
def a_command_that_wraps(log: MotorLog) -> MotorLog:
    return replace(log, position_target=log.position_target % (2 * np.pi))


@case("velocity")
def another_joints_velocity(log: MotorLog) -> MotorLog:
    return replace(log, joint_vel=np.random.default_rng(0).normal(size=log.joint_pos.shape))


@case("velocity")
def velocity_in_turns(log: MotorLog) -> MotorLog:
    return edited(log, "joint_vel", lambda speed: np.divide(speed, 2 * np.pi, out=speed))


@case("velocity", "error")
def reversed_velocity(log: MotorLog) -> MotorLog:
    return edited(log, "joint_vel", lambda speed: np.negative(speed, out=speed))


@case("unsigned_torque", row=None)
def size_of_a_current(log: MotorLog) -> MotorLog:
    return edited(log, "joint_torque", lambda torque: np.abs(torque, out=torque))


@case("torque_sign")
def away_from_the_command(log: MotorLog) -> MotorLog:
    return replace(log, joint_torque=5.0 * (log.joint_pos - log.position_target), load_inertia=None)


@case("load")
def wrong_torque_constant(log: MotorLog) -> MotorLog:
    return edited(log, "joint_torque", lambda torque: np.multiply(torque, 3.0, out=torque))


@case("load_given", "info")
def no_load(log: MotorLog) -> MotorLog:
    return replace(log, load_inertia=None, external_torque=None)


@case("stated", "info")
def told_gains(log: MotorLog) -> MotorLog:
    return replace(log, stated_kp=np.full(log.joint_pos.shape, 20.0))


@case("coverage")
def one_sine(log: MotorLog) -> MotorLog:
    late = lambda by: 0.3 * np.sin(2 * np.pi * 0.7 * (log.time[:, None] - by)) * np.ones(2)  # noqa: E731
    return replace(log, position_target=late(0.0), joint_pos=late(0.05))


@case("reversals")
def one_way(log: MotorLog) -> MotorLog:
    ramp = lambda by: 0.08 * (log.time[:, None] - by) * np.ones(2)  # noqa: E731
    return replace(log, position_target=ramp(0.0), joint_pos=ramp(0.05))


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


@pytest.mark.parametrize("change", [change for *_, change in CASES])
def test_a_remedy_in_a_column_map_is_not_the_only_one(rich_log: MotorLog, change: Callable[[MotorLog], MotorLog]):
    """Not every format takes one."""
    for finding in check_log(change(rich_log), LIMITS).findings:
        assert "column map" not in finding.remedy or "file" in finding.remedy or "sensor" in finding.remedy, finding


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


def test_a_long_log_is_judged_where_it_moves():
    rest, motion = sines((0.5, 1.3, 2.9), 0.085), sines((0.4, 1.3, 2.9), 0.085)
    parts = [replace(rest, position_target=1e-4 * rest.position_target, joint_pos=-1e-4 * rest.joint_pos)] * 10
    grown = np.clip(motion.time, 0.05, 1.0)[:, None]
    begun = replace(motion, position_target=grown * motion.position_target, joint_pos=grown * motion.joint_pos)
    parts = [*parts, begun, *[motion] * 9]
    whole = replace(
        motion,
        time=0.005 * np.arange(sum(part.num_rows for part in parts)),
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in ("position_target", "joint_pos")},
    )
    (finding,) = check_log(whole).of("tracking")
    assert finding.value == pytest.approx(0.085, abs=0.0025)
    assert finding.row is not None and finding.row >= 20_000


def test_a_reversed_joint_is_found_though_part_of_the_log_says_nothing():
    reversed_, rest = sines((0.4, 1.3, 2.9), 0.05, -1.0), sines((0.4, 1.3, 2.9), 0.05)
    noise = np.random.default_rng(0).normal(size=rest.joint_pos.shape)
    whole = replace(
        rest, time=0.005 * np.arange(4000), segment=np.repeat([0, 1], 2000),
        position_target=np.concatenate([reversed_.position_target, rest.position_target]),
        joint_pos=np.concatenate([reversed_.joint_pos, 0.1 * noise]),
    )  # fmt: skip
    assert [finding.severity for finding in check_log(whole).of("tracking")] == ["error"]


def test_the_last_rows_of_a_long_log_are_judged_too():
    motion = sines((0.4, 1.3, 2.9), 0.05, -1.0)
    still, grown = np.zeros((40_500, 1)), np.clip(motion.time, 0.0, 1.0)[:, None]
    whole = replace(
        motion, time=0.005 * np.arange(42_500),
        position_target=np.concatenate([still, grown * motion.position_target]),
        joint_pos=np.concatenate([still, grown * motion.joint_pos]),
    )  # fmt: skip
    (finding,) = check_log(whole).of("tracking")
    assert finding.severity == "error" and finding.row is not None and finding.row >= 40_000


def test_a_weight_that_is_held_is_no_unsigned_torque(rich_log: MotorLog):
    assert rich_log.joint_torque is not None
    log = replace(rich_log, joint_torque=0.1 * rich_log.joint_torque + 0.5)
    assert not check_log(log).of("unsigned_torque")


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
