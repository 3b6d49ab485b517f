"""How the robot's base was held: one word for all rows, or a column of words; or one error says what is wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from foreign_files import ROWS as FEW
from foreign_files import write_csv, write_lerobot, write_parquet, write_pt
from hypothesis import given
from hypothesis import strategies as st

from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.doctor.gap_segments import begin_at_gaps
from motorprior.logs.formats import csv_stream
from motorprior.logs.formats.parquet_io import read_parquet, write_log
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.resampling import resample

MAP = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joints.a = {}
"""
OF_DATASET = """
motor = "servo"
time = "timestamp"
segment = "episode_index"
position_target = "action[{joint}]"
joint_pos = "observation.state[{joint}]"
joints = {0 = {name = "pan"}, 1 = {name = "lift"}}
"""
ROWS = 3000
HUNG, FALLEN = POSTURES.index("hung"), POSTURES.index("fallen")


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


def test_a_dataset_states_its_posture_either_way(tmp_path: Path):
    words = np.repeat(["fixed", "fallen"], FEW // 2)
    path = write_lerobot(tmp_path, held=words)
    for posture, expected in (("hung", ["hung"] * FEW), ("held", words.tolist())):
        codes = read_log(path, columns=stating(tmp_path, posture, OF_DATASET)).posture
        assert codes is not None and [POSTURES[code] for code in codes] == expected


@given(words=st.lists(st.sampled_from(POSTURES), min_size=2, max_size=40), space=st.sampled_from(["", " ", "\t "]))
def test_words_of_a_column_are_the_postures_of_its_rows(
    tmp_path_factory: pytest.TempPathFactory, words: list[str], space: str
):
    folder, cells = tmp_path_factory.mktemp("tables"), [space + word + space for word in words]
    codes = [POSTURES.index(word) for word in words]
    assert read(folder / "log.csv", cells) == codes
    for column in (pa.array(cells), pa.array(cells, pa.large_string()), pa.array(cells).dictionary_encode()):
        assert read(folder / "log.parquet", column) == codes


def test_a_word_that_no_row_uses_harms_nothing(tmp_path: Path):
    coded = pa.DictionaryArray.from_arrays(pa.array(np.ones(ROWS, np.int32)), pa.array(["in orbit", "hung"]))
    assert read(tmp_path / "log.parquet", coded) == [HUNG] * ROWS


def test_the_name_of_a_posture_is_no_column(tmp_path: Path):
    for name in ("log.csv", "log.parquet"):
        path = written(tmp_path / name, ["fallen"] * FEW, name="hung")
        codes = read_log(path, columns=stating(tmp_path, "hung")).posture
        assert codes is not None and codes.tolist() == [HUNG] * FEW


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(
    ("row", "cell", "said"),
    [
        (0, "lying", "row 0, held is 'lying', no posture"),
        (2500, "Hung", "row 2500, held is 'Hung', no posture"),
        (7, "", "row 7, held is empty"),
        (9, "1", "row 9, held is '1', no posture"),
    ],
)
def test_a_cell_without_a_posture_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, row: int, cell: str, said: str
):
    monkeypatch.setattr(csv_stream, "_BLOCK", 20_000)  # several batches
    words = ["hung"] * ROWS
    words[row] = cell
    with pytest.raises(LogError) as refusal:
        read(tmp_path / name, words)
    assert refusal.value.problem == said and refusal.value.where == tmp_path / name
    assert "standing, hung, fixed or fallen" in str(refusal.value.remedy)


def test_a_missing_cell_of_parquet_is_named(tmp_path: Path):
    words = ["hung"] * 8 + [None] + ["hung"] * 8
    for column in (pa.array(words), pa.array(words).dictionary_encode()):
        with pytest.raises(LogError, match="row 8, held is empty"):
            read(tmp_path / "log.parquet", column)


@pytest.mark.parametrize(("posture", "words"), [("stood", ["hung"]), ("held[0]", ["hung"]), ("held[0]", [["hung"]])])
def test_a_column_that_is_missing_is_told_with_the_postures(tmp_path: Path, posture: str, words: list[Any]):
    tables = [written(tmp_path / "log.parquet", words * FEW)]
    if words == ["hung"]:
        tables.append(written(tmp_path / "log.csv", words * FEW))
    for path in tables:
        with pytest.raises(LogError) as refusal:
            read_log(path, columns=stating(tmp_path, posture))
        assert f"no column '{posture}'; it has 't', 'goal_a', 'held'" in refusal.value.problem
        assert "posture is none of standing, hung, fixed or fallen" in refusal.value.problem
        assert refusal.value.where == path and "standing, hung, fixed or fallen" in str(refusal.value.remedy)


@pytest.mark.parametrize("cell", [1, 1.5, True, ["hung"], b"hung"])
def test_a_column_of_anything_but_texts_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: Any
):
    monkeypatch.setattr(pq.ParquetFile, "iter_batches", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(LogError, match=r"log\.parquet: held is .*, not names of postures"):
        read(tmp_path / "log.parquet", [cell] * FEW)


def test_tensors_have_one_posture(tmp_path: Path):
    path, columns = write_pt(tmp_path), tmp_path / "columns.toml"
    with pytest.raises(
        LogError, match=r"log\.pt: .*posture = 'time': that is no posture, and a file of tensors has no"
    ):
        read_log(path, columns=stating(tmp_path, "time", columns.read_text("utf-8")))


@pytest.mark.parametrize("posture", ["3", "true", '""', '["hung"]'])
def test_a_posture_that_is_no_text_is_refused(tmp_path: Path, posture: str):
    columns = tmp_path / "columns.toml"
    columns.write_text(f"posture = {posture}\n{MAP}", "utf-8")
    with pytest.raises(ArtifactError, match=r"columns\.toml: posture = .* is not a text of 1 to 200 letters"):
        read_log(written(tmp_path / "log.csv", ["hung"] * FEW), columns=columns)


@given(lengths=st.lists(st.integers(5, 40), min_size=1, max_size=5), seed=st.integers(0, 99))
def test_every_row_of_a_grid_has_the_posture_of_the_last_row_before_it(lengths: list[int], seed: int):
    """Gaps between the stretches, a posture that changes anywhere, and the file besides."""
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


def test_a_stated_posture_is_written_with_its_log(tmp_path: Path):
    path = written(tmp_path / "raw.csv", ["hung"] * FEW + ["fallen"] * FEW)
    write_log(tmp_path / "log.parquet", read_log(path, columns=stating(tmp_path, "held")))
    codes = read_parquet(tmp_path / "log.parquet").posture
    assert codes is not None and codes.tolist() == [HUNG] * FEW + [FALLEN] * FEW
