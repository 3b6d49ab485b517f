"""A log is read from disk bit for bit, or refused."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.artifacts import MAX_BYTES
from motorprior.exceptions import LogError
from motorprior.logs.motor_log import channels
from motorprior.logs.readers.motor_log_file import METADATA_KEY, read_parquet, write_log
from motorprior.logs.readers.table import parquet_table


def rewrite(path, **header):
    """Change header entries of a written log (None removes an entry)."""
    table = pq.read_table(path)
    metadata = json.loads(table.schema.metadata[METADATA_KEY]) | header
    metadata = {key: value for key, value in metadata.items() if value is not None}
    pq.write_table(table.replace_schema_metadata({METADATA_KEY: json.dumps(metadata)}), path)


@pytest.fixture
def written(tmp_path, full_log):
    path = tmp_path / "new" / "log.parquet"
    write_log(path, full_log)
    return path


def test_a_written_log_is_read_bit_for_bit(written, full_log):
    log = read_parquet(written)

    assert channels(log).keys() == channels(full_log).keys()
    for name, value in channels(full_log).items():
        assert getattr(log, name).tobytes() == np.ascontiguousarray(value).tobytes(), name
    for name in ("joint_names", "robot", "motor", "source"):
        assert getattr(log, name) == getattr(full_log, name)


@pytest.mark.parametrize(
    ("header", "problem"),
    [
        ({"schema_version": 1}, "schema_version = 1 .*4"),
        ({"joint_names": ["left", "middle"]}, "position_target_rad/middle"),
        ({"encoder": "belt"}, "encoder 'belt'.*joint or rotor"),
        ({"firmware": {"dead_zone": 2}}, "firmware.dead_zone 2"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(written, header, problem):
    rewrite(written, **header)
    with pytest.raises(LogError, match=problem):
        read_parquet(written)


def test_a_parquet_file_that_is_no_motor_log_is_refused(written):
    path = written.with_name("table.parquet")
    pq.write_table(pq.read_table(written).replace_schema_metadata(None), path)

    with pytest.raises(LogError, match="motor log") as refusal:
        read_parquet(path)
    assert refusal.value.where == path


def test_a_small_file_that_unpacks_to_much_is_refused(tmp_path):
    path = tmp_path / "equal.parquet"
    pq.write_table(pa.table({"t": np.zeros(MAX_BYTES // 8 + 1, np.int8)}), path)

    assert path.stat().st_size < 1_000_000
    with pytest.raises(LogError, match=str(MAX_BYTES)):
        parquet_table(path)
