"""Small files that describe much: refused in one short message, soon, and in less than a gigabyte of memory."""

import gzip
import json
import os
import pickle
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import ArtifactError
from motorprior.logs.formats import bam
from motorprior.logs.formats.parquet_io import METADATA_KEY, write_log
from motorprior.logs.formats.puppersim import csv_columns
from motorprior.logs.motor_log import MotorLog
from motorprior.robots import model_trial
from motorprior.robots.load import load_robot

GIGABYTE, LONGEST = 1_000_000_000, 1000
READ = """
import sys
from motorprior.exceptions import MotorPriorError
from motorprior.robots.shipped import SHIPPED

def read(path):
    if path.endswith(".safetensors"):
        from motorprior.actuator.motor_prior import MotorPrior
        return MotorPrior.load(path)
    if path.endswith(".toml"):
        from motorprior.robots.load import load_robot
        return load_robot(path)
    from motorprior.logs.formats.registry import read_log
    return read_log(path, None, sys.argv[2]) if sys.argv[2:] else read_log(path, SHIPPED[0])

try:
    read(sys.argv[1])
except MotorPriorError as error:
    sys.stdout.buffer.write(str(error).encode())
peak = 1024 * int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])  # of this program alone
print(f"\\n{peak}")
"""
HEAD = ",".join(csv_columns(12)) + "\n"
MAP = """
motor = "servo"
time = "t"
position_target = "goal[{joint}]"
joint_pos = "pos[{joint}]"
[joints]
0 = {}
"""


def packed(path: Path, parts: Iterable[str]) -> Path:
    with gzip.open(path, "wb", 6) as file:
        for part in parts:
            file.write(part.encode())
    return path


def twice(make: bytes, depth: int) -> bytes:
    """Tuples that each hold the one before twice: the last one, alone on the stack, holds 2**depth."""
    text = make + b"q\x00"
    for index in range(depth):
        text += b"h" + bytes([index]) + b"\x86q" + bytes([index + 1])
    return text


TUPLES = twice(b")", 60)
LISTS = twice(b"]", 28)


