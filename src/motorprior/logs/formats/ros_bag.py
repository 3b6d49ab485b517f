"""ROS 2 bags become `MotorLog`s: two topics of sensor_msgs/JointState, one of states and one of commands.

The states' topic is called ``joint_states``, in any namespace; the other topic of that type is the command. A row is a
state, at the time at which the recorder wrote it, with the command in force: both topics on one clock. A velocity or an
effort that is NaN in every row of some joint is left out: so says the broadcaster of ros2_control that there is none.
Bags of other topics are read by a column map (`bag_columns`).
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.bag_messages import NANOSECOND, Bag, is_bag, opened_bag
from motorprior.logs.formats.log_reader import FOLDER, SAY_COLUMNS, LogReader
from motorprior.logs.formats.mapped_table import if_it_has
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

JOINT_STATE = "sensor_msgs/msg/JointState"
STATES = "joint_states"
_MEASURED = {"joint_pos": "position", "joint_vel": "velocity", "joint_torque": "effort"}
_REMEDY = f"give one topic {STATES} and one of commands, both {JOINT_STATE}; or read its topics {SAY_COLUMNS}"


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
        path: a .mcap file, or the folder that holds one.
        robot: names the log's robot and motor, and orders its joints, if these joints are its own.

    Raises:
        LogError: as `bag_messages.opened_bag`; not one topic of states and one of commands; messages whose joints
            change; names the topic.
    """
    with opened_bag(Path(path)) as bag:
        where, (state, command) = bag.path, _state_and_command(_read(bag), bag)
    if missing := sorted(set(command.names) - set(state.names)):
        raise LogError(f"the command has a joint {missing[0]!r}, the states have none", where=where, remedy=_REMEDY)
    robot = if_it_has(robot, command.names)
    joints = tuple(name for name in robot.joint_names if name in command.names) if robot else command.names
    log = MotorLog(
        **_aligned(state, command, joints, where), joint_names=joints, robot=robot.name if robot else "",
        motor=robot.motor if robot else "", source=str(where), encoder=robot.encoder if robot else "joint",
    )  # fmt: skip
    return checked(log, where=where)


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
        if values is not None and (word == "position" or not _is_absent(values[:, columns])):
            found[channel] = values[begun][:, columns]
    return found


def _is_absent(values: np.ndarray) -> bool:
    """Whether some joint never says it."""
    return bool(np.isnan(values).all(axis=0).any())


ROS_BAG = LogReader("ROS 2 bag", (".mcap", FOLDER), is_bag, read_ros_bag)


def _read(bag: Bag) -> dict[str, _Topic]:
    """Every topic of JointState that has messages."""
    topics: dict[str, _Topic] = {}
    wanted = {topic for topic, kind in bag.types.items() if kind == JOINT_STATE}
    if not wanted:
        others = bag.topics_but(JOINT_STATE)
        problem = f"no topic of {JOINT_STATE}{f'; others: {others}' if others else ''}"
        raise LogError(problem, where=bag.path, remedy=_REMEDY, argument="columns")
    for topic, time, message in bag.messages(wanted):
        known = topics.setdefault(topic, _Topic(tuple(message.name)))
        if tuple(message.name) != known.names or len(set(known.names)) != len(known.names):
            problem = f"message {len(known.times)} of {topic} is of the joints {list(message.name)[:8]}"
            raise LogError(problem, where=bag.path, remedy="record the same joints in every message")
        known.times.append(time)
        for name, values in known.values.items():
            values.extend(getattr(message, name))
    return topics


def _state_and_command(topics: dict[str, _Topic], bag: Bag) -> tuple[_Topic, _Topic]:
    states = [topic for topic in topics if topic.rsplit("/", 1)[-1] == STATES]
    if len(topics) != 2 or len(states) != 1:
        found, others = ", ".join(sorted(topics))[:300] or "without messages", bag.topics_but(JOINT_STATE)
        problem = f"its topics of {JOINT_STATE} are {found}{f'; others: {others}' if others else ''}"
        raise LogError(problem, where=bag.path, remedy=_REMEDY, argument="columns")
    (command,) = topics.keys() - states
    return topics[states[0]], topics[command]
