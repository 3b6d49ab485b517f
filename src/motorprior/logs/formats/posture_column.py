"""A table's column that says in words how the robot's base was held in every row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown
from motorprior.logs.motor_log import POSTURES

NAMES = f"{', '.join(POSTURES[:-1])} or {POSTURES[-1]}"
CORRECT = f"let every row say {NAMES}; or state one of them for all rows in the column map, as posture"


def posture_codes(column: Any, name: str, before: int, path: Path) -> np.ndarray:
    """(rows,) places in `motor_log.POSTURES`; space around a name does not count.

    Args:
        column: Arrow array of texts, or a dictionary of texts.
        name: of the column.
        before: rows of the batches before it.
        path: of the file.

    Raises:
        LogError: a cell that is empty, or no posture's name; names the row.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    coded = column.dictionary_encode()  # every word once: of a dictionary, texts may unfold to gigabytes
    words = cells.utf8_trim_whitespace(coded.dictionary)
    codes = cells.index_in(words, value_set=pa.array(POSTURES, words.type)).take(coded.indices)
    odd = np.flatnonzero(~np.asarray(codes.is_valid()))
    if odd.size:
        cell = column[odd[0]].as_py()
        problem = f"is {shown(cell)}, no posture" if cell else "is empty"
        raise LogError(f"row {before + odd[0]}, {name[:80]} {problem}", where=path, remedy=CORRECT)
    return np.asarray(codes.to_numpy(zero_copy_only=False), dtype=np.int64)
