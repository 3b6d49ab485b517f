"""Any topics of a ROS 2 bag become a motor log by a column map; it needs the extra `ros`."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from third_party_files import ANGLE, TARGET, TIME

from motorprior.exceptions import LogError
from motorprior.logs.read_log import read_log

pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")
LINE = "=" * 80
COMMAND, STATE = ("std_msgs/msg/Float64MultiArray", "float64[] data"), ("demo_msgs/msg/State", "")
STATE_TEXT = f"Motor[2] motor_state\nstring[] name\nfloat32 level\n{LINE}\nMSG: demo_msgs/Motor\nfloat64 q\nfloat64 dq"
LEGGED = """
motor = "servo"
time = "log_time"
position_target = "/commands:data[{joint}]"
joint_pos = "/state:motor_state[{joint}].q"
joint_vel = "/state:motor_state[{joint}].dq"
posture = "suspended"

[joints]
0 = { name = "pan", kp = 20 }
1 = { name = "lift", kp = 20, sign = -1 }
"""


def write_bag(path: Path, late: int = 0, names: tuple[str, str] = ("a.left", "b")) -> Path:
    """Commands as plain numbers, states of an own type; commands begin ``late`` rows after the states."""
    from mcap_ros2.writer import Writer

    with open(path, "wb") as file, Writer(file) as writer:
        command = writer.register_msgdef(*COMMAND)
        state = writer.register_msgdef(STATE[0], STATE_TEXT)
        for row, (time, target, angle) in enumerate(zip(TIME, TARGET, ANGLE, strict=True)):
            now = int(1e9 * time) + 5_000_000
            if row >= late:
                writer.write_message("/commands", command, {"data": target.tolist()}, log_time=now - 1)
            motors: list[Any] = [{"q": q, "dq": 2.0 * q} for q in angle.tolist()]
            message = {"motor_state": motors, "name": list(names), "level": 0.5}
            writer.write_message("/state", state, message, log_time=now)
    return path


def written(tmp_path: Path, text: str = LEGGED) -> str:
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    return str(tmp_path / "map.toml")


def test_messages_of_any_type_by_their_fields(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap"), columns=written(tmp_path))
    assert log.joint_names == ("pan", "lift") and log.stated_kp is not None and log.joint_vel is not None
    np.testing.assert_allclose(log.time, TIME, atol=2e-9)
    np.testing.assert_array_equal(log.position_target, TARGET * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_pos, ANGLE * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_vel, 2.0 * ANGLE * [1.0, -1.0])


def test_rows_begin_when_every_topic_has_a_message(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap", late=3), columns=written(tmp_path))
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE[3:, 0])
    np.testing.assert_allclose(log.time, TIME[3:] - TIME[3], atol=2e-9)


def test_a_joint_by_its_place_in_the_command_and_by_its_name_in_the_state(tmp_path: Path):
    text = LEGGED.replace("motor_state[{joint}]", "motor_state[{name}]").replace('"pan"', '"b"')
    log = read_log(write_bag(tmp_path / "a.mcap"), columns=written(tmp_path, text.replace('"lift"', '"a.left"')))
    np.testing.assert_array_equal(log.position_target, TARGET * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1] * [1.0, -1.0])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("/commands:data", "/cmd:data", r"no topic '/cmd'; it has '/commands'"),
        ("motor_state[{joint}].q", "motor_state[{joint}].angle", "message 0 has no number"),
        ("motor_state[{joint}].q", "motor_state[7{joint}].q", "range"),
        ('"/state:motor_state[{joint}].q"', '"q[{joint}]"', r"'q\[0\]' is not TOPIC:FIELD"),
        ('"suspended"', '"mode"', "'mode' is not TOPIC:FIELD"),
    ],
)
def test_errors_of_a_map_are_named(tmp_path: Path, old: str, new: str, said: str):
    with pytest.raises(LogError, match=said):
        read_log(write_bag(tmp_path / "a.mcap"), columns=written(tmp_path, LEGGED.replace(old, new)))
