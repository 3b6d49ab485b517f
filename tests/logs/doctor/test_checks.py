"""The log doctor finds each fault added to a healthy log, and none in healthy and real logs."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from motor_logs import log_of, of_check

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import drop_repeats
from motorprior.logs.read_log import read_log, read_log_folder
from motorprior.robots.pupper_v2.robot import PUPPER_V2

ROBOT: Any = SimpleNamespace(
    name="two", joint_names=(), limits_of=lambda names: np.array([[-1.0, 1.0]] * 2)
)
Change = Callable[[np.ndarray], np.ndarray]


def changed(**changes: Change) -> Callable[[MotorLog], MotorLog]:
    """The log with other channels: each a function of the old one."""
    return lambda log: replace(
        log, **{name: change(getattr(log, name)) for name, change in changes.items()}
    )


def rows(first: int, last: int, value: float) -> Change:
    """Other values in some rows of the left joint."""

    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[first:last, 0] = value
        return values

    return change


def held(first: int, last: int) -> Change:
    return lambda values: rows(first, last, values[first, 0])(values)


ROWS = np.arange(1200)
NOISE = np.random.default_rng(0).normal(size=(1200, 2))
EVEN_ROWS = ROWS // 2 * 2
ODD_ROWS = (ROWS - 1) // 2 * 2 + 1


def read_in_turn(angle: np.ndarray) -> np.ndarray:
    """The two joints are read in alternate rows."""
    return np.stack([angle[EVEN_ROWS, 0], angle[ODD_ROWS, 1]], axis=1)


def shifted(count: int) -> Change:
    return lambda values: np.roll(values, count, axis=0)


def with_reversed_torque(log: MotorLog) -> MotorLog:
    torque = 5.0 * (log.joint_pos - log.position_target)
    return replace(log, joint_torque=torque, load_inertia=None)


def with_copied_command(log: MotorLog) -> MotorLog:
    return replace(log, joint_pos=log.position_target.copy())


CASES: dict[str, tuple[str, str, int | None, Callable[[MotorLog], MotorLog]]] = {
    # time
    "jitter": ("jitter", "warning", 2, changed(time=lambda time: time + 0.004 * (ROWS % 2))),
    "pause": ("gaps", "warning", 700, changed(time=lambda time: time + 0.2 * (ROWS >= 700))),
    "milliseconds": ("rate", "error", 0, changed(time=lambda time: 1e3 * time)),
    "polled twice": ("repeats", "warning", 1, changed(joint_pos=lambda angle: angle[EVEN_ROWS])),
    "read in turn": ("repeats", "warning", 1, changed(joint_pos=read_in_turn)),
    # values and units
    "beyond one turn": ("units", "warning", 500, changed(joint_pos=rows(500, 501, 7.0))),
    "damaged number": ("units", "error", 500, changed(joint_pos=rows(500, 501, 1e6))),
    "degrees": ("units", "error", None, changed(joint_pos=np.rad2deg)),
    "velocity in degrees": ("units", "error", None, changed(joint_vel=np.rad2deg)),
    "failed velocity reads": (
        "failed_reads", "warning", 400, changed(joint_vel=rows(400, 402, -620.0)),
    ),
    "wrapped command": (
        "jumps", "error", None, changed(position_target=lambda angle: angle % (2 * np.pi)),
    ),
    # motion
    "beyond a limit": ("limits", "warning", 300, changed(joint_pos=rows(300, 301, 1.2))),
    "constant angle": ("dead", "warning", 0, changed(joint_pos=rows(0, 1200, 0.1))),
    "angle dies": ("dead", "warning", 600, changed(joint_pos=held(600, 850))),
    "no command": ("excitation", "error", 0, changed(position_target=np.zeros_like)),
    "other unit": ("excitation", "warning", 0, changed(joint_pos=lambda angle: 10.0 * angle)),
    "one way": (
        "reversals", "warning", 0,
        changed(position_target=np.sort, joint_pos=lambda angle: np.sort(angle, axis=0)),
    ),
    "end stop": (
        "saturation", "warning", None, changed(joint_pos=lambda angle: np.minimum(angle, 0.15)),
    ),
    "end stop that gives way": (
        "saturation", "warning", None,
        changed(joint_pos=lambda angle: np.minimum(angle, 0.15 + 2e-4 * NOISE)),
    ),
    # response to the command
    "scaled actions": ("scale", "warning", 0, changed(position_target=lambda angle: 3.0 * angle)),
    "reversed command": ("tracking", "error", 0, changed(position_target=np.negative)),
    "other command": ("tracking", "warning", 0, changed(position_target=lambda _: NOISE)),
    "late": ("tracking", "warning", 0, changed(position_target=shifted(-30))),
    "early": ("tracking", "warning", 0, changed(position_target=shifted(20))),
    "short segments": ("tracking", "warning", 0, lambda log: replace(log, segment=ROWS // 15)),
    "other zero": ("offset", "warning", 0, changed(joint_pos=lambda angle: angle + 0.5 * np.pi)),
    "command recorded twice": ("copied", "error", 1, with_copied_command),
    # velocity and torque
    "reversed velocity": ("velocity", "error", 0, changed(joint_vel=np.negative)),
    "other velocity": ("velocity", "warning", 0, changed(joint_vel=lambda _: NOISE)),
    "reversed torque": ("torque_sign", "warning", 0, with_reversed_torque),
    "reversed torque of a load": ("torque_sign", "warning", 0, changed(joint_torque=np.negative)),
    "torque in N·cm": (
        "torque_scale", "warning", 0, changed(joint_torque=lambda torque: 100.0 * torque),
    ),
    "wrong torque constant": (
        "torque_scale", "warning", 0, changed(joint_torque=lambda torque: 1.4 * torque),
    ),
    "|current|": ("unsigned_torque", "warning", 0, changed(joint_torque=np.abs)),
}  # fmt: skip
"""Check, severity and first row (None for any) of a change to a healthy log."""


@pytest.mark.parametrize("name", CASES)
def test_a_fault_is_found_by_its_check_with_severity_and_row(rich_log: MotorLog, name: str):
    check, severity, row, change = CASES[name]
    report = check_log(change(rich_log), ROBOT)
    findings = [finding for finding in of_check(report, check) if finding.severity == severity]

    assert findings, report
    assert row is None or findings[0].row == row
    assert findings[0].message
    assert findings[0].remedy


def test_a_healthy_log_has_no_errors_and_no_warnings(rich_log: MotorLog):
    report = check_log(rich_log, ROBOT)

    assert report.usable
    assert {finding.severity for finding in report.findings} == {"info"}


STORED: dict[str, Change] = {
    "6 decimals": lambda values: np.round(values, 6),
    "8 decimals": lambda values: np.round(values, 8),
    "float32": lambda values: values.astype(np.float32).astype(float),
    "float64": lambda values: values,
}


@pytest.mark.parametrize("kind", STORED)
def test_an_interpolated_angle_is_found_in_every_number_format(kind: str):
    stored = STORED[kind]
    time = np.arange(4000) / 240.0
    smooth = 0.5 * np.sin(2.0 * np.pi * 0.4 * time)
    slow = np.interp(time, time[::7], smooth[::7])
    angles = stored(np.column_stack([slow, smooth]))

    (finding,) = of_check(check_log(log_of(stored(time), angles)), "interpolated")

    assert finding.joint == "a"
    assert finding.value == 7.0
    assert "record this joint at the rate of the others" in finding.remedy


@pytest.mark.parametrize("kind", STORED)
@pytest.mark.parametrize(("hertz", "size"), [(100, 0.2), (200, 0.05), (1000, 1.5)])
def test_slow_motion_without_noise_is_not_called_interpolated(kind: str, hertz: int, size: float):
    stored = STORED[kind]
    time = np.arange(20 * hertz) / hertz
    angle = size * np.sin(2.0 * np.pi * 0.03 * time + 0.3)
    angle += 0.3 * size * np.sin(2.0 * np.pi * 0.07 * time)

    assert not of_check(check_log(log_of(stored(time), stored(angle))), "interpolated")


def test_the_published_logs_are_usable(shared_data: Path):
    for name, log in read_log_folder(shared_data / "pupper_v2", PUPPER_V2).logs.items():
        report = check_log(log, PUPPER_V2)
        assert report.usable, (name, report)
        assert not of_check(report, "limits"), (name, report)
        assert bool(of_check(report, "repeats")) == (name == "0116")
        assert all(0.08 < finding.value < 0.12 for finding in of_check(report, "tracking")), name
        assert not of_check(check_log(drop_repeats(log)), "repeats")


@pytest.mark.parametrize(
    ("folder", "columns"), [("go2", "go2_identification"), ("so101", "so101_sage"), ("xl330", None)]
)
def test_the_real_logs_have_no_errors(shared_data: Path, folder: str, columns: str | None):
    paths = sorted((shared_data / folder).glob("*.gz"))[::5]
    reports = {path: check_log(read_log(path, columns=columns)) for path in paths}

    assert reports
    for path, report in reports.items():
        assert report.usable, (path, report.errors)
        for check in ("repeats", "dead", "unsigned_torque", "torque_sign"):
            assert not of_check(report, check), path
        if folder == "go2":
            assert all(0.06 < finding.value < 0.08 for finding in of_check(report, "tracking"))
