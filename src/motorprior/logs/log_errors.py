"""Common errors of a log: a bad value in a row, a missing column, time that does not increase."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, listed, quoted

CORRECT = "correct the column map, or the file"
CORRECT_ROW = "correct or remove the row"
NUMBER = "a finite number"
Where = str | Path | None


def bad_value(row: int, column: str, value: Any, expected: str, where: Where, remedy: str = CORRECT_ROW) -> LogError:
    """The error for one cell, "row 7, joint_pos/knee is nan, not a finite number"; rows count from 0."""
    text = quoted(value.item() if isinstance(value, np.generic) else value)
    return LogError(f"row {row}, {column[:120]} is {text}, not {expected}", where=where, remedy=remedy)


def missing_column(kind: str, name: str, known: Iterable[str], where: Where, remedy: str = CORRECT) -> LogError:
    """The error for a missing column, tensor or topic; it lists the first eight that exist."""
    have = listed([quoted(each) for each in known], 8) or "none"
    return LogError(f"no {kind} {quoted(name, 80)}; it has {have[:300]}", where=where, remedy=remedy)


def require_finite(values: np.ndarray, columns: list[str], where: Where) -> None:
    """Reject values (T, N) that are not finite.

    Raises:
        LogError: names row, column and value of the first.
    """
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.argwhere(~finite)[0].tolist()
        raise bad_value(row, columns[column], values[row, column], NUMBER, where)


def require_increasing(time: np.ndarray, where: Where, first_row: int = 0) -> None:
    """Reject times (T,) [s] that do not increase.

    Raises:
        LogError: names the row, counted from ``first_row``, and both values.
    """
    stuck = np.diff(time) <= 0.0
    if stuck.any():
        row = 1 + int(np.argmax(stuck))
        before, now = float(time[row - 1]), float(time[row])
        problem = f"row {first_row + row}, time {'repeats' if before == now else 'runs backwards'}"
        remedy = "sort the rows and drop duplicates, or begin a segment where the clock restarted"
        raise LogError(f"{problem}: {now!r} s after {before!r} s, it must increase", where=where, remedy=remedy)
