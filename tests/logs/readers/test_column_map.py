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
from motorprior.logs.motor_log import POSTURES, settings_text
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
NAMES = [f"{channel}_{joint}" for channel in ("goal", "pos", "vel", "load") for joint in (1, 2)]
COLUMNS = {"stamp": 20.0 * np.arange(ROWS), "episode": np.repeat([3, 4], ROWS // 2)}
COLUMNS |= {name: np.rint(1000 * RNG.standard_normal(ROWS)) for name in NAMES}
COLUMNS |= {"unused": np.zeros(ROWS)}
TICK = TURN / 4096  # [rad]
RPM = TURN / 60  # [rad/s]


def write(path: Path, columns: dict[str, np.ndarray] = COLUMNS) -> Path:
    if path.suffix == ".parquet":
        arrays = {name: pa.array(values) for name, values in columns.items()}
        pq.write_table(pa.table(arrays), path)
        return path

    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns)]
    lines += [",".join(map(str, row)) for row in rows]
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)

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

    assert log.joint_names == ("pan", "lift")
    assert (log.robot, log.motor, log.encoder) == ("arm", "servo", "rotor")
    np.testing.assert_allclose(log.time, 0.02 * np.arange(ROWS))
    np.testing.assert_allclose(log.joint_pos[:, 0], TICK * COLUMNS["pos_1"])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.5 - TICK * COLUMNS["pos_2"])
    np.testing.assert_allclose(log.position_target[:, 1], 0.5 - TICK * COLUMNS["goal_2"])
    assert log.joint_vel is not None
    assert log.joint_torque is not None
    assert log.segment is not None
    assert log.posture is not None
    np.testing.assert_allclose(log.joint_vel[:, 1], -RPM * COLUMNS["vel_2"])
    np.testing.assert_allclose(log.joint_torque[:, 0], 0.0980665 * COLUMNS["load_1"])
    assert log.segment.tolist() == COLUMNS["episode"].tolist()
    assert set(log.posture) == {POSTURES.index("suspended")}


def test_an_entry_of_a_channel_overrides_the_entry_of_its_joint(tmp_path: Path):
    of_pan = (
        'name = "pan"\nsign = -1.0\nzero = 0.2\n'
        "[joints.1.position_target]\nsign = 1\n"
        "[joints.1.joint_vel]\nsign = 1\nscale = 3.0"
    )
    of_lift = (
        "ticks_per_turn = 1024\n"
        "[joints.2.joint_pos]\nscale = 0.1\n"
        '[joints.2.joint_torque]\ntorque = "mN·m"'
    )
    changes = [('name = "pan"', of_pan), ("sign = -1\nzero = 0.5", of_lift)]

    log = read_log(write(tmp_path / "log.csv"), columns=a_map(tmp_path, TICKS, *changes))
    assert log.joint_vel is not None
    assert log.joint_torque is not None
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
    assert log.gains is not None
    assert log.gains.tolist() == [[32.0, 16.0], [0.0, 2.0]]
    assert log.gain_unit == "N·m/rad"

    unit = ('velocity = "rpm"', 'gain = "firmware"\nvelocity = "rpm"')

    assert read_log(path, columns=a_map(tmp_path, TICKS, *gains, unit)).gain_unit == "firmware"


def test_operating_conditions_are_columns_of_one_or_all_joints_or_numbers(tmp_path: Path):
    decivolts = 74.0 + np.arange(ROWS) % 3
    degrees = 30.0 + np.arange(ROWS) / ROWS  # [°C]
    columns = {"bus": decivolts, "temp_1": degrees, "temp_2": degrees + 5.0}
    path = write(tmp_path / "log.csv", COLUMNS | columns)
    entries = 'supply_voltage = "bus"\nmotor_temperature = "temp_{joint}"\n[units]\nvoltage = "dV"'
    log = read_log(path, columns=a_map(tmp_path, TICKS, ("[units]", entries)))
    assert log.supply_voltage is not None
    assert log.motor_temperature is not None
    np.testing.assert_allclose(log.supply_voltage, 0.1 * np.stack([decivolts] * 2, axis=1))
    np.testing.assert_allclose(log.motor_temperature, np.stack([degrees, degrees + 5.0], axis=1))

    number = ("[units]", 'supply_voltage = 74\n[units]\nvoltage = "dV"')
    log = read_log(path, columns=a_map(tmp_path, TICKS, number))

    np.testing.assert_allclose(log.operating_conditions["supply_voltage"], 7.4)


