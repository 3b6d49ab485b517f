"""Time stamps of a table's rows as times since its first row: dates and times of Parquet, and ISO 8601 in texts.

Texts either all have a time zone (``Z``, ``+02:00``), and may change it, or none has one.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown

CORRECT = "correct the row; time stamps are like 2024-05-01T12:00:00.25 (ISO 8601), all with a time zone or all without"
_BEGINS = re.compile(r"\d{4}-\d\d-\d\d([T ]|$)", re.ASCII)


def begins_like_a_stamp(text: str) -> bool:
    """Whether a cell of a table of text is a date and time, and no number."""
    return _BEGINS.match(text.strip()) is not None


def are_stamps(kind: Any) -> bool:
    """Whether a column of this Arrow type can be one of time stamps."""
    import pyarrow as pa

    return pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or are_texts(kind)


def are_texts(kind: Any) -> bool:
    """Whether a column of this Arrow type is one of texts."""
    import pyarrow as pa

    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


class TimeStamps:
    """Reads consecutive batches of the rows of one file.

    Args:
        name: of the column.
        path: of the file.
    """

    def __init__(self, name: str, path: Path):
        self._name, self._path = name, path
        self._first: int | None = None
        self._with_zone = False

    def since_first(self, column: Any, before: int) -> np.ndarray:
        """(rows,) timedelta64[ns] since the first row of the file.

        Args:
            column: Arrow array of time stamps, durations, texts or a dictionary of texts.
            before: rows of the batches before it.

        Raises:
            LogError: an empty cell, a text that is no time stamp, or some with a zone and some without; names the row.
        """
        import pyarrow as pa

        empty = np.flatnonzero(~np.asarray(column.is_valid()))
        if empty.size:
            raise LogError(f"row {before + empty[0]}, {self._name} is empty", where=self._path, remedy=CORRECT)
        if not len(column):
            return np.zeros(0, "timedelta64[ns]")
        if pa.types.is_dictionary(column.type) or are_texts(column.type):
            stamps = self._of_texts(column, before)
        elif pa.types.is_duration(column.type):
            stamps = column.cast(pa.duration("ns"))
        else:
            stamps = column.cast(pa.timestamp("ns", column.type.tz))
        counts = np.asarray(stamps.cast(pa.int64()).to_numpy(zero_copy_only=False))
        self._first = int(counts[0]) if self._first is None else self._first
        return (counts - self._first).astype("timedelta64[ns]")

    def _of_texts(self, column: Any, before: int) -> Any:
        import pyarrow as pa

        if self._first is None:
            self._with_zone = _parsed(column[:1], with_zone=True) is not None
        if pa.types.is_dictionary(column.type):
            used, where = np.unique(column.indices.to_numpy(zero_copy_only=False), return_inverse=True)
            found = _parsed(column.dictionary.take(pa.array(used)), self._with_zone)
            found = None if found is None else found.take(pa.array(where))
        else:
            found = _parsed(column, self._with_zone)
        if found is None:
            raise self._first_bad(column, before)
        return found

    def _first_bad(self, column: Any, before: int) -> LogError:
        rows = (row for row in range(len(column)) if _parsed(column[row : row + 1], self._with_zone) is None)
        row = next(rows, 0)
        problem = f"row {before + row}, {self._name} is {shown(column[row].as_py())}"
        if _parsed(column[row : row + 1], not self._with_zone) is None:
            return LogError(f"{problem}, no time stamp", where=self._path, remedy=CORRECT)
        has = ("without a time zone", "with a time zone")
        problem += f", {has[not self._with_zone]}; the first row is {has[self._with_zone]}"
        return LogError(problem, where=self._path, remedy=CORRECT)


def _parsed(texts: Any, with_zone: bool) -> Any:
    """An array of texts as time stamps, or None where one is none, or is with or without a zone otherwise."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = pa.timestamp("ns", "UTC" if with_zone else None)
    texts = texts.cast(pa.string()) if pa.types.is_dictionary(texts.type) else texts
    cells: Any = pc
    try:
        return cells.utf8_trim_whitespace(texts).cast(kind)
    except pa.ArrowInvalid:
        return None
