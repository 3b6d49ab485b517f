"""A third-party table becomes a motor log by a column map, or one error names what does not fit."""

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from motor_logs import TABLE_MAP

from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.column_map import TURN, load_column_map, shipped_maps
from motorprior.logs.motor_log import POSTURES
from motorprior.logs.read_log import read_log
from motorprior.robots.pupper_v2.robot import PUPPER_V2

ROWS = 50
PLAIN = f"{TABLE_MAP}[joints]\na = {{}}\nb = {{}}\n"
TICKS = """
motor = "servo"
robot = "arm"
encoder = "rotor"
time = "stamp"
segment = "episode"
posture = "suspended"
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
RNG = np.random.default_rng(0)
NAMES = [f"{kind}_{joint}" for kind in ("goal", "pos", "vel", "load") for joint in ("1", "2")]
COLUMNS = {"stamp": 20.0 * np.arange(ROWS), "episode": np.repeat([3, 4], ROWS // 2)}
COLUMNS |= {name: np.rint(1000 * RNG.standard_normal(ROWS)) for name in NAMES} | {
    "unused": np.zeros(ROWS)
}
TICK = TURN / 4096
RPM = TURN / 60


def write(path: Path, columns: dict[str, np.ndarray] = COLUMNS) -> Path:
    if path.suffix == ".parquet":
        pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path)
        return path
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    text = "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def a_map(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "columns.toml").write_text(text, encoding="utf-8")
    return folder / "columns.toml"


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz", "log.parquet"])
def test_units_signs_and_zeros_are_those_of_the_map(tmp_path: Path, name: str):
    log = read_log(write(tmp_path / name), columns=a_map(tmp_path, TICKS))
    assert (log.joint_names, log.robot, log.motor, log.encoder) == (
        ("pan", "lift"),
        "arm",
        "servo",
        "rotor",
    )
    np.testing.assert_allclose(log.time, 0.02 * np.arange(ROWS))
    np.testing.assert_allclose(log.joint_pos[:, 0], TICK * COLUMNS["pos_1"])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.5 - TICK * COLUMNS["pos_2"])
    np.testing.assert_allclose(log.position_target[:, 1], 0.5 - TICK * COLUMNS["goal_2"])
    assert log.joint_vel is not None and log.joint_torque is not None
    assert log.segment is not None and log.posture is not None
    np.testing.assert_allclose(log.joint_vel[:, 1], -RPM * COLUMNS["vel_2"])
    np.testing.assert_allclose(log.joint_torque[:, 0], 0.0980665 * COLUMNS["load_1"])
    assert log.segment.tolist() == COLUMNS["episode"].tolist()
    assert set(log.posture) == {POSTURES.index("suspended")}


def test_what_a_channel_states_counts_before_what_its_joint_states(tmp_path: Path):
    of_pan = 'name = "pan"\nsign = -1.0\nzero = 0.2\n[joints.1.position_target]\nsign = 1\n[joints.1.joint_vel]\n'
    of_lift = 'ticks_per_turn = 1024\n[joints.2.joint_pos]\nscale = 0.1\n[joints.2.joint_torque]\ntorque = "mN·m"'
    changes = ('name = "pan"', f"{of_pan}sign = 1\nscale = 3.0"), ("sign = -1\nzero = 0.5", of_lift)
    log = read_log(write(tmp_path / "log.csv"), columns=a_map(tmp_path, TICKS, *changes))
    assert log.joint_vel is not None and log.joint_torque is not None
    np.testing.assert_allclose(log.position_target[:, 0], 0.2 + TICK * COLUMNS["goal_1"])
    np.testing.assert_allclose(log.joint_pos[:, 0], 0.2 - TICK * COLUMNS["pos_1"])
    np.testing.assert_allclose(log.joint_vel[:, 0], 3.0 * COLUMNS["vel_1"])
    np.testing.assert_allclose(log.joint_torque[:, 0], -0.0980665 * COLUMNS["load_1"])
    np.testing.assert_allclose(log.position_target[:, 1], TURN / 1024 * COLUMNS["goal_2"])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.1 * COLUMNS["pos_2"])
    np.testing.assert_allclose(log.joint_torque[:, 1], 1e-3 * COLUMNS["load_2"])


def test_gains_of_the_map_hold_for_every_row(tmp_path: Path):
    gains = (
        ('name = "pan"', 'name = "pan"\nkp = 32\nkd = 0'),
        ("sign = -1", "sign = -1\nkp = 16\nkd = 2"),
    )
    path = write(tmp_path / "log.csv")
    log = read_log(path, columns=a_map(tmp_path, TICKS, *gains))
    assert (
        log.gains is not None
        and log.gains.tolist() == [[32.0, 16.0], [0.0, 2.0]]
        and log.gain_unit == "N·m/rad"
    )
    own = ('velocity = "rpm"', 'gain = "firmware"\nvelocity = "rpm"')
    assert read_log(path, columns=a_map(tmp_path, TICKS, *gains, own)).gain_unit == "firmware"


def test_conditions_are_columns_of_a_joint_or_of_all_or_numbers(tmp_path: Path):
    volts = 74.0 + np.arange(ROWS) % 3
    degrees = 30.0 + np.arange(ROWS) / ROWS
    path = write(
        tmp_path / "log.csv", COLUMNS | {"bus": volts, "temp_1": degrees, "temp_2": degrees + 5.0}
    )
    entries = 'supply_voltage = "bus"\nmotor_temperature = "temp_{joint}"\n[units]\nvoltage = "dV"'
    log = read_log(path, columns=a_map(tmp_path, TICKS, ("[units]", entries)))
    assert log.supply_voltage is not None and log.motor_temperature is not None
    np.testing.assert_allclose(log.supply_voltage, 0.1 * np.stack([volts, volts], axis=1))
    np.testing.assert_allclose(log.motor_temperature, np.stack([degrees, degrees + 5.0], axis=1))
    number = ("[units]", 'supply_voltage = 74\n[units]\nvoltage = "dV"')
    np.testing.assert_allclose(
        read_log(path, columns=a_map(tmp_path, TICKS, number)).operating_conditions[
            "supply_voltage"
        ],
        7.4,
    )


def test_joints_come_in_the_robots_order(tmp_path: Path):
    names = PUPPER_V2.joint_names[::-1]
    table = {"t": 0.01 * np.arange(ROWS)}
    table |= {
        f"{kind}_{name}": RNG.standard_normal(ROWS) for name in names for kind in ("goal", "pos")
    }
    text = PLAIN.split("[joints]")[0] + "[joints]\n" + "\n".join(f"{name} = {{}}" for name in names)
    path = write(tmp_path / "log.csv", table)
    log = read_log(path, PUPPER_V2, a_map(tmp_path, text))
    assert log.joint_names == PUPPER_V2.joint_names and log.robot == PUPPER_V2.name
    np.testing.assert_allclose(log.joint_pos[:, 0], table[f"pos_{PUPPER_V2.joint_names[0]}"])
    strange = a_map(tmp_path, text, (f"{names[0]} = {{}}", f'{names[0]} = {{ name = "tail" }}'))
    with pytest.raises(LogError, match=r"'tail'.*FR_hip"):
        read_log(path, PUPPER_V2, strange)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('motor = "servo"', "", "missing keys"),
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
def test_a_bad_map_is_rejected(tmp_path: Path, old: str, new: str, message: str):
    with pytest.raises(ArtifactError, match=r"columns\.toml") as error:
        load_column_map(a_map(tmp_path, PLAIN, (old, new)))
    assert message in str(error.value)


def test_a_column_that_is_there_twice_is_refused(tmp_path: Path):
    known = a_map(tmp_path, TICKS)
    path = write(tmp_path / "log.csv")
    path.write_text(path.read_text().replace("unused", "pos_2", 1))
    with pytest.raises(LogError, match="'pos_2'"):
        read_log(path, columns=known)


def test_shipped_maps_can_be_loaded():
    assert {"go2_identification", "so101_sage"} <= set(shipped_maps())
    for name in shipped_maps():
        assert load_column_map(name).joints
