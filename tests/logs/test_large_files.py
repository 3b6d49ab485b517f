"""Ten million rows are read and checked in memory that is bounded by the size of the log itself."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest

ROWS, CHUNK = 10_000_000, 500_000
MAP = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"

[joints]
pan = {}
lift = {}
"""
READ = """
import sys
import pyarrow, pyarrow.csv, pyarrow.compute, pyarrow.parquet
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import channels
from motorprior.logs.formats.registry import read_log

def peak():  # of this program alone; ru_maxrss would begin at that of the parent
    return 1024 * int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])

before = peak()
log = read_log(sys.argv[1], columns=sys.argv[2])
reading = peak() - before
report = check_log(log)
print(log.num_rows, sum(values.nbytes for values in channels(log).values()), reading, peak() - before, report.usable)
"""

OWN = """
import sys
import numpy as np
import pyarrow, pyarrow.parquet
from motorprior.logs.formats.parquet_io import read_parquet, write_log
from motorprior.logs.motor_log import MotorLog, channels

def peak():
    return 1024 * int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])

if sys.argv[2] == "write":
    angle = np.sin(1e-3 * np.arange(10_000_000)[:, None] * np.array([1.3, 2.3]))
    log = MotorLog(
        time=1e-3 * np.arange(10_000_000), position_target=angle, joint_pos=angle, joint_vel=angle,
        external_torque=angle, stated_kp=np.ones_like(angle), joint_names=("a", "b"), robot="", motor="", source="",
    )
before = peak()
write_log(sys.argv[1], log) if sys.argv[2] == "write" else None
log = log if sys.argv[2] == "write" else read_parquet(sys.argv[1])
print(log.num_rows, sum(values.nbytes for values in channels(log).values()), peak() - before)
"""


def write(path: Path) -> None:
    """Two joints that follow sines 50 ms late, at 1 kHz."""
    writer = None
    for first in range(0, ROWS, CHUNK):
        time = 1e-3 * np.arange(first, first + CHUNK)
        columns = {"t": time}
        for name, late in (("goal", 0.0), ("pos", 0.05)):
            columns |= {
                f"{name}_{joint}": np.sin(rate * (time - late)) for joint, rate in (("pan", 1.3), ("lift", 2.3))
            }
        table = pa.table(columns)
        if writer is None:
            open_file = pq.ParquetWriter if path.suffix == ".parquet" else pa_csv.CSVWriter
            writer = open_file(path, table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="the peak of memory is read from Linux's /proc")
@pytest.mark.parametrize("name", ["log.parquet", "log.csv"])
def test_ten_million_rows_take_a_few_times_their_own_size(tmp_path: Path, name: str):
    (tmp_path / "columns.toml").write_text(MAP)
    write(tmp_path / name)
    command = [sys.executable, "-c", READ, str(tmp_path / name), str(tmp_path / "columns.toml")]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    rows, size, reading, checking = (int(word) for word in said[:4])
    assert (rows, size, said[4]) == (ROWS, 8 * 5 * ROWS, "True")
    assert reading < 3.5 * size, reading / size
    assert checking < 4.5 * size, checking / size


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="the peak of memory is read from Linux's /proc")
def test_a_motor_log_of_ten_million_rows_takes_hardly_more_than_its_size(tmp_path: Path):
    for action, most in (("write", 0.8), ("read", 1.8)):  # where it is written, the log is there before
        command = [sys.executable, "-c", OWN, str(tmp_path / "log.parquet"), action]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        rows, size, more = (int(word) for word in said)
        assert (rows, size) == (ROWS, 8 * 11 * ROWS)
        assert more < most * size, (action, more / size)
