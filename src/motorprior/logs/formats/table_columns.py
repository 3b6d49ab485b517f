"""Columns of tables, CSV (plain or gzip) or Parquet, batch by batch: only those asked for, as numbers.

``x[2]`` is element 2 of a column ``x`` of lists. A column of time stamps comes as time since the first row, one of
postures' names as their places in `motor_log.POSTURES`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.csv_stream import csv_batches, csv_head
from motorprior.logs.formats.parquet_pages import COPY_AGAIN, require_parquet, require_small_pages
from motorprior.logs.formats.posture_column import CORRECT as CORRECT_POSTURE
from motorprior.logs.formats.posture_column import NAMES, posture_codes
from motorprior.logs.formats.time_stamps import TimeStamps, are_stamps, are_texts, begins_like_a_stamp
from motorprior.outside_files import require_file

CORRECT = "correct the column map, or the file"
_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]", re.ASCII)


def table_columns(
    path: Path,
    names: list[str],
    time: str | None = None,
    lengths: Mapping[str, int] | None = None,
    posture: str | None = None,
) -> Iterator[dict[str, np.ndarray]]:
    """Batches of rows: name -> (rows,) float64.

    Args:
        path: the table.
        names: of its columns, or of elements of its columns of lists.
        time: that of them which may hold time stamps; it then comes as timedelta64[ns] since the first row.
        lengths: column of lists -> numbers that every list has to have.
        posture: that of them which holds names of `motor_log.POSTURES`; it then comes as int64.

    Raises:
        LogError: missing or damaged file, a column that it lacks, a cell that is empty, no number, no time stamp or no
            posture, a list of another length; names the file, the row and the column.
    """
    import pyarrow as pa

    require_file(path, LogError)
    rows, stamps = 0, TimeStamps(time or "", path)
    try:
        for batch in _batches(path, names, time, posture):
            for name, length in (lengths or {}).items():
                _require_length(batch.column(name), name, length, rows, path)
            yield {
                name: posture_codes(batch.column(name), name, rows, path)
                if name == posture
                else stamps.since_first(batch.column(name), rows)
                if name == time and _holds_stamps(batch, name)
                else _numbers(batch, name, rows, path)
                for name in names
            }
            rows += batch.num_rows
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: Exception) -> LogError:
    """What a library said, on one line."""
    said = (str(error) or type(error).__name__).splitlines()[0][:300]
    return LogError(f"cannot be read ({said})", where=path, remedy=COPY_AGAIN)


def element_of(name: str) -> tuple[str, int] | None:
    """``x[2]`` -> ("x", 2); None for a plain name."""
    found = _ELEMENT.fullmatch(name)
    return (found[1], int(found[2])) if found else None


def _batches(path: Path, names: list[str], time: str | None, posture: str | None) -> Iterator[Any]:
    if path.suffix == ".parquet":
        yield from _parquet_batches(path, names, time, posture)
        return
    wanted = present(list(csv_head(path).names), names, path, posture)
    texts = [posture] if posture else []
    texts += [time] if time in wanted and _begins_with_a_stamp(path, time) else []
    yield from csv_batches(path, wanted, texts=texts)


def _begins_with_a_stamp(path: Path, time: str) -> bool:
    """Whether the first cell of a column of a table of text is a time stamp."""
    first = next(csv_batches(path, [time], texts=[time]), None)
    return first is not None and begins_like_a_stamp(first.column(time)[0].as_py())


def _parquet_batches(path: Path, names: list[str], time: str | None, posture: str | None) -> Iterator[Any]:
    import pyarrow.parquet as pq

    require_parquet(path)
    schema = pq.read_schema(path)
    wanted = present(schema.names, names, path, posture)
    _require_kinds(schema, wanted, time, posture, path)
    texts = [name for name in wanted if are_texts(_inner(schema.field(name).type))]
    require_small_pages(path, set(wanted), texts=set(texts))
    # without pre_buffer, or all is held in memory; texts as dictionaries, or they may unfold to gigabytes
    with pq.ParquetFile(path, pre_buffer=False, read_dictionary=texts) as file:
        yield from file.iter_batches(columns=wanted)


def _inner(kind: Any) -> Any:
    """Type of the elements of a list, or of a dictionary's words; else the type itself."""
    return getattr(kind, "value_type", kind)


