"""Read named columns of CSV (plain or gzip) and Parquet tables as numbers.

``x[2]`` is element 2 of a list column ``x``. Time stamps become time since the first row; names of postures become
indices of `motor_log.POSTURES`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, quoted
from motorprior.files import MAX_FILE, require_file
from motorprior.logs.formats.csv_table import COPY_AGAIN, csv_head, csv_table
from motorprior.logs.log_errors import CORRECT, bad_value, missing_column
from motorprior.logs.motor_log import POSTURES

POSTURE_NAMES = f"{', '.join(POSTURES[:-1])} or {POSTURES[-1]}"
_CORRECT_POSTURE = f"use {POSTURE_NAMES} in each row, or give one of them for all rows as posture in the column map"
_CORRECT_TIME = "use time stamps like 2024-05-01T12:00:00.25 (ISO 8601), all with a time zone or all without"
_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]", re.ASCII)
_STAMP = re.compile(r"\d{4}-\d\d-\d\d([T ]|$)", re.ASCII)


def table_columns(
    path: Path, names: list[str], time: str | None = None, posture: str | None = None
) -> dict[str, np.ndarray]:
    """Name -> (rows,) float64; timedelta64[ns] since the first row for time stamps, int64 for postures.

    Args:
        path: the table.
        names: of columns, or of elements of list columns.
        time: the column that may hold time stamps.
        posture: the column that holds names of `motor_log.POSTURES`.

    Raises:
        LogError: missing or damaged file, missing column, or a cell that is empty or not a number; names file, row and
            column.
    """
    import pyarrow as pa

    require_file(path, LogError)
    try:
        table = _table(path, names, time, posture).combine_chunks()
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error
    found: dict[str, np.ndarray] = {}
    for name in names:
        owner, index = (name, None) if name in table.column_names else element_of(name)
        column = table.column(owner)
        column = column.chunk(0) if column.num_chunks else pa.array([], column.type)
        column = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
        if name == posture:
            found[name] = _posture_codes(column, name, path)
        elif name == time and _may_be_stamps(column.type):
            found[name] = _since_first(column, name, path)
        else:
            found[name] = _numbers(column if index is None else _elements(column, name, index, path), name, path)
    return found


def unreadable(path: Path, error: Exception) -> LogError:
    """A library's error in one line."""
    reason = (str(error) or type(error).__name__).splitlines()[0][:300]
    return LogError(f"cannot be read ({reason})", where=path, remedy=COPY_AGAIN)


def element_of(name: str) -> tuple[str, int | None]:
    """``x[2]`` -> ("x", 2), ``x`` -> ("x", None)."""
    found = _ELEMENT.fullmatch(name)
    return (found[1], int(found[2])) if found else (name, None)


def required_columns(have: list[str], names: list[str], path: Path, posture: str | None = None) -> list[str]:
    """The columns of the file that hold these names, each once.

    Raises:
        LogError: a column is missing, or occurs twice.
    """
    counted = Counter(have)
    found = dict.fromkeys(name if name in counted or name == posture else element_of(name)[0] for name in names)
    for name in found:
        if counted[name] > 1:
            raise LogError(f"more than one column {quoted(name, 80)}", where=path, remedy=CORRECT)
        if not counted[name]:
            remedy = CORRECT
            if name == posture:
                remedy = f"give posture in the column map as {POSTURE_NAMES}, or as the name of a column"
            elif have and have[0].startswith(("#", "%")):
                remedy = "its first line is a comment: remove comment lines, and the sign before the names"
            elif len(have) == 1 and len(have[0].split()) > 1:
                remedy = "its columns are separated by blanks: separate them by commas, semicolons or tabs"
            raise missing_column("column", name, have, path, remedy)
    return list(found)


def _table(path: Path, names: list[str], time: str | None, posture: str | None) -> Any:
    if path.suffix == ".parquet":
        return parquet_table(path, lambda have: required_columns(have, names, path, posture))
    wanted = required_columns(list(csv_head(path).names), names, path, posture)
    texts = [posture] if posture else []
    if time in wanted:
        cells = csv_table(path, [time], texts=[time]).column(time)
        texts += [time] if len(cells) and _STAMP.match(cells[0].as_py().strip()) else []
    return csv_table(path, wanted, texts=texts)


