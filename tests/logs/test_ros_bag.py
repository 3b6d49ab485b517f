"""A ROS 2 bag becomes a motor log; it needs the extra `ros`."""

from pathlib import Path

import numpy as np
import pytest
from foreign_files import ANGLE, JOINTS, TARGET, TIME
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import LogError
from motorprior.logs.registry import read_log

LINE = "=" * 80
DEFINITION = "\n".join(
    [
        *("std_msgs/Header header", "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"),
        *(LINE, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id"),
        *(LINE, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"),
    ]
)


def write_bag(path: Path, states: str = "/arm/joint_states", commands: str = "/arm/commands", names=JOINTS) -> Path:
    writer_of = pytest.importorskip("mcap_ros2.writer", reason="the extra ros is not installed")
    with open(path, "wb") as file, writer_of.Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        for time, target, angle in zip(TIME, TARGET, ANGLE, strict=True):
            order = {"name": names[::-1], "position": target[::-1].tolist(), "velocity": [], "effort": []}
            writer.write_message(commands, schema, {"header": head} | order, log_time=int(1e9 * time) + 1)
            measured = {"name": JOINTS, "position": angle.tolist(), "velocity": (2 * angle).tolist(), "effort": []}
            writer.write_message(states, schema, {"header": head} | measured, log_time=int(1e9 * time) + 2)
    return path


def test_states_with_the_command_in_force(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap"))
    assert log.joint_names == JOINTS[::-1] and log.joint_torque is None and log.joint_vel is not None
    np.testing.assert_allclose(log.time, TIME, atol=2e-9)
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.joint_vel, 2 * ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.position_target, TARGET[:, ::-1])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"states": "/arm/states"}, r"topics of sensor_msgs/msg/JointState are /arm/commands, /arm/states"),
        ({"commands": "/b/joint_states"}, "topics of"),
        ({"names": ("pan", "tail")}, "the command has a joint 'tail'"),
        ({"names": ("pan", "pan")}, "is of the joints"),
    ],
)
def test_other_topics_are_refused_with_their_names(tmp_path: Path, changes: dict[str, object], said: str):
    with pytest.raises(LogError, match=said):
        read_log(write_bag(tmp_path / "a.mcap", **changes))  # pyright: ignore[reportArgumentType]


@given(share=st.floats(0.0, 1.0, exclude_max=True), byte=st.none() | st.integers(0, 255))
@settings(max_examples=25, deadline=None)
def test_a_damaged_bag_is_a_log_or_one_error(tmp_path_factory: pytest.TempPathFactory, share: float, byte: int | None):
    path = write_bag(tmp_path_factory.mktemp("bag") / "a.mcap")
    data = bytearray(path.read_bytes())
    if byte is None:
        del data[int(share * len(data)) :]
    else:
        data[int(share * len(data))] = byte
    path.write_bytes(data)
    try:
        read_log(path)
    except LogError as error:
        assert "a.mcap" in str(error) and len(str(error)) < 1000


def test_without_the_extra_the_message_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mcap.reader", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(LogError, match=r"motorprior\[ros\]"):
        read_log(tmp_path / "a.mcap")