def test_joints_are_in_the_order_of_the_robot(tmp_path: Path):
    names = PUPPER_V2.joint_names[::-1]
    table = {"t": 0.01 * np.arange(ROWS)}

    for name in names:
        table[f"goal_{name}"] = RNG.standard_normal(ROWS)
        table[f"pos_{name}"] = RNG.standard_normal(ROWS)

    entries = "\n".join(f"{name} = {{}}" for name in names)
    text = f"{TABLE_MAP}[joints]\n{entries}"
    path = write(tmp_path / "log.csv", table)
    log = read_log(path, PUPPER_V2, a_map(tmp_path, text))

    assert log.joint_names == PUPPER_V2.joint_names
    assert log.robot == PUPPER_V2.name
    np.testing.assert_allclose(log.joint_pos[:, 0], table[f"pos_{PUPPER_V2.joint_names[0]}"])

    strange = a_map(tmp_path, text, (f"{names[0]} = {{}}", f'{names[0]} = {{ name = "tail" }}'))

    with pytest.raises(LogError, match=r"'tail'.*FR_hip"):
        read_log(path, PUPPER_V2, strange)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('motor = "servo"', "", "motor"),
        ('time = "t"', "", "time"),
        ("goal_{joint}", "goal", "{joint}"),
        ("a = {}", "a = {sign = 2}", "sign = 2"),
        ("a = {}", 'a = {name = "b"}', "'b'"),
        ("[joints]", '[units]\nangle = "tick"\n[joints]', "ticks_per_turn"),
        ("[joints]", '[units]\nangle = "grad"\n[joints]', "angle = 'grad'"),
        ("[joints]", "[joints", "TOML"),
        ("a = {}", "a = {kp = 3}", "'b' lacks kp"),
        ("[joints]", "kp = -3\n[joints]", "kp = -3"),
        ("[joints]", "kp = true\n[joints]", "kp = True"),
    ],
)
def test_an_invalid_map_is_refused_by_its_key_and_value(
    tmp_path: Path, old: str, new: str, message: str
):
    with pytest.raises(ArtifactError, match=r"columns\.toml") as error:
        load_column_map(a_map(tmp_path, PLAIN, (old, new)))
    assert message in str(error.value)


def test_a_repeated_column_is_refused(tmp_path: Path):
    column_map = a_map(tmp_path, TICKS)
    path = write(tmp_path / "log.csv")
    path.write_text(path.read_text().replace("unused", "pos_2", 1))

    with pytest.raises(LogError, match="'pos_2'"):
        read_log(path, columns=column_map)


def test_a_number_is_the_gain_of_every_joint_that_states_none(tmp_path: Path):
    path = a_map(
        tmp_path, PLAIN, ("[joints]", "kp = 35\nkd = 1\n[joints]"), ("b = {}", "b = {kp = 3}")
    )

    joints = load_column_map(path).joints

    assert [(joint.kp, joint.kd) for joint in joints] == [(35, 1), (3, 1)]


