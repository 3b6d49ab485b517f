"""Tables of any columns, CSV (plain or gzip) or Parquet, read by a column map."""

from __future__ import annotations

import re
from pathlib import Path

from motorprior.exceptions import LogError, listed
from motorprior.logs.log_reader import LogReader
from motorprior.logs.tables import csv_names, table_columns

_NUMBER = re.compile(r"[-+.,\d]*(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)


def _unmapped(path: Path) -> str:
    names = csv_names(path)
    found = listed(list(map(ascii, names)), 8)[:200]
    if all(_NUMBER.fullmatch(name) for name in names):
        raise LogError(f"no header: its first line is {found}", where=path, remedy="begin it with names")
    return f"a table of unknown format; its first line is {found}"


READER = LogReader(
    "table",
    (".csv", ".csv.gz", ".parquet"),
    unmapped=_unmapped,
    columns=lambda path, names, columns: table_columns(path, names, columns.time),
)
