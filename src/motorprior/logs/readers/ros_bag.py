"""ROS 2 bags in MCAP: a .mcap file, or the folder of ``ros2 bag record`` that holds one.

They need the extra ``ros``. A column of a column map is a number in the messages of a topic:

    TOPIC:FIELD     /lowstate:motor_state[3].q
                    /joint_states:position[elbow]
                    /cmd:points[0].positions[2]

FIELD is a path of fields separated by points. A list element is given by its index or, in a message
that lists joint names (``name`` or ``joint_names``), by a joint's name. ``log_time`` is the
recorder's clock. A row is a message with the angle of a joint: of the joint with the most messages.
Commands of a row are means until the next row, since they act from their own time on; other
measurements are interpolated at the time of the row; gains and flags are the last before it. A
message that lists joint names has values of these joints only, so that several publishers may share
a topic.

Without a map, a bag has two topics of sensor_msgs/JointState: the states, named ``joint_states`` in
any namespace, and the commands, whose velocities and efforts are velocity targets and feed-forward
torques. A velocity or effort that a first message lacks is not read.
"""

import re
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, listed, quoted
from motorprior.logs.column_map import (
    COMMANDS,
    QUANTITIES,
    TURN,
    ColumnMap,
    Conversion,
    MappedJoint,
)
from motorprior.logs.log_reader import (
    FOLDER,
    GIVE_COLUMNS,
    LogReader,
    read_mapped_log,
    robot_of_joints,
)
from motorprior.logs.motor_log import CORRECT, MotorLog, missing_column
from motorprior.robots.robot import Robot
from motorprior.signals import mean_between

CLOCK = "log_time"
JOINT_STATE = "sensor_msgs/msg/JointState"
_POINT = re.compile(r"\.(?![^\[]*\])")  # between fields, not within a joint's name
_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)
_RECOVER = "repair it with `mcap recover`, or copy it again from its source"
# messages at the beginning of a topic from which the names of its joints are read
_FIRST_MESSAGES = 100
_REMEDY = (
    f"give one topic joint_states and one of commands, both {JOINT_STATE}; "
    f"or read the bag {GIVE_COLUMNS}"
)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, str]]]:
    """Reader of the MCAP file of a bag, and the message type of each topic."""
    if path.is_dir():
        path = max(_files(path), key=lambda file: file.suffix == ".mcap")
    if path.suffix != ".mcap":
        remedy = (
            f"`ros2 bag convert -i {path.name} -o mcap.yaml`, with the lines output_bags: and "
            "- {uri: converted, storage_id: mcap, all_topics: true} in mcap.yaml"
        )
        raise LogError(f"the bag is not stored as MCAP: {path.name}", where=path, remedy=remedy)

    try:
        from mcap.reader import make_reader  # pyright: ignore[reportMissingImports]
        from mcap_ros2.decoder import DecoderFactory  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        problem = "ROS 2 bags need the libraries mcap and mcap-ros2-support"
        remedy = "pip install mcap mcap-ros2-support"
        raise LogError(problem, where=path, remedy=remedy) from error

    try:
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            yield reader, _message_types(reader.get_summary(), path)
    except LogError:
        raise
    except Exception as error:  # decoders of damaged bytes raise many types
        problem = f"cannot be read ({str(error)[:300]})"
        raise LogError(problem, where=path, remedy=_RECOVER) from error


def _message_types(summary: Any, path: Path) -> dict[str, str]:
    """Message type of each topic."""
    if summary is None:
        problem = "the bag has no summary: its recorder was not closed"
        raise LogError(problem, where=path, remedy=_RECOVER)
    names = {number: schema.name for number, schema in summary.schemas.items()}
    return {
        channel.topic: names.get(channel.schema_id, "no type")
        for channel in summary.channels.values()
    }


def _files(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))


