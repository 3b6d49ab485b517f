"""Angles that jump are found and classified; fast motion, noise, coarse encoders and steps of the command are none."""

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
    return log_of(
        time, 0.1 * np.sin(time) if command is None else command, angle, joint_names=("knee",)
    )


def swing(rows: int = 1500, period: float = 0.01, size: float = 1.0) -> np.ndarray:
    """Up to 13 rad/s."""
    time = period * np.arange(rows)
    return size * (0.5 * np.sin(2 * np.pi * 0.7 * time) + 0.9 * np.sin(2 * np.pi * 2.0 * time))


def jumps(log: MotorLog) -> list[Finding]:
    return of_check(check_log(log), "jumps")


def joint(
    command: np.ndarray, period: float, rate: float = 6.0, kicks: dict[int, float] | None = None
) -> np.ndarray:
    """A joint that oscillates at ``rate`` [Hz] about its command, damped by a tenth; kicks add to its speed [rad/s]."""
    parts = 20
    natural = 2 * np.pi * rate
    angle = float(command[0])
    speed = 0.0
    found = []
    for row, target in enumerate(command.tolist()):
        found.append(angle)
        speed += (kicks or {}).get(row, 0.0)
        for _ in range(parts):
            speed += period / parts * (natural * natural * (target - angle) - 0.2 * natural * speed)
            angle += period / parts * speed
    return np.array(found)


@pytest.mark.parametrize(("rows", "value"), [(slice(700, 703), -np.pi), (slice(1, 2), -3.0)])
def test_reads_that_fail_are_named_and_counted(rows: slice, value: float):
    angle = swing()
    angle[rows] = value
    (found,) = jumps(of_angle(angle))
    assert (found.severity, found.joint, found.row) == ("error", "knee", rows.start)
    assert (
        f"{value:.4g} rad" in found.message
        and f"{rows.stop - rows.start} such rows" in found.message
    )
    assert found.remedy


@pytest.mark.parametrize("turn", [2 * np.pi, 2 * np.pi * 4095 / 4096])
def test_an_encoder_that_wraps_is_to_be_unwrapped(turn: float):
    angle = 0.3 + swing()
    wrapped = angle % turn
    (found,) = jumps(of_angle(wrapped))
    steps = np.flatnonzero(np.abs(np.diff(wrapped)) > 4.0)
    assert found.row == 1 + steps[0] and f"{len(steps)} such rows" in found.message
    assert "numpy.unwrap" in found.remedy
    assert not jumps(of_angle(np.unwrap(wrapped, period=turn)))


def test_an_angle_that_jumps_and_stays_is_an_error():
    angle = swing()
    angle[800:] += 1.5
    (found,) = jumps(of_angle(angle))
    assert found.row == 800 and found.value == pytest.approx(1.5, abs=0.2)


def shoved(period: float) -> MotorLog:
    """By hand, 2 rad there within 0.1 s, and a second later back; nothing was commanded."""
    time = period * np.arange(round(10.0 / period))
    return of_angle(
        2.0 * (np.clip((time - 4.0) / 0.1, 0.0, 1.0) - np.clip((time - 5.0) / 0.1, 0.0, 1.0)),
        period,
    )


def flicked(period: float) -> MotorLog:
    """At 55 rad/s for 20 ms or three rows, and it stays."""
    steps = np.zeros(round(10.0 / period))
    steps[len(steps) // 2 :][: max(3, round(0.02 / period))] = min(1.2, 55.0 * period)
    return of_angle(np.cumsum(steps), period)


MOTIONS: dict[str, Callable[[float], MotorLog]] = {
    "steps of the command": lambda dt: with_command(
        np.repeat([0.0, 1.5, 0.2, -1.0], round(2.0 / dt)), dt
    ),
    "a telegraph": lambda dt: with_command(
        np.repeat(np.random.default_rng(0).choice([-0.5, 0.5], 300), 2), dt
    ),
    "an impact": lambda dt: of_angle(
        joint(np.zeros(round(3 / dt)), dt, kicks={round(1 / dt): 20.0}), dt
    ),
    "one fast move": lambda dt: with_command(
        np.where(np.arange(round(20 / dt)) < round(10 / dt), 0.0, 2.0), dt
    ),
    "fast motion": lambda dt: of_angle(swing(round(10 / dt), dt, size=4.0), dt),
    "noise": lambda dt: of_angle(0.2 * np.random.default_rng(1).normal(size=1000), dt),
    "a coarse encoder": lambda dt: of_angle(0.05 * np.rint(swing(round(10 / dt), dt) / 0.05), dt),
    "a coarse encoder that toggles": lambda dt: of_angle(
        0.05 * (np.random.default_rng(2).random(1000) < 0.02), dt
    ),
    "a shove": shoved,
    "a flick": flicked,
    "rows that are lost": lambda dt: lossy(of_angle(swing(round(10 / dt), dt), dt)),
}


def with_command(command: np.ndarray, period: float) -> MotorLog:
    return of_angle(joint(command, period), period, command)


def lossy(log: MotorLog) -> MotorLog:
    kept = np.random.default_rng(3).random(log.num_rows) < 0.8
    kept[100:130] = False
    return log.rows(kept)


@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
@pytest.mark.parametrize("name", MOTIONS)
def test_true_motion_is_no_jump(name: str, rate: float):
    log = MOTIONS[name](1.0 / rate)
    report = check_log(log)
    assert of_check(report, "angles") and not {"jumps", "units"} & {
        found.check for found in report.errors
    }