def test_a_map_without_joints_reads_those_of_the_robot(tmp_path: Path):
    column_map = a_map(tmp_path, TABLE_MAP, ('motor = "servo"', 'motor = "servo"\nkp = 35'))
    columns = {"t": 0.02 * np.arange(ROWS)}
    for name in PUPPER_V2.joint_names:
        columns |= {f"goal_{name}": COLUMNS["goal_1"], f"pos_{name}": COLUMNS["pos_1"]}
    path = write(tmp_path / "log.csv", columns)

    log = read_log(path, PUPPER_V2, column_map)

    assert log.joint_names == PUPPER_V2.joint_names
    assert log.logged_kp is not None
    np.testing.assert_array_equal(log.logged_kp, 35.0)
    with pytest.raises(ArtifactError, match=r"no joints -> give robot, or .*\[joints"):
        read_log(path, columns=column_map)

    shared = a_map(tmp_path, TABLE_MAP, ("goal_{joint}", "goal"))
    with pytest.raises(ArtifactError, match=r"'goal' lacks \{joint\}"):
        read_log(path, PUPPER_V2, shared)


def test_shipped_maps_can_be_loaded():
    assert {"go2_identification", "so101_sage"} <= set(shipped_maps())
    for name in shipped_maps():
        assert load_column_map(name).joints


BASE_ROWS = 50
BASE_DEGREES = 'base = "deg"\n'
BASE_MAP = (
    'motor = "m"\ntime = "t"\nposition_target = "goal"\njoint_pos = "pos"\n{base}\n'
    '[units]\nangle = "deg"\n{unit}[joints.a]\n'
)


@pytest.mark.parametrize(
    ("base", "unit"),
    [
        ("base_roll = 0\nbase_pitch = 20", BASE_DEGREES),
        ('base_roll = "roll"\nbase_pitch = "pitch"', BASE_DEGREES),
        ('base_quaternion = ["w", "x", "y", "z"]', ""),
        ('base_quaternion = ["x", "y", "z", "w"]\nquaternion_order = "xyzw"', ""),
    ],
    ids=["numbers", "columns", "quaternion", "scalar_last"],
)
def test_the_orientation_of_the_base_is_read_in_every_form(tmp_path: Path, base: str, unit: str):
    pitch = np.deg2rad(20.0)
    time = 0.01 * np.arange(BASE_ROWS)
    quaternion = [np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0]
    constants = np.tile([0.0, 20.0, *quaternion], (BASE_ROWS, 1))
    table = np.column_stack([time, 10.0 * np.sin(time), 9.0 * np.sin(time), constants])
    head = "t,goal,pos,roll,pitch,w,x,y,z"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=head, comments="")
    columns = tmp_path / "map.toml"
    columns.write_text(BASE_MAP.format(base=base, unit=unit))

    log = read_log(tmp_path / "log.csv", columns=columns)

    assert log.base_orientation is not None
    np.testing.assert_allclose(log.base_orientation, [[0.0, pitch]] * BASE_ROWS, atol=1e-12)
    assert "base at roll 0.0°, pitch 20.0°" in settings_text(log)


@pytest.mark.parametrize("name", ["base_roll", "base_pitch"])
def test_roll_and_pitch_beside_angles_in_degrees_need_their_own_unit(tmp_path: Path, name: str):
    (tmp_path / "map.toml").write_text(BASE_MAP.format(base=f"{name} = 0.35", unit=""))

    with pytest.raises(ArtifactError, match=f"{name} has no unit") as refused:
        load_column_map(tmp_path / "map.toml")

    assert 'base = "rad"' in str(refused.value.remedy)


QUATERNION = 'base_quaternion = ["w", "x", "y", "z"]'


@pytest.mark.parametrize(
    ("base", "unit", "problem"),
    [
        ('quaternion_order = "xyzw"', "", "quaternion_order without base_quaternion"),
        ("", BASE_DEGREES, r"\[units\]: base without base_roll or base_pitch"),
        (QUATERNION, BASE_DEGREES, r"\[units\]: base without base_roll or base_pitch"),
    ],
)
def test_what_states_the_form_of_an_orientation_that_is_not_given_is_refused(
    tmp_path: Path, base: str, unit: str, problem: str
):
    (tmp_path / "map.toml").write_text(BASE_MAP.format(base=base, unit=unit))

    with pytest.raises(ArtifactError, match=problem) as refused:
        load_column_map(tmp_path / "map.toml")

    assert refused.value.remedy == "leave it out"


