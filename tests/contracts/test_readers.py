"""Every reader of logs describes itself, and the registry asks each in turn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from third_party_files import write_bam, write_lerobot, write_sage

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs import read_log as registry
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import READERS, read_log
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.logs.readers.puppersim import csv_columns
from motorprior.logs.readers.robot_run import Mode, run_columns
from motorprior.robots.load import load_robot

ROBOT = load_robot("pupper_v2")
ROWS = 20


def a_log() -> MotorLog:
    time = 0.01 * np.arange(ROWS)
    angles = np.tile(np.sin(time)[:, None], (1, ROBOT.num_joints))
    return MotorLog(
        time=time, position_target=angles, joint_pos=angles, joint_names=ROBOT.joint_names, robot=ROBOT.name,
        motor=ROBOT.motor, source="a test",
    )  # fmt: skip


def write_rows(path: Path, columns: tuple[str, ...], fixed: dict[str, float]) -> Path:
    time = 0.01 * np.arange(ROWS)
    table = np.column_stack([fixed.get(name, 0.0) + time * (name in ("time", "t_s")) for name in columns])
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    return path


FOREIGN = {
    "pendulum of Rhoban/bam": write_bam,
    "motion of isaac-sim2real/sage": write_sage,
    "dataset of LeRobot": write_lerobot,
}
IN_THIS_INSTALLATION = [reader for reader in READERS if reader.name != "ROS 2 bag"]
"""ROS 2 bags need an extra; tests/logs/formats/test_ros_bag.py has them."""
NAMELESS = ("recording of a robot", "log of jietan/puppersim")
"""Formats that do not say which joints they are of."""


def sample_of(reader: LogReader, folder: Path) -> Path:
    """A small file in the reader's format."""
    if reader.name in FOREIGN:
        return FOREIGN[reader.name](folder)
    if reader.name == "motor log":
        write_log(folder / "a.parquet", a_log())
        return folder / "a.parquet"
    if reader.name == "recording of a robot":
        return write_rows(folder / "run.csv", run_columns(ROBOT.joint_names, False), {"mode": float(Mode.WALK)})
    return write_rows(folder / "env_real_a_log.csv", csv_columns(ROBOT.num_joints), {})


@pytest.mark.parametrize("reader", IN_THIS_INSTALLATION, ids=lambda reader: reader.name)
def test_a_reader_knows_its_own_files_and_read_log_finds_it(reader: LogReader, tmp_path: Path):
    path = sample_of(reader, tmp_path)
    assert next(known for known in READERS if known.matches(path)) is reader
    log = read_log(path, ROBOT)
    if reader.name not in FOREIGN:
        assert (log.robot, log.joint_names, log.num_rows) == (ROBOT.name, ROBOT.joint_names, ROWS)
    np.testing.assert_array_equal(log.joint_pos, reader.read(path, ROBOT).joint_pos)


@pytest.mark.parametrize("reader", IN_THIS_INSTALLATION, ids=lambda reader: reader.name)
def test_a_format_without_names_needs_a_robot(reader: LogReader, tmp_path: Path):
    path = sample_of(reader, tmp_path)
    if reader.name not in NAMELESS:
        np.testing.assert_array_equal(read_log(path).joint_pos, read_log(path, ROBOT).joint_pos)
    else:
        with pytest.raises(ConfigError, match="does not name its joints") as refusal:
            read_log(path)
        assert refusal.value.argument == "robot" and refusal.value.where == path


def test_an_unknown_format_is_refused_with_those_that_are_known(tmp_path: Path):
    (tmp_path / "log.mat").write_text("")
    with pytest.raises(LogError, match=r"motor log \(\.parquet\); recording of a robot \(\.csv\); log of jietan/pup"):
        read_log(tmp_path / "log.mat")
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "log.npz")


def test_a_new_reader_is_one_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    mine = LogReader("mine", (".mine",), lambda path: True, lambda path, robot: replace(a_log(), source=str(path)))
    monkeypatch.setattr(registry, "READERS", (*READERS, mine))
    (tmp_path / "a.mine").write_text("")
    assert read_log(tmp_path / "a.mine").source == str(tmp_path / "a.mine")
