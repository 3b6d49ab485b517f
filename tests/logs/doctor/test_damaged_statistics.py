"""A Parquet file whose description of a column is damaged is refused; it does not end the process."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motorprior.exceptions import LogError
from motorprior.logs.formats.table_columns import table_columns


def test_damaged_statistics_of_a_column_of_lists_are_an_error_and_not_the_end(tmp_path: Path):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"a": np.arange(50.0), "b": [[1.0, 2.0]] * 50}), path)
    data = path.read_bytes()
    footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    outcomes = []
    for place in range(50, 57):  # of the second column's path in the schema, and its nesting
        damaged = bytearray(data)
        damaged[footer + place] = 25
        path.write_bytes(damaged)
        try:
            outcomes.append(sum(len(batch["b[0]"]) for batch in table_columns(path, ["b[0]"])))
        except LogError as error:
            assert str(path) in str(error)
            outcomes.append(None)
    assert set(outcomes) <= {50, None} and None in outcomes
