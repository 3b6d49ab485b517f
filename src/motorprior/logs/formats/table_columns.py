"""Columns of tables, CSV (plain or gzip) or Parquet: only the requested ones, as numbers.

``x[2]`` is element 2 of a list column ``x``. Time stamps become time since the first row, names of postures become
indices in `motor_log.POSTURES`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown
from motorprior.files import MAX_FILE, require_file
from motorprior.logs.formats.csv_table import COPY_AGAIN, csv_head, csv_table
from motorprior.logs.motor_log import POSTURES

CORRECT = "correct the column map, or the file"
POSTURE_NAMES = f"{', '.join(POSTURES[:-1])} or {POSTURES[-1]}"
CORRECT_POSTURE = f"use {POSTURE_NAMES} in each row, or state one of them for all rows as posture in the column map"
_CORRECT_TIME = "use time stamps like 2024-05-01T12:00:00.25 (ISO 8601), all with a time zone or all without"
_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]", re.ASCII)
_BEGINS_LIKE_A_STAMP = re.compile(r"\d{4}-\d\d-\d\d([T ]|$)", re.ASCII)


def table_columns(
    path: Path,
    names: list[str],
    time: str | None = None,
    lengths: Mapping[str, int] | None = None,
    posture: str | None = None,
) -> dict[str, np.ndarray]:
    """Name -> (rows,) float64; timedelta64[ns] since the first row for time stamps, int64 for postures.

    Args:
        path: the table.
        names: of columns, or of elements of list columns.
        time: the column that may hold time stamps.
        lengths: list column -> length of each of its lists.
        posture: the column that holds names of `motor_log.POSTURES`.

    Raises:
        LogError: missing or damaged file, missing column, or a cell that is empty or of another kind; names file, row
            and column.
    """
    import pyarrow as pa

    require_file(path, LogError)
    try:
        table = _table(path, names, time, posture).combine_chunks()
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error

    def column(name: str) -> Any:
        found = table.column(name)
        found = found.chunk(0) if found.num_chunks else pa.array([], found.type)
        return found.dictionary_decode() if pa.types.is_dictionary(found.type) else found

    for name, length in (lengths or {}).items():
        _require_length(column(name), name, length, path)
    found: dict[str, np.ndarray] = {}
    for name in names:
        owner = name if name in table.column_names else _owner(name, ())
        if name == posture:
            found[name] = _posture_codes(column(owner), name, path)
        elif name == time and _may_be_stamps(column(owner).type):
            found[name] = _since_first(column(owner), name, path)
        else:
            found[name] = _numbers(column(owner), name, owner, path)
    return found


def unreadable(path: Path, error: Exception) -> LogError:
    """The error of a library as one line."""
    said = (str(error) or type(error).__name__).splitlines()[0][:300]
    return LogError(f"cannot be read ({said})", where=path, remedy=COPY_AGAIN)


def element_of(name: str) -> tuple[str, int] | None:
    """``x[2]`` -> ("x", 2); None for a plain name."""
    found = _ELEMENT.fullmatch(name)
    return (found[1], int(found[2])) if found else None


def present(have: list[str], names: list[str], path: Path, posture: str | None = None) -> list[str]:
    """Columns of the file that hold these names, each once."""
    counted = Counter(have)
    found = dict.fromkeys(name if name == posture else _owner(name, counted) for name in names)
    for name in found:
        if counted[name] != 1:
            problem = "more than one column" if counted[name] else "no column"
            problem = f"posture is not {POSTURE_NAMES}, and {problem}" if name == posture else problem
            columns = ", ".join(map(ascii, have[:8])) + (", …" if len(have) > 8 else "")
            remedy = CORRECT_POSTURE if name == posture else _header_remedy(have) or CORRECT
            raise LogError(f"{problem} {name[:80]!r}; it has {columns[:300]}", where=path, remedy=remedy)
    return list(found)


def _header_remedy(names: list[str]) -> str:
    """Remedy for a first line that names no columns; empty otherwise."""
    if names and names[0].startswith(("#", "%")):
        return "its first line is a comment: remove comment lines, and the sign before the names"
    if len(names) == 1 and len(names[0].split()) > 1:
        return "its columns are separated by blanks: separate them by commas, semicolons or tabs"
    return ""


def _owner(name: str, have: Any) -> str:
    """The column with this name, or the list column of which it is an element."""
    element = element_of(name)
    return element[0] if element and name not in have else name


def _table(path: Path, names: list[str], time: str | None, posture: str | None) -> Any:
    if path.suffix == ".parquet":
        return parquet_table(path, lambda have: present(have, names, path, posture))
    wanted = present(list(csv_head(path).names), names, path, posture)
    texts = [posture] if posture else []
    if time in wanted:
        cells = csv_table(path, [time], texts=[time]).column(time)
        texts += [time] if len(cells) and _BEGINS_LIKE_A_STAMP.match(cells[0].as_py().strip()) else []
    return csv_table(path, wanted, texts=texts)


def parquet_table(path: Path, wanted: Any) -> Any:
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


def _numbers(column: Any, name: str, owner: str, path: Path) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    if owner != name:
        index = int(name[name.rindex("[") + 1 : -1])
        _require_length(column, name, index + 1, path, at_least=True)
        column = cells.list_element(column, index)
    _require_no_empty(column, name, path)
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise LogError(f"{name} is {column.type}, not numbers", where=path, remedy=CORRECT)
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _require_no_empty(column: Any, name: str, path: Path, remedy: str = CORRECT) -> None:
    if column.null_count:
        row = np.flatnonzero(~np.asarray(column.is_valid()))[0]
        raise LogError(f"row {row}, {name[:80]} is empty", where=path, remedy=remedy)


def _require_length(column: Any, name: str, length: int, path: Path, at_least: bool = False) -> None:
    import pyarrow.compute as pc

    cells: Any = pc
    if "list" not in str(column.type):
        raise LogError(f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT)
    lengths = np.asarray(cells.fill_null(cells.list_value_length(column), length))  # empty cells are an error later
    if bad := np.flatnonzero(lengths < length if at_least else lengths != length).tolist():
        problem = f"row {bad[0]}, {name}: its list has {lengths[bad[0]]} numbers, expected {length}"
        raise LogError(problem, where=path, remedy=CORRECT)


def _posture_codes(column: Any, name: str, path: Path) -> np.ndarray:
    """(rows,) indices in `motor_log.POSTURES`."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    if not pa.types.is_string(column.type) and not pa.types.is_large_string(column.type):
        raise LogError(f"{name} is {column.type}, not names of postures", where=path, remedy=CORRECT_POSTURE)
    _require_no_empty(column, name, path, CORRECT_POSTURE)
    words = cells.utf8_trim_whitespace(column)
    codes = cells.index_in(words, value_set=pa.array(POSTURES, words.type))
    if unknown := np.flatnonzero(~np.asarray(codes.is_valid())).tolist():
        problem = f"row {unknown[0]}, {name[:80]} is {shown(column[unknown[0]].as_py())}, not a posture"
        raise LogError(problem, where=path, remedy=CORRECT_POSTURE)
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
            problem = f"row {row}, {name} is {shown(column[row].as_py())}"
            if _parsed(column[row : row + 1], not with_zone) is not None:
                problem += f", {'without' if with_zone else 'with'} a time zone, unlike the first row"
            raise LogError(problem, where=path, remedy=_CORRECT_TIME)
    counts = np.asarray(stamps.cast(pa.int64()).to_numpy(zero_copy_only=False))
    return (counts - counts[:1]).astype("timedelta64[ns]")


def _parsed(texts: Any, with_zone: bool) -> Any:
    """Texts as time stamps; None if one is not, or has another kind of time zone."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    try:
        return cells.utf8_trim_whitespace(texts).cast(pa.timestamp("ns", "UTC" if with_zone else None))
    except pa.ArrowInvalid:
        return None
