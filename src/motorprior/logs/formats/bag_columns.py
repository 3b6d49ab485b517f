"""Columns of a ROS 2 bag for a column map: numbers in the messages of any topics.

    TOPIC:FIELD          /lowstate:motor_state[3].q, /joint_states:position[elbow], /cmd:points[0].positions[2]

FIELD is the way to a number: fields joined by points, elements of a list by their place or, in a message that names
its joints (``name`` or ``joint_names``), by a joint's name. CLOCK is the time at which the recorder wrote the message.
A row is a message of one topic, with the last message before it of every other one; rows begin where all have said
something.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown
from motorprior.logs.formats.bag_messages import NANOSECOND, Bag, opened_bag
from motorprior.logs.formats.table_columns import CORRECT

CLOCK = "log_time"
NAMES = ("name", "joint_names")
"""Fields of a message that name its joints."""
_POINT = re.compile(r"\.(?![^\[]*\])")
"""Between fields, not within a joint's name."""
_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)
_FORM = "TOPIC:FIELD, as /lowstate:motor_state[3].q or /joint_states:position[elbow]"

Way = Callable[[Any], float]
"""From a message to a number."""


def bag_columns(path: Path, names: list[str], rows: str) -> dict[str, np.ndarray]:
    """Name -> (rows,) float64.

    Args:
        path: of the bag.
        names: CLOCK, in seconds since the first row, or TOPIC:FIELD.
        rows: any TOPIC:FIELD of the topic whose messages are the rows.

    Raises:
        LogError: as `bag_messages.opened_bag`; no such topic; a message that lacks a field; names topic, message and
            field.
    """
    wanted: dict[str, dict[str, Way]] = {}
    numbers = [name for name in dict.fromkeys(names) if name != CLOCK]
    for name in numbers:
        topic, way = _parted(name, path)
        wanted.setdefault(topic, {})[name] = way
    with opened_bag(path) as bag:
        if strange := sorted(wanted.keys() - bag.types.keys()):
            problem = f"no topic {shown(strange[0])}; it has {bag.topics_but() or 'none'}"
            raise LogError(problem, where=bag.path, remedy=CORRECT)
        found = _rows(bag, wanted, _parted(rows, path)[0], numbers)
    time = NANOSECOND * (found[CLOCK] - found[CLOCK][:1])
    return {name: time if name == CLOCK else found[name] for name in names}


def _rows(bag: Bag, wanted: dict[str, dict[str, Way]], topic_of_rows: str, names: list[str]) -> dict[str, np.ndarray]:
    """(rows,) by name, CLOCK in nanoseconds."""
    times, values = array("q"), array("d")
    latest: dict[str, float] = {}
    count = dict.fromkeys(wanted, 0)
    for topic, time, message in bag.messages(wanted.keys()):
        for name, way in wanted[topic].items():
            latest[name] = _number(way, message, name, count[topic], bag)
        count[topic] += 1
        if topic == topic_of_rows and len(latest) == len(names):
            times.append(time)
            values.extend(latest[name] for name in names)
    if silent := [topic for topic, messages in count.items() if not messages]:
        raise LogError(f"no message of {shown(silent[0])}", where=bag.path, remedy=CORRECT)
    table = np.frombuffer(values, dtype=np.float64).reshape(len(times), len(names))
    return {CLOCK: np.frombuffer(times, dtype=np.int64)} | dict(zip(names, table.T, strict=True))


def _number(way: Way, message: Any, name: str, index: int, bag: Bag) -> float:
    try:
        return way(message)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        problem = f"message {index} of the topic has no number {name[:120]!r} ({str(error)[:120]})"
        raise LogError(problem, where=bag.path, remedy=CORRECT) from error


def _parted(name: str, path: Path) -> tuple[str, Way]:
    """Topic, and the way through its messages."""
    topic, colon, text = name.partition(":")
    steps = [_STEP.fullmatch(step) for step in _POINT.split(text)]
    if not (topic and colon and all(steps)):
        problem = f"{shown(name)} names no number of a bag's messages"
        raise LogError(problem, where=path, remedy=f"name {CLOCK} for the time, and {_FORM}", argument="columns")
    way = [(step[1], step[2]) for step in steps if step]
    return topic, lambda message: _followed(message, way)


def _followed(message: Any, way: list[tuple[str, str | None]]) -> float:
    value = message
    for attribute, element in way:
        value = getattr(value, attribute)
        if element is not None:
            value = value[_place(message, element)]
    if not isinstance(value, (int, float)):
        raise TypeError(f"it is a {type(value).__name__}")
    return float(value)


def _place(message: Any, element: str) -> int:
    """Of an element of a list: its number, or that of a joint among those that a message names."""
    names = [name for field in NAMES for name in getattr(message, field, ())]
    if element.isdecimal() and (element not in names or names.index(element) == int(element)):
        return int(element)
    if element.isdecimal() or names.count(element) != 1:
        raise LookupError(f"it names the joints {names[:8]}")
    return names.index(element)
