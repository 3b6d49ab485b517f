"""Tables of any columns, CSV (plain or gzip) or Parquet, read by a column map.

The separator of CSV is a comma, semicolon or tab, as in the first line. Numbers have a decimal
point; with semicolons or tabs, all may have a decimal comma. ``x[2]`` is element 2 of a list column
``x``. Time stamps become time since the first row. Numbers are read with pyarrow.
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
from motorprior.logs.column_map import ColumnMap
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
    """Columns, or elements of list columns, (rows,) float64 by name.

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
    return {name: _numbers(table, name, name == time, path) for name in names}


def _numbers(table: Any, name: str, is_time: bool, path: Path) -> np.ndarray:
    """(rows,) of one column, or one element of a list column, of an Arrow table."""
    import pyarrow.types as arrow_types

    index = None
    column_name = name
    if name not in table.column_names:
        column_name, index = element_of(name)
    column = table.column(column_name).combine_chunks()

    if column.null_count:
        row = int(np.argmin(column.is_valid()))
        raise LogError(f"row {row}, {name[:80]} is empty", where=path, remedy=CORRECT)
    if index is not None:
        column = _elements(column, name, index, path)
    if arrow_types.is_dictionary(column.type):
        column = column.dictionary_decode()

    if arrow_types.is_integer(column.type) or arrow_types.is_floating(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    if is_time:
        return _since_first(column, name, path)
    raise LogError(f"{name} is {column.type}, not numbers", where=path, remedy=CORRECT)


def csv_names(path: Path) -> list[str]:
    """The column names of a CSV file.

    Raises:
        LogError: a damaged file, or a first line that is empty or not UTF-8.
    """
    first_line = read_bytes(path, LogError).partition(b"\n")[0]
    return _names_and_delimiter(first_line, path)[0]


def _names_and_delimiter(line: bytes, path: Path) -> tuple[list[str], str]:
    try:
        text = line.decode("utf-8-sig").strip("\r\n")
    except UnicodeDecodeError as error:
        raise LogError(f"not UTF-8 ({error})", where=path, remedy=SAVE_AS) from error
    if not text or "\0" in text or "\r" in text:
        raise LogError(
            "its first line is empty, binary or ends with CR alone", where=path, remedy=SAVE_AS
        )

    without_quotes = re.sub(r'"[^"]*"', "", text)
    delimiter = max(",;\t", key=without_quotes.count)
    names = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    return [name.strip() for name in names], delimiter


def csv_table(
    path: Path, names: Sequence[str], inferred: Collection[str] = (), may_be_cut: bool = False
) -> Any:
    """Arrow table of the columns of a CSV file.

    Columns are float64; ``inferred`` columns have the type of their cells.

    Raises:
        LogError: as `csv_names`; a missing column, a wrong number of cells, or a cell that is not a
            number.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    first_line, _, rows = read_bytes(path, LogError).partition(b"\n")
    names_of_file, delimiter = _names_and_delimiter(first_line, path)
    columns = required_columns(names_of_file, names, path)
    if may_be_cut:
        rows = rows[: rows.rfind(b"\n") + 1]
    if not rows.strip():
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)

    # one block, so that types are inferred from all rows
    reading = pa_csv.ReadOptions(
        column_names=names_of_file, use_threads=False, block_size=len(rows) + 1
    )
    errors = []
    for decimal_point in "." if delimiter == "," else ".,":
        converting = pa_csv.ConvertOptions(
            column_types={name: pa.float64() for name in columns if name not in inferred},
            include_columns=columns,
            null_values=[""],
            strings_can_be_null=True,
            decimal_point=decimal_point,
        )
        try:
            return pa_csv.read_csv(
                pa.BufferReader(rows),
                reading,
                pa_csv.ParseOptions(delimiter=delimiter),
                converting,
            )
        except pa.ArrowException as error:
            errors.append(error)
    raise _csv_error(errors[0], names_of_file, path)


def _csv_error(error: Exception, names: Sequence[str], path: Path) -> LogError:
    remedy = f"correct the row; {SAVE_AS}"
    if cell := _BAD_CELL.search(str(error)):
        row = int(cell[2]) - 1
        return bad_value(row, names[int(cell[1])], cell[3], "a number", path, remedy)
    if count := _BAD_ROW.search(str(error)):
        problem = f"row {int(count[1]) - 1} has {count[3]} cells, expected {count[2]}"
        return LogError(problem, where=path, remedy=remedy)
    return unreadable(path, error)


def parquet_table(path: Path, names: Sequence[str] | None = None) -> Any:
    """Arrow table of the columns of these names, by default of all.

    Raises:
        LogError: not a complete Parquet file with rows, or a missing column.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    require_file(path, LogError)
    try:
        with pq.ParquetFile(path) as file:
            _require_unpacked_size(file.metadata, path)
            columns = None
            if names is not None:
                columns = required_columns(file.schema_arrow.names, names, path)
            table = file.read(columns=columns)
    except (pa.ArrowException, OSError) as error:
        problem = f"not a complete Parquet file ({error})"
        raise LogError(problem, where=path, remedy=COPY_AGAIN) from error
    if not table.num_rows:
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    return table


def _require_unpacked_size(metadata: Any, path: Path) -> None:
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    stated_size = sum(group.total_byte_size for group in groups)
    # equal numbers are packed in every size that the file states
    unpacked_size = 8 * metadata.num_rows * metadata.num_columns
    require_size(max(stated_size, unpacked_size), path, LogError)


def element_of(name: str) -> tuple[str, int | None]:
    """``x[2]`` -> ("x", 2), ``x`` -> ("x", None)."""
    element = _ELEMENT.fullmatch(name)
    return (element[1], int(element[2])) if element else (name, None)


def required_columns(names_of_file: Sequence[str], names: Sequence[str], path: Path) -> list[str]:
    """The columns of the file that hold these names, each once.

    Raises:
        LogError: a column is missing, or occurs twice.
    """
    count = Counter(names_of_file)
    columns = dict.fromkeys(name if name in count else element_of(name)[0] for name in names)
    for name in columns:
        if count[name] > 1:
            raise LogError(f"more than one column {quoted(name, 80)}", where=path, remedy=CORRECT)
        if not count[name]:
            raise missing_column("column", name, names_of_file, path)
    return list(columns)


def _elements(column: Any, name: str, index: int, path: Path) -> Any:
    """Element ``index`` of each list of a column."""
    import pyarrow.compute

    compute: Any = pyarrow.compute
    if "list" not in str(column.type):
        raise LogError(
            f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT
        )
    lengths = np.asarray(compute.list_value_length(column))
    short_rows = np.flatnonzero(lengths <= index)
    if short_rows.size:
        row = short_rows[0]
        problem = f"row {row}, {name}: its list has {lengths[row]} numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return compute.list_element(column, index)


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
            first = datetime.fromisoformat(texts[0].strip())
            since.append(datetime.fromisoformat(text.strip()) - first)
        except (ValueError, TypeError, AttributeError) as error:
            expected = "a time stamp like the others"
            raise bad_value(row, name, text, expected, path, _CORRECT_TIME) from error
    return np.array(since, "timedelta64[ns]")


def _unmapped(path: Path) -> str:
    names = listed([ascii(name) for name in csv_names(path)], 8)
    return f"a table of unknown format; its first line is {names[:200]}"


def _names(path: Path) -> list[str]:
    if path.suffix != ".parquet":
        return csv_names(path)
    import pyarrow.parquet as pq

    return list(pq.read_schema(path).names)


def _columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    return table_columns(path, names, columns.time)


READER = LogReader(
    "table", (".csv", ".csv.gz", ".parquet"), columns=_columns, names=_names, unmapped=_unmapped
)
