"""Whatever is done to a file, reading it ends in a log or in one LogError that names it."""

import gzip
import json
import random
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from foreign_files import (
    ANGLE,
    JOINTS,
    ROWS,
    TIME,
    write_bam,
    write_csv,
    write_lerobot,
    write_parquet,
    write_pt,
    write_sage,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog

WRITERS = {
    "bam": write_bam, "sage": write_sage, "lerobot": write_lerobot, "pt": write_pt, "csv": write_csv,
    "parquet": write_parquet,
}  # fmt: skip


def read(path: Path) -> MotorLog:
    columns = path.parent / "columns.toml"
    return read_log(path, columns=columns if columns.is_file() else None)


def files_of(path: Path) -> list[Path]:
    return [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())


def reads_or_says_why(path: Path) -> MotorLog | None:
    try:
        log = read(path)
    except LogError as error:
        text = str(error)
        assert path.name in text and "\n" not in text and len(text) < 1000
        return None
    assert all(np.isfinite(getattr(log, name)).all() for name in ("time", "position_target", "joint_pos"))
    check_log(log)
    return log


@pytest.fixture(scope="module", params=WRITERS)
def sample(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return WRITERS[request.param](tmp_path_factory.mktemp(request.param))


@given(which=st.integers(0, 3), share=st.floats(0.0, 1.0, exclude_max=True))
@settings(max_examples=25, deadline=None)
def test_truncated(sample: Path, which: int, share: float):
    with tempfile.TemporaryDirectory() as folder:
        path = copied(sample, folder)
        files = files_of(path)
        file = files[which % len(files)]
        data = file.read_bytes()
        file.write_bytes(data[: int(share * len(data))])
        log = reads_or_says_why(path)
        assert log is None or log.num_rows <= ROWS


@given(which=st.integers(0, 3), share=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
@settings(max_examples=25, deadline=None)
def test_a_changed_byte(sample: Path, which: int, share: float, byte: int):
    with tempfile.TemporaryDirectory() as folder:
        path = copied(sample, folder)
        files = files_of(path)
        file = files[which % len(files)]
        data = bytearray(file.read_bytes())
        data[int(share * len(data))] = byte
        file.write_bytes(data)
        reads_or_says_why(path)


def copied(sample: Path, folder: str) -> Path:
    for extra in sample.parent.iterdir():
        if extra.is_dir():
            shutil.copytree(extra, Path(folder) / extra.name)
        else:
            shutil.copy(extra, folder)
    return Path(folder) / sample.name


def entries() -> list[dict[str, object]]:
    rows = zip(TIME.tolist(), ANGLE[:, 0].tolist(), strict=True)
    return [{"timestamp": t, "goal_position": q, "position": q, "speed": 0.0, "torque_enable": True} for t, q in rows]


VALUES = st.one_of(
    st.none(), st.booleans(), st.text(max_size=5), st.floats(), st.integers(), st.lists(st.integers(), max_size=2)
)


@given(
    row=st.integers(0, ROWS - 1),
    name=st.sampled_from(["timestamp", "goal_position", "position", "speed", "torque_enable"]),
    value=VALUES,
)
@settings(max_examples=60, deadline=None)
def test_a_strange_value_of_a_pendulum(tmp_path_factory: pytest.TempPathFactory, row: int, name: str, value: object):
    some = entries()
    some[row][name] = value
    log = reads_or_says_why(write_bam(tmp_path_factory.mktemp("bam"), entries=some))
    if name != "torque_enable" and not (isinstance(value, float | int) and not isinstance(value, bool)):
        assert log is None


@given(name=st.sampled_from(["mass", "length", "kp", "motor", "entries"]), value=VALUES)
@settings(max_examples=60, deadline=None)
def test_a_strange_head_of_a_pendulum(tmp_path_factory: pytest.TempPathFactory, name: str, value: object):
    log = reads_or_says_why(write_bam(tmp_path_factory.mktemp("bam"), **{name: value}))
    good = {"motor": isinstance(value, str), "entries": False}
    number = isinstance(value, float | int) and not isinstance(value, bool) and value > 0
    assert log is None or good.get(name, number)


@given(seed=st.integers(1, 1000))
@settings(max_examples=15, deadline=None)
def test_shuffled_rows_are_refused(tmp_path_factory: pytest.TempPathFactory, seed: int):
    folder, mixed = tmp_path_factory.mktemp("mixed"), np.random.default_rng(seed).permutation(ROWS)
    if np.all(np.diff(mixed) > 0):
        return
    some = entries()
    path = write_bam(folder, entries=[some[row] for row in mixed])
    with pytest.raises(LogError, match="time runs backwards"):
        read(path)
    sage = write_sage(folder)
    for name in ("control.csv", "state_motor.csv"):
        write_sage(folder)
        head, *lines = (sage / name).read_text().splitlines()
        (sage / name).write_text("\n".join([head, *(lines[row] for row in mixed)]) + "\n")
        with pytest.raises(LogError, match="time"):
            read(sage)
    with pytest.raises(LogError, match=r"time|starts again"):
        read(write_lerobot(folder, timestamp=TIME[mixed], episode_index=np.zeros(ROWS, dtype=int)))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_are_refused_with_their_row(tmp_path: Path, value: float):
    some = entries()
    some[7]["position"] = value
    with pytest.raises(LogError, match=r"swing\.json\.gz: row 7, position is"):
        read(write_bam(tmp_path, entries=some))
    angle = ANGLE.copy()
    angle[25, 1] = value
    with pytest.raises(LogError, match=r"row 25, joint_pos/lift \(column observation\.state\[1\]\) is"):
        read(write_lerobot(tmp_path, **{"observation.state": list(angle)}))
    sage = write_sage(tmp_path)
    text = (sage / "state_motor.csv").read_text().splitlines()
    text[9] = text[9].replace(str(ANGLE[8, 0]), str(value))
    (sage / "state_motor.csv").write_text("\n".join(text))
    with pytest.raises(LogError, match=r"state_motor\.csv: row 8, positions\[0\] is"):
        read(sage)


def test_files_under_each_others_names_are_refused(tmp_path: Path):
    sage = write_sage(tmp_path)
    shutil.copy(sage / "state_motor.csv", sage / "control.csv")
    with pytest.raises(LogError, match=r"control\.csv: row 0 is of type 'STATE_MOTOR'"):
        read(sage)
    write_sage(tmp_path)
    (sage / "joint_list.txt").write_text("pan\nlift\ntail\n")
    with pytest.raises(LogError, match="2 values for 3 joints"):
        read(sage)
    pendulum = tmp_path / "a.json"
    pendulum.write_text(json.dumps({"codebase_version": "v3.0"}))
    with pytest.raises(LogError, match=r"a\.json: no table with a list of entries"):
        read(pendulum)
    (tmp_path / "b.json.gz").write_bytes(gzip.compress(b"[" * 100_000))
    with pytest.raises(LogError, match="not JSON"):
        read(tmp_path / "b.json.gz")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="a folder, and no log by itself"):
        read(tmp_path / "empty")
    (tmp_path / "notes.docx").touch()
    with pytest.raises(LogError, match="not a log that can be read"):
        read(tmp_path / "notes.docx")


def test_wrong_units_are_found(tmp_path: Path):
    some = entries()
    for entry in some:
        entry["position"] = 180.0 * ANGLE[0, 0] + 57.3 * random.Random(0).random() + 5.0 * TIME[0]
        entry["goal_position"] = 57.3
    assert {finding.check for finding in check_log(read(write_bam(tmp_path, entries=some))).findings} >= {"units"}
    degrees = read(write_lerobot(tmp_path, action=list(1e3 * ANGLE), **{"observation.state": list(1e3 * ANGLE)}))
    assert {finding.joint for finding in check_log(degrees).of("units")} == set(JOINTS)
