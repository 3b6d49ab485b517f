"""Failed reads are left out and counted, wrapped angles unwrapped, exchanged joints not taken for reversed ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motor_logs import log_of, of_check
from third_party_files import write_bam

import motorprior as mp
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.doctor.response import COMPARE
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
    assert log.num_rows == 1493 and log.segment is None
    np.testing.assert_array_equal(log.joint_pos, clean.joint_pos[np.isin(TIME, log.time)])
    assert cleaned(clean, "made") == (clean, [])


def test_errors_are_warnings_of_the_import_and_an_impossible_rate_ends_it(tmp_path: Path):
    log = moving((0.5, 0.8))
    path = tmp_path / "log.parquet"
    mp.write_log(path, replace(log, joint_pos=log.joint_pos * [1.0, -1.0], joint_vel=None))
    with pytest.warns(UserWarning, match="b moves against its command"):
        mp.load_log(path)
    mp.write_log(path, replace(log, time=1e3 * log.time))
    with pytest.raises(mp.LogError, match='time = "s", "ms"'):
        mp.load_log(path)


def test_a_column_that_wraps_is_unwrapped_by_its_map(tmp_path: Path):
    angle = np.cumsum(np.full(400, 0.05))
    ticks = np.rint(np.stack([angle + 0.05, angle], axis=1) * 4096 / (2 * np.pi)) % 4096
    table = np.column_stack([TIME[:400], ticks])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,goal,pos", comments="")
    lines = 'motor = "m"\ntime = "t"\nposition_target = "goal"\njoint_pos = "pos"\n[units]\nangle = "tick"\n'
    (tmp_path / "map.toml").write_text(lines + "ticks_per_turn = 4096\n[joints.pan]\n")
    report = check_log(mp.read_log(tmp_path / "log.csv", columns=tmp_path / "map.toml"))
    assert any("wraps = true" in found.remedy and "4096" in found.remedy for found in report.errors)
    (tmp_path / "map.toml").write_text(
        lines + "ticks_per_turn = 4096\n[joints.pan]\nwraps = true\n"
    )
    log = mp.read_log(tmp_path / "log.csv", columns=tmp_path / "map.toml")
    np.testing.assert_allclose(
        log.joint_pos[:, 0] - log.joint_pos[0, 0], angle - angle[0], atol=2e-3
    )
    np.testing.assert_allclose(log.position_target - log.joint_pos, 0.05, atol=2e-3)


def test_exchanged_joints_are_no_reversed_ones():
    log = moving((0.5, 0.83, 1.37))
    report = check_log(replace(log, joint_pos=log.joint_pos[:, [1, 2, 0]], joint_vel=None))
    found = [each for each in of_check(report, "tracking") if each.severity != "info"]
    assert [(each.severity, each.joint) for each in found] == [("error", joint) for joint in "abc"]
    assert all(f" of {other}," in each.message for each, other in zip(found, "bca", strict=True))
    assert not any("sign" in each.remedy for each in found)


def test_a_reversed_joint_is_reversed_and_two_that_may_be_either_are_to_be_compared():
    log = moving((0.5, 0.83))
    (found,) = [
        each
        for each in check_log(
            replace(log, joint_pos=log.joint_pos * [-1, 1], joint_vel=None)
        ).errors
    ]
    assert found.joint == "a" and "sign = -1" in found.remedy
    command = log.position_target[:, [0, 0]] * [1, -1]
    report = check_log(
        replace(
            log, position_target=command, joint_pos=-np.roll(command, 3, axis=0), joint_vel=None
        )
    )
    found = of_check(report, "tracking")
    assert [(each.severity, each.remedy) for each in found] == [("error", COMPARE)] * 2


def test_findings_of_one_kind_are_one_line():
    log = moving((0.5, 0.8, 1.1, 1.3))
    errors = check_log(replace(log, joint_pos=-log.joint_pos, joint_vel=None)).errors
    (one,) = grouped(errors)
    assert len(errors) == 4 and all(name in one.message for name in "abcd")


def test_a_bench_log_becomes_one_of_the_robots_joints_by_one_option(tmp_path: Path):
    path = write_bam(tmp_path)
    for names, words in (((), "pendulum"), (("nose",), "nose")):
        with pytest.raises(mp.ConfigError, match=rf"{words}.*FR_hip") as error:
            mp.load_log(path, robot="pupper_v2", settings=mp.LogSettings(as_joint=names))
        assert error.value.argument == "as_joint"
    log = mp.load_log(path, robot="pupper_v2", settings=mp.LogSettings(as_joint=["FR_hip"]))
    assert (log.robot, log.joint_names, log.gain_unit) == ("pupper_v2", ("FR_hip",), "firmware")
    assert mp.load_log(path).robot == "pendulum"


def test_a_value_that_is_held_is_no_motion_and_an_order_of_joints_no_sign():
    log = moving((0.5, 0.8))
    held = log.joint_pos.copy()
    held[400:420, 0] = -np.pi
    assert [
        found.row for found in check_log(replace(log, joint_pos=held, joint_vel=None)).errors
    ] == [400]
    phases = {"FL": 0.0, "FR": np.pi, "RL": np.pi, "RR": 0.0}  # a trot
    sizes = {"hip": (0.05, 0.0), "thigh": (0.3, 0.6), "calf": (0.5, 1.9)}
    names = tuple(f"{leg}_{part}" for leg in phases for part in sizes)
    waves = [(size, at + lag) for at in phases.values() for size, lag in sizes.values()]
    command = np.stack([size * np.sin(4 * np.pi * TIME + at) for size, at in waves], axis=1)
    by_part = [names.index(f"{leg}_{part}") for part in sizes for leg in phases]
    trot = replace(
        log,
        position_target=command,
        joint_pos=np.roll(command, 3, axis=0)[:, by_part],
        joint_vel=None,
        joint_names=names,
    )
    assert all("sign = -1" not in found.remedy for found in check_log(trot).errors)
