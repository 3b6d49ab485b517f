"""A folder of logs: every format, what is no log left out with a reason, and an error that says what would help."""

from dataclasses import replace
from pathlib import Path

import pytest
from foreign_files import write_csv, write_lerobot, write_sage

from motorprior.exceptions import LogError
from motorprior.logs.formats.registry import read_log
from motorprior.pipeline.log_import.log_folder import read_log_folder
from motorprior.robots.load import load_robot

MAP = """
motor = "servo"
time = "t"
position_target = "u_{joint}"
joint_pos = "q_{joint}"
[joints.knee]
"""
ROBOT = load_robot("pupper_v2")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two tables that a map fits, and one that it does not."""
    logs = tmp_path / "logs"
    logs.mkdir()
    (tmp_path / "map.toml").write_text(MAP, "utf-8")
    for name in "ab":
        rows = "".join(f"{0.01 * row},{0.1 * row},{0.1 * row}\n" for row in range(5))
        (logs / f"{name}.csv").write_text("t,u_knee,q_knee\n" + rows, "utf-8")
    (logs / "notes.csv").write_text("who,when\nme,today\n", "utf-8")
    (logs / "README.md").write_text("logs", "utf-8")
    return logs


def test_tables_that_a_map_fits_are_read_and_others_named(folder: Path):
    found = read_log_folder(folder, None, str(folder.parent / "map.toml"))
    assert list(found.logs) == ["a", "b"] and found.files == [folder / "a.csv", folder / "b.csv"]
    assert len(found.left_out) == 1 and found.left_out[0].startswith("notes.csv: no column 't'")


def test_a_file_is_a_log(folder: Path):
    found = read_log_folder(folder / "a.csv", None, str(folder.parent / "map.toml"))
    assert list(found.logs) == ["a"] and found.logs["a"].joint_names == ("knee",)


def test_of_a_dataset_count_only_files_that_are_read(tmp_path: Path):
    path = write_lerobot(tmp_path)
    unread = [path / "videos" / "camera" / "chunk-000" / "file-000.mp4", path / "images" / "camera" / "frame.png"]
    for file in unread:
        file.parent.mkdir(parents=True)
        file.touch()
    tables = [path / "data" / "chunk-000" / f"file-{number:03d}.parquet" for number in (0, 1)]
    assert read_log_folder(path, None).files == [path / "meta" / "info.json", *tables]


def test_of_another_format_all_files_of_its_folder_count(tmp_path: Path):
    path = write_sage(tmp_path)
    found = read_log_folder(path, None).files
    assert found == [path / "control.csv", path / "joint_list.txt", path / "state_motor.csv"]


def test_tables_without_a_map_ask_for_one(folder: Path):
    with pytest.raises(LogError, match=r"no log in it can be read; a\.csv: .*columns.*so101_sage"):
        read_log_folder(folder, ROBOT)


def test_a_folder_without_logs_says_where_some_are(tmp_path: Path):
    with pytest.raises(LogError, match="no log of a real robot"):
        read_log_folder(tmp_path, ROBOT)
    for robot in (None, replace(ROBOT, name="other")):
        with pytest.raises(LogError, match="no log in it"):
            read_log_folder(tmp_path, robot)


def test_a_folder_in_a_logs_place_is_told_which_files_to_give(tmp_path: Path):
    folder = tmp_path / "run"
    folder.mkdir()
    with pytest.raises(LogError, match="a folder, and no log by itself -> give a log; it holds none"):
        read_log(folder)
    columns = str(write_csv(folder).parent / "columns.toml")
    for known in (None, columns):
        with pytest.raises(LogError, match="run: a folder") as refusal:
            read_log(folder, columns=known)
        assert refusal.value.remedy == f"give its files: {folder / '*.csv'}"