def long_number(value: int) -> bytes:
    data = value.to_bytes(value.bit_length() // 8 + 1, "little")
    return b"\x8a" + bytes([len(data)]) + data


def in_a_list(content: bytes) -> bytes:
    """As the first row of the times of a recording."""
    lists = (b"X" + struct.pack("<I", len(key)) + key + b"]" for key in (b"action", b"MotorAngle", b"IMU"))
    return b"}(X\x01\x00\x00\x00t" + b"](" + content + b"e" + b"".join(lists) + b"u."


PICKLES = {
    "tuples as a key": b"}" + TUPLES + b"K\x01s.",
    "numbers of one hash as keys": b"}("
    + b"".join(long_number(k * sys.hash_info.modulus) + b"N" for k in range(1, 60_000))
    + b"u.",
    "tuples as a shape": b"cnumpy._core.numeric\n_frombuffer\n(C\x01acnumpy\ndtype\nX\x02\x00\x00\x00f8\x85R"
    + TUPLES
    + b"X\x01\x00\x00\x00CtR.",
    "sizes of a million digits": b"cnumpy._core.numeric\n_frombuffer\n(C\x01acnumpy\ndtype\nX\x02\x00\x00\x00f8\x85R("
    + 8 * (b"\x8b" + struct.pack("<i", 3_000_000) + 3_000_000 * b"\x01")
    + b"tX\x01\x00\x00\x00CtR.",
    "lists as a number": in_a_list(b"](" + LISTS + b"e"),
    "bytes that are repeated": in_a_list(
        b"\x96" + struct.pack("<Q", 1_000_000) + bytes(1_000_000) + b"q\x00" + 5000 * b"h\x00"
    ),
    "a key of a megabyte": pickle.dumps({1_000_000 * "k": 0}, 2)[2:],
}


@pytest.fixture
def refused() -> Callable[..., str]:
    """What a process says that reads a file and must not be able to."""
    if not Path("/proc/self/status").is_file():
        pytest.skip("the peak of memory is read from Linux's /proc")

    def run(path: Path, *columns: Path, names: Path | None = None) -> str:
        words = [sys.executable, "-c", READ, str(path), *map(str, columns)]
        done = subprocess.run(words, check=True, capture_output=True, timeout=300)
        said, _, peak = done.stdout.decode().strip().rpartition("\n")
        assert said.startswith(str(names or path)) and " -> " in said
        assert "\n" not in said and len(said.encode()) <= LONGEST
        assert int(peak) < GIGABYTE
        return said

    return run


@pytest.mark.parametrize("name", PICKLES)
def test_a_pickle(refused: Callable[..., str], tmp_path: Path, name: str):
    path = tmp_path / "env_real_x_log.txt"
    path.write_bytes(b"\x80\x02" + PICKLES[name])
    refused(path)


TABLES = {
    "rows": ("more than 1034482 rows", 300 * [10_000 * ("0," * 28 + "0\n")]),
    "one line": ("a line of more than", 200 * [500_000 * "0,"]),
    "empty lines": ("empty lines", 400 * [1_000_000 * "\n"]),
    "a cell": ("a line of more than", 200 * [1_000_000 * "1"]),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_packed_table(refused: Callable[..., str], tmp_path: Path, name: str):
    problem, parts = TABLES[name]
    assert problem in refused(packed(tmp_path / "env_real_x_log.csv.gz", [HEAD, *parts]))


def test_a_packed_table_of_somebody(refused: Callable[..., str], tmp_path: Path):
    (tmp_path / "map.toml").write_text(MAP.replace("[{joint}]", "_{joint}"))
    path = packed(tmp_path / "x.csv.gz", ["t,goal_0,pos_0\n", *(140 * [200_000 * "0,0,0\n"])])
    assert "unpacks to more than 100000000 bytes" in refused(path, tmp_path / "map.toml")


def test_lists_of_a_million_numbers(refused: Callable[..., str], tmp_path: Path):
    (tmp_path / "map.toml").write_text(MAP)
    zeros = pa.ListArray.from_arrays(np.arange(0, 50_000_001, 1_000_000, dtype=np.int32), np.zeros(50_000_000))
    table = pa.table({"t": np.arange(50.0), "goal": zeros, "pos": zeros})
    pq.write_table(table, tmp_path / "x.parquet", compression="zstd")
    assert "50 rows of 2,000,001 numbers that are read, and may have 29 (3 columns: goal, pos, t)" in refused(
        tmp_path / "x.parquet", tmp_path / "map.toml"
    )


def motor_log(path: Path) -> pa.Table:
    angle = np.zeros((2, 2))
    log = MotorLog(
        time=np.arange(2.0), position_target=angle, joint_pos=angle, joint_names=("a", "b"), robot="", motor="",
        source="",
    )  # fmt: skip
    write_log(path, log)
    return pq.read_table(path)


def test_a_motor_log_of_many_equal_rows(refused: Callable[..., str], tmp_path: Path):
    table = motor_log(tmp_path / "x.parquet")
    rows = pa.table({name: np.zeros(4_000_000) for name in table.column_names})
    with pq.ParquetWriter(
        tmp_path / "x.parquet", rows.schema.with_metadata(table.schema.metadata), compression="zstd"
    ) as writer:
        for _ in range(13):
            writer.write_table(rows.replace_schema_metadata(table.schema.metadata))
    assert "52,000,000 rows of 5 numbers, and a motor log has at most 48,000,000" in refused(tmp_path / "x.parquet")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda header: "[" * 200_000 + "]" * 200_000, "its header"),
        (lambda header: json.dumps(header | {"joint_names": [f"joint {k}" for k in range(1_000_000)]}), "description"),
        (lambda header: json.dumps(header | {"joint_names": 50_000 * ["joint"]}), "joint_names"),
        (lambda header: json.dumps(header).replace('"a"', 5000 * "9"), "its header is not JSON"),
    ],
)
def test_the_header_of_a_motor_log(refused: Callable[..., str], tmp_path: Path, change: Callable, problem: str):
    table = motor_log(tmp_path / "x.parquet")
    header = json.loads(table.schema.metadata[METADATA_KEY])
    pq.write_table(table.replace_schema_metadata({METADATA_KEY: change(header)}), tmp_path / "x.parquet")
    assert problem in refused(tmp_path / "x.parquet")


