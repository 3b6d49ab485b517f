"""Columns of tables: numbers are exact; other cells are refused by file, row and column."""

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.readers.table import csv_names, table_columns

ROWS = [[0.1, -2.5e-3], [1e300, 3.0]]


def written(folder: Path, text: str, name: str = "table.csv") -> Path:
    path = folder / name
    data = text.encode()
    path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)

    return path


@pytest.mark.parametrize(("name", "end"), [("table.csv", "\r\n"), ("table.csv.gz", "\n")])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_numbers_of_csv_are_read_exactly(tmp_path: Path, name: str, end: str, delimiter: str):
    lines = [delimiter.join(["\ufeffa", "b"])]
    lines += [delimiter.join(map(repr, row)) for row in ROWS]
    path = written(tmp_path, end.join(lines) + end, name)

    assert csv_names(path) == ["a", "b"]

    columns = table_columns(path, ["a", "b"])

    np.testing.assert_array_equal(np.stack([columns["a"], columns["b"]], axis=1), ROWS)


def test_a_last_line_that_a_crash_cut_is_left_out(tmp_path: Path):
    path = written(tmp_path, "a,b\n1,2\n3,4\n5")
    np.testing.assert_array_equal(table_columns(path, ["b"], may_be_cut=True)["b"], [2, 4])


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("1,2\n3,x\n", "row 1, b .*'x'"),
        ("1,2\n3,\n", "row 1, b "),
        ("1,2\n3,4\n5\n", "row 2 .*1.*2"),
        ("1,2,3\n", "row 0 .*3.*2"),
        ("", "no rows"),
    ],
)
def test_a_bad_row_is_named(tmp_path: Path, rows: str, problem: str):
    with pytest.raises(LogError, match=problem):
        table_columns(written(tmp_path, "a,b\n" + rows), ["a", "b"])


def test_numbers_may_have_a_decimal_comma_between_semicolons(tmp_path: Path):
    columns = table_columns(written(tmp_path, "a;b\n1,5;2\n-1,25e1;3\n"), ["a", "b"])

    assert columns["a"].tolist() == [1.5, -12.5]
    with pytest.raises(LogError, match=r"row 0, a .*'1,5'"):
        table_columns(written(tmp_path, "a;b\n1,5;2\n1.5;3\n"), ["a", "b"])


@pytest.mark.parametrize("name", ["whole", "repeated", "pair[1]"])
def test_numbers_of_parquet_are_read(tmp_path: Path, name: str):
    numbers = pa.array([1.0, 2.0])
    pairs = pa.array([[0.0, 1.0], [0.0, 2.0]])
    table = pa.table(
        {"whole": pa.array([1, 2]), "repeated": numbers.dictionary_encode(), "pair": pairs}
    )
    pq.write_table(table, tmp_path / "x.parquet")

    np.testing.assert_array_equal(table_columns(tmp_path / "x.parquet", [name])[name], [1.0, 2.0])


@pytest.mark.parametrize(("name", "row"), [("ragged[1]", 2), ("ragged[0]", 3), ("pair[2]", 0)])
def test_a_list_that_is_too_short_is_named_by_its_row(tmp_path: Path, name: str, row: int):
    lists = {"ragged": [[1.0, 2.0], [3.0, 4.0], [5.0], []], "pair": 4 * [[0.0, 1.0]]}
    pq.write_table(pa.table(lists), tmp_path / "x.parquet")
    length = len(lists[name[:-3]][row])

    with pytest.raises(LogError, match=rf"x\.parquet: row {row}, .*\b{length}\b"):
        table_columns(tmp_path / "x.parquet", [name])
