"""Columns of a ROS 2 bag for a column map: numbers in the messages of any topics.

    TOPIC:FIELD          /lowstate:motor_state[3].q, /joint_states:position[elbow], /cmd:points[0].positions[2]

FIELD is a path of fields separated by points. A list element is given by its index or, in a message that lists joint
names (``name`` or ``joint_names``), by a joint's name. ``log_time`` is the recorder's clock. A row is a message of one
topic, with the last message before it of every other topic.
"""

from __future__ import annotations

import re
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, quoted
from motorprior.logs.formats.bag_messages import NANOSECOND, Bag, opened_bag
from motorprior.logs.log_errors import CORRECT, missing_column

CLOCK = "log_time"
_POINT = re.compile(r"\.(?![^\[]*\])")  # between fields, not within a joint's name
_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)

Steps = list[tuple[str, str | None]]  # fields with their list elements, from a message to a number


def bag_columns(path: Path, names: list[str], row_column: str) -> dict[str, np.ndarray]:
    """Name -> (rows,) float64.

    Args:
        path: of the bag.
        names: CLOCK, in seconds since the first row, or TOPIC:FIELD.
        row_column: any TOPIC:FIELD of the topic whose messages are the rows.

    Raises:
        LogError: as `bag_messages.opened_bag`; a missing topic or field; names topic, message and field.
    """
    wanted: dict[str, dict[str, Steps]] = {}
    numbers = [name for name in dict.fromkeys(names) if name != CLOCK]
    for name in numbers:
        topic, steps = _parsed(name, path)
        wanted.setdefault(topic, {})[name] = steps
    with opened_bag(path) as bag:
        for topic in wanted.keys() - bag.types.keys():
            raise missing_column("topic", topic, bag.types, bag.path)
        times, table = _rows(bag, wanted, _parsed(row_column, path)[0], numbers)
    found = dict(zip(numbers, table.T, strict=True)) | {CLOCK: NANOSECOND * (times - times[:1])}
    return {name: found[name] for name in names}


def _rows(bag: Bag, wanted: dict[str, dict[str, Steps]], row_topic: str, names: list[str]) -> tuple[np.ndarray, ...]:
    """Times (rows,) [ns] and numbers (rows, names), from the first row for which every topic has a message."""
    times, values = array("q"), array("d")
    latest: dict[str, float] = {}
    count = dict.fromkeys(wanted, 0)
    for topic, time, message in bag.messages(wanted.keys()):
        for name, steps in wanted[topic].items():
            try:
                latest[name] = _number(message, steps)
            except (AttributeError, LookupError, TypeError, ValueError) as error:
                problem = f"message {count[topic]} has no number {quoted(name, 120)} ({str(error)[:120]})"
                raise LogError(problem, where=bag.path, remedy=CORRECT) from error
        count[topic] += 1
        if topic == row_topic and len(latest) == len(names):
            times.append(time)
            values.extend(latest[name] for name in names)
    if silent := [topic for topic, messages in count.items() if not messages]:
        raise LogError(f"no message of {quoted(silent[0])}", where=bag.path, remedy=CORRECT)
    table = np.frombuffer(values, dtype=np.float64).reshape(len(times), len(names))
    return np.frombuffer(times, dtype=np.int64), table


def _parsed(name: str, path: Path) -> tuple[str, Steps]:
    """Topic, and the path through its messages."""
    topic, colon, text = name.partition(":")
    steps = [_STEP.fullmatch(step) for step in _POINT.split(text)]
    if not (topic and colon and all(steps)):
        remedy = f"name {CLOCK}, or TOPIC:FIELD, as /lowstate:motor_state[3].q or /joint_states:position[elbow]"
        raise LogError(f"{quoted(name)} is not TOPIC:FIELD", where=path, remedy=remedy, argument="columns")
    return topic, [(step[1], step[2]) for step in steps if step]


def _number(message: Any, steps: Steps) -> float:
    value = message
    for attribute, element in steps:
        value = getattr(value, attribute)
        if element is not None:
            value = value[_index(message, element)]
    if not isinstance(value, (int, float)):
        raise TypeError(f"it is a {type(value).__name__}")
    return float(value)


def _index(message: Any, element: str) -> int:
    """Index of a list element, given by number or by a joint's name."""
    names = [name for field in ("name", "joint_names") for name in getattr(message, field, ())]
    if element.isdecimal() and (element not in names or names.index(element) == int(element)):
        return int(element)
    if element.isdecimal() or names.count(element) != 1:
        raise LookupError(f"the message lists the joints {names[:8]}")
    return names.index(element)
