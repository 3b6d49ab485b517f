"""ROS 2 bags in MCAP: a .mcap file, or the folder of ``ros2 bag record`` that holds one. Needs the extra ``ros``.

A column of a column map is a number in the messages of a topic:

    TOPIC:FIELD          /lowstate:motor_state[3].q, /joint_states:position[elbow], /cmd:points[0].positions[2]

FIELD is a path of fields separated by points. A list element is given by its index or, in a message
that lists joint names (``name`` or ``joint_names``), by a joint's name. ``log_time`` is the
recorder's clock. A row is a message of the topic of the angles, with the last message before it of
every other topic.

Without a map, a bag has two topics of sensor_msgs/JointState: the states, named ``joint_states`` in
any namespace, and the commands. A velocity or effort that the first message lacks is not read.
"""

import re
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, listed, quoted
from motorprior.logs.column_map import ColumnMap, MappedJoint
from motorprior.logs.log_reader import (
    FOLDER,
    GIVE_COLUMNS,
    LogReader,
    read_mapped_log,
    robot_of_joints,
)
from motorprior.logs.motor_log import CORRECT, MotorLog, missing_column
from motorprior.robots.robot import Robot

CLOCK = "log_time"
JOINT_STATE = "sensor_msgs/msg/JointState"
_POINT = re.compile(r"\.(?![^\[]*\])")  # between fields, not within a joint's name
_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)
_RECOVER = "repair it with `mcap recover`, or copy it again from its source"
_REMEDY = f"give one topic joint_states and one of commands, both {JOINT_STATE}; or read the bag {GIVE_COLUMNS}"


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, str]]]:
    """Reader of a .mcap file, or of the one in the folder of a bag; and topic -> type of its messages."""
    if path.is_dir():
        path = max(_files(path), key=lambda file: file.suffix == ".mcap")
    if path.suffix != ".mcap":
        remedy = f"`ros2 bag convert -i {path.name} -o mcap.yaml`, with the lines output_bags: and "
        remedy += "- {uri: converted, storage_id: mcap, all_topics: true} in mcap.yaml"
        raise LogError(f"the bag is not stored as MCAP: {path.name}", where=path, remedy=remedy)
    try:
        from mcap.reader import make_reader  # pyright: ignore[reportMissingImports]
        from mcap_ros2.decoder import DecoderFactory  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        problem = "ROS 2 bags need the libraries mcap and mcap-ros2-support"
        raise LogError(problem, where=path, remedy='pip install "motorprior[ros]"') from error
    try:
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            if summary is None:
                raise LogError(
                    "the bag has no summary: its recorder was not closed",
                    where=path,
                    remedy=_RECOVER,
                )
            kinds = {number: schema.name for number, schema in summary.schemas.items()}
            yield (
                reader,
                {
                    each.topic: kinds.get(each.schema_id, "no type")
                    for each in summary.channels.values()
                },
            )
    except LogError:
        raise
    except Exception as error:  # decoders of damaged bytes raise many types
        raise LogError(
            f"cannot be read ({str(error)[:300]})", where=path, remedy=_RECOVER
        ) from error


def _files(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))


