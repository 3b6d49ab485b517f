"""Recordings of a motor that swings a known pendulum, in the JSON of Rhoban/bam, become `MotorLog`s with their load.

A file holds ``mass`` [kg] at ``length`` [m], ``kp`` (the firmware's gain, in its own unit), ``motor``, perhaps ``vin``,
the voltage of the supply [V], which counts where rows lack one, and ``entries`` with ``timestamp`` [s],
``goal_position`` and ``position`` [rad], 0 where the pendulum hangs, and, where they were recorded, ``speed`` [rad/s],
``input_volts`` [V], ``temp`` [°C] and ``torque_enable``; where that is false the goal may be null. Of a point mass, and
of an arm of ``arm_mass`` if the file says one (a uniform rod),

    load_inertia = (mass + arm_mass/3)·length²,  external_torque = -(mass + arm_mass/2)·g·length·sin(joint_pos),

and load_stiffness the derivative of the latter.

Rows in which the torque was off are left out; a segment ends there, and the log's source says how many.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import is_number
from motorprior.exceptions import LogError
from motorprior.files import read_text
from motorprior.logs.formats.log_reader import LogReader
from motorprior.logs.held_runs import runs_of
from motorprior.logs.motor_log import CONDITIONS, MotorLog
from motorprior.logs.validity import checked

ENDINGS = (".json", ".json.gz")
GRAVITY = 9.81
MAX_BYTES = 15_000_000
_REMEDY = "give a file of Rhoban/bam (mass, length, kp, motor, entries)"
_MOST = {"mass": 100.0, "length": 10.0, "arm_mass": 100.0, "kp": 1e6}
_CONDITIONS = {"supply_voltage": "input_volts", "motor_temperature": "temp"}
"""Channels and the entries that have them, where they were recorded."""
_MIN_ROWS = 2


def read_bam(path: str | Path) -> MotorLog:
    """Read one recording, with its gain as stated_kp in the firmware's unit.

    Raises:
        LogError: missing or damaged file, no JSON, an entry that is missing or no finite number (its row, name and
            value), times that do not increase, or a torque that was never on.
    """
    path = Path(path)
    content = _content(path)
    mass, length, kp = (_positive(content, name, path) for name in ("mass", "length", "kp"))
    arm = _positive(content, "arm_mass", path) if content.get("arm_mass") else 0.0
    time, angle = (_numbers(content["entries"], name, path) for name in ("timestamp", "position"))
    enabled = _enabled(content["entries"], path)
    target = angle.copy()  # of rows that are left out
    target[enabled] = _numbers(content["entries"], "goal_position", path, enabled)
    measured = _conditions(content)
    if _any_has("speed", content["entries"]):
        measured["joint_vel"] = _numbers(content["entries"], "speed", path)[:, None]
    log = MotorLog(
        time=time, position_target=target[:, None], joint_pos=angle[:, None], **measured,
        load_inertia=np.full((len(angle), 1), (mass + arm / 3.0) * length**2),
        external_torque=(-(mass + arm / 2.0) * GRAVITY * length * np.sin(angle))[:, None],
        load_stiffness=(-(mass + arm / 2.0) * GRAVITY * length * np.cos(angle))[:, None],
        stated_kp=np.full((len(angle), 1), kp), gain_unit="firmware",
        joint_names=("pendulum",), robot="pendulum", motor=_text(content, "motor", path), source=str(path),
    )  # fmt: skip
    return _with_torque(checked(log, where=path), enabled, path)


BAM = LogReader("pendulum of Rhoban/bam", ENDINGS, lambda path: path.is_file(), lambda path, robot: read_bam(path))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_text(path, MAX_BYTES, LogError))
    except (ValueError, RecursionError) as error:
        raise LogError(f"not JSON ({error})", where=path, remedy="copy the file again") from error
    if not isinstance(content, dict) or not isinstance(content.get("entries"), list) or not content["entries"]:
        raise LogError("no table with a list of entries", where=path, remedy=_REMEDY)
    return content


def _conditions(content: dict[str, Any]) -> dict[str, Any]:
    """Those of CONDITIONS that every row has, within bounds; a recorder writes 0 where it read none."""
    found = {}
    for channel, name in _CONDITIONS.items():
        values = [entry.get(name) if isinstance(entry, dict) else None for entry in content["entries"]]
        if channel == "supply_voltage" and not all(_bears(channel, value) for value in values):
            values = [content.get("vin")] * len(values)
        if all(_bears(channel, value) for value in values):
            found[channel] = np.array(values, dtype=np.float64)[:, None]
    return found


def _bears(channel: str, value: object) -> bool:
    return is_number(value, *CONDITIONS[channel]) and value != 0


def _positive(content: dict[str, Any], name: str, path: Path) -> float:
    value: Any = content.get(name)
    if not is_number(value, 0.0, _MOST[name]) or value == 0.0:
        problem = f"{name} = {repr(value)[:40]} is no number above 0 and up to {_MOST[name]:g}"
        raise LogError(problem, where=path, remedy=_REMEDY)
    return float(value)


def _text(content: dict[str, Any], name: str, path: Path) -> str:
    if not isinstance(content.get(name), str):
        raise LogError(f"{name} = {repr(content.get(name))[:40]} is no text", where=path, remedy=_REMEDY)
    return content[name]


def _numbers(entries: list[Any], name: str, path: Path, rows: np.ndarray | None = None) -> np.ndarray:
    """Of all rows, or of those that a mask (T,) selects."""
    values = {
        row: entry.get(name) if isinstance(entry, dict) else None
        for row, entry in enumerate(entries)
        if rows is None or rows[row]
    }
    for row, value in values.items():
        if not is_number(value):
            raise LogError(f"row {row}, {name} is {repr(value)[:40]}, not a finite number", where=path, remedy=_REMEDY)
    return np.array(list(values.values()), dtype=np.float64)


def _any_has(name: str, entries: list[Any]) -> bool:
    return any(entry.get(name) is not None for entry in entries)


def _enabled(entries: list[Any], path: Path) -> np.ndarray:
    flags = [entry.get("torque_enable", True) for entry in entries]
    for row, flag in enumerate(flags):
        if flag not in (True, False):
            raise LogError(f"row {row}, torque_enable is {repr(flag)[:40]}", where=path, remedy=_REMEDY)
    return np.array(flags, dtype=bool)


def _with_torque(log: MotorLog, enabled: np.ndarray, path: Path) -> MotorLog:
    if enabled.all():
        return log
    runs = runs_of(log, enabled)
    runs = runs.where(runs.stops - runs.starts >= _MIN_ROWS)
    if not runs.starts.size:
        raise LogError("the torque is off in every row", where=path, remedy="record with torque")
    rows = np.concatenate([np.arange(start, stop) for start, stop in zip(runs.starts, runs.stops, strict=True)])
    segment = np.repeat(np.arange(len(runs.starts)), runs.stops - runs.starts)
    left_out = f"{path} ({log.num_rows - len(rows)} rows without torque left out)"
    return checked(replace(log.rows(rows), segment=segment, source=left_out), where=path)
