"""A folder of logs: every format, what is no log left out with a reason, and an error that suggests a remedy."""

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


def test_tables_that_a_map_fits_are_read_and_others_named(folder: Path):
    found = read_log_folder(folder, None, str(folder.parent / "map.toml"))
    assert list(found.logs) == ["a", "b"] and found.files == [folder / "a.csv", folder / "b.csv"]
    assert len(found.unreadable) == 1 and found.unreadable[0].startswith("notes.csv: no column 't'")


def test_a_folder_without_logs_says_what_would_help(tmp_path: Path):
    for robot in (None, ROBOT):
        with pytest.raises(LogError, match=r"no log in it .*read tables with columns"):
            read_log_folder(tmp_path, robot)
