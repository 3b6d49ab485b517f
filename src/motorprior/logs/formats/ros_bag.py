"""ROS 2 bags in MCAP become `MotorLog`s: two topics of sensor_msgs/JointState, one of states and one of commands.

The states' topic is called ``joint_states``, in any namespace; the other topic of that type is the command. A row is a
state, at the time at which the recorder wrote it, with the command in force: both topics on one clock. A bag is a .mcap
file, or the folder of METADATA and such a file that ``ros2 bag record`` makes. Needs the extra ``ros``.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import IO, Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.log_reader import FOLDER, LogReader
from motorprior.logs.formats.mapped_table import if_it_has
from motorprior.logs.formats.mcap_chunks import mcap_messages, mcap_summary
from motorprior.logs.formats.table_columns import unreadable
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

JOINT_STATE = "sensor_msgs/msg/JointState"
STATES = "joint_states"
METADATA = "metadata.yaml"
NANOSECOND = 1e-9
_MEASURED = {"joint_pos": "position", "joint_vel": "velocity", "joint_torque": "effort"}
_REMEDY = (
    f"record one topic {STATES} and one of commands, both {JOINT_STATE}: leave further ones out (`ros2 bag convert`, "
    f"topics), and publish commands of another type as {JOINT_STATE}"
)
_SHOWN = 8
"""Topics, or files, that an error names."""


@dataclass
class _Topic:
    """What one topic said: times [ns], and per field the values of all its joints one after another."""

    names: tuple[str, ...]
    times: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(
        default_factory=lambda: {name: array("d") for name in _MEASURED.values()}
    )  # fmt: skip

    def series(self, name: str) -> np.ndarray | None:
        """(T, J), or None where not every message has it."""
        values = np.frombuffer(self.values[name], dtype=np.float64)
        rows, joints = len(self.times), len(self.names)
        return values.reshape(rows, joints) if len(values) == rows * joints else None


def read_ros_bag(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read one bag.

    Args:
        path: a .mcap file, or the folder that holds one beside METADATA.
        robot: names the log's robot and motor, and orders its joints, if these joints are its own.

    Raises:
        LogError: the extra `ros` is not installed; no MCAP file, or a damaged one; not one topic of states and one of
            commands; messages whose joints change; names the topic; a folder of a bag in another storage.
    """
    path = _only_file(Path(path))
    topics, types = _read(path)
    state, command = _state_and_command(topics, types, path)
    if missing := sorted(set(command.names) - set(state.names)):
        raise LogError(f"the command has a joint {missing[0]!r}, the states have none", where=path, remedy=_REMEDY)
    robot = if_it_has(robot, command.names)
    joints = tuple(name for name in robot.joint_names if name in command.names) if robot else command.names
    log = MotorLog(
        **_aligned(state, command, joints, path), joint_names=joints, robot=robot.name if robot else "",
        motor=robot.motor if robot else "", source=str(path), encoder=robot.encoder if robot else "joint",
    )  # fmt: skip
    return checked(log, where=path)


def is_bag(path: Path) -> bool:
    """Whether it is a bag, whatever its messages: a .mcap file, or a folder as ``ros2 bag record`` writes it.

    Not that of a bag of several .mcap files, each of which is a recording: it is a folder of logs.
    """
    if not path.is_dir():
        return path.suffix == ".mcap" and path.is_file()
    found = _files(path) if (path / METADATA).is_file() else []
    return len(found) == 1 or any(file.suffix != ".mcap" for file in found)


def _files(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))


def _only_file(path: Path) -> Path:
    """The .mcap file of a bag's folder, or the path itself if it is none.

    Raises:
        LogError: several files, or one of another storage.
    """
    if not path.is_dir():
        return path
    found = _files(path)
    if other := [file.name for file in found if file.suffix != ".mcap"]:
        remedy = "turn it into MCAP with `ros2 bag convert` (storage_id: mcap)"
        raise LogError(f"a bag that is not stored as MCAP: {other[0]}", where=path, remedy=remedy)
    return found[0]


