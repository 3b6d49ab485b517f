"""Files of other projects become motor logs with exact values, loads and segments."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from third_party_files import (
    ANGLE,
    JOINTS,
    ROWS,
    TARGET,
    TIME,
    Storage,
    Tensor,
    write_bam,
    write_lerobot,
    write_pt,
    write_sage,
    write_tensors,
)

from motorprior.exceptions import LogError
from motorprior.logs.column_map import load_column_map
from motorprior.logs.motor_log import channels
from motorprior.logs.read_log import read_log
from motorprior.logs.readers.bam import GRAVITY
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def assert_same(log, table, tolerance):
    for name in ("time", "position_target", "joint_pos"):
        np.testing.assert_allclose(getattr(log, name), getattr(table, name), rtol=0, atol=tolerance)


def test_a_log_of_a_pendulum_has_its_load(tmp_path: Path):
    path = write_bam(tmp_path)
    log = read_log(path, PUPPER_V2)

    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE[:, 0])
    np.testing.assert_array_equal(log.position_target[:, 0], TARGET[:, 0])
    assert log.load_inertia is not None
    assert log.external_torque is not None
    np.testing.assert_allclose(log.load_inertia, 0.5 * 0.1**2)
    np.testing.assert_allclose(
        log.external_torque[:, 0], -0.5 * GRAVITY * 0.1 * np.sin(ANGLE[:, 0])
    )
    assert (log.joint_names, log.motor, log.gain_unit) == (("pendulum",), "xl330", "firmware")
    assert log.logged_kp is not None
    assert set(log.logged_kp[:, 0]) == {100.0}


def test_a_pendulum_states_the_stall_torque_of_a_known_motor(tmp_path: Path):
    (model,) = read_log(write_bam(tmp_path)).motor_models
    assert model.torque_limit is not None
    assert model.torque_limit.value == 0.52
    assert read_log(write_bam(tmp_path, motor="unknown")).motor_models == ()


def test_a_pendulum_has_the_voltage_and_temperature_of_its_rows_or_else_its_supply(tmp_path: Path):
    supplied = read_log(write_bam(tmp_path))
    assert supplied.supply_voltage is not None
    assert supplied.motor_temperature is None
    assert set(supplied.supply_voltage[:, 0]) == {7.4}

    entry = {"position": 0.1, "goal_position": 0.2, "temp": 31}
    rows = [entry | {"timestamp": 0.01 * row, "input_volts": 7.0 + 0.1 * row} for row in range(4)]
    measured = read_log(write_bam(tmp_path, entries=rows))
    assert measured.supply_voltage is not None
    assert measured.motor_temperature is not None
    np.testing.assert_allclose(measured.supply_voltage[:, 0], [7.0, 7.1, 7.2, 7.3])
    assert set(measured.motor_temperature[:, 0]) == {31.0}

    rows[2] |= {"input_volts": 0, "temp": None}
    log = read_log(write_bam(tmp_path, entries=rows))
    assert log.supply_voltage is not None
    assert set(log.supply_voltage[:, 0]) == {7.4}
    assert log.motor_temperature is None


def test_rows_without_torque_are_cut_out_and_counted(tmp_path: Path):
    whole = []
    for time in TIME.tolist():
        entry = {"timestamp": time, "goal_position": 0.0, "position": 0.1 * time, "speed": 0.1}
        whole.append(entry)

    off = set(range(10, 15)) | {16}  # row 15 alone is too short for a segment
    entries = [entry | {"torque_enable": row not in off} for row, entry in enumerate(whole)]
    log = read_log(write_bam(tmp_path, entries=entries))
    assert log.segment is not None
    assert log.segment.tolist() == [0] * 10 + [1] * 23
    np.testing.assert_array_equal(log.time, TIME[[*range(10), *range(17, 40)]])
    assert log.source.endswith("(7 rows without torque left out)")

    all_off = [entry | {"torque_enable": False} for entry in whole]

    with pytest.raises(LogError, match="every row"):
        read_log(write_bam(tmp_path, entries=all_off))


def test_the_files_of_a_sage_folder_are_merged_by_time(tmp_path: Path):
    log = read_log(write_sage(tmp_path), PUPPER_V2)

    assert log.joint_names == JOINTS
    assert log.joint_torque is None
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(log.joint_pos, ANGLE)
    np.testing.assert_array_equal(log.position_target, TARGET)

    late = read_log(write_sage(tmp_path, control_late=0.005))

    np.testing.assert_array_equal(late.position_target, TARGET[:-1])
    np.testing.assert_array_equal(late.joint_pos, ANGLE[1:])


def test_an_episode_of_lerobot_is_a_segment(tmp_path: Path):
    log = read_log(write_lerobot(tmp_path), PUPPER_V2)

    assert (log.joint_names, log.robot) == (JOINTS, "arm")
    assert log.segment is not None
    assert log.segment.tolist() == [0] * (ROWS // 2) + [1] * (ROWS // 2)
    np.testing.assert_allclose(log.joint_pos, ANGLE, atol=1e-6)
    np.testing.assert_allclose(log.position_target, TARGET, atol=1e-6)

    arm: Any = SimpleNamespace(name="mine", joint_names=JOINTS[::-1], encoder="rotor")
    in_order_of_robot = read_log(tmp_path / "dataset", arm)

    np.testing.assert_array_equal(in_order_of_robot.joint_pos, log.joint_pos[:, ::-1])


def test_lerobot_and_sage_record_the_registers_and_the_encoder_of_the_arm(tmp_path: Path):
    assert read_log(write_lerobot(tmp_path)).firmware == {}

    info = tmp_path / "dataset" / "meta" / "info.json"
    content = json.loads(info.read_text()) | {"robot_type": "so101_follower"}
    info.write_text(json.dumps(content))
    firmware = read_log(tmp_path / "dataset").firmware

    assert firmware == pytest.approx(load_column_map("so101_sage").firmware, rel=1e-5)
    acceleration = pytest.approx(38.963, rel=1e-4)
    assert firmware == {"profile_acceleration": acceleration, "output_encoder": 1.0}
    assert read_log(write_sage(tmp_path)).firmware == {}, "joints of another robot"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"total_frames": ROWS + 1}, "total_frames .*41"),
        ({"codebase_version": "v2.1"}, r"'v2\.1'.*convert_dataset_v21_to_v30"),
    ],
)
def test_a_lerobot_dataset_must_be_complete_and_of_version_3(
    tmp_path: Path, change: dict[str, Any], problem: str
):
    path = write_lerobot(tmp_path)
    info = json.loads((path / "meta" / "info.json").read_text())
    (path / "meta" / "info.json").write_text(json.dumps(info | change))

    with pytest.raises(LogError, match=problem):
        read_log(path)


def test_tensors_of_any_layout_are_read_by_a_map(tmp_path: Path):
    log = read_log(write_pt(tmp_path), columns=tmp_path / "columns.toml")

    np.testing.assert_array_equal(log.joint_pos, ANGLE.astype(np.float32))
    np.testing.assert_array_equal(log.position_target, TARGET.astype(np.float32))
    with pytest.raises(LogError, match=r"'des_dof_pos' \(40, 2\).*go2_tensors"):
        read_log(tmp_path / "log.pt")

    (tmp_path / "log.pt").write_bytes((tmp_path / "log.pt").read_bytes()[:-30])

    with pytest.raises(LogError, match="damaged"):
        read_log(tmp_path / "log.pt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"time": Tensor(Storage("FloatStorage", "0", 10), 5, (6,), (1,))}, "buffer"),
        ({"t": 3.0}, "'time'"),
    ],
)
def test_a_tensor_beyond_its_storage_and_a_missing_tensor_are_refused(
    tmp_path: Path, content, message: str
):
    good = Tensor(Storage("FloatStorage", "0", 10), 0, (5, 2), (2, 1))
    if "t" not in content:
        content = {"des_dof_pos": good, "dof_pos": good} | content

    path = write_pt(tmp_path)
    write_tensors(path, content, {"0": np.zeros(10, "<f4").tobytes()})

    with pytest.raises(LogError) as refusal:
        read_log(path, columns=tmp_path / "columns.toml")
    assert message in str(refusal.value)
    assert "log.pt" in str(refusal.value)


def test_original_files_and_their_published_tables_are_the_same_logs(shared_data: Path):
    motion = read_log(shared_data / "so101" / "original" / "step_response")
    table = read_log(shared_data / "so101" / "step_response.csv.gz", columns="so101_sage")

    assert_same(motion, table, 6e-7)

    tensors = read_log(shared_data / "go2" / "traj_0.pt", columns="go2_tensors")
    table = read_log(shared_data / "go2" / "traj_0.csv.gz", columns="go2_identification")

    assert_same(tensors, table, 6e-6)
    assert tensors.joint_names == table.joint_names
    assert channels(tensors).keys() == channels(table).keys()
