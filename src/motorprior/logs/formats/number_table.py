"""CSV files of numbers, plain or gzip, read strictly: the expected columns, and a number in every cell."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.csv_stream import csv_batches, csv_head
from motorprior.logs.formats.growing_array import GrowingArray
from motorprior.outside_files import require_file

MAX_NUMBERS = 30_000_000
"""Of a table: 240 MB, three times over where rows are picked; three hours of a robot with 12 motors at 100 Hz."""


def read_number_table(path: Path, columns: Sequence[str], may_be_cut: bool = False) -> np.ndarray:
    """Read a CSV file with exactly these columns.

    Args:
        path: ``.csv``, or gzip where the name ends in ``.gz``.
        columns: names the first line must hold, in order.
        may_be_cut: its writer may have been killed; a last line without an end does not count.

    Returns:
        Shape (rows, columns), float64; NaN and infinity pass.

    Raises:
        LogError: missing or truncated file, more than `MAX_NUMBERS`, another header, a row with too few or too many
            cells, or a cell that is not a number (row from 0, column, value).
    """
    names = list(csv_head(path).names)
    if names != list(columns):
        raise LogError(_header_difference(names, list(columns)), where=path, remedy="restore the header line")
    table: GrowingArray | None = None
    rows = 0
    for batch in csv_batches(path, names, may_be_cut=may_be_cut):
        rows += batch.num_rows
        if rows * len(names) > MAX_NUMBERS:
            problem = f"more than {MAX_NUMBERS // len(names)} rows of {len(names)} numbers"
            raise LogError(problem, where=path, remedy="split the recording")
        values = np.column_stack([column.to_numpy() for column in batch.columns])
        if table is None:
            table = GrowingArray(values)
        else:
            table.add(values)
    if table is None:
        raise LogError("no rows after the header", where=path, remedy="copy the file again")
    return table.finished()


def read_text(path: Path, max_bytes: int) -> str:
    """The text of a file, plain or gzip.

    Raises:
        LogError: it cannot be read, is damaged, is no text, or is longer than ``max_bytes``.
    """
    require_file(path, LogError)
    try:
        opener = gzip.open if path.suffix == ".gz" else open
        with opener(path, "rb") as file:
            data = file.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise LogError(f"more than {max_bytes} bytes of text", where=path, remedy="split the recording")
        return data.decode("utf-8-sig")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(
            f"truncated or damaged gzip file ({error})",
            where=path,
            remedy="copy the file again from its source",
        ) from error
    except UnicodeDecodeError as error:
        raise LogError(f"not a text file ({error})", where=path, remedy="copy the file again") from error
    except OSError as error:
        raise LogError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def _header_difference(found: list[str], wanted: list[str]) -> str:
    if len(found) != len(wanted):
        return f"{len(found)} columns, expected {len(wanted)} ({wanted[0]} .. {wanted[-1]})"
    index = next(i for i, name in enumerate(wanted) if found[i] != name)
    return f"column {index} is named {found[index]!r}, expected {wanted[index]!r}"
