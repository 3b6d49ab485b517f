"""Tables of any columns, CSV (plain or gzip) or Parquet, read by a column map; numbers are read with pyarrow.

The separator of CSV is a comma, semicolon or tab, as in the first line. Numbers have a decimal
point; with semicolons or tabs, all may have a decimal comma. ``x[2]`` is element 2 of a list column
``x``. Time stamps become time since the first row.
"""

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_bytes, require_file, require_size
from motorprior.exceptions import LogError, listed, quoted
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import COPY_AGAIN, CORRECT, bad_value, missing_column, unreadable

SAVE_AS = "save it as UTF-8 with commas, semicolons or tabs and numbers like -1.5e-3"
_CORRECT_TIME = (
    "use time stamps like 2024-05-01T12:00:00.25 (ISO 8601), all with a time zone or all without"
)
_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]", re.ASCII)
_BAD_CELL = re.compile(r"In CSV column #(\d+): Row #(\d+): .*invalid value '(.*)'", re.DOTALL)
_BAD_ROW = re.compile(r"Row #(\d+): Expected (\d+) columns, got (\d+)")


def table_columns(
    path: Path, names: Sequence[str], time: str | None = None, may_be_cut: bool = False
) -> dict[str, np.ndarray]:
    """Name of a column, or of an element of a list column -> (rows,) float64.

    The column ``time`` may hold time stamps; it is timedelta64[ns] since the first row. If the
    writer of a CSV may have been killed (``may_be_cut``), a last line without line end is dropped.

    Raises:
        LogError: missing or damaged file, missing column, no rows, or a cell that is empty or not a
            number; names file, row and column.
    """
    if path.suffix == ".parquet":
        table = parquet_table(path, names)
    else:
        table = csv_table(path, names, [time] if time else [], may_be_cut)
    import pyarrow.types as kinds

    found: dict[str, np.ndarray] = {}
    for name in names:
        owner, index = (name, None) if name in table.column_names else element_of(name)
        column = table.column(owner).combine_chunks()
        if column.null_count:
            row = int(np.argmin(column.is_valid()))
            raise LogError(f"row {row}, {name[:80]} is empty", where=path, remedy=CORRECT)
        column = column if index is None else _elements(column, name, index, path)
        column = column.dictionary_decode() if kinds.is_dictionary(column.type) else column
        if kinds.is_integer(column.type) or kinds.is_floating(column.type):
            found[name] = np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
        elif name == time:
            found[name] = _since_first(column, name, path)
        else:
            raise LogError(f"{name} is {column.type}, not numbers", where=path, remedy=CORRECT)
    return found


def csv_names(path: Path) -> list[str]:
    """The column names of a CSV file; LogError for a damaged file, or a first line that is empty or not UTF-8."""
    return _head(read_bytes(path, LogError).partition(b"\n")[0], path)[0]


def _head(line: bytes, path: Path) -> tuple[list[str], str]:
    try:
        text = line.decode("utf-8-sig").strip("\r\n")
    except UnicodeDecodeError as error:
        raise LogError(f"not UTF-8 ({error})", where=path, remedy=SAVE_AS) from error
    if not text or "\0" in text or "\r" in text:
        raise LogError(
            "its first line is empty, binary or ends with CR alone", where=path, remedy=SAVE_AS
        )
    delimiter = max(",;\t", key=re.sub(r'"[^"]*"', "", text).count)
    names = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    return [name.strip() for name in names], delimiter


