"""Columns of tables, CSV (plain or gzip) or Parquet, batch by batch: only those asked for, as numbers.

``x[2]`` is element 2 of a column ``x`` of lists.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.csv_stream import csv_batches, csv_head
from motorprior.outside_files import require_file

ENDINGS = (".csv", ".csv.gz", ".parquet")
CORRECT = "correct the column map, or the file"
COPY_AGAIN = "copy or record it again"
MAX_NUMBERS = 60_000_000
"""Of a log: half a gigabyte."""
MAX_FOOTER = 10_000_000
"""Bytes at the end of a Parquet file that say what is in it."""
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
            _require_few(file, set(wanted), path)
            yield from file.iter_batches(columns=wanted)
    else:
        yield from csv_batches(path, present(list(csv_head(path).names), names, path))


def require_parquet(path: Path) -> None:
    """Refuse what is no Parquet file, or says too much about itself: its last bytes tell, before it is opened.

    Raises:
        LogError: no file, not a Parquet file, or a description of more than `MAX_FOOTER` bytes.
    """
    size = require_file(path, LogError)
    with open(path, "rb") as file:
        file.seek(max(0, size - 8))
        end = file.read(8)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != b"PAR1" or length > size:
        raise LogError("not a complete Parquet file (its end is no Parquet file's)", where=path, remedy=COPY_AGAIN)
    if length > MAX_FOOTER:
        problem = f"it has {length} bytes of description, more than {MAX_FOOTER}"
        raise LogError(problem, where=path, remedy="write it with fewer columns and larger groups of rows")


def _require_numbers(schema: Any, wanted: list[str], path: Path) -> None:
    """Refuse, before it is read, any column but of numbers or their lists: texts may unfold to gigabytes."""
    import pyarrow as pa

    for name in wanted:
        kind = schema.field(name).type
        inner = getattr(kind, "value_type", kind)  # of a list, or of a dictionary
        if not (pa.types.is_integer(inner) or pa.types.is_floating(inner)):
            raise LogError(f"{name} is {kind}, not numbers", where=path, remedy=CORRECT)


def _require_few(file: Any, wanted: set[str], path: Path) -> None:
    """Refuse columns of lists that unfold to more numbers than a log may have."""
    schema, metadata = file.schema_arrow, file.metadata
    lists = {name for name in wanted if hasattr(schema.field(name).type, "value_type")}
    count = metadata.num_rows * (len(wanted) - len(lists))
    if lists:
        used = [k for k in range(metadata.num_columns) if metadata.schema.column(k).path.split(".")[0] in lists]
        count += _numbers_in(path, used)
    if count > MAX_NUMBERS:
        problem = f"{count} numbers in {', '.join(sorted(wanted))}, more than {MAX_NUMBERS}"
        raise LogError(problem, where=path, remedy="split the recording")


_COUNT = """
import sys, pyarrow.parquet
metadata = pyarrow.parquet.read_metadata(sys.argv[1])
groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
print(sum(group.column(int(k)).num_values for group in groups for k in sys.argv[2:]))
"""


def _numbers_in(path: Path, columns: list[int]) -> int:
    """Numbers in some columns of a Parquet file, as it says itself.

    Asked in a process of its own: pyarrow ends the process that asks about a column whose size statistics are damaged.

    Raises:
        LogError: that process ended.
    """
    words = [sys.executable, "-c", _COUNT, str(path.absolute()), *map(str, columns)]
    asked = subprocess.run(words, capture_output=True, text=True, check=False)
    if asked.returncode != 0 or not asked.stdout.strip().isdigit():
        raise LogError("cannot be read (the description of a column is damaged)", where=path, remedy=COPY_AGAIN)
    return int(asked.stdout)


def present(have: list[str], names: list[str], path: Path) -> list[str]:
    """Columns of the file that hold these names, each once."""
    found = dict.fromkeys(_owner(name, have) for name in names)
    for name in found:
        if have.count(name) != 1:
            problem = "no column" if name not in have else "more than one column"
            shown = ", ".join(map(ascii, have[:8])) + (", …" if len(have) > 8 else "")
            raise LogError(f"{problem} {name[:80]!r}; it has {shown[:300]}", where=path, remedy=CORRECT)
    return list(found)


def _owner(name: str, have: list[str]) -> str:
    """The column that holds a name: that of this name, or the column of lists of which it is an element."""
    element = element_of(name)
    return element[0] if element and name not in have else name


def _numbers(batch: Any, name: str, before: int, path: Path) -> np.ndarray:
    """(rows,) float64 of a batch."""
    owner = _owner(name, batch.schema.names)
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
