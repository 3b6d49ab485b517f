"""Every format describes itself in one file, and `read_log` asks each."""

from pathlib import Path

import numpy as np
import pytest
from motor_logs import joints_of, log_of
from third_party_files import csv_columns, write_bam, write_csv, write_lerobot, write_pt, write_sage

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.log_reader import LogReader
from motorprior.logs.read_log import READERS, read_log
from motorprior.logs.readers.deploy_recording import Mode, run_columns
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.robots.load import load_robot

ROBOT = load_robot("pupper_v2")
ROWS = 20


def write_motor_log(folder: Path) -> Path:
    time = 0.01 * np.arange(ROWS)
    angles = np.tile(np.sin(time)[:, None], (1, ROBOT.num_joints))
    write_log(folder / "a.parquet", log_of(time, angles, **joints_of(ROBOT)))
    return folder / "a.parquet"


def write_rows(path: Path, columns: tuple[str, ...], mode: float = 0.0) -> Path:
    time = 0.01 * np.arange(ROWS)
    table = np.column_stack(
        [mode * (name == "mode") + time * (name in ("time", "t_s")) for name in columns]
    )
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    return path


SAMPLES = {
    "motor log": write_motor_log,
    "pendulum of Rhoban/bam": write_bam,
    "motion of isaac-sim2real/sage": write_sage,
    "dataset of LeRobot": write_lerobot,
    "table": write_csv,
    "arrays": write_pt,
    "recording of a robot": lambda folder: write_rows(
        folder / "run.csv", run_columns(ROBOT.joint_names, False), float(Mode.WALK)
    ),
    "log of jietan/puppersim": lambda folder: write_rows(
        folder / "env_real_a_log.csv", csv_columns(ROBOT.num_joints)
    ),
}  # ROS 2 bags need an extra: tests/logs/readers/test_ros_bag.py
NAMELESS = ("recording of a robot", "log of jietan/puppersim")


def test_every_format_has_a_sample():
    assert {reader.name for reader in READERS} == {*SAMPLES, "ROS 2 bag"}


@pytest.mark.parametrize(
    "reader", [reader for reader in READERS if reader.read and reader.name in SAMPLES]
)
def test_a_format_is_recognised_and_needs_a_robot_only_without_joint_names(
    reader: LogReader, tmp_path: Path
):
    path = SAMPLES[reader.name](tmp_path)
    assert [each.name for each in READERS if each.read and each.matches(path)] == [reader.name]
    log = read_log(path, ROBOT)
    assert reader.read is not None
    np.testing.assert_array_equal(log.joint_pos, reader.read(path, ROBOT).joint_pos)
    if reader.name in NAMELESS:
        assert log.joint_names == ROBOT.joint_names
        with pytest.raises(ConfigError, match="does not name its joints") as refusal:
            read_log(path)
        assert refusal.value.argument == "robot" and refusal.value.where == path
    else:
        np.testing.assert_array_equal(read_log(path).joint_pos, log.joint_pos)


@pytest.mark.parametrize("name", ["table", "arrays"])
def test_a_format_without_meaning_needs_a_map(name: str, tmp_path: Path):
    path = SAMPLES[name](tmp_path)
    with pytest.raises(LogError, match="read it with columns") as refusal:
        read_log(path)
    assert refusal.value.argument == "columns"
    assert read_log(path, columns=tmp_path / "columns.toml").joint_names == ("pan", "lift")


def test_an_unknown_format_is_refused_with_those_that_are_known(tmp_path: Path):
    (tmp_path / "log.xyz").write_text("")
    for columns in (None, "so101_sage"):
        with pytest.raises(
            LogError, match=r"unknown log format.*pendulum of Rhoban/bam \(\.json, \.json\.gz\)"
        ):
            read_log(tmp_path / "log.xyz", columns=columns)
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "none.npz")
