"""Postures of the base: one for all rows, or a column of words."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from third_party_files import ROWS, write_csv, write_parquet, write_pt

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import POSTURES
from motorprior.logs.read_log import read_log

MAP = """
motor = "servo"
rate = 100
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joints.a = {}
"""


def stating(folder: Path, posture: str, text: str = MAP) -> Path:
    """A map of this text that states a posture."""
    path = folder / "columns.toml"
    path.write_text(f'posture = "{posture}"\n{text}', "utf-8")
    return path


def read(path: Path, words: Any) -> list[int]:
    """Postures of a table with a column of words, as texts of CSV or as they are given."""
    if path.suffix == ".parquet":
        angle = np.sin(np.arange(len(words)))
        pq.write_table(pa.table({"goal_a": angle, "held": words, "pos_a": angle}), path)
    else:
        path.write_text("goal_a,held,pos_a\n" + "".join(f"0.1,{word},0.2\n" for word in words), "utf-8")
    log = read_log(path, columns=stating(path.parent, "held"))
    assert log.posture is not None
    return log.posture.tolist()


@pytest.mark.parametrize("write", [write_csv, write_parquet, write_pt])
@pytest.mark.parametrize("posture", POSTURES)
def test_a_posture_holds_for_all_rows(tmp_path: Path, write: Callable[[Path], Path], posture: str):
    path, columns = write(tmp_path), tmp_path / "columns.toml"
    assert read_log(path, columns=columns).posture is None
    log = read_log(path, columns=stating(tmp_path, posture, columns.read_text("utf-8")))
    assert log.posture is not None and log.posture.tolist() == [POSTURES.index(posture)] * ROWS


def test_words_of_a_column_are_the_postures_of_its_rows(tmp_path: Path):
    cells, codes = [f"\t{word} " for word in POSTURES[::-1]], [3, 2, 1, 0]
    assert read(tmp_path / "log.csv", cells) == codes
    for column in (pa.array(cells), pa.array(cells, pa.large_string()), pa.array(cells).dictionary_encode()):
        assert read(tmp_path / "log.parquet", column) == codes


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(("row", "cell"), [(0, "lying"), (2500, "Suspended")])
def test_a_cell_without_a_posture_is_named(tmp_path: Path, name: str, row: int, cell: str):
    words = ["suspended"] * 3000
    words[row] = cell
    with pytest.raises(LogError, match=f"row {row}, held is '{cell}', not a posture") as refusal:
        read(tmp_path / name, words)
    assert refusal.value.where == tmp_path / name
    assert "standing, suspended, fixed or fallen" in str(refusal.value.remedy)
