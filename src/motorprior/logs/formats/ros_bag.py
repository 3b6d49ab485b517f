"""ROS 2 bags with two topics of sensor_msgs/JointState: states and commands.

The states' topic is named ``joint_states``, in any namespace; the other topic is the command. A row is a state at the
recorder's time, with the command in force. A velocity or effort that is NaN throughout for some joint is dropped:
ros2_control writes NaN for a missing interface. Bags of other topics need a column map (`bag_columns`).
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.bag_messages import NANOSECOND, Bag, is_bag, opened_bag
from motorprior.logs.formats.log_reader import FOLDER, GIVE_COLUMNS, LogReader
from motorprior.logs.formats.mapped_table import robot_of_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

JOINT_STATE = "sensor_msgs/msg/JointState"
_MEASURED = {"joint_pos": "position", "joint_vel": "velocity", "joint_torque": "effort"}
_REMEDY = f"give one topic joint_states and one of commands, both {JOINT_STATE}; or read the bag {GIVE_COLUMNS}"


@dataclass
class _Topic:
    """Times [ns] of a topic's messages, and by field the values of all messages one after another."""

    names: tuple[str, ...]
    times: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(
        default_factory=lambda: {name: array("d") for name in _MEASURED.values()}
    )  # fmt: skip

    def series(self, name: str) -> np.ndarray | None:
        """(T, J), or None unless every message has the field."""
        values = np.frombuffer(self.values[name], dtype=np.float64)
        rows, joints = len(self.times), len(self.names)
        return values.reshape(rows, joints) if len(values) == rows * joints else None


def read_ros_bag(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read one bag.

    Args:
        path: a .mcap file, or the folder that holds one.
        robot: gives robot, motor and order of the joints if it has these joints.

    Raises:
        LogError: as `bag_messages.opened_bag`; not exactly one topic of states and one of commands; messages whose
            joints change.
    """
    with opened_bag(Path(path)) as bag:
        where, (state, command) = bag.path, _state_and_command(bag)
    if missing := sorted(set(command.names) - set(state.names)):
        raise LogError(f"the command has a joint {missing[0]!r}, the states have none", where=where, remedy=_REMEDY)
    robot = robot_of_joints(robot, command.names)
    joints = tuple(name for name in robot.joint_names if name in command.names) if robot else command.names
    log = MotorLog(
        **_aligned(state, command, joints, where), joint_names=joints, robot=robot.name if robot else "",
        motor=robot.motor if robot else "", source=str(where), encoder=robot.encoder if robot else "joint",
    )  # fmt: skip
    return checked(log, where=where)


ROS_BAG = LogReader("ROS 2 bag", (".mcap", FOLDER), is_bag, read_ros_bag)


def _state_and_command(bag: Bag) -> tuple[_Topic, _Topic]:
    topics: dict[str, _Topic] = {}
    wanted = {topic for topic, kind in bag.types.items() if kind == JOINT_STATE}
    for topic, time, message in bag.messages(wanted) if wanted else ():
        known = topics.setdefault(topic, _Topic(tuple(message.name)))
        if tuple(message.name) != known.names or len(set(known.names)) != len(known.names):
            problem = f"message {len(known.times)} of {topic} has the joints {list(message.name)[:8]}"
            raise LogError(problem, where=bag.path, remedy="record the same joints in every message")
        known.times.append(time)
        for name, values in known.values.items():
            values.extend(getattr(message, name))
    states = [topic for topic in topics if topic.rsplit("/", 1)[-1] == "joint_states"]
    if len(topics) != 2 or len(states) != 1:
        problem = f"no topic of states and one of commands; it has {bag.topics_text()}"
        raise LogError(problem, where=bag.path, remedy=_REMEDY, argument="columns")
    (command,) = topics.keys() - states
    return topics[states[0]], topics[command]


def _aligned(state: _Topic, command: _Topic, joints: tuple[str, ...], path: Path) -> dict[str, Any]:
    """Channels of the rows that have a command."""
    time, since = (np.frombuffer(topic.times, dtype=np.int64) for topic in (state, command))
    begun = time >= since[0]
    in_force = np.searchsorted(since, time[begun], side="right") - 1
    targets = command.series("position")
    if targets is None or state.series("position") is None:
        raise LogError("a message lacks positions", where=path, remedy=_REMEDY)
    columns = [state.names.index(name) for name in joints]
    found: dict[str, Any] = {"time": NANOSECOND * (time[begun] - time[0])}
    found["position_target"] = targets[in_force][:, [command.names.index(name) for name in joints]]
    for channel, name in _MEASURED.items():
        values = state.series(name)
        if values is None or (name != "position" and np.isnan(values[:, columns]).all(axis=0).any()):
            continue
        found[channel] = values[begun][:, columns]
    return found