def read_ros_bag(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read a bag with one topic of states and one of commands.

    A robot gives order and motor if it has these joints.
    """
    messages = _first_joint_states(path)
    state = next(topic for topic in messages if _is_state(topic))
    command = next(topic for topic in messages if topic != state)

    names = _joint_names(messages[command])
    missing = sorted(set(names) - set(_joint_names(messages[state])))
    if missing:
        raise LogError(
            f"the command has a joint {missing[0]!r}, the states have none",
            where=path,
            remedy=_REMEDY,
        )

    series = {
        "position_target": command + ":position[{joint}]",
        "joint_pos": state + ":position[{joint}]",
    }
    for channel, topic, name in (
        ("joint_vel", state, "velocity"),
        ("joint_torque", state, "effort"),
        ("velocity_target", command, "velocity"),
        ("torque_feedforward", command, "effort"),
    ):
        values = [np.array(getattr(message, name)) for message in messages[topic]]
        # ros2_control writes NaN for a missing interface
        if all(array.size and not np.isnan(array).any() for array in values):
            series[channel] = f"{topic}:{name}[{{joint}}]"

    robot = robot_of_joints(robot, names)
    columns = ColumnMap(
        source=str(path),
        motor=robot.motor if robot else "",
        time=CLOCK,
        series=series,
        joints=tuple(MappedJoint(name, name) for name in names),
    )
    return read_mapped_log(path, columns, _columns, robot)


def _is_state(topic: str) -> bool:
    return topic.rsplit("/", 1)[-1] == "joint_states"


def _joint_names(messages: list[Any]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for message in messages for name in message.name))


def _first_joint_states(path: Path) -> dict[str, list[Any]]:
    """First JointStates of the topic of states and of the topic of commands.

    There is one for each set of joints that a message names.
    """
    messages: dict[str, list[Any]] = {}
    with _opened(path) as (reader, types):
        for topic in types:
            if types[topic] == JOINT_STATE:
                first = islice(reader.iter_decoded_messages(topics=[topic]), _FIRST_MESSAGES)
                of_joints = {}
                for item in first:
                    of_joints.setdefault(tuple(item.decoded_message.name), item.decoded_message)
                if of_joints:
                    messages[topic] = list(of_joints.values())

    if len(messages) != 2 or sum(map(_is_state, messages)) != 1:
        topics = [f"{topic} ({message_type})" for topic, message_type in sorted(types.items())]
        problem = f"no topic of states and one of commands; it has {listed(topics, 8) or 'none'}"
        raise LogError(problem, where=path, remedy=_REMEDY, argument="columns")
    return messages


@dataclass(frozen=True)
class _Field:
    """A number in the messages of a topic."""

    name: str  # in the column map
    topic: str
    steps: tuple[tuple[str, str | None], ...]  # fields, each with its list element


def _columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """Columns (rows,) float64 by name; CLOCK in seconds since the first row.

    Rows begin when every column has a value. An error names topic, message and field.
    """
    fields = [_field(name, path) for name in names if name != CLOCK]
    readings = {field.name: _Readings() for field in fields}
    count = dict.fromkeys((field.topic for field in fields), 0)

    with _opened(path) as (reader, types):
        for topic in count.keys() - types.keys():
            raise missing_column("topic", topic, types, path)

        for message in reader.iter_decoded_messages(topics=list(count)):  # in order of time
            topic = message.channel.topic
            content = message.decoded_message
            for field in fields:
                if field.topic == topic and _has_joint(content, field):
                    readings[field.name].times.append(message.message.log_time)
                    readings[field.name].values.append(_number(content, field, count, path))
            count[topic] += 1

    for topic, messages in count.items():
        if not messages:
            raise LogError(f"no message of {quoted(topic)}", where=path, remedy=CORRECT)
    for field in fields:
        if not readings[field.name].times:
            raise LogError(
                f"no message has the joint of {quoted(field.name, 120)}",
                where=path,
                remedy=CORRECT,
            )
    table = _at_rows(readings, names, columns)
    if len(table[CLOCK]) < 2:
        problem = "fewer than 2 angles after the first message of every column"
        raise LogError(problem, where=path, remedy="record longer, or leave a late column out")
    return table


@dataclass(frozen=True)
class _Readings:
    """Values of a column."""

    times: array = dataclass_field(default_factory=lambda: array("q"))  # [ns]
    values: array = dataclass_field(default_factory=lambda: array("d"))


def _at_rows(
    readings: dict[str, _Readings], names: list[str], columns: ColumnMap
) -> dict[str, np.ndarray]:
    """Columns (rows,) at the messages of the joint that has the most."""
    channels = {}
    turns = {}  # a turn in the unit of each column that wraps
    for channel in columns.series:
        of_joints = columns.columns_of(channel, columns.joints)
        for name, joint in zip(of_joints, columns.joints, strict=True):
            channels[name] = channel
            conversion = joint.conversions.get(channel, Conversion())
            if conversion.wraps:
                turns[name] = TURN / abs(conversion.factor)
    angles = columns.columns_of("joint_pos", columns.joints)
    fastest = max(angles, key=lambda name: len(readings[name].times))
    start = max(series.times[0] for series in readings.values())

    def seconds(series: _Readings) -> np.ndarray:
        return 1e-9 * (np.array(series.times) - start)

    rows = seconds(readings[fastest])
    rows = rows[rows >= 0.0]
    edges = np.append(rows, rows[-1:] + np.median(np.diff(rows, prepend=0.0)))
    durations = np.maximum(np.diff(edges), 1e-9)  # rows may repeat a time

    table = {CLOCK: rows - rows[:1]}
    for name, series in readings.items():
        values = np.array(series.values)
        if name in turns:  # no angle is between those before and after the jump
            values = np.unwrap(values, period=turns[name])
        times = seconds(series)
        channel = channels.get(name)
        if channel in COMMANDS and len(rows):
            table[name] = mean_between(times, values[:, None], edges, durations)[:, 0]
        elif channel in QUANTITIES or channel == "load_stiffness":
            table[name] = np.interp(rows, times, values)
        else:
            table[name] = values[np.searchsorted(times, rows, side="right") - 1]
    return {name: table[name] for name in names}


def _field(name: str, path: Path) -> _Field:
    topic, colon, text = name.partition(":")
    steps = [_STEP.fullmatch(step) for step in _POINT.split(text)]
    if not (topic and colon and all(steps)):
        remedy = (
            f"name {CLOCK}, or TOPIC:FIELD, as /lowstate:motor_state[3].q or "
            "/joint_states:position[elbow]"
        )
        raise LogError(
            f"{quoted(name)} is not TOPIC:FIELD", where=path, remedy=remedy, argument="columns"
        )
    return _Field(name, topic, tuple((step[1], step[2]) for step in steps if step))


def _number(message: Any, field: _Field, count: dict[str, int], path: Path) -> float:
    try:
        return _value(message, field)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        number = count[field.topic]
        reason = str(error)[:120]
        problem = f"message {number} has no number {quoted(field.name, 120)} ({reason})"
        raise LogError(problem, where=path, remedy=CORRECT) from error


def _has_joint(message: Any, field: _Field) -> bool:
    """Whether a message that lists joint names lists the joint of the field."""
    names = [*getattr(message, "name", ()), *getattr(message, "joint_names", ())]
    elements = [element for _, element in field.steps if element is not None]
    if not names or len(elements) != 1 or elements[0].isdecimal():
        return True
    return elements[0] in names


def _value(message: Any, field: _Field) -> float:
    value = message
    for attribute, element in field.steps:
        value = getattr(value, attribute)
        if element is not None:
            joints = [*getattr(message, "name", ()), *getattr(message, "joint_names", ())]
            index = joints.index(element) if element in joints else int(element)
            value = value[index]
    if not isinstance(value, (int, float)):
        raise TypeError(f"it is a {type(value).__name__}")
    return float(value)


def _is_bag(path: Path) -> bool:
    """Whether it is a file, or the folder of one file; a folder of several holds several logs."""
    return path.is_file() or ((path / "metadata.yaml").is_file() and len(_files(path)) == 1)


READER = LogReader("ROS 2 bag", (".mcap", ".db3", FOLDER), _is_bag, read_ros_bag, _columns)
