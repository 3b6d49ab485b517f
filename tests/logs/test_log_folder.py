"""A folder of logs is read in every format; files that are no logs are named with the reason."""

from pathlib import Path

import numpy as np
import pytest
from motor_logs import TABLE_MAP, log_of, write_table

from motorprior.exceptions import LogError
from motorprior.logs.read_log import read_log_folder
from motorprior.robots.load import load_robot

ROBOT = load_robot("pupper_v2")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two tables that a map fits, and one that it does not."""
    logs = tmp_path / "logs"
    logs.mkdir()
    (tmp_path / "map.toml").write_text(f"{TABLE_MAP}[joints.a]\n", "utf-8")

    for name in "ab":
        write_table(log_of(0.01 * np.arange(5), 0.1 * np.arange(5)), logs / f"{name}.csv")

    (logs / "notes.csv").write_text("who,when\nme,today\n", "utf-8")
    (logs / "README.md").write_text("logs", "utf-8")

    return logs


def test_tables_that_fit_the_map_are_read_and_the_unreadable_ones_are_named(folder: Path):
    logs_of_folder = read_log_folder(folder, None, str(folder.parent / "map.toml"))

    assert list(logs_of_folder.logs) == ["a", "b"]
    assert logs_of_folder.files == [folder / "a.csv", folder / "b.csv"]
    assert len(logs_of_folder.unreadable) == 1
    assert logs_of_folder.unreadable[0].startswith("notes.csv: ")
    assert "'t'" in logs_of_folder.unreadable[0], "the column that it lacks"


def test_a_folder_without_logs_is_refused_with_the_remedy_to_name_columns(tmp_path: Path):
    for robot in (None, ROBOT):
        with pytest.raises(LogError) as refusal:
            read_log_folder(tmp_path, robot)
        assert refusal.value.where == tmp_path
        assert "columns" in str(refusal.value)
