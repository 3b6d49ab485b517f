"""Tables of text are read however they are written, as long as there is one way to read them; a bad row is named."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.formats import csv_stream, number_table
from motorprior.logs.formats.number_table import read_number_table
from motorprior.logs.formats.table_columns import table_columns

NAMES = ["t", "q_0", "q_1"]
VALUES = np.array([[0.0, 1.5, -2.0], [0.25, 1e-3, 4.0], [0.5, -0.125, 6.0]])
PLAIN = "\n".join([",".join(NAMES), *(",".join(map(str, row)) for row in VALUES.tolist())]) + "\n"


def both(path: Path) -> list[np.ndarray]:
    """The table, by either reader."""
    batches = [np.stack([batch[name] for name in NAMES], axis=1) for batch in table_columns(path, NAMES)]
    return [read_number_table(path, NAMES), np.concatenate(batches)]


WRITTEN = {
    "commas": PLAIN,
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "semicolons and decimal commas": PLAIN.replace(",", ";").replace(".", ","),
    "tabs and decimal commas": PLAIN.replace(",", "\t").replace(".", ","),
    "byte order mark": "\ufeff" + PLAIN,
    "lines of Windows": PLAIN.replace("\n", "\r\n"),
    "no end of the last line": PLAIN.rstrip("\n"),
    "empty lines": PLAIN.replace("\n", "\n\n"),
    "quotes": PLAIN.replace("1.5", '"1.5"'),
    "spaces": PLAIN.replace(",", ", "),
    "spaces before quotes": PLAIN.replace("t,q_0,q_1", '"t", "q_0", "q_1"'),
}


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_there_is_one_way_to_read_it(tmp_path: Path, name: str, ending: str):
    data = WRITTEN[name].encode()
    (tmp_path / f"x{ending}").write_bytes(gzip.compress(data) if ending == ".csv.gz" else data)
    for table in both(tmp_path / f"x{ending}"):
        np.testing.assert_array_equal(table, VALUES)


@pytest.mark.parametrize("block", [10, 40, 1000])
def test_blocks_make_no_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int):
    monkeypatch.setattr(csv_stream, "_BLOCK", block)
    values = np.round(np.random.default_rng(0).normal(size=(500, 3)), 6)
    lines = [";".join(NAMES), *(";".join(map(str, row)).replace(".", ",") for row in values.tolist())]
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    for table in both(tmp_path / "x.csv"):
        np.testing.assert_array_equal(table, values)
    lines[401] = lines[401].replace(",", ".")
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match=r"x\.csv: row 400, t is .*, not a number"):
        both(tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("1.5", "1_5", r"row 0, q_0 is '1_5', not a number"),
        ("0.001", "٣", r"row 1, q_0 is '٣', not a number"),
        ("0.001", "\xa00.001", r"row 1, q_0 is '\\xa00.001', not a number"),
        ("4.0", "0x1p3", r"row 1, q_1 is '0x1p3', not a number"),
        ("4.0", "", r"row 1, q_1 is '', not a number"),
        ("4.0", "NULL", r"row 1, q_1 is 'NULL', not a number"),
        ("4.0", "1 000", r"row 1, q_1 is '1 000', not a number"),
        ("-0.125", "-0,125", r"row 2 has 4 cells, expected 3"),
        (",4.0", "", r"row 1 has 2 cells, expected 3"),
    ],
)
def test_a_cell_that_can_be_read_in_no_way_or_two_is_named(tmp_path: Path, old: str, new: str, problem: str):
    (tmp_path / "x.csv").write_text(PLAIN.replace(old, new), encoding="utf-8")
    for read in (lambda: read_number_table(tmp_path / "x.csv", NAMES), lambda: both(tmp_path / "x.csv")):
        with pytest.raises(LogError, match=rf"x\.csv: {problem} -> .*UTF-8, cells between commas, semicolons or tabs"):
            read()


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("0.001", '"0.001', "a quote is opened in row 1 and not closed"),
        ("0.001", 200_000 * "1" + "x", "row 1 cannot be read .*131072"),
        ("0.001", "0.0\r01", "row 1 has a line end that is CR alone"),
    ],
)
def test_a_row_that_is_no_row_is_named(tmp_path: Path, old: str, new: str, problem: str):
    lines = PLAIN.replace(old, new) + 20_000 * "1.0,2.0,3.0\n"
    (tmp_path / "x.csv").write_bytes(lines.replace("\n", "\r\n").encode())
    for read in (lambda: read_number_table(tmp_path / "x.csv", NAMES), lambda: both(tmp_path / "x.csv")):
        with pytest.raises(LogError, match=rf"x\.csv: {problem}"):
            read()


def test_points_and_commas_in_one_table_are_refused(tmp_path: Path):
    (tmp_path / "x.csv").write_text(PLAIN.replace(",", ";").replace("6.0", "6,0"))
    with pytest.raises(LogError, match="row 2, q_1 is '6,0', not a number"):
        both(tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (PLAIN.encode("utf-16"), "not UTF-8"),
        (PLAIN.replace("t", "µ").encode("latin-1"), "not UTF-8"),
        (PLAIN.replace("\n", "\r").encode(), "it has a line end that is CR alone: save with LF or CRLF"),
        (200_000 * PLAIN.replace("\n", "\r").encode(), "it has a line end that is CR alone: save with LF or CRLF"),
        (b"", "the file is empty"),
    ],
)
def test_another_kind_of_text_is_refused_by_its_name(tmp_path: Path, data: bytes, problem: str):
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(LogError, match=rf"x\.csv: {problem}"):
        both(tmp_path / "x.csv")


def test_what_stands_between_cells_is_seen_outside_of_quotes(tmp_path: Path):
    (tmp_path / "x.csv").write_text('"t [s;;]",q\n1.5,2.5\n')
    (batch,) = table_columns(tmp_path / "x.csv", ["t [s;;]"])
    np.testing.assert_array_equal(batch["t [s;;]"], [1.5])


def test_rows_are_not_swallowed_by_a_quote_in_a_column_that_nobody_wants(tmp_path: Path):
    rows = "t,note\n" + 3 * "0,x\n" + '1,"open\n' + 3 * "2,x\n"
    (tmp_path / "x.csv").write_text(rows)
    with pytest.raises(LogError, match="a quote is opened in row 3 and not closed"):
        list(table_columns(tmp_path / "x.csv", ["t"]))
    (tmp_path / "x.csv").write_text(rows.replace('"open', '5" long'))
    assert sum(len(batch["t"]) for batch in table_columns(tmp_path / "x.csv", ["t"])) == 7


def test_more_numbers_than_a_log_may_have_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "x.csv").write_text(PLAIN)
    monkeypatch.setattr(number_table, "MAX_NUMBERS", 8)
    with pytest.raises(LogError, match=r"x\.csv: more than 2 rows of 3 numbers -> split the recording"):
        read_number_table(tmp_path / "x.csv", NAMES)