def read_ros_bag(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read a bag with one topic of states and one of commands; a robot gives order and motor if it has these joints."""
    with _opened(path) as (reader, types):
        topics = [topic for topic, kind in types.items() if kind == JOINT_STATE]
        heads = {
            topic: next(reader.iter_decoded_messages(topics=[topic]), None) for topic in topics
        }
    first = {topic: found.decoded_message for topic, found in heads.items() if found is not None}
    states = [topic for topic in first if topic.rsplit("/", 1)[-1] == "joint_states"]
    if len(first) != 2 or len(states) != 1:
        has = listed([f"{topic} ({kind})" for topic, kind in sorted(types.items())], 8) or "none"
        problem = f"no topic of states and one of commands; it has {has}"
        raise LogError(problem, where=path, remedy=_REMEDY, argument="columns")
    (state,), (command,) = states, first.keys() - set(states)
    names = tuple(first[command].name)
    known = set(first[state].name)
    if missing := sorted(set(names) - known):
        raise LogError(
            f"the command has a joint {missing[0]!r}, the states have none",
            where=path,
            remedy=_REMEDY,
        )
    robot = robot_of_joints(robot, names)
    series = {
        "position_target": command + ":position[{joint}]",
        "joint_pos": state + ":position[{joint}]",
    }
    for channel, name in (("joint_vel", "velocity"), ("joint_torque", "effort")):
        values = np.array(getattr(first[state], name))
        # ros2_control writes NaN for a missing interface
        if values.size and not np.isnan(values).any():
            series[channel] = f"{state}:{name}[{{joint}}]"
    columns = ColumnMap(
        source=str(path),
        motor=robot.motor if robot else "",
        time=CLOCK,
        series=series,
        joints=tuple(MappedJoint(name, name) for name in names),
    )
    return read_mapped_log(path, columns, _columns, robot)


def _columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """Name -> (rows,) float64, CLOCK in seconds since the first row; names topic, message and field of an error.

    Rows begin when every topic has a message.
    """
    times = array("q")
    values = array("d")
    latest = {}
    with _opened(path) as (reader, types):
        parsed = {name: _parsed(name, path) for name in names if name != CLOCK}
        row_topic = _parsed(columns.columns_of("joint_pos", columns.joints)[0], path)[0]
        count = dict.fromkeys((topic for topic, _ in parsed.values()), 0)
        for topic in count.keys() - types.keys():
            raise missing_column("topic", topic, types, path)
        for found in reader.iter_decoded_messages(topics=list(count)):  # in order of time
            topic = found.channel.topic
            message = found.decoded_message
            for name in (name for name, (of, _) in parsed.items() if of == topic):
                try:
                    latest[name] = _number(message, parsed[name][1])
                except (AttributeError, LookupError, TypeError, ValueError) as error:
                    problem = f"message {count[topic]} has no number {quoted(name, 120)} ({str(error)[:120]})"
                    raise LogError(problem, where=path, remedy=CORRECT) from error
            count[topic] += 1
            if topic == row_topic and len(latest) == len(parsed):
                times.append(found.message.log_time)
                values.extend(latest[name] for name in parsed)
    if silent := [topic for topic, messages in count.items() if not messages]:
        raise LogError(f"no message of {quoted(silent[0])}", where=path, remedy=CORRECT)
    table = np.array(values).reshape(len(times), len(parsed))
    clock = np.array(times)
    by_name = dict(zip(parsed, table.T, strict=True)) | {CLOCK: 1e-9 * (clock - clock[:1])}
    return {name: by_name[name] for name in names}


def _parsed(name: str, path: Path) -> tuple[str, list[tuple[str, str | None]]]:
    """Topic, and the path from a message to a number: fields with their list elements."""
    topic, colon, text = name.partition(":")
    steps = [_STEP.fullmatch(step) for step in _POINT.split(text)]
    if not (topic and colon and all(steps)):
        remedy = f"name {CLOCK}, or TOPIC:FIELD, as /lowstate:motor_state[3].q or /joint_states:position[elbow]"
        raise LogError(
            f"{quoted(name)} is not TOPIC:FIELD", where=path, remedy=remedy, argument="columns"
        )
    return topic, [(step[1], step[2]) for step in steps if step]


def _number(message: Any, steps: list[tuple[str, str | None]]) -> float:
    value = message
    for attribute, element in steps:
        value = getattr(value, attribute)
        if element is not None:  # a joint's name, or an index
            names = [
                name for field in ("name", "joint_names") for name in getattr(message, field, ())
            ]
            value = value[names.index(element) if element in names else int(element)]
    if not isinstance(value, (int, float)):
        raise TypeError(f"it is a {type(value).__name__}")
    return float(value)


READER = LogReader(
    "ROS 2 bag",
    (".mcap", ".db3", FOLDER),
    # a folder with several files is a folder of logs
    lambda path: path.is_file() or ((path / "metadata.yaml").is_file() and len(_files(path)) == 1),
    read_ros_bag,
    _columns,
)