def _aligned(state: _Topic, command: _Topic, joints: tuple[str, ...], path: Path) -> dict[str, Any]:
    """Channels of the rows that have a command."""
    time, since = (np.frombuffer(topic.times, dtype=np.int64) for topic in (state, command))
    begun = time >= since[0]
    in_force = np.searchsorted(since, time[begun], side="right") - 1
    targets = command.series("position")
    if targets is None or state.series("position") is None:
        raise LogError("a message has no positions, or some", where=path, remedy=_REMEDY)
    columns = [state.names.index(name) for name in joints]
    found: dict[str, Any] = {"time": NANOSECOND * (time[begun] - time[0])}
    found["position_target"] = targets[in_force][:, [command.names.index(name) for name in joints]]
    for channel, word in _MEASURED.items():
        values = state.series(word)
        if values is not None:
            found[channel] = values[begun][:, columns]
    return found


ROS_BAG = LogReader("ROS 2 bag", (".mcap", FOLDER), is_bag, read_ros_bag)


def _read(path: Path) -> tuple[dict[str, _Topic], dict[str, str]]:
    """Every topic of JointState that has messages, and the types of all topics by name."""
    topics: dict[str, _Topic] = {}
    types: dict[str, str] = {}
    try:
        for topic, time, message in _messages(path, types):
            known = topics.setdefault(topic, _Topic(tuple(message.name)))
            if tuple(message.name) != known.names or len(set(known.names)) != len(known.names):
                problem = f"message {len(known.times)} of {topic} is of the joints {list(message.name)[:8]}"
                raise LogError(problem, where=path, remedy="record the same joints in every message")
            known.times.append(time)
            for name, values in known.values.items():
                values.extend(getattr(message, name))
    except LogError:
        raise
    except Exception as error:  # a decoder of damaged bytes may end in anything
        raise unreadable(path, error) from error
    return topics, types


def _messages(path: Path, types: dict[str, str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of recording [ns] and content of every JointState, in order of time; fills in the types of topics."""
    try:
        import mcap.reader  # noqa: F401  # pyright: ignore[reportMissingImports]
        from mcap_ros2.decoder import DecoderFactory  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise LogError(
            "ROS 2 bags need the libraries mcap and mcap-ros2-support", where=path,
            remedy='pip install "motorprior[ros]"',
        ) from error  # fmt: skip
    with open(path, "rb") as file:
        summary = _summary(file, path)
        types |= {channel.topic: _type(summary, channel) for channel in summary.channels.values()}
        kinds = {number: kind for number, kind in summary.schemas.items() if kind.name == JOINT_STATE}
        channels = {number: channel for number, channel in summary.channels.items() if channel.schema_id in kinds}
        if not channels:
            raise LogError(f"no topic of {JOINT_STATE}{_others(types)}", where=path, remedy=_REMEDY)
        found = [
            (message.log_time, message.channel_id, message.data)
            for message in mcap_messages(file, summary.chunk_indexes, set(channels), path)
        ]
    factory = DecoderFactory()
    decoders = {}
    for number, channel in channels.items():
        decoders[number] = decoder = factory.decoder_for(channel.message_encoding, kinds[channel.schema_id])
        if decoder is None:
            problem = f"messages of {channel.topic} are encoded as {channel.message_encoding[:40]!r}"
            raise LogError(problem, where=path, remedy="record it with ROS 2, whose encoding is cdr")
    for time, number, data in sorted(found, key=itemgetter(0)):
        yield channels[number].topic, time, decoders[number](data)


def _summary(file: IO[bytes], path: Path) -> Any:
    summary = mcap_summary(file, path)
    if summary is None:
        problem = "the bag has no summary: its recorder was not closed"
        raise LogError(problem, where=path, remedy="repair it with `mcap recover`")
    return summary


def _type(summary: Any, channel: Any) -> str:
    return summary.schemas[channel.schema_id].name if channel.schema_id in summary.schemas else "no type"


def _others(types: dict[str, str]) -> str:
    """The topics of other types, for an error."""
    found = [f"{topic} ({kind})" for topic, kind in sorted(types.items()) if kind != JOINT_STATE]
    return f"; others: {', '.join(found[:_SHOWN])}{', …' if len(found) > _SHOWN else ''}" if found else ""


def _state_and_command(topics: dict[str, _Topic], types: dict[str, str], path: Path) -> tuple[_Topic, _Topic]:
    states = [topic for topic in topics if topic.rsplit("/", 1)[-1] == STATES]
    if len(topics) != 2 or len(states) != 1:
        found = ", ".join(sorted(topics))[:300] or "without messages"
        problem = f"its topics of {JOINT_STATE} are {found}{_others(types)}"
        raise LogError(problem, where=path, remedy=_REMEDY)
    (command,) = topics.keys() - states
    return topics[states[0]], topics[command]