def test_json_of_tables_just_below_the_bound(refused: Callable[..., str], tmp_path: Path):
    """The kind that takes most memory per byte."""
    path = packed(tmp_path / "x.json.gz", ["[", *(20 * [90_000 * '{"":{}},']), "{}]"])
    assert 0.8 * bam.MAX_BYTES < 20 * 90_000 * 8 < bam.MAX_BYTES
    refused(path)


def test_json_of_empty_tables(refused: Callable[..., str], tmp_path: Path):
    path = packed(tmp_path / "x.json.gz", ["[", *(80 * [300_000 * "{},"]), "{}]"])
    assert f"more than {bam.MAX_BYTES} bytes" in refused(path)


@pytest.mark.parametrize("text", [".".join(25_000 * ["a"]) + " = 1", "a = [" + 600_000 * "[]," + "]"])
def test_toml(refused: Callable[..., str], tmp_path: Path, text: str):
    (tmp_path / "x.toml").write_text(text)
    assert "more than" in refused(tmp_path / "x.toml")


MODELS = {
    "a texture": '<asset><texture name="t" type="2d" builtin="flat" width="20000" height="20000"/></asset>',
    "a field of heights": '<asset><hfield name="h" nrow="20000" ncol="20000" size="1 1 1 1"/></asset>',
    "numbers of the user": '<size nuser_body="400000000"/>',
    "an arena": '<size memory="100G"/>',
}


@pytest.mark.parametrize("name", MODELS)
def test_a_robot_s_model(refused: Callable[..., str], tmp_path: Path, name: str):
    """As small as it is, it is compiled to gigabytes."""
    body = '<body><geom size="1"/><joint name="a" range="-1 1"/></body>'
    (tmp_path / "x.xml").write_text(f"<mujoco>{MODELS[name]}<worldbody>{body}</worldbody></mujoco>")
    assert "MuJoCo" in refused(robot_of(tmp_path), names=tmp_path / "x.xml")


@pytest.mark.parametrize(
    "model",
    ['<include file="pipe"/>', '<worldbody><replicate count="9000000"><geom size="1"/></replicate></worldbody>'],
)
def test_a_robot_s_model_that_takes_for_ever(tmp_path: Path, model: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(model_trial, "WAIT", 3)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "x.xml").write_text(f"<mujoco>{model}</mujoco>")
    with pytest.raises(ArtifactError, match=r"x\.xml: MuJoCo did not read it within 3 s"):
        load_robot(robot_of(tmp_path))


def robot_of(folder: Path) -> Path:
    """A robot's file for the model x.xml beside it."""
    text = 'name = "x"\nmotor = "m"\nmodel = "x.xml"\nbase = "fixed"\n'
    text += "nominal_pose = 0.0\nkp = 1.0\nkd = 0.1\ntorque_limit = 1.0\n"
    (folder / "x.toml").write_text(text)
    return folder / "x.toml"


F64 = {"dtype": "F64", "shape": [250_000_000], "data_offsets": [0, 2_000_000_000]}


@pytest.mark.parametrize(
    ("header", "size", "problem"),
    [
        ({"x": F64, "__metadata__": {"motorprior": "{}"}}, 2_000_000_000, "more than the 400000000"),
        ({"__metadata__": {"motorprior": "[" + 15_000_000 * "[]," + "1]"}}, 0, "not a complete safetensors file"),
    ],
)  # fmt: skip
def test_a_prior(refused: Callable[..., str], tmp_path: Path, header: dict, size: int, problem: str):
    text = json.dumps(header).encode()
    with open(tmp_path / "x.safetensors", "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        file.truncate(8 + len(text) + size)  # a hole: no disk is taken
    assert problem in refused(tmp_path / "x.safetensors")


@pytest.mark.parametrize("name", ["x.csv", "x.txt", "x.json", "x.parquet", "x.pt", "x.mcap", "x.toml", "x.safetensors"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: os.symlink("/dev/zero", path)], ids=["pipe", "device"])
def test_what_is_no_file_is_refused_and_not_waited_for(
    refused: Callable[..., str], tmp_path: Path, name: str, make: Callable
):
    (tmp_path / "map.toml").write_text(MAP)
    make(tmp_path / name)
    columns = [tmp_path / "map.toml"] if name == "x.pt" else []
    assert "a pipe, a socket or a device, not a file" in refused(tmp_path / name, *columns)
