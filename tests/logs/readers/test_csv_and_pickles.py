"""Third-party CSV tables and pickles: numbers are exact, bad rows are named, and no code runs."""

import gzip
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from motorprior.logs.csv_table import csv_head, csv_table, read_number_table

from motorprior.exceptions import LogError
from motorprior.files import load_pickle, numpy_names

ROWS = [[0.1, -2.5e-3], [1e300, 3.0]]


def written(folder: Path, text: str, name: str = "table.csv") -> Path:
    path, data = folder / name, text.encode()
    path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    return path


@pytest.mark.parametrize("name", ["table.csv", "table.csv.gz"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(("delimiter", "point"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
def test_numbers_come_through(tmp_path: Path, name: str, end: str, delimiter: str, point: str):
    lines = [delimiter.join(["\ufeffa", "b"])]
    lines += [delimiter.join(repr(value).replace(".", point) for value in row) for row in ROWS]
    path = written(tmp_path, end.join(lines) + end, name)
    assert csv_head(path).names == ("a", "b")
    np.testing.assert_array_equal(read_number_table(path, ["a", "b"]), ROWS)


def test_a_line_that_was_cut_by_a_crash_does_not_count(tmp_path: Path):
    path = written(tmp_path, "a,b\n1,2\n3,4\n5")
    np.testing.assert_array_equal(read_number_table(path, ["a", "b"], may_be_cut=True), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("1,2\n3,x\n", "row 1, b is 'x'"),
        ("1,2\n3,\n", "row 1, b is ''"),
        ("1,2\n3,1_0\n", "row 1, b is '1_0'"),
        ("1,2\n3,4\n5\n", "row 2 has 1 cells, expected 2"),
        ("1,2,3\n", "row 0 has 3 cells, expected 2"),
    ],
)
def test_a_bad_row_is_named(tmp_path: Path, rows: str, problem: str):
    with pytest.raises(LogError, match=problem):
        csv_table(written(tmp_path, "a,b\n" + rows), ["a", "b"])


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_containers_and_arrays_come_through(protocol: int):
    value = {"t": [0.1, 1e-300, True, None, "µ", b"\xff"], "x": np.arange(6.0).reshape(2, 3), "y": np.float32(0.5)}
    loaded = load_pickle(pickle.dumps(value, protocol), numpy_names())
    assert loaded["t"] == value["t"] and loaded["y"] == 0.5
    np.testing.assert_array_equal(loaded["x"], value["x"])


@pytest.mark.parametrize("function", [os.system, eval, os.unlink, np.load, getattr])
def test_a_pickle_calls_nothing_else(tmp_path: Path, function):
    class Call:
        def __reduce__(self):
            return function, (str(victim),)

    victim = tmp_path / "victim"
    victim.touch()
    with pytest.raises(LogError, match=rf"{function.__name__}, which is not allowed"):
        load_pickle(pickle.dumps({"t": Call()}), numpy_names())
    assert victim.exists()


def test_a_truncated_pickle_is_an_error():
    with pytest.raises(LogError, match="not a complete pickle"):
        load_pickle(pickle.dumps([1.0, 2.0])[:-3], numpy_names())


def test_raw_bytes_never_become_addresses_of_objects():
    class Forged:
        def __reduce__(self):
            dtype = np.dtype("O8")
            return np.zeros(0).__reduce__()[0], (np.ndarray, (0,), b"b"), (1, (1,), dtype, False, 8 * b"A")

    with pytest.raises(LogError, match="'O8', not plain numbers"):
        load_pickle(pickle.dumps({"t": Forged()}), numpy_names())
