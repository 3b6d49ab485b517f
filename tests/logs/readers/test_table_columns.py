"""Columns of Parquet files: numbers, dictionaries of numbers and elements of lists; all else is refused by name."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from motorprior.logs.table_columns import table_columns

from motorprior.exceptions import LogError


@pytest.fixture
def table(tmp_path: Path) -> Path:
    numbers = pa.array([1.0, 2.0])
    columns = {
        "whole": pa.array([1, 2]), "repeated": numbers.dictionary_encode(), "pair": pa.array([[0.0, 1.0], [0.0, 2.0]]),
        "bytes": pa.array([b"x", b"y"]), "truths": pa.array([True, False]), "texts": pa.array([["a"], ["b"]]),
    }  # fmt: skip
    pq.write_table(pa.table(columns), tmp_path / "x.parquet")
    return tmp_path / "x.parquet"


@pytest.mark.parametrize("name", ["whole", "repeated", "pair[1]"])
def test_numbers_are_read(table: Path, name: str):
    np.testing.assert_array_equal(table_columns(table, [name])[name], [1.0, 2.0])


@pytest.mark.parametrize(("name", "row"), [("ragged[1]", 2), ("ragged[0]", 3), ("pair[2]", 0)])
def test_a_list_that_is_too_short_is_named_by_its_row(tmp_path: Path, name: str, row: int):
    lists = {"ragged": [[1.0, 2.0], [3.0, 4.0], [5.0], []], "pair": 4 * [[0.0, 1.0]]}
    pq.write_table(pa.table(lists), tmp_path / "x.parquet")
    with pytest.raises(
        LogError, match=rf"x\.parquet: row {row}, .*: its list has {len(lists[name[:-3]][row])} numbers"
    ):
        list(table_columns(tmp_path / "x.parquet", [name]))


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("# recorded today\nt,x\n0,1\n", "its first line is a comment"),
        ("t x\n0 1\n", "separated by blanks"),
        ("time,x\n0,1\n", "correct the column map, or the file"),
    ],
)
def test_a_first_line_that_names_no_columns_is_told_what_it_is(tmp_path: Path, text: str, remedy: str):
    (tmp_path / "x.csv").write_text(text, "utf-8")
    with pytest.raises(LogError, match="no column 't'") as refusal:
        list(table_columns(tmp_path / "x.csv", ["t"]))
    assert remedy in str(refusal.value.remedy)
