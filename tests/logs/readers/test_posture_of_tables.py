"""Postures of the base: one for all rows, or a column of words."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from third_party_files import ROWS as FEW
from third_party_files import write_csv, write_parquet, write_pt

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.operations import begin_at_gaps, resample
from motorprior.logs.read_log import read_log

MAP = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joints.a = {}
"""
ROWS = 3000


def stating(folder: Path, posture: str, text: str = MAP) -> Path:
    """A map of this text that states a posture."""
    path = folder / "columns.toml"
    path.write_text(f'posture = "{posture}"\n{text}', "utf-8")
    return path


def written(path: Path, words: Any, name: str = "held") -> Path:
    """A table with a column of words, as texts of CSV or as they are given."""
    time, angle = 0.01 * np.arange(len(words)), np.sin(0.1 * np.arange(len(words)))
    if path.suffix == ".parquet":
        pq.write_table(pa.table({"t": time, "goal_a": angle, name: words, "pos_a": angle}), path)
    else:
        rows = [f"{t!r},{a!r},{word},{a!r}" for t, a, word in zip(time.tolist(), angle.tolist(), words, strict=True)]
        path.write_text("\n".join([f"t,goal_a,{name},pos_a", *rows]) + "\n", "utf-8")
    return path


def read(path: Path, words: Any) -> list[int]:
    log = read_log(written(path, words), columns=stating(path.parent, "held"))
    assert log.posture is not None
    return log.posture.tolist()


@pytest.mark.parametrize("write", [write_csv, write_parquet, write_pt])
@pytest.mark.parametrize("posture", POSTURES)
def test_a_posture_holds_for_all_rows(tmp_path: Path, write: Callable[[Path], Path], posture: str):
    path, columns = write(tmp_path), tmp_path / "columns.toml"
    assert read_log(path, columns=columns).posture is None
    log = read_log(path, columns=stating(tmp_path, posture, columns.read_text("utf-8")))
    assert log.posture is not None and log.posture.tolist() == [POSTURES.index(posture)] * FEW


@settings(deadline=None)
@given(words=st.lists(st.sampled_from(POSTURES), min_size=2, max_size=40), space=st.sampled_from(["", " ", "\t "]))
def test_words_of_a_column_are_the_postures_of_its_rows(
    tmp_path_factory: pytest.TempPathFactory, words: list[str], space: str
):
    folder, cells = tmp_path_factory.mktemp("tables"), [space + word + space for word in words]
    codes = [POSTURES.index(word) for word in words]
    assert read(folder / "log.csv", cells) == codes
    for column in (pa.array(cells), pa.array(cells, pa.large_string()), pa.array(cells).dictionary_encode()):
        assert read(folder / "log.parquet", column) == codes


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(
    ("row", "cell", "said"),
    [
        (0, "lying", "row 0, held is 'lying', not a posture"),
        (2500, "Suspended", "row 2500, held is 'Suspended', not a posture"),
    ],
)
def test_a_cell_without_a_posture_is_named(tmp_path: Path, name: str, row: int, cell: str, said: str):
    words = ["suspended"] * ROWS
    words[row] = cell
    with pytest.raises(LogError) as refusal:
        read(tmp_path / name, words)
    assert refusal.value.problem == said and refusal.value.where == tmp_path / name
    assert "standing, suspended, fixed or fallen" in str(refusal.value.remedy)


@given(lengths=st.lists(st.integers(5, 40), min_size=1, max_size=5), seed=st.integers(0, 99))
def test_every_row_of_a_grid_has_the_posture_of_the_last_row_before_it(lengths: list[int], seed: int):
    rng, count = np.random.default_rng(seed), sum(lengths)
    time = np.cumsum(rng.uniform(0.009, 0.011, count)) + np.repeat(np.arange(len(lengths)), lengths)
    codes = rng.integers(len(POSTURES), size=count)
    log = MotorLog(
        time=time, position_target=time[:, None], joint_pos=time[:, None], posture=codes, joint_names=("a",), robot="r",
        motor="m", source="made",
    )  # fmt: skip
    grid = resample(begin_at_gaps(log)[0], 0.004)
    before = np.searchsorted(time, grid.time + 1e-8, side="right") - 1
    assert grid.posture is not None and grid.posture.tolist() == codes[before].tolist()