def _holds_stamps(batch: Any, name: str) -> bool:
    """Whether a column of a batch has time stamps, where it may."""
    kind = batch.schema.field(name).type if batch.schema.get_field_index(name) >= 0 else None
    return kind is not None and are_stamps(_inner(kind))


def _require_kinds(schema: Any, wanted: list[str], time: str | None, posture: str | None, path: Path) -> None:
    """Refuse, before it is read, any column but of numbers or their lists, of time stamps, or of postures' names."""
    import pyarrow as pa

    for name in wanted:
        kind = schema.field(name).type
        inner = _inner(kind)
        if name == posture:
            if not are_texts(inner) or pa.types.is_nested(kind):
                raise LogError(f"{name} is {kind}, not names of postures", where=path, remedy=CORRECT_POSTURE)
            continue
        if name == time and are_stamps(inner) and not pa.types.is_nested(kind):
            continue
        if not (pa.types.is_integer(inner) or pa.types.is_floating(inner)):
            raise LogError(f"{name} is {kind}, not numbers", where=path, remedy=CORRECT)


def present(have: list[str], names: list[str], path: Path, posture: str | None = None) -> list[str]:
    """Columns of the file that hold these names, each once; that of postures holds no lists."""
    counted = Counter(have)
    found = dict.fromkeys(name if name == posture else _owner(name, counted) for name in names)
    for name in found:
        if counted[name] != 1:
            problem = "no column" if name not in counted else "more than one column"
            problem = f"posture is none of {NAMES}, and {problem}" if name == posture else problem
            shown = ", ".join(map(ascii, have[:8])) + (", …" if len(have) > 8 else "")
            remedy = CORRECT_POSTURE if name == posture else _first_line(have) or CORRECT
            raise LogError(f"{problem} {name[:80]!r}; it has {shown[:300]}", where=path, remedy=remedy)
    return list(found)


def _first_line(names: list[str]) -> str:
    """What to do about a table of text whose first line names no columns; empty if it does."""
    if names and names[0].startswith(("#", "%")):
        return "its first line is a comment: remove such lines, and the sign before the names, if they have one"
    if len(names) == 1 and len(names[0].split()) > 1:
        return "its columns are separated by blanks: separate them by commas, semicolons or tabs"
    return ""


def _owner(name: str, have: Container[str]) -> str:
    """The column that holds a name: that of this name, or the column of lists of which it is an element."""
    element = element_of(name)
    return element[0] if element and name not in have else name


def _numbers(batch: Any, name: str, before: int, path: Path) -> np.ndarray:
    """(rows,) float64 of a batch."""
    owner = name if batch.schema.get_field_index(name) >= 0 else _owner(name, ())
    column = batch.column(owner)
    if owner != name:
        column = _element(column, name, before, path)
    kind = str(column.type)
    if column.null_count or not (kind in ("float", "double", "halffloat") or kind.startswith(("int", "uint"))):
        empty = np.flatnonzero(~np.asarray(column.is_valid()))
        problem = f"row {before + empty[0]}, {name} is empty" if empty.size else f"{name} is {kind}, not numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _element(column: Any, name: str, before: int, path: Path) -> Any:
    import pyarrow.compute as pc

    index = int(name[name.rindex("[") + 1 : -1])
    if "list" not in str(column.type):
        raise LogError(f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT)
    lengths = _lengths(column, index + 1)
    if short := np.flatnonzero(lengths <= index).tolist():
        problem = f"row {before + short[0]}, {name}: its list has {lengths[short[0]]} numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return pc.list_element(column, index)  # pyright: ignore[reportAttributeAccessIssue]


def _require_length(column: Any, name: str, length: int, before: int, path: Path) -> None:
    if "list" not in str(column.type):
        raise LogError(f"{name} is {column.type}, not lists", where=path, remedy=CORRECT)
    lengths = _lengths(column, length)
    if odd := np.flatnonzero(lengths != length).tolist():
        problem = f"row {before + odd[0]}, {name} has {lengths[odd[0]]} numbers, and {length} are described"
        raise LogError(problem, where=path, remedy="describe every number, or correct the row")


def _lengths(column: Any, of_empty: int) -> np.ndarray:
    """(rows,) numbers in the lists of a column; of an empty cell, which is refused as such, ``of_empty``."""
    import pyarrow.compute as pc

    cells: Any = pc
    return np.asarray(cells.fill_null(cells.list_value_length(column), of_empty))
