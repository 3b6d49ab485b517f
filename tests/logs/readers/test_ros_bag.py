"""A ROS 2 bag becomes a motor log, by its JointState or by the topics of a column map."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from third_party_files import ANGLE, JOINTS, TARGET, TIME

from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.read_log import read_log, read_log_folder

pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")
LINE = "=" * 80
JOINT_STATE = "\n".join(
    [
        *(
            "std_msgs/Header header",
            "string[] name",
            "float64[] position",
            "float64[] velocity",
            "float64[] effort",
        ),
        *(LINE, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id"),
        *(LINE, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"),
    ]
)
STATE = (
    f"Motor[2] motor_state\nstring[] name\nfloat32 level\n{LINE}\n"
    "MSG: demo_msgs/Motor\nfloat64 q\nfloat64 dq"
)
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


def write_bag(
    path: Path,
    states: str = "/arm/joint_states",
    commands: str = "/arm/commands",
    names=JOINTS,
    numbers: str = "",
    velocity: float = 0.0,
    feedforward: float | None = None,
) -> Path:
    """A bag of two topics of JointState, and one of plain numbers where its name is given.

    With ``feedforward``, commands have velocities of 0 and efforts of this size.
    """
    from mcap_ros2.writer import Writer

    with open(path, "wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        for time, target, angle in zip(TIME, TARGET, ANGLE, strict=True):
            order = {
                "name": names[::-1],
                "position": target[::-1].tolist(),
                "velocity": [],
                "effort": [],
            }
            if feedforward is not None:
                order["velocity"] = [0.0] * len(order["name"])
                order["effort"] = [feedforward] * len(order["name"])
            writer.write_message(
                commands, schema, {"header": head} | order, log_time=int(1e9 * time) + 1
            )
            speed = (2 * angle + velocity).tolist()
            measured = {"name": JOINTS, "position": angle.tolist(), "velocity": speed, "effort": []}
            writer.write_message(
                states, schema, {"header": head} | measured, log_time=int(1e9 * time) + 2
            )
        if numbers:
            plain = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")
            writer.write_message(numbers, plain, {"data": [0.5]}, log_time=0)

    return path


def write_legged(folder: Path, text: str = LEGGED, late: int = 0) -> tuple[Path, str]:
    """A bag with commands as plain numbers and states of a custom type, and its column map.

    late: rows from the first state to the first command.
    """
    from mcap_ros2.writer import Writer

    with open(folder / "a.mcap", "wb") as file, Writer(file) as writer:
        command = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")
        state = writer.register_msgdef("demo_msgs/msg/State", STATE)
        for row, (time, target, angle) in enumerate(zip(TIME, TARGET, ANGLE, strict=True)):
            now = int(1e9 * time) + 5_000_000
            if row >= late:
                writer.write_message(
                    "/commands", command, {"data": target.tolist()}, log_time=now - 1
                )
            motors: list[Any] = [{"q": q, "dq": 2.0 * q} for q in angle.tolist()]
            message = {"motor_state": motors, "name": ["a.left", "b"], "level": 0.5}
            writer.write_message("/state", state, message, log_time=now)

    (folder / "map.toml").write_text(text, encoding="utf-8")

    return folder / "a.mcap", str(folder / "map.toml")


def test_a_bag_of_joint_states_has_the_command_in_force_in_every_row(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap"))

    assert log.joint_names == JOINTS[::-1]
    assert log.joint_torque is None
    assert log.joint_vel is not None
    np.testing.assert_allclose(log.time, TIME, atol=2e-9)
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.joint_vel, 2 * ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.position_target, TARGET[:, ::-1])
    assert read_log(write_bag(tmp_path / "b.mcap", velocity=np.nan)).joint_vel is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": "/arm/states", "numbers": "/cmd"}, "/arm/commands.*/arm/states.*/cmd"),
        ({"commands": "/b/joint_states"}, "/b/joint_states"),
        ({"names": ("pan", "tail")}, "'tail'"),
    ],
)
def test_ambiguous_or_missing_topics_and_joints_are_refused_by_name(
    tmp_path: Path, changes: dict[str, Any], message: str
):
    with pytest.raises(LogError, match=message):
        read_log(write_bag(tmp_path / "a.mcap", **changes))


def test_velocities_and_efforts_of_commands_are_targets_unless_they_are_0(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap", feedforward=0.4))
    unused = read_log(write_bag(tmp_path / "b.mcap", feedforward=0.0))

    assert log.command_mode == "mit"
    assert log.torque_feedforward is not None
    assert np.all(log.torque_feedforward == 0.4)
    assert log.velocity_target is None
    assert unused.command_mode == "position"


def test_the_folder_of_a_bag_is_its_one_file(tmp_path: Path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    write_bag(folder / "run_0.mcap")
    file_log = read_log(folder / "run_0.mcap")

    np.testing.assert_array_equal(read_log(folder).joint_pos, file_log.joint_pos)
    assert list(read_log_folder(folder, None).logs) == ["run"]

    write_bag(folder / "run_1.mcap")

    with pytest.raises(LogError, match=r"run: .*\.mcap"):
        read_log(folder)
    assert list(read_log_folder(folder, None).logs) == ["run_0", "run_1"], "a bag in two files"


def test_a_bag_in_another_storage_must_be_converted(tmp_path: Path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (tmp_path / "run_0.db3").write_bytes(b"SQLite format 3")

    with pytest.raises(LogError, match=r"run_0\.db3.*ros2 bag convert"):
        read_log(tmp_path)


def test_the_remedy_for_a_truncated_bag_is_mcap_recover(tmp_path: Path):
    path = write_bag(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:2000])

    with pytest.raises(LogError, match="mcap recover"):
        read_log(path)


def test_messages_of_any_type_are_read_by_their_fields(tmp_path: Path):
    path, columns = write_legged(tmp_path, late=3)
    log = read_log(path, columns=columns)

    assert log.joint_names == ("pan", "lift")
    assert log.logged_kp is not None
    np.testing.assert_allclose(
        log.time, TIME[3:] - TIME[3], atol=2e-9, err_msg="from the first command on"
    )
    np.testing.assert_array_equal(log.position_target, TARGET[3:] * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_pos, ANGLE[3:] * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_vel, 2.0 * ANGLE[3:] * [1.0, -1.0])


def test_a_joint_is_read_by_its_index_in_the_command_and_by_its_name_in_the_state(tmp_path: Path):
    text = LEGGED.replace("motor_state[{joint}]", "motor_state[{name}]").replace('"pan"', '"b"')
    path, columns = write_legged(tmp_path, text.replace('"lift"', '"a.left"'))
    log = read_log(path, columns=columns)

    np.testing.assert_array_equal(log.position_target, TARGET * [1.0, -1.0])
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1] * [1.0, -1.0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("/commands:data", "/cmd:data", r"'/cmd'.*'/commands'"),
        ("motor_state[{joint}].q", "motor_state[{joint}].angle", "message 0 "),
        ("motor_state[{joint}].q", "motor_state[7{joint}].q", "range"),
        ('"/state:motor_state[{joint}].q"', '"q[{joint}]"', r"'q\[0\]'"),
    ],
)
def test_a_topic_or_field_that_does_not_exist_is_refused_by_name(
    tmp_path: Path, old: str, new: str, message: str
):
    path, columns = write_legged(tmp_path, LEGGED.replace(old, new))
    with pytest.raises(LogError, match=message):
        read_log(path, columns=columns)


def write_two_publishers(path: Path) -> Path:
    """A bag whose states come from two publishers, a joint each, one after the other."""
    from mcap_ros2.writer import Writer

    with open(path, "wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)

        def put(topic: str, time: int, names: tuple[str, ...], position: np.ndarray) -> None:
            message = {
                "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                "name": names,
                "position": position.tolist(),
                "velocity": [],
                "effort": [],
            }
            writer.write_message(topic, schema, message, log_time=time)

        for time, target, angle in zip(TIME, TARGET, ANGLE, strict=True):
            now = int(1e9 * time)
            put("/commands", now + 1, JOINTS, target)
            put("/joint_states", now + 2, JOINTS[1:], angle[1:])
            put("/joint_states", now + 3, JOINTS[:1], angle[:1])
    return path


@pytest.mark.parametrize("with_map", [False, True])
def test_a_message_has_values_of_the_joints_that_it_names(tmp_path: Path, with_map: bool):
    path = write_two_publishers(tmp_path / "a.mcap")
    columns = tmp_path / "map.toml"
    columns.write_text(
        'motor = "m"\ntime = "log_time"\nposition_target = "/commands:position[{joint}]"\n'
        f'joint_pos = "/joint_states:position[{{joint}}]"\n[joints.{JOINTS[0]}]\n'
    )

    log = read_log(path, columns=columns if with_map else None)

    joints = JOINTS[:1] if with_map else JOINTS
    assert log.joint_names == joints
    # angles are interpolated over the nanosecond between both publishers
    np.testing.assert_allclose(log.joint_pos, ANGLE[:, : len(joints)], atol=1e-8)
    np.testing.assert_array_equal(log.position_target, TARGET[:, : len(joints)])


def write_clocks(path: Path, offset: float, slow_rows: int) -> Path:
    """A bag with a command ``offset`` rows before each state of a fast joint, and a slow joint.

    The states of the slow joint, which is named first, come with each ``slow_rows``-th row.
    """
    from mcap_ros2.writer import Writer

    period = 10_000_000  # [ns]
    with open(path, "wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)

        def put(topic: str, time: int, names: list[str], position: list[float]) -> None:
            head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
            message = {"header": head, "name": names, "position": position}
            message |= {"velocity": [], "effort": []}
            writer.write_message(topic, schema, message, log_time=time)

        for row in range(100):
            now = (1 + row) * period
            put("/commands", now - round(offset * period), ["slow", "fast"], [row, row])
            angle = np.sin(0.1 * row)
            if row % slow_rows == 0:
                put("/joint_states", now, ["slow"], [angle])
            put("/joint_states", now, ["fast"], [angle])
    return path


def test_commands_act_from_their_own_time_on(tmp_path: Path):
    log = read_log(write_clocks(tmp_path / "a.mcap", offset=0.25, slow_rows=1))

    # command k acts for three quarters of row k, command k + 1 for the rest
    np.testing.assert_allclose(log.position_target[:-1, 0], np.arange(99) + 0.25, atol=1e-6)


def test_no_angle_is_interpolated_across_the_jump_of_an_encoder_that_wraps(tmp_path: Path):
    from mcap_ros2.writer import Writer

    # a command comes between two rows, and the slow joint has an angle in every second row
    turns = 0.05 * np.arange(100)
    slow_turns = turns + 0.005
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")

        def put(topic: str, time: float, turn: float) -> None:
            message = {"data": [4096.0 * (turn % 1.0)]}
            writer.write_message(topic, schema, message, log_time=round(1e7 * (1.0 + time)))

        for row in range(100):
            put("/goal0", row - 0.25, turns[row])
            put("/goal1", row - 0.25, turns[row])
            put("/angle0", row, turns[row])
            if row % 2 == 0:
                put("/angle1", row, slow_turns[row])
    columns = tmp_path / "map.toml"
    columns.write_text(
        'motor = "m"\ntime = "log_time"\nposition_target = "/goal{joint}:data[0]"\n'
        'joint_pos = "/angle{joint}:data[0]"\n'
        '[units]\nangle = "tick"\nticks_per_turn = 4096\nwraps = true\n'
        '[joints]\n0 = { name = "fast" }\n1 = { name = "slow", sign = -1 }\n'
    )

    log = read_log(path, columns=columns)

    signs = np.array([1.0, -1.0])
    angles = 2.0 * np.pi * signs * np.column_stack([turns, slow_turns])[:-1]
    np.testing.assert_allclose(log.joint_pos[:-1], angles, atol=1e-6)
    commands = 2.0 * np.pi * signs * (turns[:-1, None] + 0.25 * 0.05)
    np.testing.assert_allclose(log.position_target[:-1], commands, atol=1e-6)


def test_rows_are_those_of_the_joint_with_the_most_messages(tmp_path: Path):
    log = read_log(write_clocks(tmp_path / "a.mcap", offset=0.0, slow_rows=7))

    assert log.joint_names == ("slow", "fast")
    angle = np.sin(0.1 * np.arange(100))
    slow = np.interp(np.arange(100), np.arange(0, 100, 7), angle[::7])
    np.testing.assert_allclose(log.joint_pos, np.column_stack([slow, angle]), atol=1e-9)
    finding = next(item for item in check_log(log).findings if item.check == "interpolated")
    assert finding.joint == "slow"  # the fast one is no line
    assert finding.value == pytest.approx(7.0)
