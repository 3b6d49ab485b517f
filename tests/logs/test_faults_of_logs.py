"""Failed reads, wrapped angles, and reversed or exchanged joints are told apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motor_logs import log_of, of_check
from third_party_files import write_bam

import motorprior as mp
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.doctor.response import COMPARE_JOINTS
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.prepare_log import cleaned
from motorprior.progress import Note

TIME = 0.01 * np.arange(1500)


def moving(rates: tuple[float, ...], lag: int = 3) -> MotorLog:
    """Joints that follow sines of different rates [Hz], ``lag`` rows later."""
    command = np.stack([0.4 * np.sin(2 * np.pi * rate * TIME) for rate in rates], axis=1)
    angle = np.roll(command, lag, axis=0)
    angle[:lag] = 0.0

    return log_of(TIME, command, angle, joint_vel=np.gradient(angle, 0.01, axis=0))


def test_failed_reads_of_angles_and_velocities_are_left_out_and_counted():
    clean = moving((0.5, 0.8))
    assert clean.joint_vel is not None

    angle = clean.joint_pos.copy()
    speed = clean.joint_vel.copy()
    angle[[200, 700], 0] = -np.pi
    angle[900:902, 1] = -np.pi
    angle[-1, 1] = -np.pi
    speed[[400, 1200], 1] = 620.0
    log, (note,) = cleaned(replace(clean, joint_pos=angle, joint_vel=speed), "made")
    text = "made: 7 rows in which a read failed are left out (a 2, b 5)"

    assert note == Note("warning", text)
    assert log.num_rows == 1493
    assert log.segment is None
    np.testing.assert_array_equal(log.joint_pos, clean.joint_pos[np.isin(TIME, log.time)])
    assert cleaned(clean, "made") == (clean, [])


def test_loading_refuses_a_reversed_joint_and_an_impossible_rate(tmp_path: Path):
    log = moving((0.5, 0.8))
    path = tmp_path / "log.parquet"
    mp.write_log(path, replace(log, joint_pos=log.joint_pos * [1.0, -1.0], joint_vel=None))

    with pytest.raises(mp.LogError, match=r"\bb\b.*against"):
        mp.load_log(path)

    mp.write_log(path, replace(log, time=1e3 * log.time))

    with pytest.raises(mp.LogError, match='time = "s", "ms"'):
        mp.load_log(path)


def test_a_column_that_wraps_is_unwrapped_by_its_map(tmp_path: Path):
    angle = np.cumsum(np.full(400, 0.05))
    ticks = np.rint(np.stack([angle + 0.05, angle], axis=1) * 4096 / (2 * np.pi)) % 4096
    table = np.column_stack([TIME[:400], ticks])
    lines = (
        'motor = "m"\ntime = "t"\nposition_target = "goal"\njoint_pos = "pos"\n'
        '[units]\nangle = "tick"\nticks_per_turn = 4096\n[joints.pan]\n'
    )
    path = tmp_path / "log.csv"
    columns = tmp_path / "map.toml"

    columns.write_text(lines)
    np.savetxt(path, table, delimiter=",", header="t,goal,pos", comments="")
    remedies = [finding.remedy for finding in check_log(mp.read_log(path, columns=columns)).errors]

    assert any("wraps = true" in remedy and "4096" in remedy for remedy in remedies)

    columns.write_text(lines + "wraps = true\n")
    log = mp.read_log(path, columns=columns)
    turned = log.joint_pos[:, 0] - log.joint_pos[0, 0]

    np.testing.assert_allclose(turned, angle - angle[0], atol=2e-3)
    np.testing.assert_allclose(log.position_target - log.joint_pos, 0.05, atol=2e-3)


def test_exchanged_joints_are_named_and_not_taken_for_reversed_joints():
    log = moving((0.5, 0.83, 1.37))
    exchanged = replace(log, joint_pos=log.joint_pos[:, [1, 2, 0]], joint_vel=None)

    report = check_log(exchanged)
    findings = [finding for finding in of_check(report, "tracking") if finding.severity != "info"]

    assert [(finding.severity, finding.joint) for finding in findings] == [
        ("error", "a"),
        ("error", "b"),
        ("error", "c"),
    ]
    for finding, joint_that_follows in zip(findings, "bca", strict=True):
        assert f" of {joint_that_follows}," in finding.message
        assert "sign" not in finding.remedy


def test_a_reversed_joint_gets_a_sign_and_joints_of_one_command_are_to_be_compared():
    log = moving((0.5, 0.83))
    reversed_joint = replace(log, joint_pos=log.joint_pos * [-1, 1], joint_vel=None)
    (error,) = check_log(reversed_joint).errors

    assert error.joint == "a"
    assert "sign = -1" in error.remedy

    # both joints have one command but for its sign: they may be reversed or exchanged
    command = log.position_target[:, [0, 0]] * [1, -1]
    angle = -np.roll(command, 3, axis=0)
    either = replace(log, position_target=command, joint_pos=angle, joint_vel=None)
    findings = of_check(check_log(either), "tracking")

    assert [(finding.severity, finding.remedy) for finding in findings] == [
        ("error", COMPARE_JOINTS)
    ] * 2


def test_equal_findings_of_several_joints_are_one_line():
    log = moving((0.5, 0.8, 1.1, 1.3))
    errors = check_log(replace(log, joint_pos=-log.joint_pos, joint_vel=None)).errors
    (one,) = grouped(errors)

    assert len(errors) == 4
    assert all(name in one.message for name in "abcd")


def test_the_setting_as_joint_makes_a_bench_log_one_of_a_robots_joint(tmp_path: Path):
    path = write_bam(tmp_path)

    for names, joint in (((), "pendulum"), (("nose",), "nose")):
        with pytest.raises(mp.ConfigError, match=joint) as error:
            mp.load_log(path, robot="pupper_v2", settings=mp.LogSettings(as_joint=names))
        assert "FR_hip" in str(error.value), "a joint that may be chosen"
        assert error.value.argument == "as_joint"

    log = mp.load_log(path, robot="pupper_v2", settings=mp.LogSettings(as_joint=["FR_hip"]))

    assert (log.robot, log.joint_names, log.gain_unit) == ("pupper_v2", ("FR_hip",), "firmware")
    assert mp.load_log(path).robot == "pendulum"


def test_a_held_value_is_one_failed_read():
    log = moving((0.5, 0.8))
    held = log.joint_pos.copy()
    held[400:420, 0] = -np.pi

    report = check_log(replace(log, joint_pos=held, joint_vel=None))

    assert [error.row for error in report.errors] == [400]


def test_joints_of_a_trot_in_another_order_are_not_taken_for_reversed_joints():
    phases = {"FL": 0.0, "FR": np.pi, "RL": np.pi, "RR": 0.0}  # a trot
    sizes = {"hip": (0.05, 0.0), "thigh": (0.3, 0.6), "calf": (0.5, 1.9)}  # [rad], lag [rad]
    names = [f"{leg}_{segment}" for leg in phases for segment in sizes]
    columns = []

    for phase in phases.values():
        for size, lag in sizes.values():
            columns.append(size * np.sin(4 * np.pi * TIME + phase + lag))

    command = np.stack(columns, axis=1)

    # all hips first, then all thighs, then all calves
    by_segment = [names.index(f"{leg}_{segment}") for segment in sizes for leg in phases]
    angle = np.roll(command, 3, axis=0)[:, by_segment]
    trot = log_of(TIME, command, angle, joint_names=tuple(names))

    assert all("sign = -1" not in error.remedy for error in check_log(trot).errors)