MOTEUS = (
    'motor = "moteus"\nrate = 100\nposition_target = "c"\nvelocity_target = "dc"\n'
    'joint_pos = "q"\nkp = 100\nkd = "kd"\n[units]\nangle = "turn"\n'
)


def test_turns_turns_per_second_and_gains_per_turn_become_si_units(tmp_path: Path):
    turns = np.sin(0.1 * np.arange(BASE_ROWS))
    columns = tmp_path / "map.toml"
    columns.write_text(MOTEUS + 'velocity = "turn/s"\ngain = "N·m/turn"\n[joints.a]\n')
    np.savez(tmp_path / "log.npz", c=turns, dc=turns, q=turns - 0.01, kd=np.full(BASE_ROWS, 2.0))

    log = read_log(tmp_path / "log.npz", columns=columns)

    turn = 2.0 * np.pi
    assert log.velocity_target is not None
    assert log.gains is not None
    np.testing.assert_allclose(log.velocity_target[:, 0], turn * turns)
    np.testing.assert_allclose(log.gains[:, 0], [100.0 / turn, 2.0 / turn])
    assert log.gain_unit == "N·m/rad"


def test_velocities_beside_angles_in_turns_need_their_own_unit(tmp_path: Path):
    (tmp_path / "map.toml").write_text(MOTEUS + "[joints.a]\n")

    with pytest.raises(ArtifactError, match="velocity_target has no unit") as refused:
        load_column_map(tmp_path / "map.toml")

    assert "turn/s" in str(refused.value.remedy)


VELOCITY_MAP = (
    'motor = "m"\nrate = 100\nposition_target = "c_{joint}"\nvelocity_target = "dc_{joint}"\n'
    'joint_pos = "q_{joint}"\n'
)


@pytest.mark.parametrize(
    "joint",
    [
        '[joints.a]\nangle = "deg"\n',
        '[joints.a.joint_pos]\nangle = "deg"\n',
        '[joints.b]\nangle = "rad"\n[joints.a.position_target]\nangle = "deg"\n',
    ],
)
def test_velocities_need_a_unit_if_the_angles_of_one_joint_are_in_degrees(
    tmp_path: Path, joint: str
):
    columns = tmp_path / "map.toml"
    columns.write_text(VELOCITY_MAP + joint)

    with pytest.raises(ArtifactError, match=r"\[joints.a\]: velocity_target has no unit.* in deg"):
        load_column_map(columns)

    columns.write_text(f'{VELOCITY_MAP}{joint}[joints.a.velocity_target]\nvelocity = "deg/s"\n')
    joints = load_column_map(columns).joints
    conversions = next(item.conversions for item in joints if item.column == "a")
    assert conversions["velocity_target"].factor == pytest.approx(TURN / 360)


def test_velocities_of_a_joint_with_its_own_angles_in_radians_need_no_unit(tmp_path: Path):
    columns = tmp_path / "map.toml"
    columns.write_text(f'{VELOCITY_MAP}[units]\nangle = "deg"\n[joints.a]\nangle = "rad"\n')

    assert load_column_map(columns).joints[0].conversions["velocity_target"].factor == 1.0


@pytest.mark.parametrize("joint", ["[joints]\na = 3\n", "[joints.a]\nvelocity_target = 3\n"])
def test_a_joint_that_is_no_table_is_refused_beside_velocities_without_a_unit(
    tmp_path: Path, joint: str
):
    (tmp_path / "map.toml").write_text(f'{VELOCITY_MAP}[units]\nangle = "deg"\n{joint}')

    with pytest.raises(ArtifactError, match=r"\b3\b.*table|table.*\b3\b"):
        load_column_map(tmp_path / "map.toml")
