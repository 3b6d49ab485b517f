"""Contract of all log formats: exactly one reader recognises a file, and `read_log` uses it."""

from pathlib import Path

import numpy as np
import pytest
from motor_logs import joints_of, log_of
from servo_recordings import write_servo_recording
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
    table = np.zeros((ROWS, len(columns)))

    for index, name in enumerate(columns):
        if name == "mode":
            table[:, index] = mode
        elif name in ("time", "t_s"):
            table[:, index] = time

    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")

    return path


def write_deploy_recording(folder: Path) -> Path:
    columns = run_columns(ROBOT.joint_names, False)
    return write_rows(folder / "run.csv", columns, float(Mode.WALK))


def write_puppersim(folder: Path) -> Path:
    return write_rows(folder / "env_real_a_log.csv", csv_columns(ROBOT.num_joints))


SAMPLES = {
    "motor log": write_motor_log,
    "pendulum of Rhoban/bam": write_bam,
    "motion of isaac-sim2real/sage": write_sage,
    "dataset of LeRobot": write_lerobot,
    "table": write_csv,
    "arrays": write_pt,
    "recording of a robot": write_deploy_recording,
    "log of jietan/puppersim": write_puppersim,
    "recording of servos": write_servo_recording,
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
    matching = [
        candidate.name for candidate in READERS if candidate.read and candidate.matches(path)
    ]

    assert matching == [reader.name]

    log = read_log(path, ROBOT)
    assert reader.read is not None
    np.testing.assert_array_equal(log.joint_pos, reader.read(path, ROBOT).joint_pos)
    if reader.name in NAMELESS:
        assert log.joint_names == ROBOT.joint_names
        with pytest.raises(ConfigError) as refusal:
            read_log(path)
        assert refusal.value.argument == "robot"
        assert refusal.value.where == path
    else:
        np.testing.assert_array_equal(read_log(path).joint_pos, log.joint_pos)


@pytest.mark.parametrize("name", ["table", "arrays"])
def test_a_format_without_named_channels_needs_a_column_map(name: str, tmp_path: Path):
    path = SAMPLES[name](tmp_path)

    with pytest.raises(LogError, match="columns") as refusal:
        read_log(path)
    assert refusal.value.argument == "columns"
    assert read_log(path, columns=tmp_path / "columns.toml").joint_names == ("pan", "lift")


def test_an_unknown_format_is_refused_with_the_list_of_formats(tmp_path: Path):
    (tmp_path / "log.xyz").write_text("")
    for columns in (None, "so101_sage"):
        with pytest.raises(LogError, match=r"Rhoban/bam \(\.json, \.json\.gz\)") as refusal:
            read_log(tmp_path / "log.xyz", columns=columns)
        assert refusal.value.where == tmp_path / "log.xyz"


def test_a_missing_file_is_refused(tmp_path: Path):
    with pytest.raises(LogError, match=r"none\.npz"):
        read_log(tmp_path / "none.npz")
