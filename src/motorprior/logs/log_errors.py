"""The two usual errors of a log: a bad value in a row, and a missing column."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, listed, shown

CORRECT = "correct the column map, or the file"
CORRECT_ROW = "correct or remove the row"
NUMBER = "a finite number"
Where = str | Path | None


def bad_value(row: int, column: str, value: Any, expected: str, where: Where, remedy: str = CORRECT_ROW) -> LogError:
    """The error for one cell, "row 7, joint_pos/knee is nan, not a finite number"; rows count from 0."""
    text = shown(value.item() if isinstance(value, np.generic) else value)
    return LogError(f"row {row}, {column[:120]} is {text}, not {expected}", where=where, remedy=remedy)


def missing_column(kind: str, name: str, known: Iterable[str], where: Where, remedy: str = CORRECT) -> LogError:
    """The error for a missing column, tensor or topic; it lists the first eight that exist."""
    have = listed([shown(each) for each in known], 8) or "none"
    return LogError(f"no {kind} {shown(name, 80)}; it has {have[:300]}", where=where, remedy=remedy)


def require_finite(values: np.ndarray, columns: list[str], where: Where) -> None:
    """Reject values (T, N) that are not finite.

    Raises:
        LogError: names row, column and value of the first.
    """
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.argwhere(~finite)[0].tolist()
        raise bad_value(row, columns[column], values[row, column], NUMBER, where)
