"""Jumps of an angle are found and classified; fast motion, noise and rounding are no jumps."""

from collections.abc import Callable

import numpy as np
import pytest
from motor_logs import log_of, of_check

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.motor_log import MotorLog


def of_angle(
    angle: np.ndarray, period: float = 0.01, command: np.ndarray | None = None
) -> MotorLog:
    """One joint, slowly commanded by default."""
    time = period * np.arange(len(angle))
    if command is None:
        command = 0.1 * np.sin(time)

    return log_of(time, command, angle, joint_names=("knee",))


def swing(rows: int = 1500, period: float = 0.01, size: float = 1.0) -> np.ndarray:
    """Angle of a motion with speeds up to 13 rad/s."""
    time = period * np.arange(rows)
    return size * (0.5 * np.sin(2 * np.pi * 0.7 * time) + 0.9 * np.sin(2 * np.pi * 2.0 * time))


def jumps(log: MotorLog) -> list[Finding]:
    return of_check(check_log(log), "jumps")


def joint(
    command: np.ndarray, period: float, rate: float = 6.0, kicks: dict[int, float] | None = None
) -> np.ndarray:
    """Angles of a joint that oscillates about its command.

    rate: natural frequency [Hz]; its damping ratio is 0.1.
    kicks: change of speed [rad/s] at a row.
    """
    num_substeps = 20
    dt = period / num_substeps
    natural = 2 * np.pi * rate
    angle = float(command[0])
    speed = 0.0
    angles = []

    for row, target in enumerate(command.tolist()):
        angles.append(angle)
        speed += (kicks or {}).get(row, 0.0)
        for _ in range(num_substeps):
            acceleration = natural * natural * (target - angle) - 0.2 * natural * speed
            speed += dt * acceleration
            angle += dt * speed

    return np.array(angles)


@pytest.mark.parametrize(("rows", "value"), [(slice(700, 703), -np.pi), (slice(1, 2), -3.0)])
def test_failed_reads_are_named_and_counted(rows: slice, value: float):
    angle = swing()
    angle[rows] = value
    (finding,) = jumps(of_angle(angle))

    assert (finding.severity, finding.joint, finding.row) == ("error", "knee", rows.start)
    assert f"{value:.4g} rad" in finding.message
    assert f"{rows.stop - rows.start} such rows" in finding.message
    assert finding.remedy


@pytest.mark.parametrize("turn", [2 * np.pi, 2 * np.pi * 4095 / 4096])
def test_an_encoder_that_wraps_is_to_be_unwrapped(turn: float):
    angle = 0.3 + swing()
    wrapped = angle % turn
    (finding,) = jumps(of_angle(wrapped))
    steps = np.flatnonzero(np.abs(np.diff(wrapped)) > 4.0)

    assert finding.row == 1 + steps[0]
    assert f"{len(steps)} such rows" in finding.message
    assert "numpy.unwrap" in finding.remedy
    assert not jumps(of_angle(np.unwrap(wrapped, period=turn)))


def test_an_angle_that_jumps_and_stays_is_an_error():
    angle = swing()
    angle[800:] += 1.5
    (finding,) = jumps(of_angle(angle))

    assert finding.row == 800
    assert finding.value == pytest.approx(1.5, abs=0.2)


def shoved(period: float) -> MotorLog:
    """A push by hand, 2 rad within 0.1 s, and back a second later, without a command."""
    time = period * np.arange(round(10.0 / period))
    there = np.clip((time - 4.0) / 0.1, 0.0, 1.0)
    back = np.clip((time - 5.0) / 0.1, 0.0, 1.0)

    return of_angle(2.0 * (there - back), period)


def flicked(period: float) -> MotorLog:
    """A motion at 55 rad/s for 20 ms, at least three rows; the joint stays there."""
    steps = np.zeros(round(10.0 / period))
    start = len(steps) // 2
    num_rows = max(3, round(0.02 / period))
    steps[start : start + num_rows] = min(1.2, 55.0 * period)

    return of_angle(np.cumsum(steps), period)


def steps_of_the_command(dt: float) -> MotorLog:
    return with_command(np.repeat([0.0, 1.5, 0.2, -1.0], round(2.0 / dt)), dt)


def telegraph(dt: float) -> MotorLog:
    levels = np.random.default_rng(0).choice([-0.5, 0.5], 300)
    return with_command(np.repeat(levels, 2), dt)


def impact(dt: float) -> MotorLog:
    """A kick of 20 rad/s after one second."""
    command = np.zeros(round(3 / dt))
    return of_angle(joint(command, dt, kicks={round(1 / dt): 20.0}), dt)


def fast_move(dt: float) -> MotorLog:
    """A step of the command by 2 rad after 10 s."""
    is_before = np.arange(round(20 / dt)) < round(10 / dt)
    return with_command(np.where(is_before, 0.0, 2.0), dt)


def fast_motion(dt: float) -> MotorLog:
    return of_angle(swing(round(10 / dt), dt, size=4.0), dt)


def noise(dt: float) -> MotorLog:
    return of_angle(0.2 * np.random.default_rng(1).normal(size=1000), dt)


def coarse_encoder(dt: float) -> MotorLog:
    return of_angle(0.05 * np.rint(swing(round(10 / dt), dt) / 0.05), dt)


def toggling_encoder(dt: float) -> MotorLog:
    return of_angle(0.05 * (np.random.default_rng(2).random(1000) < 0.02), dt)


def lost_rows(dt: float) -> MotorLog:
    return lossy(of_angle(swing(round(10 / dt), dt), dt))


def with_command(command: np.ndarray, period: float) -> MotorLog:
    return of_angle(joint(command, period), period, command)


def lossy(log: MotorLog) -> MotorLog:
    kept = np.random.default_rng(3).random(log.num_rows) < 0.8
    kept[100:130] = False
    return log.rows(kept)


MOTIONS: tuple[Callable[[float], MotorLog], ...] = (
    steps_of_the_command,
    telegraph,
    impact,
    fast_move,
    fast_motion,
    noise,
    coarse_encoder,
    toggling_encoder,
    shoved,
    flicked,
    lost_rows,
)


@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
@pytest.mark.parametrize("motion", MOTIONS)
def test_true_motion_is_no_jump(motion: Callable[[float], MotorLog], rate: float):
    log = motion(1.0 / rate)

    report = check_log(log)

    assert of_check(report, "angles")
    assert not {"jumps", "units"} & {error.check for error in report.errors}
