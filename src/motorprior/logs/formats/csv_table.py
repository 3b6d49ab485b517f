"""Read CSV files, plain or gzip, with pyarrow.

The separator is a comma, semicolon or tab, as in the first line. Numbers have a decimal point; with semicolons or tabs,
all may have a decimal comma.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.files import read_bytes, require_file
from motorprior.logs.log_errors import bad_value

COPY_AGAIN = "copy or record it again"
SAVE_AS = "save it as UTF-8 with commas, semicolons or tabs and numbers like -1.5e-3"
_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class CsvHead:
    """Column names and separator."""

    names: tuple[str, ...]
    delimiter: str


def csv_head(path: Path) -> CsvHead:
    """Parse the first line.

    Raises:
        LogError: missing, damaged, empty or not UTF-8.
    """
    require_file(path, LogError)
    try:
        with gzip.open(path) if path.suffix == ".gz" else open(path, "rb") as file:
            return _head(file.readline(1_000_000), path)
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(f"truncated or damaged file ({error})", where=path, remedy=COPY_AGAIN) from error


def csv_table(path: Path, wanted: Sequence[str], texts: Collection[str] = (), may_be_cut: bool = False) -> Any:
    """Arrow table of some columns: float64, or strings for ``texts``.

    Args:
        path: ``.csv``, or gzip if the name ends in ``.gz``.
        wanted: column names.
        texts: columns of strings.
        may_be_cut: the writer may have been killed; drop a last line without line end.

    Raises:
        LogError: as `csv_head`; a row with a wrong number of cells, or a cell that is not a number.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    first, _, body = read_bytes(path, error=LogError).partition(b"\n")
    head = _head(first, path)
    if may_be_cut:
        body = body[: body.rfind(b"\n") + 1]
    kinds = {name: pa.string() if name in texts else pa.float64() for name in wanted}
    if not body.strip():
        return pa.table({name: pa.array([], kind) for name, kind in kinds.items()})
    problem = "empty cells"
    for decimal_point in "." if head.delimiter == "," else ".,":
        try:
            found = pa_csv.read_csv(
                pa.BufferReader(body),
                pa_csv.ReadOptions(column_names=list(head.names), use_threads=False),
                pa_csv.ParseOptions(delimiter=head.delimiter),
                pa_csv.ConvertOptions(
                    include_columns=list(wanted), column_types=kinds, null_values=[""], decimal_point=decimal_point
                ),
            )
        except pa.ArrowException as error:
            problem = str(error).splitlines()[0][:200]
            continue
        if not any(column.null_count for column in found.columns):
            return found
    _raise_bad_row(body, head, [name for name in wanted if name not in texts], path)
    raise LogError(f"cannot be read ({problem})", where=path, remedy=SAVE_AS)


def read_number_table(path: Path, columns: Sequence[str], may_be_cut: bool = False) -> np.ndarray:
    """Read a CSV file with exactly these columns as (rows, columns) float64; NaN and infinity are allowed.

    Raises:
        LogError: as `csv_table`; other columns, or no rows.
    """
    names = csv_head(path).names
    if names != tuple(columns):
        different = next((pair for pair in zip(names, columns, strict=False) if pair[0] != pair[1]), None)
        problem = f"{len(names)} columns, expected {len(columns)}"
        problem = f"a column is named {different[0]!r}, expected {different[1]!r}" if different else problem
        raise LogError(problem, where=path, remedy="restore the header line")
    table = csv_table(path, names, may_be_cut=may_be_cut)
    if not table.num_rows:
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    return np.column_stack([column.to_numpy() for column in table.columns])


def _head(line: bytes, path: Path) -> CsvHead:
    try:
        text = line.decode("utf-8-sig").strip("\r\n")
    except UnicodeDecodeError as error:
        raise LogError(f"not UTF-8 ({error})", where=path, remedy=SAVE_AS) from error
    if not text or "\0" in text or "\r" in text:
        raise LogError("its first line is empty, binary or ends with CR alone", where=path, remedy=SAVE_AS)
    delimiter = max(",;\t", key=re.sub(r'"[^"]*"', "", text).count)
    names = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    return CsvHead(tuple(name.strip() for name in names), delimiter)


def _raise_bad_row(body: bytes, head: CsvHead, numbers: Sequence[str], path: Path) -> None:
    """Raise the error of the first row with a wrong number of cells, or with a cell that is not a number."""
    rows = csv.reader(io.StringIO(body.decode("utf-8", errors="replace")), delimiter=head.delimiter)
    for row, cells in enumerate(cells for cells in rows if cells):
        if len(cells) != len(head.names):
            problem = f"row {row} has {len(cells)} cells, expected {len(head.names)}"
            raise LogError(problem, where=path, remedy="correct the row; " + SAVE_AS)
        for name in numbers:
            cell = cells[head.names.index(name)].strip()
            if not _NUMBER.fullmatch(cell if head.delimiter == "," else cell.replace(",", ".")):
                raise bad_value(row, name, cell, "a number", path, "correct the row; " + SAVE_AS)
