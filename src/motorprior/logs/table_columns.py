"""Columns of tables, CSV (plain or gzip) or Parquet, batch by batch: only those asked for, as numbers.

``x[2]`` is element 2 of a column ``x`` of lists.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.csv_stream import csv_batches, csv_head
from motorprior.logs.parquet_pages import COPY_AGAIN, require_parquet, require_small_pages
from motorprior.outside_files import require_file

ENDINGS = (".csv", ".csv.gz", ".parquet")
CORRECT = "correct the column map, or the file"
_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]", re.ASCII)


def table_columns(path: Path, names: list[str]) -> Iterator[dict[str, np.ndarray]]:
    """Batches of rows: name -> (rows,) float64.

    Raises:
        LogError: missing or damaged file, a column that it lacks, a cell that is empty or no number; names the file,
            the row and the column.
    """
    import pyarrow as pa

    require_file(path, LogError)
    rows = 0
    try:
        for batch in _batches(path, names):
            yield {name: _numbers(batch, name, rows, path) for name in names}
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


def _batches(path: Path, names: list[str]) -> Iterator[Any]:
    import pyarrow.parquet as pq

    if path.suffix == ".parquet":
        require_parquet(path)
        with pq.ParquetFile(path, pre_buffer=False) as file:  # or it holds the whole file in memory
            wanted = present(file.schema_arrow.names, names, path)
            _require_numbers(file.schema_arrow, wanted, path)
            require_small_pages(path, set(wanted))
            yield from file.iter_batches(columns=wanted)
    else:
        yield from csv_batches(path, present(list(csv_head(path).names), names, path))


def _require_numbers(schema: Any, wanted: list[str], path: Path) -> None:
    """Refuse, before it is read, any column but of numbers or their lists: texts may unfold to gigabytes."""
    import pyarrow as pa

    for name in wanted:
        kind = schema.field(name).type
        inner = getattr(kind, "value_type", kind)  # of a list, or of a dictionary
        if not (pa.types.is_integer(inner) or pa.types.is_floating(inner)):
            raise LogError(f"{name} is {kind}, not numbers", where=path, remedy=CORRECT)


def present(have: list[str], names: list[str], path: Path) -> list[str]:
    """Columns of the file that hold these names, each once."""
    counted = Counter(have)
    found = dict.fromkeys(_owner(name, counted) for name in names)
    for name in found:
        if counted[name] != 1:
            problem = "no column" if name not in counted else "more than one column"
            shown = ", ".join(map(ascii, have[:8])) + (", …" if len(have) > 8 else "")
            raise LogError(f"{problem} {name[:80]!r}; it has {shown[:300]}", where=path, remedy=CORRECT)
    return list(found)


def _owner(name: str, have: Container[str]) -> str:
    """The column that holds a name: that of this name, or the column of lists of which it is an element."""
    element = element_of(name)
    return element[0] if element and name not in have else name


def _numbers(batch: Any, name: str, before: int, path: Path) -> np.ndarray:
    """(rows,) float64 of a batch."""
    owner = name if batch.schema.get_field_index(name) >= 0 else _owner(name, ())
    column = batch.column(owner)
    if owner != name:
        column = _element(column, name, path)
    kind = str(column.type)
    if column.null_count or not (kind in ("float", "double", "halffloat") or kind.startswith(("int", "uint"))):
        empty = np.flatnonzero(~np.asarray(column.is_valid()))
        problem = f"row {before + empty[0]}, {name} is empty" if empty.size else f"{name} is {kind}, not numbers"
        raise LogError(problem, where=path, remedy=CORRECT)
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _element(column: Any, name: str, path: Path) -> Any:
    import pyarrow as pa
    import pyarrow.compute as pc

    index = int(name[name.rindex("[") + 1 : -1])
    if "list" not in str(column.type):
        raise LogError(f"{name}: the column is {column.type}, not lists", where=path, remedy=CORRECT)
    try:
        return pc.list_element(column, index)  # pyright: ignore[reportAttributeAccessIssue]
    except pa.ArrowException as error:
        raise LogError(f"{name}: a list has no such element ({error})", where=path, remedy=CORRECT) from error
