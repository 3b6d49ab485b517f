"""A third-party table becomes a motor log by a column map, or one error names what does not fit."""

import gzip
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.column_map import load_column_map, shipped_maps
from motorprior.logs.column_units import TURN
from motorprior.logs.read_log import read_log
from motorprior.robots.pupper_v2.robot import PUPPER_V2

ROWS = 50
PLAIN = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"

[joints]
a = {}
b = {}
"""
TICKS = """
motor = "servo"
robot = "arm"
encoder = "rotor"
time = "stamp"
segment = "episode"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joint_vel = "vel_{joint}"
joint_torque = "load_{joint}"

[units]
time = "ms"
angle = "tick"
ticks_per_turn = 4096
velocity = "rpm"
torque = "kg·cm"

[joints.1]
name = "pan"
[joints.2]
name = "lift"
sign = -1
zero = 0.5
"""


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    names = [f"{kind}_{joint}" for kind in ("goal", "pos", "vel", "load") for joint in ("1", "2")]
    table = {"stamp": 20.0 * np.arange(ROWS), "episode": np.repeat([3, 4], ROWS // 2)}
    return table | {name: np.rint(1000 * rng.standard_normal(ROWS)) for name in names} | {"unused": np.zeros(ROWS)}


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    if path.suffix == ".parquet":
        pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path)
        return path
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    text = "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def a_map(folder: Path, text: str) -> Path:
    path = folder / "columns.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz", "log.parquet"])
def test_units_signs_and_zeros_are_those_of_the_map(tmp_path: Path, columns: dict[str, np.ndarray], name: str):
    log = read_log(write(tmp_path / name, columns), columns=a_map(tmp_path, TICKS))
    assert (log.joint_names, log.robot, log.motor, log.encoder) == (("pan", "lift"), "arm", "servo", "rotor")
    tick, rpm = TURN / 4096, TURN / 60
    np.testing.assert_allclose(log.time, 0.02 * np.arange(ROWS))
    np.testing.assert_allclose(log.joint_pos[:, 0], tick * columns["pos_1"])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.5 - tick * columns["pos_2"])
    np.testing.assert_allclose(log.position_target[:, 1], 0.5 - tick * columns["goal_2"])
    assert log.joint_vel is not None and log.joint_torque is not None and log.segment is not None
    np.testing.assert_allclose(log.joint_vel[:, 1], -rpm * columns["vel_2"])
    np.testing.assert_allclose(log.joint_torque[:, 0], 0.0980665 * columns["load_1"])
    assert log.segment.tolist() == columns["episode"].tolist()


def test_gains_of_the_map_hold_for_every_row(tmp_path: Path, columns: dict[str, np.ndarray]):
    text = TICKS.replace('name = "pan"', 'name = "pan"\nkp = 32\nkd = 0').replace(
        "sign = -1", "sign = -1\nkp = 16\nkd = 2"
    )
    path = write(tmp_path / "log.csv", columns)
    log = read_log(path, columns=a_map(tmp_path, text))
    assert log.stated_kp is not None and log.stated_kd is not None and log.gain_unit == "N·m/rad"
    assert set(map(tuple, log.stated_kp)) == {(32.0, 16.0)} and set(map(tuple, log.stated_kd)) == {(0.0, 2.0)}
    own = read_log(
        path, columns=a_map(tmp_path, text.replace('velocity = "rpm"', 'gain = "firmware"\nvelocity = "rpm"'))
    )
    assert own.gain_unit == "firmware"
    assert read_log(path, columns=a_map(tmp_path, TICKS)).stated_kp is None


def test_conditions_are_columns_of_a_joint_or_of_all_or_numbers(tmp_path: Path, columns: dict[str, np.ndarray]):
    volts, degrees = 74.0 + np.arange(ROWS) % 3, 30.0 + np.arange(ROWS) / ROWS
    path = write(tmp_path / "log.csv", columns | {"bus": volts, "temp_1": degrees, "temp_2": degrees + 5.0})
    said = 'supply_voltage = "bus"\nmotor_temperature = "temp_{joint}"\n[units]\nvoltage = "dV"'
    log = read_log(path, columns=a_map(tmp_path, TICKS.replace("[units]", said)))
    assert log.supply_voltage is not None and log.motor_temperature is not None
    np.testing.assert_allclose(log.supply_voltage, 0.1 * np.stack([volts, volts], axis=1))
    np.testing.assert_allclose(log.motor_temperature, np.stack([degrees, degrees + 5.0], axis=1))
    tenths = read_log(
        path, columns=a_map(tmp_path, TICKS.replace("[units]", 'supply_voltage = 74\n[units]\nvoltage = "dV"'))
    )
    assert tenths.supply_voltage is not None and np.allclose(tenths.supply_voltage, 7.4)
    same = read_log(path, columns=a_map(tmp_path, TICKS.replace("[units]", "supply_voltage = 12\n[units]")))
    assert same.supply_voltage is not None and same.motor_temperature is None
    assert same.supply_voltage.tolist() == [[12.0, 12.0]] * ROWS


def test_a_number_of_a_column_of_lists_is_a_joint(tmp_path: Path):
    rng = np.random.default_rng(1)
    goal, pos = 90 * rng.standard_normal((2, ROWS, 2))
    table = pa.table({"t": np.arange(ROWS) / 30.0, "action": list(goal), "state": list(pos)})
    pq.write_table(table, tmp_path / "episode.parquet")
    text = PLAIN.replace("goal_{joint}", "action[{joint}]").replace("pos_{joint}", "state[{joint}]")
    text = text.replace("a = {}", '0 = {name = "pan"}').replace("b = {}", '1 = {name = "lift"}')
    text = text.replace("[joints]", '[units]\nangle = "deg"\n[joints]')
    log = read_log(tmp_path / "episode.parquet", columns=a_map(tmp_path, text))
    np.testing.assert_allclose(log.position_target, np.deg2rad(goal))
    np.testing.assert_allclose(log.joint_pos, np.deg2rad(pos))
    missing = a_map(tmp_path, text.replace("1 = {", "7 = {"))
    with pytest.raises(LogError, match="action"):
        read_log(tmp_path / "episode.parquet", columns=missing)


def test_joints_come_in_the_robots_order(tmp_path: Path):
    names = PUPPER_V2.joint_names[::-1]
    rng = np.random.default_rng(2)
    table = {"t": 0.01 * np.arange(ROWS)}
    table |= {f"{kind}_{name}": rng.standard_normal(ROWS) for name in names for kind in ("goal", "pos")}
    text = PLAIN.split("[joints]")[0] + "[joints]\n" + "\n".join(f"{name} = {{}}" for name in names)
    path, columns = write(tmp_path / "log.csv", table), a_map(tmp_path, text)
    log = read_log(path, PUPPER_V2, columns)
    assert log.joint_names == PUPPER_V2.joint_names and log.robot == PUPPER_V2.name
    np.testing.assert_allclose(log.joint_pos[:, 0], table[f"pos_{PUPPER_V2.joint_names[0]}"])
    strange = a_map(tmp_path, text.replace(f"{names[0]} = {{}}", f'{names[0]} = {{ name = "tail" }}'))
    with pytest.raises(LogError, match=r"'tail'.*remove its table, or give its key name"):
        read_log(path, PUPPER_V2, strange)


@pytest.mark.parametrize(("said", "of_robot", "expected"), [("rotor", "joint", "rotor"), ("", "rotor", "rotor")])
def test_the_encoder_is_that_of_the_map_or_else_of_the_robot(
    tmp_path: Path, columns: dict[str, np.ndarray], said: str, of_robot: str, expected: str
):
    path = write(tmp_path / "log.csv", columns)
    known = a_map(tmp_path, TICKS.replace('encoder = "rotor"', f'encoder = "{said}"' if said else ""))
    arm: Any = SimpleNamespace(name="arm", joint_names=("pan", "lift"), encoder=of_robot)
    assert read_log(path, arm, known).encoder == expected
    assert read_log(path, columns=known).encoder == (said or "joint")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('motor = "servo"', "", "missing keys"),
        ('time = "t"', 'time = "t"\nspeed = "v"', "speed"),
        ('time = "t"', "", "neither time"),
        ("goal_{joint}", "goal", "lacks {joint}"),
        ("a = {}", "a = {sign = 2}", "sign = 2"),
        ("a = {}", 'a = {name = "b"}', "two joints are named 'b'"),
        ("[joints]", '[units]\nangle = "tick"\n[joints]', "ticks_per_turn"),
        ("[joints]", '[units]\nangle = "grad"\n[joints]', "angle = 'grad'"),
        ("[joints]", "[joints", "not valid TOML"),
        ("a = {}", "a = {kp = 3}", "joint 'b' lacks kp"),
    ],
)
def test_a_bad_map_is_rejected(tmp_path: Path, old: str, new: str, said: str):
    assert old in PLAIN
    with pytest.raises(ArtifactError, match=r"columns\.toml") as error:
        load_column_map(a_map(tmp_path, PLAIN.replace(old, new)))
    assert said in str(error.value)


def test_a_column_that_is_missing_or_twice_is_refused(tmp_path: Path, columns: dict[str, np.ndarray]):
    known = a_map(tmp_path, TICKS)
    some = {name: values for name, values in columns.items() if name != "pos_2"}
    with pytest.raises(LogError, match="no column 'pos_2'"):
        read_log(write(tmp_path / "log.csv", some), columns=known)
    path = write(tmp_path / "log.csv", columns)
    path.write_text(path.read_text().replace("unused", "pos_2", 1))
    with pytest.raises(LogError, match="more than one column 'pos_2'"):
        read_log(path, columns=known)
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "nowhere.csv", columns=known)


def test_shipped_maps_can_be_loaded():
    assert {"go2_identification", "so101_sage"} <= set(shipped_maps())
    for name in shipped_maps():
        assert load_column_map(name).joints


def test_shipped_maps_read_the_logs_that_they_are_for(shared_data: Path):
    go2 = read_log(shared_data / "go2" / "traj_0.csv.gz", columns="go2_identification")
    assert go2.joint_pos.shape == (4781, 12) and go2.joint_names[2] == "FL_calf_joint"
    assert np.sqrt(np.mean((go2.position_target - go2.joint_pos) ** 2)) < 0.1
    arm = read_log(shared_data / "so101" / "chirp_sweep.csv.gz", columns="so101_sage")
    assert arm.num_joints == 6 and arm.joint_torque is None
    assert 0.019 < np.median(np.diff(arm.time)) < 0.021


def test_columns_of_a_single_joint_need_no_placeholder(tmp_path: Path):
    text = PLAIN.replace("goal_{joint}", "goal").replace("pos_{joint}", "angle").replace("b = {}", "")
    angle = np.sin(np.arange(ROWS))
    path = write(tmp_path / "log.csv", {"t": np.arange(ROWS), "goal": -angle, "angle": angle})
    np.testing.assert_array_equal(read_log(path, columns=a_map(tmp_path, text)).joint_pos[:, 0], angle)
