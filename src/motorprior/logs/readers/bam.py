"""Recordings of a motor that swings a known pendulum, in the JSON of Rhoban/bam.

A file holds ``mass`` [kg] at ``length`` [m], ``kp`` (in firmware units), ``motor``, optionally
``vin``, the supply voltage [V], used where rows lack one, and ``entries`` with ``timestamp`` [s],
``goal_position`` and ``position`` [rad], 0 where the pendulum hangs down; optionally ``speed``
[rad/s], ``input_volts`` [V], ``temp`` [°C], ``torque_enable``. For a point mass and an optional arm
of ``arm_mass`` (a uniform rod),

    load_inertia = (mass + arm_mass/3)·length²,  external_torque = -(mass +
    arm_mass/2)·g·length·sin(joint_pos),

and load_stiffness is the derivative of the latter. Rows with the torque off are dropped; a segment
ends there.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_text
from motorprior.bounds import is_number
from motorprior.exceptions import LogError, quoted
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import NUMBER, OPERATING_CONDITIONS, MotorLog, bad_value, checked
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.signals import runs_of_true

_REMEDY = "give a file of Rhoban/bam (mass, length, kp, motor, entries)"


def read_bam(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read one recording; raises LogError, also if the torque was never on."""
    try:
        content = json.loads(read_text(path, LogError))
        entries = content["entries"]
        enabled = np.array([bool(entry.get("torque_enable", True)) for entry in entries])
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError) as error:
        raise LogError(
            f"not JSON with a list of entries ({error})", where=path, remedy=_REMEDY
        ) from error
    mass, length, kp = (_positive(content, name, path) for name in ("mass", "length", "kp"))
    arm = _positive(content, "arm_mass", path) if content.get("arm_mass") else 0.0
    # where the torque is off, the goal may be null
    goals = [
        entry if on else entry | {"goal_position": 0.0}
        for entry, on in zip(entries, enabled, strict=True)
    ]
    angle = _column(entries, "position", path)
    measured = _conditions(content)
    if any(entry.get("speed") is not None for entry in entries):
        measured["joint_vel"] = _column(entries, "speed", path)
    log = MotorLog(
        time=_column(entries, "timestamp", path)[:, 0],
        position_target=_column(goals, "goal_position", path),
        joint_pos=angle,
        **measured,
        load_inertia=np.full_like(angle, (mass + arm / 3.0) * length**2),
        external_torque=-(mass + arm / 2.0) * GRAVITY * length * np.sin(angle),
        load_stiffness=-(mass + arm / 2.0) * GRAVITY * length * np.cos(angle),
        logged_kp=np.full_like(angle, kp),
        gain_unit="firmware",
        joint_names=("pendulum",),
        robot="pendulum",
        motor=str(content.get("motor", "")),
        source=str(path),
    )
    log = checked(log)
    runs = [run for run in runs_of_true(enabled).tolist() if run[1] - run[0] >= 2]
    if not runs:
        raise LogError("the torque is off in every row", where=path, remedy="record with torque")
    if enabled.all():
        return log
    rows = np.concatenate([np.arange(*run) for run in runs])
    segment = np.repeat(np.arange(len(runs)), [stop - start for start, stop in runs])
    source = f"{path} ({log.num_rows - len(rows)} rows without torque left out)"
    return checked(replace(log.rows(rows), segment=segment, source=source))


READER = LogReader("pendulum of Rhoban/bam", (".json", ".json.gz"), read=read_bam)


def _conditions(content: dict[str, Any]) -> dict[str, Any]:
    """Voltage and temperature if all rows have them within bounds; the recorder writes 0 for a failed read."""
    found = {}
    default = content.get("vin")
    for channel, name in (("supply_voltage", "input_volts"), ("motor_temperature", "temp")):
        rows = [entry.get(name) for entry in content["entries"]]
        for values in (rows, [default] * len(rows) if channel == "supply_voltage" else []):
            if values and all(
                is_number(value, *OPERATING_CONDITIONS[channel][:2]) and value != 0
                for value in values
            ):
                found[channel] = np.array(values, dtype=np.float64)[:, None]
                break
    return found


def _positive(content: dict[str, Any], name: str, path: Path) -> float:
    value: Any = content.get(name)
    if not is_number(value, 1e-12):
        raise LogError(
            f"{name} {quoted(value)} is not a positive number", where=path, remedy=_REMEDY
        )
    return float(value)


def _column(entries: list[dict[str, Any]], name: str, path: Path) -> np.ndarray:
    """(T, 1) numbers of all entries."""
    values = [entry.get(name) for entry in entries]
    for row, value in enumerate(values):
        if not is_number(value):
            raise bad_value(row, name, value, NUMBER, path, _REMEDY)
    return np.array(values, dtype=np.float64)[:, None]