def parquet_table(path: Path, wanted: Callable[[list[str]], list[str]]) -> Any:
    """Arrow table of the columns ``wanted(names of all columns)`` of a Parquet file.

    Raises:
        LogError: not a complete Parquet file, or larger than `files.MAX_FILE` when unpacked.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    require_file(path, LogError)
    try:
        with pq.ParquetFile(path) as file:
            groups = range(file.metadata.num_row_groups)
            if sum(file.metadata.row_group(index).total_byte_size for index in groups) > MAX_FILE:
                raise LogError(f"more than {MAX_FILE} bytes", where=path, remedy="split the recording")
            return file.read(columns=wanted(file.schema_arrow.names))
    except (pa.ArrowException, OSError) as error:
        raise LogError(f"not a complete Parquet file ({error})", where=path, remedy=COPY_AGAIN) from error


def _elements(column: Any, name: str, index: int, path: Path) -> Any:
    """Element ``index`` of each list; empty cells stay empty."""
    import pyarrow.compute as pc

    cells: Any = pc
    if "list" not in str(column.type):
        raise LogError(f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT)
    lengths = np.asarray(cells.fill_null(cells.list_value_length(column), index + 1))
    if (short := np.flatnonzero(lengths <= index)).size:
        problem = f"row {short[0]}, {name}: its list has {lengths[short[0]]} numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return cells.list_element(column, index)


def _numbers(column: Any, name: str, path: Path) -> np.ndarray:
    import pyarrow as pa

    _require_no_empty(column, name, path)
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise LogError(f"{name} is {column.type}, not numbers", where=path, remedy=CORRECT)
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _require_no_empty(column: Any, name: str, path: Path, remedy: str = CORRECT) -> None:
    if column.null_count:
        row = np.flatnonzero(~np.asarray(column.is_valid()))[0]
        raise LogError(f"row {row}, {name[:80]} is empty", where=path, remedy=remedy)


def _posture_codes(column: Any, name: str, path: Path) -> np.ndarray:
    """(rows,) indices of `motor_log.POSTURES`."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    if not pa.types.is_string(column.type) and not pa.types.is_large_string(column.type):
        raise LogError(f"{name} is {column.type}, not names of postures", where=path, remedy=_CORRECT_POSTURE)
    _require_no_empty(column, name, path, _CORRECT_POSTURE)
    words = cells.utf8_trim_whitespace(column)
    codes = cells.index_in(words, value_set=pa.array(POSTURES, words.type))
    if unknown := np.flatnonzero(~np.asarray(codes.is_valid())).tolist():
        raise bad_value(unknown[0], name, column[unknown[0]].as_py(), "a posture", path, _CORRECT_POSTURE)
    return np.asarray(codes.to_numpy(zero_copy_only=False), dtype=np.int64)


def _may_be_stamps(kind: Any) -> bool:
    import pyarrow as pa

    tests = (pa.types.is_timestamp, pa.types.is_duration, pa.types.is_string, pa.types.is_large_string)
    return any(test(kind) for test in tests)


def _since_first(column: Any, name: str, path: Path) -> np.ndarray:
    """(rows,) timedelta64[ns] since the first row, of time stamps, durations or ISO 8601 texts."""
    import pyarrow as pa

    _require_no_empty(column, name, path, _CORRECT_TIME)
    if pa.types.is_duration(column.type):
        stamps = column.cast(pa.duration("ns"))
    elif pa.types.is_timestamp(column.type):
        stamps = column.cast(pa.timestamp("ns", column.type.tz))
    else:
        with_zone = _parsed(column[:1], with_zone=True) is not None
        stamps = _parsed(column, with_zone)
        if stamps is None:
            row = next(row for row in range(len(column)) if _parsed(column[row : row + 1], with_zone) is None)
            expected = f"a time stamp {'with' if with_zone else 'without'} a time zone"
            raise bad_value(row, name, column[row].as_py(), expected, path, _CORRECT_TIME)
    counts = np.asarray(stamps.cast(pa.int64()).to_numpy(zero_copy_only=False))
    return (counts - counts[:1]).astype("timedelta64[ns]")


def _parsed(texts: Any, with_zone: bool) -> Any:
    """Texts as time stamps; None if one is not, or differs in having a time zone."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    try:
        return cells.utf8_trim_whitespace(texts).cast(pa.timestamp("ns", "UTC" if with_zone else None))
    except pa.ArrowInvalid:
        return None
