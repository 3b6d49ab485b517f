"""A ROS 2 bag becomes a motor log; it needs the extra `ros`."""

from pathlib import Path

import numpy as np
import pytest
from third_party_files import ANGLE, JOINTS, TARGET, TIME

from motorprior.exceptions import LogError
from motorprior.logs.read_log import read_log_folder
from motorprior.logs.read_log import read_log

LINE = "=" * 80
DEFINITION = "\n".join(
    [
        *("std_msgs/Header header", "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"),
        *(LINE, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id"),
        *(LINE, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"),
    ]
)


def write_bag(
    path: Path, states: str = "/arm/joint_states", commands: str = "/arm/commands", names=JOINTS, numbers: str = "",
    lacks: dict[str, int] | None = None,
) -> Path:  # fmt: skip
    """A bag of two topics of JointState, and one of plain numbers where its name is given.

    Of the second joint the fields that are named in ``lacks`` are NaN in that row and all after it.
    """
    writer_of = pytest.importorskip("mcap_ros2.writer", reason="the extra ros is not installed")
    with open(path, "wb") as file, writer_of.Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        for row, (time, target, angle) in enumerate(zip(TIME, TARGET, ANGLE, strict=True)):
            order = {"name": names[::-1], "position": target[::-1].tolist(), "velocity": [], "effort": []}
            writer.write_message(commands, schema, {"header": head} | order, log_time=int(1e9 * time) + 1)
            measured = {"name": JOINTS, "position": angle.tolist(), "velocity": (2 * angle).tolist(), "effort": []}
            for name, first in (lacks or {}).items():
                measured[name] = [0.0, np.nan if row >= first else 0.0]
            writer.write_message(states, schema, {"header": head} | measured, log_time=int(1e9 * time) + 2)
        if numbers:
            plain = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")
            writer.write_message(numbers, plain, {"data": [0.5]}, log_time=0)
    return path


def test_states_with_the_command_in_force(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap"))
    assert log.joint_names == JOINTS[::-1] and log.joint_torque is None and log.joint_vel is not None
    np.testing.assert_allclose(log.time, TIME, atol=2e-9)
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.joint_vel, 2 * ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.position_target, TARGET[:, ::-1])


def test_a_velocity_or_effort_that_is_always_nan_is_absent(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap", lacks={"velocity": 0, "effort": 0}))
    assert log.joint_vel is None and log.joint_torque is None
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"states": "/arm/states", "numbers": "/cmd"}, r"it has /arm/commands .*, /arm/states .*, /cmd .* -> "),
        ({"commands": "/b/joint_states"}, "no topic of states and one of commands"),
        ({"names": ("pan", "tail")}, "the command has a joint 'tail'"),
    ],
)
def test_other_topics_are_refused_with_their_names(tmp_path: Path, changes: dict[str, object], said: str):
    with pytest.raises(LogError, match=said):
        read_log(write_bag(tmp_path / "a.mcap", **changes))  # pyright: ignore[reportArgumentType]


def write_folder(folder: Path, *names: str) -> Path:
    """As `ros2 bag record` leaves it."""
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    for name in names:
        write_bag(folder / name)
    return folder


def test_the_folder_of_a_bag_is_its_one_file(tmp_path: Path):
    (tmp_path / "run").mkdir()
    folder = write_folder(tmp_path / "run", "run_0.mcap")
    np.testing.assert_array_equal(read_log(folder).joint_pos, read_log(folder / "run_0.mcap").joint_pos)
    assert list(read_log_folder(folder, None).logs) == ["run"]
    write_bag(folder / "run_1.mcap")
    with pytest.raises(LogError, match=r"a folder that is not a log -> give its files: .*\.mcap"):
        read_log(folder)
    assert list(read_log_folder(folder, None).logs) == ["run_0", "run_1"], "a bag in two files"


def test_a_bag_in_another_storage_must_be_converted(tmp_path: Path):
    folder = write_folder(tmp_path)
    (folder / "run_0.db3").write_bytes(b"SQLite format 3")
    with pytest.raises(LogError, match=r"not stored as MCAP: run_0\.db3 -> .*ros2 bag convert"):
        read_log(folder)


@pytest.mark.parametrize("left", [40, 2000, -8])
def test_a_truncated_bag_is_recommended_for_recovery(tmp_path: Path, left: int):
    path = write_bag(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(LogError, match="mcap recover"):
        read_log(path)