def csv_table(
    path: Path, names: Sequence[str], inferred: Collection[str] = (), may_be_cut: bool = False
) -> Any:
    """Arrow table of the columns of a CSV file; float64, or of the type of its cells for ``inferred`` columns.

    Raises LogError as `csv_names`, for a missing column, a wrong number of cells, or a cell that is
    no number.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    first, _, body = read_bytes(path, LogError).partition(b"\n")
    have, delimiter = _head(first, path)
    wanted = required_columns(have, names, path)
    body = body[: body.rfind(b"\n") + 1] if may_be_cut else body
    if not body.strip():
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    errors = []
    for decimal_point in "." if delimiter == "," else ".,":
        try:
            return pa_csv.read_csv(
                pa.BufferReader(body),
                # one block, so that types are inferred from all rows
                pa_csv.ReadOptions(column_names=have, use_threads=False, block_size=len(body) + 1),
                pa_csv.ParseOptions(delimiter=delimiter),
                pa_csv.ConvertOptions(
                    column_types={name: pa.float64() for name in wanted if name not in inferred},
                    include_columns=wanted,
                    null_values=[""],
                    strings_can_be_null=True,
                    decimal_point=decimal_point,
                ),
            )
        except pa.ArrowException as error:
            errors.append(error)
    raise _csv_error(errors[0], have, path)


def _csv_error(error: Exception, names: Sequence[str], path: Path) -> LogError:
    remedy = f"correct the row; {SAVE_AS}"
    if cell := _BAD_CELL.search(str(error)):
        return bad_value(int(cell[2]) - 1, names[int(cell[1])], cell[3], "a number", path, remedy)
    if count := _BAD_ROW.search(str(error)):
        problem = f"row {int(count[1]) - 1} has {count[3]} cells, expected {count[2]}"
        return LogError(problem, where=path, remedy=remedy)
    return unreadable(path, error)


def parquet_table(path: Path, names: Sequence[str] | None = None) -> Any:
    """Arrow table of the columns of these names, by default of all, of a complete Parquet file with rows."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    require_file(path, LogError)
    try:
        with pq.ParquetFile(path) as file:
            groups = range(file.num_row_groups)
            rows = file.metadata.num_rows
            unpacked = sum(file.metadata.row_group(each).total_byte_size for each in groups)
            # equal numbers are packed in every size that the file states
            require_size(max(unpacked, 8 * rows * file.metadata.num_columns), path, LogError)
            wanted = (
                None if names is None else required_columns(file.schema_arrow.names, names, path)
            )
            table = file.read(columns=wanted)
    except (pa.ArrowException, OSError) as error:
        raise LogError(
            f"not a complete Parquet file ({error})", where=path, remedy=COPY_AGAIN
        ) from error
    if not table.num_rows:
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    return table


def element_of(name: str) -> tuple[str, int | None]:
    """``x[2]`` -> ("x", 2), ``x`` -> ("x", None)."""
    found = _ELEMENT.fullmatch(name)
    return (found[1], int(found[2])) if found else (name, None)


def required_columns(have: Sequence[str], names: Sequence[str], path: Path) -> list[str]:
    """The columns of the file that hold these names, each once; raises LogError if one is missing, or occurs twice."""
    counted = Counter(have)
    found = dict.fromkeys(name if name in counted else element_of(name)[0] for name in names)
    for name in found:
        if counted[name] > 1:
            raise LogError(f"more than one column {quoted(name, 80)}", where=path, remedy=CORRECT)
        if not counted[name]:
            raise missing_column("column", name, have, path)
    return list(found)


def _elements(column: Any, name: str, index: int, path: Path) -> Any:
    import pyarrow.compute as pc

    cells: Any = pc
    if "list" not in str(column.type):
        raise LogError(
            f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT
        )
    lengths = np.asarray(cells.list_value_length(column))
    if (short := np.flatnonzero(lengths <= index)).size:
        problem = f"row {short[0]}, {name}: its list has {lengths[short[0]]} numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return cells.list_element(column, index)


def _since_first(column: Any, name: str, path: Path) -> np.ndarray:
    """(rows,) timedelta64[ns] since the first row, of time stamps, durations or ISO 8601 texts."""
    import pyarrow as pa

    if pa.types.is_duration(column.type) or pa.types.is_timestamp(column.type):
        moments = column.to_numpy(zero_copy_only=False)
        return (moments - moments[0]).astype("timedelta64[ns]")
    texts = column.to_pylist()
    since = []
    for row, text in enumerate(texts):
        try:
            since.append(
                datetime.fromisoformat(text.strip()) - datetime.fromisoformat(texts[0].strip())
            )
        except (ValueError, TypeError, AttributeError) as error:
            raise bad_value(
                row, name, text, "a time stamp like the others", path, _CORRECT_TIME
            ) from error
    return np.array(since, "timedelta64[ns]")


def _unmapped(path: Path) -> str:
    return f"a table of unknown format; its first line is {listed(list(map(ascii, csv_names(path))), 8)[:200]}"


READER = LogReader(
    "table",
    (".csv", ".csv.gz", ".parquet"),
    unmapped=_unmapped,
    columns=lambda path, names, columns: table_columns(path, names, columns.time),
)
