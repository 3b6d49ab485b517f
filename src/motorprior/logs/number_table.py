"""CSV files of numbers, plain or gzip, read strictly: the expected columns, and a number in every cell."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError

MAX_BYTES = 500_000_000


def read_number_table(path: Path, columns: Sequence[str], may_be_cut: bool = False) -> np.ndarray:
    """Read a CSV file with exactly these columns.

    Args:
        path: ``.csv``, or gzip where the name ends in ``.gz``.
        columns: names the first line must hold, in order.
        may_be_cut: its writer may have been killed; a last line without an end does not count.

    Returns:
        Shape (rows, columns), float64; NaN and infinity pass.

    Raises:
        LogError: missing or truncated file, more than 500 MB, another header, a row with too few or too many
            cells, or a cell that is not a number (row from 0, column, value).
    """
    header, _, body = read_text(path).partition("\n")
    if may_be_cut:
        body = body[: body.rfind("\n") + 1]
    names = header.strip().split(",")
    if names != list(columns):
        raise LogError(_header_difference(names, list(columns)), where=path, remedy="restore the header line")
    if not body.strip():
        raise LogError("no rows after the header", where=path, remedy="copy the file again")
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=",", comments=None, ndmin=2)
        if table.shape[1] == len(columns):
            return table
    except ValueError:
        pass
    raise _first_bad_row(body, columns, path)


def read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """The text of a file, plain or gzip.

    Raises:
        LogError: it cannot be read, is damaged, is no text, or is longer than ``max_bytes``.
    """
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


def _first_bad_row(body: str, columns: Sequence[str], path: Path) -> LogError:
    """The error for the first row that is not as many numbers as there are columns."""
    remedy = "delete the row, or copy the file again from its source"
    for row, line in enumerate(text for text in body.splitlines() if text.strip()):
        cells = line.split(",")
        if len(cells) != len(columns):
            problem = f"row {row} has {len(cells)} cells, expected {len(columns)}"
            return LogError(problem, where=path, remedy=remedy)
        for name, cell in zip(columns, cells, strict=True):
            if not _is_number(cell):
                return LogError(f"row {row}, {name} is {cell[:40]!r}, not a number", where=path, remedy=remedy)
    return LogError("the rows cannot be read as numbers", where=path, remedy=remedy)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
